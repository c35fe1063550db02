"""What README.md and docs/extending.md tell a reader to type works: every command and every block of Python."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
QDIL = ".venv/bin/qdil "
pytestmark = pytest.mark.physics


def blocks(page, language):
    """The code blocks of a page in one language."""
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / page).read_text(), re.S)


def commands(page):
    """The page's ``qdil`` commands, without comments. ``make`` is what runs these tests, or trains for hours."""
    lines = [line.split("  #")[0].strip() for block in blocks(page, "sh") for line in block.splitlines()]
    return [line.removeprefix(QDIL) for line in lines if line.startswith(QDIL)]


def run(arguments, folder):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module", params=["README.md", "docs/extending.md"])
def reader(request, tmp_path_factory):
    """A reader's folder with the runs that come with the repository, and the page's modules saved under their names."""
    folder = tmp_path_factory.mktemp("reader")
    (folder / "results").mkdir()
    (folder / "results" / "showcase").symlink_to(ROOT / "results" / "showcase")
    for block in blocks(request.param, "python"):
        if named := re.match(r"# (\w+\.py)\n", block):
            (folder / named[1]).write_text(block)
    return request.param, folder


def test_every_command_works(reader):
    page, folder = reader
    listed = commands(page)
    assert len(listed) >= 4
    if not any("--method true" in line and "walker2d" in line for line in listed):  # an expert that the page presumes
        run([*shlex.split("-m qdil train --env walker2d --method true --budget smoke")], folder)
        run([*shlex.split("-m qdil demos --env walker2d --budget smoke")], folder)
    for line in listed:
        run(["-m", "qdil", *shlex.split(line)], folder)
    finished = {path.parent.parent.name for path in folder.glob("results/smoke/*/*/seed-1/manifest.json")}
    assert {"true", "mconbo-nearest"} <= finished
    assert any(path.name == "hopper2" for path in folder.glob("results/smoke/*"))


def test_every_block_of_python_works(reader):
    page, folder = reader
    for block in blocks(page, "python"):
        run(["-c", block], folder)
    if page == "README.md":
        assert (folder / "archive.html").stat().st_size > 10_000
        assert (folder / "gaits.gif").read_bytes()[:3] == b"GIF"
