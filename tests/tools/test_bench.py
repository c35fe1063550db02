"""The arithmetic of ``qdil bench``; the measurements themselves only where whole runs are allowed."""

import json
import os
import threading
from typing import Any, NamedTuple

import jax.numpy as jnp
import pytest

from qdil.cli import main
from qdil.tools import bench


class Run(NamedTuple):
    """As much of ``ppga.Search`` as the bench moves from run to run."""

    archives: list
    xnes: Any
    rng: Any
    state: Any


def test_ratios_are_taken_within_a_round():
    # The machine slows down fourfold from round to round; the ratio must not notice.
    taken = {
        "simulator": [(100.0, 1.0), (100.0, 4.0), (100.0, 16.0)],
        "iteration": [(50.0, 1.0), (50.0, 4.0), (50.0, 16.0)],
    }
    speeds, over = bench._against(taken, "simulator")
    assert over == {"simulator": 1.0, "iteration": 0.5}
    assert speeds == {"simulator": 25.0, "iteration": 12.5}


def test_every_work_is_done_once_before_it_is_timed():
    calls = []

    def work(name):
        calls.append(name)
        return 1.0, 1.0

    taken = bench._in_turns({"a": lambda: work("a"), "b": lambda: work("b")}, 2)
    assert calls == ["a", "b", "a", "b", "a", "b"]
    assert taken == {"a": [(1.0, 1.0)] * 2, "b": [(1.0, 1.0)] * 2}


def test_table_and_json_show_every_robot():
    rows = {"walker2d": {"device_speedup": 1.83}, "humanoid": {"device_speedup": 1.9, "peak_memory_mb": 1024.0}}
    assert json.loads(bench.as_json(rows)) == rows
    lines = bench.table(rows).splitlines()
    assert lines[0].split() == ["walker2d", "humanoid"]
    assert lines[1].split() == ["device_speedup", "1.83", "1.9"] and lines[2].split()[1:] == ["nan", "1.02e+03"]


def test_speedup_compares_the_same_iterations(monkeypatch):
    """Searches of which only a number matters: it grows by one an iteration, and archives are changed in place."""
    searches = [Run([], None, None, jnp.asarray(at)) for at in (100, 5)]
    done = []

    def iteration(search):
        done.append((search.archives is searches[1].archives, len(search.archives), int(search.state)))
        search.archives.append("elite")
        return search._replace(state=search.state + 1), (1.0, 1.0)

    monkeypatch.setattr(bench, "_iteration", iteration)
    before, turn = bench._same_iterations(*searches)
    for _ in range(2):
        before()
        turn()
    assert done == [(False, 0, 5), (True, 0, 5), (False, 1, 6), (True, 1, 6)]


@pytest.mark.parametrize("arguments", [["--env", "ant"], ["--budget", "huge"], ["--rounds", "0"]])
def test_what_cannot_be_measured_is_refused(arguments, capsys):
    assert main(["bench", *arguments]) == 2
    assert capsys.readouterr().err.startswith("qdil: ")


@pytest.mark.slow
def test_all_promised_figures_are_measured(capsys):
    assert main(["bench", "--env", "walker2d", "--budget", "smoke", "--rounds", "1", "--json"]) == 0
    row = json.loads(capsys.readouterr().out)["walker2d"]
    promised = {
        "simulator_steps_per_second",
        "iteration_steps_per_second",
        "iteration_over_simulator",
        "device_speedup",
    }
    promised |= {"cold_start_seconds", "warm_start_seconds", "peak_memory_mb", "full_networks_over_floor"}
    assert promised <= set(row) and all(value > 0 for value in row.values())
    assert row["warm_start_seconds"] < row["cold_start_seconds"]


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="threads cannot be held to a core here")
def test_one_core_means_every_thread_and_only_for_the_turn():
    waiting = threading.Event()
    other = threading.Thread(target=waiting.wait)
    other.start()

    def cores() -> tuple[set[int], set[int]]:
        return os.sched_getaffinity(0), os.sched_getaffinity(other.native_id)

    before = cores()
    try:
        during = bench._on_one_core(cores)()
        assert len(during[0]) == 1 and during[0] == during[1] and cores() == before
        with pytest.raises(ZeroDivisionError):
            bench._on_one_core(lambda: 1 / 0)()
        assert cores() == before
    finally:
        waiting.set()
