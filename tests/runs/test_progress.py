"""What a person is told of a run: on a terminal, in a log, from its beginning and from the middle."""

import re
from pathlib import Path

import pytest

from qdil.runs import progress
from qdil.config import make_config
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
    told = {"iteration": iteration, "env_steps": env_steps, "coverage": 0.25, "qd_score": 1234.5, "best": 99.0}
    return {**told, "wall_seconds": 1e3, "not_finite": 0.0, "rolled_back": 0.0, **more}


def test_a_log_tells_the_beginning_and_now_and_then_an_iteration(clock, capsys):
    show = Progress(CONFIG, live=False)
    show.announce(FOLDER, None)
    assert capsys.readouterr().out == "walker2d gail: compiling, then 6 warm-up updates\n"
    clock[0] += 60.0  # compilation
    show(None, row(1, 5_000))
    assert capsys.readouterr().out == (
        "walker2d gail: iteration 1/10, coverage 25%, QD-score 1234, best 99\n"  # no speed: there is nothing to tell
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


def test_a_run_that_goes_on_says_so_and_counts_only_what_it_does_itself(clock, capsys):
    show = Progress(CONFIG, live=False)
    show.announce(FOLDER, (2, 0))
    said = capsys.readouterr().out
    assert said.startswith(f"Going on with the unfinished run in {FOLDER}: 0 of 10 iterations.\n")
    assert said.endswith("compiling, then 4 warm-up updates\n")
    show = Progress(CONFIG, live=False)
    show.announce(FOLDER, (6, 4))
    said = capsys.readouterr().out
    assert "4 of 10 iterations" in said and said.endswith("walker2d gail: compiling\n")
    show(None, row(5, 50_000))
    clock[0] += 20.0
    show(None, row(7, 60_000))
    assert "500 steps/s, 30 s left" in capsys.readouterr().out


def test_a_bar_starts_where_the_run_goes_on(clock, capsys):
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
    said = capsys.readouterr().err
    assert re.search(r"walker2d gail:\s+40%.* 4/10", said) and " 0/10" not in said


@pytest.mark.parametrize("live", [False, True])
def test_what_turned_not_finite_is_told_once_and_summed_up_at_the_end(live, clock, capsys):
    show = Progress(CONFIG, live)
    show.announce(FOLDER, None)
    show(None, row(1, 1.0))
    show(None, row(2, 2.0, not_finite=3.0))
    said = capsys.readouterr().out
    assert "walker2d gail: by iteration 2, 3 candidates left out because their physics diverged.\n" in said
    show(None, row(3, 3.0, not_finite=2.0))
    assert "diverged" not in capsys.readouterr().out
    show(None, row(4, 4.0, rolled_back=1.0, reward_rolled_back=1.0))
    said = capsys.readouterr().out
    assert "5 candidates left out" in said and "1 training phases undone" in said
    assert "1 rounds of the reward model's learning undone" in said
    show(None, row(10, 9.0))
    assert "by iteration 10, 5 candidates left out" in capsys.readouterr().out
    show.close()


def test_a_sound_run_says_nothing_of_trouble(clock, capsys):
    show = Progress(CONFIG, live=False)
    show.announce(FOLDER, None)
    for iteration in range(1, 11):
        show(None, row(iteration, iteration))
    said = capsys.readouterr().out
    assert "undone" not in said and "diverged" not in said


def test_devices_without_work_are_named_at_the_start(monkeypatch, capsys):
    monkeypatch.setattr(progress, "idle_devices", lambda requested, per_copy, candidates: "Using 5 of 8 devices.")
    Progress(CONFIG, live=False).announce(FOLDER, None)
    assert capsys.readouterr().out.splitlines()[0] == "Using 5 of 8 devices."
