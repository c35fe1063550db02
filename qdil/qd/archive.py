"""A run's two archives, pyribs grids over the unit measure square: one guides the search, one is the result."""

import copy
from typing import Any, NamedTuple

import numpy as np
from ribs.archives import GridArchive

from qdil.qd.cells import EDGE

EXTRA = ("true_return", "length", "obs_mean", "obs_std")  # fields of a result elite besides pyribs' own


class Candidates(NamedTuple):
    """Evaluated policies, axis (λ) in front, on the host."""

    theta: np.ndarray  # (λ, P) flat parameters
    obs_mean: np.ndarray  # (λ, O) the observation normaliser under which each was evaluated
    obs_std: np.ndarray  # (λ, O)
    fitness: np.ndarray  # (λ,) the score that the archives compare
    true_return: np.ndarray  # (λ,) mean return in the environment's own reward
    measures: np.ndarray  # (λ, k) mean over episodes of each episode's mean δ
    length: np.ndarray  # (λ,) mean episode length, steps
    finite: np.ndarray  # (λ,) bool, False where the physics diverged


class Archives(NamedTuple):
    """``soft`` holds thresholds t_e and decides what counts as an improvement; ``result`` keeps the best per cell."""

    soft: GridArchive
    result: GridArchive


class Added(NamedTuple):
    """The archives after candidates were inserted, and how the soft archive judged each of these."""

    archives: Archives
    improvement: np.ndarray  # (λ,) Δ of Algorithm 2
    accepted: np.ndarray  # (λ,) bool


def make(cells: int, k: int, theta_size: int, obs_size: int, learning_rate: float, threshold_min: float) -> Archives:
    """Two empty grids of ``cells`` per measure, measures in [0, 1].

    The soft archive follows Algorithm 2's threshold rule (pyribs' batch form of it); only its thresholds are
    used, so the policies themselves are kept once, in the result archive.
    """
    grid: dict[str, Any] = {"dims": [cells] * k, "ranges": [(0.0, 1.0)] * k, "dtype": np.float32, "epsilon": EDGE}
    soft = GridArchive(solution_dim=1, learning_rate=learning_rate, threshold_min=threshold_min, **grid)
    extra: dict[str, Any] = {
        "true_return": ((), np.float32),
        "length": ((), np.float32),
        "obs_mean": ((obs_size,), np.float32),
        "obs_std": ((obs_size,), np.float32),
    }
    return Archives(soft, GridArchive(solution_dim=theta_size, extra_fields=extra, **grid))


def add(archives: Archives, candidates: Candidates, rejects: str = "zero") -> Added:
    """Insert the finite candidates into copies of both archives (Algorithm 2).

    A candidate that the soft archive accepts improves by Δ = f_i − t_e > 0. ``rejects`` selects Δ of the others: "zero"
    (Algorithm 2), or "difference", f_i − t_e ≤ 0 (released program), so that xNES learns from them, too. A candidate
    that is not finite has the lowest Δ of all.
    """
    count = len(candidates.fitness)
    ok = np.flatnonzero(usable(candidates))
    if len(ok) == 0:
        return Added(archives, np.zeros(count), np.zeros(count, bool))
    archives = copy.deepcopy(archives)  # pyribs changes archives in place; a search is a value
    good = Candidates(*(field[ok] for field in candidates))
    info = archives.soft.add(np.zeros((len(ok), 1)), good.fitness, good.measures)
    accepted, improvement = np.zeros(count, bool), np.full(count, -np.inf)
    accepted[ok] = info["status"] > 0
    improvement[ok] = np.where(accepted[ok] | (rejects == "difference"), info["value"], 0.0)
    improvement[np.isinf(improvement)] = min(0.0, improvement[ok].min())
    extra = {name: getattr(good, name) for name in EXTRA}
    archives.result.add(good.theta, good.fitness, good.measures, **extra)
    return Added(archives, improvement, accepted)


def usable(candidates: Candidates) -> np.ndarray:
    """Which candidates (λ,) may enter: their physics stayed finite, and so are all numbers that an elite would keep."""
    fields = [values for name, values in candidates._asdict().items() if name != "finite"]
    sound = [np.isfinite(values).reshape(len(values), -1).all(axis=1) for values in fields]
    return candidates.finite & np.all(sound, axis=0)


def occupied(archives: Archives) -> np.ndarray:
    """Which cells of the result archive are filled, as a (cells, …) bool grid; its complement is A_e."""
    grid = np.zeros(int(archives.result.cells), bool)
    grid[archives.result.data("index")] = True
    return grid.reshape(tuple(archives.result.dims))


def random_elite(archives: Archives, rng: np.random.Generator) -> dict[str, np.ndarray] | None:
    """The elite of a random cell, drawn uniformly from those that the soft archive has filled; None if it is empty.

    Elites below ``threshold_min`` are only in the result archive, and the search does not restart from them.
    """
    elites = elite_arrays(archives)
    rows = np.flatnonzero(np.isin(elites["index"], archives.soft.data("index")))
    if len(rows) == 0:
        return None
    row = rows[rng.integers(len(rows))]
    return {name: values[row] for name, values in elites.items()}


def elite_arrays(archives: Archives) -> dict[str, np.ndarray]:
    """Everything the result archive holds, one row per filled cell in order of cell index."""
    data = archives.result.data(return_type="dict")
    order = np.argsort(data["index"])
    renamed = {"fitness": data["objective"], "solution": data["solution"]}
    same = {name: data[name] for name in ("index", "measures", *EXTRA)}
    return {name: np.asarray(values)[order] for name, values in {**same, **renamed}.items()}


def returns(archives: Archives) -> dict[str, np.ndarray]:
    """``index``, ``true_return`` and ``fitness`` of ``elite_arrays``, without copying any policy."""
    names = {"index": "index", "true_return": "true_return", "objective": "fitness"}
    data = archives.result.data(list(names), return_type="dict")
    order = np.argsort(data["index"])
    return {name: np.asarray(data[field])[order] for field, name in names.items()}


def content(grid: GridArchive) -> dict[str, np.ndarray]:
    """All that a grid holds, thresholds included, a row per filled cell in order of cell index."""
    data = grid.data(return_type="dict")
    order = np.argsort(data["index"])
    return {name: np.asarray(values)[order] for name, values in data.items()}


def refill(grid: GridArchive, rows: dict[str, np.ndarray]) -> None:
    """Put ``content`` back into an empty grid, bit by bit.

    pyribs has no public way to set a threshold, and adding the elites again would only approximate the old one. Its
    running statistics (``stats``, ``best_elite``) are not restored; nothing here reads them.
    """
    grid._store.add(rows["index"], {name: values for name, values in rows.items() if name != "index"})


def metrics(elites: dict[str, np.ndarray], cells: int) -> dict[str, float]:
    """The paper's four metrics (section 5.3) from true returns, and the QD-score in the learned fitness.

    QD-score is the plain sum over filled cells (eq. 1), no offset; coverage is a share of ``cells``; an empty archive
    has QD-score and coverage 0, and best and average not-a-number.
    """
    returns = elites["true_return"].astype(np.float64)
    filled = len(returns)
    return {
        "qd_score": float(returns.sum()),
        "coverage": filled / cells,
        "best": float(returns.max()) if filled else float("nan"),
        "average": float(returns.mean()) if filled else float("nan"),
        "learned_qd_score": float(elites["fitness"].astype(np.float64).sum()),
    }
