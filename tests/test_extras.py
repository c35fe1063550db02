"""Without an extra, its feature ends in one sentence that names it, and all others work."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from qdil.errors import ConfigError
from qdil.extras import needs

pytestmark = pytest.mark.physics  # processes
ROOT = Path(__file__).parent.parent
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
# Modules whose distributions the extras install; Pillow is none of them, for matplotlib brings it.
MODULES = {
    "explorer": ("anywidget", "ipywidgets", "traitlets", "imageio_ffmpeg"),
    "sweeps": ("snakemake",),
    "notebooks": ("papermill", "nbformat", "nbclient", "ipykernel", "IPython", "jupyterlab", "sphinx", "myst_nb"),
}
# A Python process that lacks some modules and then executes its last argument.
WITHOUT = """
import importlib.metadata, sys
missing = sys.argv[1].split(",")
class Nothing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in missing:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Nothing())
found = importlib.metadata.Distribution.from_name
def from_name(name):
    if name in missing:
        raise importlib.metadata.PackageNotFoundError(name)
    return found(name)
importlib.metadata.Distribution.from_name = from_name
exec(sys.argv[2])
"""
COMMAND = "from qdil.cli import main; sys.exit(main({!r}.split()))"
BASE = """
import os, pkgutil, importlib, qdil
os.environ["QDIL_EXPLORER"] = "page"
for module in pkgutil.walk_packages(qdil.__path__, "qdil."):
    if module.name not in {"qdil.__main__", "qdil.explorer.widget"} and not module.name.startswith("qdil.series"):
        importlib.import_module(module.name)
run = "results/showcase/walker2d/true/seed-1"
assert qdil.explore(run, recordings=1).save(sys.argv[3] + "/page.html").stat().st_size > 100_000
assert qdil.render(run, 1, sys.argv[3] + "/gait.png", width=64).is_file()
"""


def without(extras: list[str], what: str, *arguments: str) -> subprocess.CompletedProcess:
    missing = ",".join(module for extra in extras for module in MODULES[extra])
    command = [sys.executable, "-c", WITHOUT, missing, what, *arguments]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)


def test_a_missing_package_becomes_a_sentence_and_a_missing_module_of_ours_stays_an_error():
    with pytest.raises(ConfigError, match=r"^flying needs the package no_such_wing: pip install 'qdil\[birds\]'$"):
        with needs("birds", "flying"):
            import no_such_wing.feather  # noqa: F401
    with pytest.raises(ModuleNotFoundError), needs("birds", "flying"):
        import qdil.no_such_module  # noqa: F401


def test_the_library_alone_needs_no_extra(tmp_path):
    ran = without(list(MODULES), BASE, str(tmp_path))
    assert ran.returncode == 0, ran.stderr


@pytest.mark.parametrize(
    "extras, arguments, sentence",
    [
        (["notebooks"], "notebooks", "the execution of notebooks needs the package nbformat: "),
        (["sweeps"], "notebooks", "the execution of notebooks needs the package snakemake: "),
    ],
)
def test_a_command_without_its_extra_ends_in_one_sentence(extras, arguments, sentence):
    ran = without(extras, COMMAND.format(arguments))
    assert (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr == f"qdil: {sentence}pip install 'qdil[notebooks]'\n"


@pytest.mark.parametrize(
    "call, message",
    [
        ("qdil.explore(run, live=True)", "the explorer in a live notebook needs the package anywidget: "),
        ("qdil.render(run, 1, '/nowhere/film.mp4')", "an .mp4 film needs the package imageio_ffmpeg: "),
    ],
)
def test_the_explorer_without_its_extra_names_it(call, message):
    ran = without(["explorer"], f"import qdil; run = 'results/showcase/walker2d/true/seed-1'; {call}")
    assert ran.stderr.splitlines()[-1] == f"qdil.errors.ConfigError: {message}pip install 'qdil[explorer]'"


def test_extras_hold_each_other_as_their_features_do():
    assert "qdil[explorer,sweeps]" in EXTRAS["notebooks"]
    assert EXTRAS["all"] == ["qdil[explorer,sweeps,notebooks,dev]"]
    assert set(EXTRAS) == {*MODULES, "dev", "all"}
