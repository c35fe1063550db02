"""Runs that are killed, interrupted or run out of disk, in separate processes, end with the same bytes."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from fake_runs import same_run

from qdil.cli import main
from qdil.config import make_config
from qdil.runs.folder import is_finished
from qdil.runs.train import train

pytestmark = pytest.mark.physics

ROOT = Path(__file__).parents[2]
ANNOUNCING = ROOT / "tests" / "announcing.py"
ITERATIONS = 8

# When a run is killed, in order: after its process has announced a step n times, and at most so many seconds later.
# Every process resumes where the one before it was killed, so the last ones have little left to do.
FEW = [("replace", 6, 0.1), ("remove", 1, 0.1)]
MANY = [
    ("", 0, 3.0), ("", 0, 6.0), ("begin", 1, 0.1), ("begin", 1, 4.0), ("warm_up", 2, 0.1), ("iteration", 3, 0.1),
    ("replace", 4, 0.1), ("iteration", 3, 0.1), ("reevaluate", 1, 0.1), ("replace", 2, 0.1), ("write", 1, 0.1),
    ("remove", 1, 0.1),
]  # fmt: skip


def killed(folder: Path, where: tuple[str, int, float], rng: random.Random) -> None:
    """Train until the given moment, and a little on; the process must then be alive, and die of the kill."""
    step, times, later = where
    process = subprocess.Popen(
        [sys.executable, str(ANNOUNCING), str(folder), str(ITERATIONS)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    while times > 0:
        line = process.stdout.readline()
        assert line, f"it ended before {where}"
        times -= line.strip() == step
    time.sleep(rng.uniform(0.0, later))
    process.send_signal(signal.SIGKILL)
    process.stdout.close()
    assert process.wait() == -signal.SIGKILL, f"it ended before the kill at {where} landed"


@pytest.mark.skipif(os.name != "posix", reason="kills processes")
@pytest.mark.parametrize("moments", [FEW, pytest.param(MANY, marks=pytest.mark.slow)], ids=["few", "many"])
def test_kills_change_nothing(tmp_path, moments):
    config = make_config("walker2d", "true", "smoke", iterations=ITERATIONS)
    train(config, tmp_path / "whole")
    rng, folder = random.Random(0), tmp_path / "killed"
    half_written = 0
    for where in moments:
        killed(folder, where, rng)
        half_written += sum(1 for path in folder.rglob(".*") if path.is_file())
    assert half_written > 0  # or no kill met a write
    assert is_finished(folder) and (folder / "checkpoint").exists()  # the last one met the very last step
    assert not train(config, folder)
    assert {path.name for path in folder.iterdir()} == {path.name for path in (tmp_path / "whole").iterdir()}
    assert same_run(folder, tmp_path / "whole")


LONG = 40  # iterations: seconds of training


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("long") / "run"
    train(make_config("walker2d", "true", "smoke", iterations=LONG), folder)
    return folder


WORDS = ["train", "--env", "walker2d", "--method", "true", "--budget", "smoke", "--set", f"iterations={LONG}", "--out"]


def qdil_train(folder: Path, first: str = "") -> subprocess.Popen:
    """``qdil train`` in a separate process that saves often; ``first`` is a statement that runs before it."""
    words = [*WORDS, str(folder), "--save-seconds", "0"]
    code = f"import resource, signal, sys; from qdil.cli import main\n{first}\nsys.exit(main({words!r}))"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, text=True, **pipes)


def wait_for_an_iteration(folder: Path, process: subprocess.Popen) -> None:
    """Wait until a checkpoint holds a QD iteration."""
    while process.poll() is None:
        if any(int(path.name.split("-")[1]) for path in (folder / "checkpoint").glob("[0-9]*.npz")):
            return
        time.sleep(0.01)
    raise AssertionError(process.communicate())


def test_control_c_leaves_a_folder_to_resume_from(tmp_path, uninterrupted, capsys):
    # A process in the background ignores this signal: handle it as in a person's shell.
    process = qdil_train(tmp_path, "signal.signal(signal.SIGINT, signal.default_int_handler)")
    wait_for_an_iteration(tmp_path, process)
    process.send_signal(signal.SIGINT)
    output = process.communicate(timeout=300)
    assert process.returncode == 1, output
    assert output[1] == "qdil: interrupted.\n"
    assert not is_finished(tmp_path)
    assert main([*WORDS, str(tmp_path)]) == 0
    output = capsys.readouterr().out
    assert "Resuming the unfinished run" in output and "is finished" in output
    assert same_run(tmp_path, uninterrupted)


def test_a_full_disk_is_reported_in_a_sentence_and_loses_nothing(tmp_path, uninterrupted):
    """A limit on the size of files stands for the disk: small ones still fit, a checkpoint does not."""
    limited = qdil_train(tmp_path, "resource.setrlimit(resource.RLIMIT_FSIZE, (5000, resource.RLIM_INFINITY))")
    output = limited.communicate(timeout=300)
    assert limited.returncode == 1, output
    assert output[1].splitlines()[-1].endswith(".npz: File too large.") and "Traceback" not in output[1], output
    assert [path.name for path in (tmp_path / "checkpoint").iterdir()] == ["lock"]
    assert main([*WORDS, str(tmp_path)]) == 0
    assert same_run(tmp_path, uninterrupted)
