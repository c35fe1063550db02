"""The arithmetic of ``qdil bench``; the measurements themselves only where whole runs are allowed."""

import json
import os
import threading
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import pytest

from qdil.cli import main
from qdil.errors import ConfigError
from qdil.tools import against, bench, timing, workloads
from qdil.tools.compiled_code import compiled_code


class Run(NamedTuple):
    """The fields of ``ppga.Search`` that ``same_iterations`` moves from one search to the other."""

    archives: list
    xnes: Any
    rng: Any
    state: Any


def test_ratios_are_taken_within_a_round():
    # The machine slows down fourfold from round to round; the ratio must not notice.
    turns = {
        "simulator": [(100.0, 1.0), (100.0, 4.0), (100.0, 16.0)],
        "iteration": [(50.0, 1.0), (50.0, 4.0), (50.0, 16.0)],
    }
    speeds, over = timing.speeds_and_ratios(turns, "simulator")
    assert over == {"simulator": 1.0, "iteration": 0.5}
    assert speeds == {"simulator": 25.0, "iteration": 12.5}


def test_every_workload_is_run_once_before_it_is_timed():
    calls = []

    def work(name):
        calls.append(name)
        return 1.0, 1.0

    turns = timing.in_turns({"a": lambda: work("a"), "b": lambda: work("b")}, 2)
    assert calls == ["a", "b", "a", "b", "a", "b"]
    assert turns == {"a": [(1.0, 1.0)] * 2, "b": [(1.0, 1.0)] * 2}


def test_table_and_json_show_every_robot():
    rows = {"walker2d": {"device_speedup": 1.83}, "humanoid": {"device_speedup": 1.9, "peak_memory_mb": 1024.0}}
    assert json.loads(bench.as_json(rows)) == rows
    lines = bench.table(rows).splitlines()
    assert lines[0].split() == ["walker2d", "humanoid"]
    assert lines[1].split() == ["device_speedup", "1.83", "1.9"] and lines[2].split()[1:] == ["nan", "1.02e+03"]


def test_speedup_compares_the_same_iterations(monkeypatch):
    """Both see the same state and archives in each round; each iteration adds one to the state and an elite."""
    one, together = Run(["other"], None, None, jnp.asarray(100)), Run([], None, None, jnp.asarray(5))
    done = []

    def iteration(search):
        done.append((search.archives, int(search.state)))
        return search._replace(state=search.state + 1, archives=[*search.archives, "elite"]), (1.0, 1.0)

    monkeypatch.setattr(workloads, "iteration", iteration)
    on_one, on_all = workloads.same_iterations(one, together)
    for _ in range(2):
        on_one()
        on_all()
    assert done == [([], 5), ([], 5), (["elite"], 6), (["elite"], 6)]


@pytest.mark.parametrize(
    "arguments", [["--env", "crab"], ["--budget", "huge"], ["--rounds", "0"], ["--against", "nowhere"]]
)
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
    assert promised <= set(row) and all(row[name] > 0 for name in promised)
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
        during = timing.on_one_core(cores)()
        assert len(during[0]) == 1 and during[0] == during[1] and cores() == before
        with pytest.raises(ZeroDivisionError):
            timing.on_one_core(lambda: 1 / 0)()
        assert cores() == before
    finally:
        waiting.set()


def test_two_versions_are_compared_by_median_speeds_and_starts():
    here = [against.Measured(30.0, [10.0, 10.0], [1.0, 2.0]), against.Measured(9.0, [10.0], [1.0])]
    other = [against.Measured(20.0, [10.0, 10.0], [2.0, 2.0]), against.Measured(7.0, [10.0], [50.0])]
    assert against.figures(here, other) == {
        "iteration_speed_over_other": 10.0 / 5.0,
        "steps_over_other": 1.0,
        "cold_start_seconds": 30.0,
        "warm_start_seconds": 9.0,
        "other_cold_start_seconds": 20.0,
        "other_warm_start_seconds": 7.0,
    }
    assert "warm_start_seconds" not in against.figures(here[:1], other[:1])


@pytest.mark.slow
def test_this_version_against_itself_does_the_same_work(tmp_path):
    """A checkout is a folder with the package: a link to ours stands for another version."""
    (tmp_path / "qdil").symlink_to(Path(workloads.__file__).parents[1])
    row = against.compare(tmp_path, "walker2d", "smoke", rounds=2, warm_up=2, iterations=3)
    for method in ("true", "mconbo_gail"):
        assert row[f"{method}_steps_over_other"] == 1.0
        assert row[f"{method}_warm_start_seconds"] < row[f"{method}_cold_start_seconds"] or method == "mconbo_gail"


@pytest.mark.physics
def test_a_version_that_fails_is_refused_in_a_sentence(tmp_path):
    (tmp_path / "qdil").mkdir()
    (tmp_path / "qdil" / "__init__.py").touch()
    with pytest.raises(ConfigError, match=f"the version of qdil in {tmp_path} failed to run true on walker2d."):
        against._measure(tmp_path, tmp_path / "cache", ["walker2d", "true", "smoke", "1", "1", "demos.npz"])


@pytest.mark.slow
@pytest.mark.skipif(jax.default_backend() != "cpu", reason="the figures are of code for CPUs")
def test_compiled_code_has_figures():
    figures = compiled_code("walker2d")
    assert set(figures) == {"rollout_parallel_operations", "evaluation_parallel_operations", "reset_kernel_lines"}
