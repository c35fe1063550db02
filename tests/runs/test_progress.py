"""What ``Progress`` prints of a run: on a terminal and in a log, for a new run and for one that resumes."""

import re
from pathlib import Path

import pytest

from qdil.config import make_config
from qdil.runs import progress
from qdil.runs.progress import Progress

CONFIG = make_config("walker2d", "gail", "smoke", iterations=10, warmup_updates=6)
FOLDER = Path("some") / "folder"


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still until it is moved."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def row(iteration: int, env_steps: float, **more: float) -> dict[str, float]:
    metrics = {"iteration": iteration, "env_steps": env_steps, "coverage": 0.25, "qd_score": 1234.5, "best": 99.0}
    return {**metrics, "wall_seconds": 1e3, "not_finite": 0.0, "rolled_back": 0.0, **more}


def test_a_log_has_the_start_and_an_iteration_now_and_then(clock, capsys):
    show = Progress(CONFIG, live=False)
    show.announce(FOLDER, None)
    assert capsys.readouterr().out == "walker2d gail: compiling, then 6 warm-up updates\n"
    clock[0] += 60.0  # compilation
    show(None, row(1, 5_000))
    assert capsys.readouterr().out == (
        "walker2d gail: iteration 1/10, coverage 25%, QD-score 1234, best 99\n"  # no speed yet
    )
    clock[0] += 2.0
    show(None, row(2, 7_000))
    assert capsys.readouterr().out == ""
    clock[0] += 18.0
    show(None, row(3, 25_000))
    assert capsys.readouterr().out == (
        "walker2d gail: iteration 3/10, coverage 25%, QD-score 1234, best 99, 1,000 steps/s, 70 s left\n"
    )
    show(None, row(10, 30_000))
    assert "iteration 10/10" in capsys.readouterr().out


def test_a_resumed_run_says_so_and_measures_its_own_speed(clock, capsys):
    show = Progress(CONFIG, live=False)
    show.announce(FOLDER, (2, 0))
    text = capsys.readouterr().out
    assert text.startswith(f"Resuming the unfinished run in {FOLDER}: 0 of 10 iterations.\n")
    assert text.endswith("compiling, then 4 warm-up updates\n")
    show = Progress(CONFIG, live=False)
    show.announce(FOLDER, (6, 4))
    text = capsys.readouterr().out
    assert "4 of 10 iterations" in text and text.endswith("walker2d gail: compiling\n")
    show(None, row(5, 50_000))
    clock[0] += 20.0
    show(None, row(7, 60_000))
    assert "500 steps/s, 30 s left" in capsys.readouterr().out


def test_a_bar_starts_where_the_run_resumes(clock, capsys):
    show = Progress(CONFIG, live=True)
    show.announce(FOLDER, (6, 4))
    assert (show.bar.n, show.bar.initial) == (4, 4)
    before = show.bar.start_t
    show(None, row(5, 50_000))
    assert (show.bar.n, show.bar.initial) == (5, 5) and show.bar.start_t >= before  # its speed counts from here
    clock[0] += 20.0
    show(None, row(7, 60_000))
    assert show.bar.n == 7 and "500 steps/s" in show.bar.postfix
    show.close()
    text = capsys.readouterr().err
    assert re.search(r"walker2d gail:\s+40%.* 4/10", text) and " 0/10" not in text


@pytest.mark.parametrize("live", [False, True])
def test_numbers_that_are_not_finite_are_reported_once_and_summed_up_at_the_end(live, clock, capsys):
    show = Progress(CONFIG, live)
    show.announce(FOLDER, None)
    show(None, row(1, 1.0))
    show(None, row(2, 2.0, not_finite=3.0))
    text = capsys.readouterr().out
    assert "walker2d gail: by iteration 2, 3 candidates left out because their physics diverged.\n" in text
    show(None, row(3, 3.0, not_finite=2.0))
    assert "diverged" not in capsys.readouterr().out
    show(None, row(4, 4.0, rolled_back=1.0, reward_rolled_back=1.0))
    text = capsys.readouterr().out
    assert "5 candidates left out" in text and "1 training phases discarded" in text
    assert "1 updates of the reward model discarded" in text
    show(None, row(10, 9.0))
    assert "by iteration 10, 5 candidates left out" in capsys.readouterr().out
    show.close()


def test_a_run_without_problems_reports_none(clock, capsys):
    show = Progress(CONFIG, live=False)
    show.announce(FOLDER, None)
    for iteration in range(1, 11):
        show(None, row(iteration, iteration))
    text = capsys.readouterr().out
    assert "discarded" not in text and "diverged" not in text


def test_idle_devices_are_named_at_the_start(monkeypatch, capsys):
    monkeypatch.setattr(progress, "idle_devices", lambda requested, per_copy, candidates: "Using 5 of 8 devices.")
    Progress(CONFIG, live=False).announce(FOLDER, None)
    assert capsys.readouterr().out.splitlines()[0] == "Using 5 of 8 devices."
