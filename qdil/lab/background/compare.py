"""The background algorithms over several seeds, at a size for each budget, and tables of their final metrics."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from qdil.lab.background.algorithms import Result, metrics, run_algorithm
from qdil.lab.background.noise import noisy, rescored
from qdil.lab.background.problems import Problem


class ExperimentSize(NamedTuple):
    """The size of a background experiment."""

    dim: int  # of a solution
    cells: int  # per measure
    iterations: int
    learning_rate: float  # α of the soft archive
    seeds: tuple[int, ...]


_SEEDS = tuple(range(5))
SIZES = {
    "smoke": ExperimentSize(dim=10, cells=10, iterations=30, learning_rate=0.1, seeds=(0, 1)),
    "laptop": ExperimentSize(dim=100, cells=50, iterations=600, learning_rate=0.1, seeds=_SEEDS),
    "desk": ExperimentSize(dim=100, cells=50, iterations=3000, learning_rate=0.1, seeds=_SEEDS),
    # DQD's dimension, grid and iterations; the α that MAP-Annealing uses for that grid. Both papers: 20 seeds.
    "full": ExperimentSize(dim=1000, cells=100, iterations=10_000, learning_rate=0.01, seeds=_SEEDS),
}
SOFT = ("cma-maega", "cma-maega-xnes")


def size_of(budget: str, seed: int) -> ExperimentSize:
    """The size for a budget, with seeds that count up from ``seed``."""
    size = SIZES[budget]
    return size._replace(seeds=tuple(seed + i for i in size.seeds))


def repeat(problem: Problem, algorithm: str, size: ExperimentSize, **settings: Any) -> list[Result]:
    """One run of ``algorithm`` per seed of ``size``; ``settings`` of ``run_algorithm`` replace those of ``size``."""
    chosen = _settings(algorithm, size, settings)
    return [run_algorithm(problem, algorithm, seed=seed, **chosen) for seed in size.seeds]


class Case(NamedTuple):
    """The noise of evaluations, as in ``noise.noisy``, and their number per iteration."""

    objective_sd: float = 0.0
    measure_sd: float = 0.0
    batch: int = 36


def under_noise(
    problem: Problem, names: Sequence[str], size: ExperimentSize, cases: Mapping[str, Case]
) -> pd.DataFrame:
    """The metrics of every algorithm's archives from noisy values and from true values, a row per run.

    Columns ``case``, ``algorithm``, ``seed``, and ``claimed_`` (noisy) and ``true_`` with each of ``qd_score``,
    ``coverage``, ``best``.
    """
    return pd.DataFrame(
        {"case": label, "algorithm": name, "seed": seed, **_both(problem, name, size, case, seed)}
        for label, case in cases.items()
        for name in names
        for seed in size.seeds
    )


def _both(problem: Problem, algorithm: str, size: ExperimentSize, case: Case, seed: int) -> dict[str, float]:
    """Claimed and true metrics of one run."""
    # ``run_algorithm`` refuses a threshold above the start's objective, which noise can push below 0.
    floor = {"threshold_min": -100.0} if algorithm in SOFT else {}
    settings = _settings(algorithm, size, {"batch": case.batch, **floor})
    seen = noisy(problem, case.objective_sd, case.measure_sd, seed)
    archive = run_algorithm(seen, algorithm, seed=seed, **settings).archive
    both = {"claimed": metrics(archive), "true": metrics(rescored(problem, archive))}
    return {f"{which}_{name}": value for which, values in both.items() for name, value in values.items()}


def _settings(algorithm: str, size: ExperimentSize, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of ``run_algorithm``: the size's iterations, grid and α (of a soft archive), then ``settings``."""
    chosen: dict[str, Any] = {"iterations": size.iterations, "cells": size.cells}
    if algorithm in SOFT:
        chosen["learning_rate"] = size.learning_rate
    return chosen | dict(settings)


def ends(results: Mapping[Any, Sequence[Result]]) -> pd.DataFrame:
    """Final metrics, a row per run: ``label``, ``seed`` (numbered from 0 within a label) and a column per metric."""
    rows = [
        {"label": label, "seed": i, **{name: float(values[-1]) for name, values in result.history.items()}}
        for label, several in results.items()
        for i, result in enumerate(several)
    ]
    return pd.DataFrame(rows)


def table(results: Mapping[Any, Sequence[Result]]) -> pd.DataFrame:
    """Median and range over seeds of the final metrics, as texts, a row per label; coverage in percent."""
    final = ends(results).assign(coverage=lambda frame: 100 * frame["coverage"])
    shown = {"qd_score": "QD-score", "coverage": "coverage, %", "best": "best objective"}
    columns = {title: final.groupby("label", sort=False)[name].apply(_spread) for name, title in shown.items()}
    return pd.DataFrame(columns).rename_axis(None)


def _spread(values: pd.Series) -> str:
    """``median (lowest to highest)``, or the value alone."""
    digits = 0 if np.abs(values).max() >= 1000 else 1
    low, mid, high = (f"{v:,.{digits}f}" for v in (values.min(), values.median(), values.max()))
    return mid if len(values) == 1 else f"{mid} ({low} to {high})"
