"""The algorithms that PPGA grew from, in pyribs: MAP-Elites, CMA-ME, CMA-MEGA, CMA-MAEGA, the last two also with xNES.

Beside them stands novelty search with local competition ("nslc"), which is older (section 2.1).
Papers: Lehman & Stanley (2011), "Evolving a Diversity of Virtual Creatures through Novelty Search and Local
Competition"; Mouret & Clune (2015); Fontaine et al. (2020), CMA-ME; Fontaine & Nikolaidis (2021), "Differentiable
Quality Diversity" (DQD); Fontaine & Nikolaidis (2023), "Covariance Matrix Adaptation MAP-Annealing" (MAP-Annealing). A
source named beside a setting means the paper and the program published with it.

Departure: eq. 16 of the QD-IL paper weighs ∇f with |c_0|. Here, as in pyribs and in the programs of DQD and
MAP-Annealing, c_0 keeps its sign, so that a candidate may also move against ∇f.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from ribs.archives import ArchiveBase, GridArchive, ProximityArchive
from ribs.emitters import EmitterBase, EvolutionStrategyEmitter, GaussianEmitter, GradientArborescenceEmitter
from ribs.schedulers import Scheduler

from qdil.lab.background.competition import Generations, novelty_archive
from qdil.lab.background.problems import Problem
from qdil.qd.xnes import XNES


class Result(NamedTuple):
    """A finished run."""

    searched: ArchiveBase  # the archive that guided the search; CMA-MAEGA's is soft, and that of nslc has no cells
    archive: GridArchive  # the best solution found in every cell; the same object as ``searched`` for the others
    history: dict[str, np.ndarray]  # one row per iteration: evaluations, and ``metrics`` of ``archive``


class Algorithm(NamedTuple):
    """The parts in which the algorithms differ."""

    emitter: Callable[[Problem, Any, int, int], EmitterBase]  # (problem, archive, evaluations, seed)
    uses_gradients: bool = False
    soft: bool = False  # a soft archive (with thresholds) guides the search
    novelty: bool = False  # an archive of novel solutions, without cells, guides the search


def run_algorithm(
    problem: Problem,
    algorithm: str,
    iterations: int,
    seed: int,
    *,
    cells: int = 100,  # per measure (DQD)
    batch: int = 36,  # evaluations per emitter and iteration, including that of a gradient (DQD)
    emitters: int = 1,  # that share the archive (DQD; MAP-Annealing has 15)
    learning_rate: float = 0.01,  # α of CMA-MAEGA's soft archive, 0 ≤ α ≤ 1 (MAP-Annealing, for 100 x 100 cells)
    threshold_min: float = 0.0,  # the soft archive's threshold of an empty cell, objective units (MAP-Annealing)
) -> Result:
    """Search ``problem`` with one of ``ALGORITHMS``; each of them uses ``iterations * emitters * batch`` evaluations.

    A gradient counts as part of the evaluation at its point, as in DQD. Only CMA-MAEGA reads the last two settings.
    The same arguments give the same result. Raises ValueError, before any work, for an unknown algorithm or a setting
    out of range.
    """
    if algorithm not in ALGORITHMS:
        raise ValueError(f"There is no algorithm {algorithm!r}: choose one of {', '.join(ALGORITHMS)}.")
    chosen = ALGORITHMS[algorithm]
    _check_counts(iterations, cells, batch, emitters)
    if chosen.soft:
        _check_softness(problem, learning_rate, threshold_min)
    soft = {"learning_rate": learning_rate, "threshold_min": threshold_min} if chosen.soft else {}
    seeds = [int(s) for s in np.random.SeedSequence(seed).generate_state(emitters + 1)]
    grid = _grid(problem, cells, seed=seeds[0], **soft)
    searched = novelty_archive(problem, cells, seeds[0]) if chosen.novelty else grid
    sources = [chosen.emitter(problem, searched, batch, s) for s in seeds[1:]]
    archive = _grid(problem, cells) if chosen.soft else grid
    scheduler = Scheduler(searched, sources, None if searched is archive else archive)
    rows = []
    for iteration in range(1, iterations + 1):
        if chosen.uses_gradients:
            _tell_gradients(problem, scheduler)
        scheduler.tell(*problem.evaluate(scheduler.ask()))
        rows.append({"evaluations": iteration * batch * emitters, **metrics(archive)})
    history = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return Result(searched, archive, history)


def metrics(archive: GridArchive) -> dict[str, float]:
    """QD-score (plain sum of the elites' objectives, no offset), coverage (share of cells filled), best objective.

    They are computed from the archive's arrays, because the sums that pyribs keeps in ``stats`` drift by rounding. The
    best of an empty archive is not-a-number. The papers of this module divide the QD-score by the number of cells.
    """
    stored = archive.data(["index", "objective"], return_type="dict")
    objective = stored["objective"][np.argsort(stored["index"])]  # summed in the order of cells, not of insertion
    return {
        "qd_score": float(objective.sum()),
        "coverage": len(objective) / int(archive.cells),
        "best": float(objective.max()) if len(objective) else float("nan"),
    }


def _first_batch(problem: Problem, batch: int, seed: int) -> np.ndarray:
    """(batch, d) from N(0, I), as DQD's initial population (which had 100 solutions, not counted as evaluations)."""
    return np.random.default_rng([seed, 0]).standard_normal((batch, problem.solution_dim))


def _competition(problem: Problem, archive: ProximityArchive, batch: int, seed: int) -> EmitterBase:
    """Novelty search with local competition, from MAP-Elites' first batch and with its noise."""
    return Generations(archive, problem.sigma, _first_batch(problem, batch, seed), seed)


def _gaussian(problem: Problem, archive: GridArchive, batch: int, seed: int) -> EmitterBase:
    """MAP-Elites: random elites plus isotropic noise."""
    start = _first_batch(problem, batch, seed)
    return GaussianEmitter(archive, sigma=problem.sigma, initial_solutions=start, batch_size=batch, seed=seed)


def _evolution(problem: Problem, archive: GridArchive, batch: int, seed: int) -> EmitterBase:
    """CMA-ME with improvement emitters: CMA-ES in solution space, ranked by improvement of the archive."""
    return EvolutionStrategyEmitter(
        archive,
        x0=np.zeros(problem.solution_dim),  # (DQD)
        sigma0=problem.sigma,
        ranker="2imp",  # new cells before improved ones (CMA-ME paper)
        selection_rule="filter",  # parents are those that entered the archive (CMA-ME paper)
        restart_rule="no_improvement",  # from a random elite if none entered (CMA-ME paper)
        batch_size=batch,
        seed=seed,
    )


def _arborescence(
    problem: Problem, archive: GridArchive, batch: int, seed: int, *, es: Any, ranker: str, restart_rule: Any
) -> EmitterBase:
    """CMA-MEGA and CMA-MAEGA: a strategy ``es`` over coefficients of the unit-length gradients at one point θ."""
    return GradientArborescenceEmitter(
        archive,
        x0=np.zeros(problem.solution_dim),  # (DQD)
        sigma0=problem.sigma_g,
        lr=1.0,  # θ moves all the way to the parents' weighted mean (DQD)
        grad_opt="gradient_ascent",  # (DQD)
        ranker=ranker,
        # The better half are parents (DQD). pyribs' default makes parents of the solutions that entered the archive. If
        # none entered and the restart rule is "basic", there are no parents, their mean is 0 and θ moves to the origin.
        selection_rule="mu",
        restart_rule=restart_rule,
        es=es,
        batch_size=batch - 1,  # θ itself is evaluated too
        seed=seed,
    )


_MEGA = {"ranker": "2imp", "restart_rule": "no_improvement"}  # (DQD)
# Ranked by f − t_e; restarts only if the strategy itself asks for one (MAP-Annealing).
_MAEGA = {"ranker": "imp", "restart_rule": "basic"}


def _dqd(es: Any, rules: dict[str, Any], soft: bool) -> Algorithm:
    return Algorithm(partial(_arborescence, es=es, **rules), uses_gradients=True, soft=soft)


ALGORITHMS = {
    "nslc": Algorithm(_competition, novelty=True),
    "map-elites": Algorithm(_gaussian),
    "cma-me": Algorithm(_evolution),
    "cma-mega": _dqd("cma_es", _MEGA, soft=False),
    "cma-maega": _dqd("cma_es", _MAEGA, soft=True),
    "cma-mega-xnes": _dqd(XNES, _MEGA, soft=False),
    "cma-maega-xnes": _dqd(XNES, _MAEGA, soft=True),
}


def _grid(problem: Problem, cells: int, **settings: Any) -> GridArchive:
    k = len(problem.measure_ranges)
    return GridArchive(solution_dim=problem.solution_dim, dims=[cells] * k, ranges=problem.measure_ranges, **settings)


def _tell_gradients(problem: Problem, scheduler: Scheduler) -> None:
    """Evaluate every emitter's θ with its Jacobian: rows ∇f, ∇m_1 … ∇m_k."""
    theta = scheduler.ask_dqd()
    objective_grad, measure_grads = problem.gradients(theta)
    # A fresh array: pyribs normalises the rows in place.
    jacobian = np.concatenate([objective_grad[:, None, :], measure_grads], axis=1)
    scheduler.tell_dqd(*problem.evaluate(theta), jacobian)


def _check_counts(iterations: int, cells: int, batch: int, emitters: int) -> None:
    # A strategy needs two samples to rank, and θ is evaluated too.
    least = {"iterations": (iterations, 1), "cells": (cells, 1), "batch": (batch, 3), "emitters": (emitters, 1)}
    for name, (value, smallest) in least.items():
        if value < smallest:
            raise ValueError(f"{name} must be at least {smallest}, not {value}.")


def _check_softness(problem: Problem, learning_rate: float, threshold_min: float) -> None:
    if not 0 <= learning_rate <= 1:
        raise ValueError(f"learning_rate must be between 0 and 1, not {learning_rate}.")
    # A start above the threshold always enters the soft archive, so that a restart finds an elite.
    start = float(problem.evaluate(np.zeros((1, problem.solution_dim)))[0][0])
    if not -np.inf < threshold_min < start:
        raise ValueError(f"threshold_min must be finite and below the start's objective, {start:.6g}.")
