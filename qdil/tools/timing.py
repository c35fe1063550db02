"""Alternating measurements: in every round, all workloads run one after the other.

Machines are shared and drift, so a single speed is worth little. The ratio of two speeds of the same round is nearly
free of the drift; the medians of such ratios are what the bench reports.
"""

import os
import statistics
import time
from collections.abc import Callable
from contextlib import suppress

import jax

Turn = Callable[[], tuple[float, float]]  # does some work; returns its amount (mostly steps) and the seconds it took
Turns = dict[str, list[tuple[float, float]]]  # by name, a turn's result per round


def in_turns(workloads: dict[str, Turn], rounds: int) -> Turns:
    """Run every workload once to compile it, then all of them in each of ``rounds`` rounds."""
    for workload in workloads.values():
        workload()
    turns: Turns = {name: [] for name in workloads}
    for _ in range(rounds):
        for name, workload in workloads.items():
            turns[name].append(workload())
    return turns


def speeds_and_ratios(turns: Turns, base: str) -> tuple[dict[str, float], dict[str, float]]:
    """Median amount per second of each workload, and the median of its ratio to ``base`` in the same round."""
    rates = {name: [amount / seconds for amount, seconds in results] for name, results in turns.items()}
    speeds = {name: statistics.median(values) for name, values in rates.items()}
    ratios = {n: statistics.median(a / b for a, b in zip(v, rates[base], strict=True)) for n, v in rates.items()}
    return speeds, ratios


def timed(function: Callable[[jax.Array], jax.Array], argument: jax.Array, amount: float) -> tuple[float, float]:
    """One call as a turn that does ``amount`` of work."""
    start = time.monotonic()
    jax.block_until_ready(function(argument))
    return amount, time.monotonic() - start


def on_one_core(workload: Turn) -> Turn:
    """``workload`` with all threads of the process pinned to one core (Linux only).

    Without this, XLA and its helper threads use several cores even for a single device.
    """

    def pin(cores: set[int]) -> None:
        for thread in os.listdir("/proc/self/task"):
            with suppress(ProcessLookupError):  # it has just ended
                os.sched_setaffinity(int(thread), cores)

    def turn() -> tuple[float, float]:
        cores = os.sched_getaffinity(0)
        pin({min(cores)})
        try:
            return workload()
        finally:
            pin(cores)

    return turn
