"""CMA-ES and xNES alone, on the smallest problem with the two difficulties of PPGA: few dimensions and much noise."""

from typing import Any, NamedTuple

import numpy as np
from ribs.emitters.opt import CMAEvolutionStrategy

from qdil.qd.xnes import XNES


class WholeRankOne(CMAEvolutionStrategy):
    """pyribs' CMA-ES with the weight that Hansen's tutorial (2016) gives the covariance's rank-one term.

    pyribs 0.12 multiplies this term by its learning rate twice and leaves out the step size, so that the covariance
    shrinks unless the rank-μ term keeps it up. The evolution path is divided by the current step size, not by that of
    every step in it.
    """

    @staticmethod
    def _calc_cov_update(cov, c1a, cmu, c1, pc, sigma, rank_mu_update, weights):  # type: ignore[override] # numba's
        kept = cov * (1 - c1a - cmu * np.sum(weights))
        return kept + (c1 * np.outer(pc, pc) + cmu * rank_mu_update) / sigma**2


STRATEGIES: dict[str, Any] = {
    "CMA-ES (pyribs)": CMAEvolutionStrategy,
    "CMA-ES (whole rank-one term)": WholeRankOne,
    "xNES": XNES,
}
START = 10.0  # distance of the start from the optimum, in units of the first step


class Chase(NamedTuple):
    """The course of a strategy towards an optimum, a row per iteration."""

    distance: np.ndarray  # (n,) from the distribution's mean to the optimum, in units of the first step
    width: np.ndarray  # (n,) of the distribution: the geometric mean of its axes, in the same units


def chase(strategy: str, noise: float, iterations: int, seed: int, dim: int = 3, batch: int = 36) -> Chase:
    """Maximise -|c|² over c in R^``dim`` from a random point at distance ``START``, with first step 1.

    Every value has normal noise of deviation ``noise`` (in units of -|c|²), drawn anew each time, so that near the
    optimum the ranking of the ``batch`` samples is chance. Dimension 3 is that of the coefficients (c_0, c_1, c_2) of a
    robot with two feet. Raises ValueError for an unknown strategy.
    """
    if strategy not in STRATEGIES:
        raise ValueError(f"There is no strategy {strategy!r}: choose one of {', '.join(STRATEGIES)}.")
    rng = np.random.default_rng([seed, 0])
    start = rng.standard_normal(dim)
    search = STRATEGIES[strategy](sigma0=1.0, solution_dim=dim, batch_size=batch, seed=seed)
    search.reset(START * start / np.linalg.norm(start))
    rows = []
    for _ in range(iterations):
        samples = np.array(search.ask())
        values = -np.square(samples).sum(axis=1) + noise * rng.standard_normal(batch)
        search.tell(np.argsort(-values, kind="stable"), values, batch // 2)
        rows.append((np.linalg.norm(search.mean), _width(search)))
    return Chase(*np.array(rows).T)


def _width(search: Any) -> float:
    """Geometric mean of the axes of the distribution that ``search`` samples from."""
    if isinstance(search, XNES):
        return search.sigma  # its shape has determinant 1
    eigenvalues = np.linalg.eigvalsh(search.cov.cov)
    return search.sigma * float(np.exp(0.5 * np.log(np.maximum(eigenvalues, 1e-300)).mean()))
