"""xNES (Glasmachers et al., 2010) over gradient coefficients, as one more of pyribs' evolution strategies."""

from typing import Any

import numpy as np
from ribs.emitters.opt import EvolutionStrategyBase


def utilities(values: np.ndarray) -> np.ndarray:
    """Rank-based weights (n,) that sum to zero, best largest, for ``values`` (n,) or (n, criteria).

    u_i ∝ max(0, log(n/2+1) − log i) − 1/n for rank i = 1 … n (section 3.1 of the xNES paper). Rows of ``values``
    that are equal share the mean of their ranks' weights, so that solutions without improvement do not move the mean.
    """
    values = np.atleast_2d(np.asarray(values, float).T).T
    n = len(values)
    raw = np.maximum(0.0, np.log(n / 2 + 1) - np.log(np.arange(1, n + 1)))
    by_rank = raw / raw.sum() - 1.0 / n
    _, group = np.unique(values, axis=0, return_inverse=True)  # groups in ascending lexicographic order
    group = group.reshape(-1)
    order = np.argsort(-group, kind="stable")
    weights = np.empty(n)
    weights[order] = by_rank
    return (np.bincount(group, weights) / np.bincount(group))[group]


def symmetric_exp(a: np.ndarray) -> np.ndarray:
    """The matrix exponential of a symmetric ``a`` (d, d), from its eigenvectors.

    SciPy's ``expm`` calls BLAS, whose threads spin for a tenth of a second afterwards on cores that the simulation
    needs.
    """
    values, vectors = np.linalg.eigh(a)
    return (vectors * np.exp(values)) @ vectors.T


def draw_center(kind: str, dim: int, rng: np.random.Generator) -> np.ndarray:
    """The mean (d,) at which xNES starts: 0 for ``kind`` "zero"; for "random" a point of [0, 2] × [−2, 2]^(d−1)."""
    if kind == "zero":
        return np.zeros(dim)
    low = np.array([0.0] + [-2.0] * (dim - 1))
    return rng.uniform(low, 2.0)


class XNES(EvolutionStrategyBase):
    """Exponential natural evolution strategy: samples c = μ + σ·B·z, z ~ N(0, I), and follows the natural gradient.

    All samples count, weighted by ``utilities``; ``num_parents`` is ignored. Learning rates are that paper's: 1 for
    the mean, (9 + 3 log d) / (5 d √d) for σ and B. Its state is ``mean`` (d,), ``sigma`` and ``shape`` B (d, d) with
    determinant 1. The search space is unbounded: finite bounds raise ValueError.

    ``fold_first`` samples |c_0| in place of c_0, adapts to the folded samples, and keeps the mean's first coordinate
    from being negative. If it adapted to the samples before folding, their values would be an even function of c_0, and
    from 0 the mean could not learn in which direction they improve.
    """

    def __init__(
        self,
        sigma0: float,
        solution_dim: int,
        batch_size: int | None = None,
        seed: Any = None,
        dtype: Any = np.float64,
        lower_bounds: float | np.ndarray = -np.inf,
        upper_bounds: float | np.ndarray = np.inf,
        fold_first: bool = False,
    ) -> None:
        if np.any(np.isfinite(lower_bounds)) or np.any(np.isfinite(upper_bounds)):
            raise ValueError("xNES searches an unbounded space: leave lower_bounds and upper_bounds infinite.")
        self.sigma0, self.dim, self.dtype = float(sigma0), int(solution_dim), dtype
        self.batch_size = int(batch_size or 4 + 3 * np.log(solution_dim))
        self.rate = (9 + 3 * np.log(self.dim)) / (5 * self.dim * np.sqrt(self.dim))
        self.seed, self.fold_first = seed, fold_first
        self.rng = np.random.default_rng(seed)
        self.reset(np.zeros(self.dim))

    def reset(self, x0: np.ndarray, same_samples: bool = False) -> None:
        """Start over at mean ``x0`` (d,) with Σ = σ0² I. The random generator continues, so new samples differ.

        ``same_samples`` restarts the generator from its seed, too (the authors' released program).
        """
        if same_samples:
            self.rng = np.random.default_rng(self.seed)
        self.mean = np.array(x0, float)
        self.sigma = self.sigma0
        self.shape = np.eye(self.dim)
        self._z = np.zeros((0, self.dim))

    def check_stop(self, ranking_values: np.ndarray) -> bool:
        """True if the distribution has become too narrow or too wide to sample from."""
        if not (np.isfinite(self.sigma) and np.all(np.isfinite(self.shape))):
            return True
        widest = self.sigma * np.linalg.norm(self.shape, ord=2)
        return bool(widest < 1e-8 or widest > 1e8)

    def ask(self, batch_size: Any = None) -> np.ndarray:
        """Sample (batch_size, d) coefficient vectors; with ``fold_first``, their first coordinate is not negative."""
        self._z = self.rng.standard_normal((batch_size or self.batch_size, self.dim))
        samples = self.mean + self.sigma * self._z @ self.shape.T
        if self.fold_first:
            samples[:, 0] = np.abs(samples[:, 0])
            self._z = self._standardised(samples, np.linalg.norm(self._z, axis=1))
        return samples.astype(self.dtype)

    def _standardised(self, samples: np.ndarray, longest: np.ndarray) -> np.ndarray:
        """z (n, d) of ``samples``, none longer than ``longest`` (n,).

        A folded sample may lie far outside a narrow distribution, and ``tell`` grows with the square of that distance.
        """
        z = np.linalg.solve(self.sigma * self.shape, (samples - self.mean).T).T
        return z * np.minimum(1.0, longest / np.maximum(np.linalg.norm(z, axis=1), 1e-300))[:, None]

    def tell(self, ranking_indices: np.ndarray, ranking_values: np.ndarray, num_parents: Any = 0) -> None:
        """Adapt to the ``ranking_values`` (n,) or (n, criteria) of the last samples, larger is better.

        ``ranking_indices`` is pyribs' argsort; the ranking is read from the values, which also show ties. Equal values
        change nothing.
        """
        values = np.asarray(ranking_values)
        if (values == values[:1]).all():
            return  # all ranks are shared; rounding errors would move the mean by about 1e-17
        u = utilities(values)
        z = self._z
        toward = u @ z  # natural gradient in the mean, G_δ
        spread = (u[:, None] * z).T @ z - u.sum() * np.eye(self.dim)  # natural gradient in the covariance, G_M
        growth = np.trace(spread) / self.dim
        self.mean = self.mean + self.sigma * self.shape @ toward
        self.shape = self.shape @ symmetric_exp(0.5 * self.rate * (spread - growth * np.eye(self.dim)))
        self.sigma *= np.exp(0.5 * self.rate * growth)
        if self.fold_first and self.mean[0] < 0:  # the folded distribution is that of the mirror image, too
            mirror = np.where(np.arange(self.dim) == 0, -1.0, 1.0)
            self.mean, self.shape = mirror * self.mean, mirror[:, None] * self.shape * mirror
