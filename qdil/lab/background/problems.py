"""Quality-diversity benchmarks whose gradients are known exactly: two linear projections and a planar arm.

From Fontaine et al. (2020), "Covariance Matrix Adaptation for the Rapid Illumination of Behavior Space", and
Fontaine & Nikolaidis (2021), "Differentiable Quality Diversity" (DQD). All are maximised; the optimum is 100.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

LIMIT = 5.12  # |x| up to which a coordinate counts in full in a linear projection (CMA-ME paper, section 4)
OFFSET = 0.4 * LIMIT  # every coordinate of the optimum of the sphere and of Rastrigin (same section)

Elementwise = Callable[[np.ndarray], np.ndarray]


class Problem(NamedTuple):
    """An objective f and k measures m over real vectors, evaluated in batches of N solutions."""

    name: str
    solution_dim: int  # d
    measure_ranges: tuple[tuple[float, float], ...]  # (lowest, highest) of each of the k measures
    evaluate: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # (N, d) -> f (N,), m (N, k)
    gradients: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # (N, d) -> ∇f (N, d), ∇m (N, k, d)
    sigma: float  # the papers' initial step in solution space, in units of x
    sigma_g: float  # the papers' initial step of the coefficients of unit-length gradients


def sphere(dim: int) -> Problem:
    """Linear projection of the sphere: f falls with the squared distance from x_i = ``OFFSET``.

    f = 100 (1 − Σ (x_i − OFFSET)² / worst), where ``worst`` is the sum at the corner x_i = −LIMIT, so that f is below
    0 only far outside the box.
    """
    return _linear_projection("sphere", dim, penalty=np.square, slope=lambda z: 2 * z)


def rastrigin(dim: int) -> Problem:
    """Linear projection of Rastrigin's function: the sphere's bowl with a local optimum near every whole step.

    f = 100 (1 − Σ (10 + z_i² − 10 cos 2πz_i) / worst), z_i = x_i − OFFSET, where ``worst`` is the sum at the corner
    x_i = −LIMIT, as in DQD's experiments. The wave crests near the corner are worse: f is as low as −11 inside the box.
    """
    return _linear_projection(
        "rastrigin",
        dim,
        penalty=lambda z: 10 + np.square(z) - 10 * np.cos(2 * np.pi * z),
        slope=lambda z: 2 * z + 20 * np.pi * np.sin(2 * np.pi * z),
    )


def arm(dim: int) -> Problem:
    """Planar arm repertoire: ``dim`` joint angles (radians, each relative to the link before), links of length 1.

    The measures are the end of the arm (x, y). It reaches only the disc of radius ``dim``, about π/4 of the cells.
    f = 100 (1 − population variance of the angles), so equal bends are best; f is below 0 for variances above 1.
    """
    _check_dim(dim, least=1)

    def evaluate(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        heading = np.cumsum(angles, axis=1)  # of each link, from the x axis
        ends = np.stack([np.cos(heading).sum(axis=1), np.sin(heading).sum(axis=1)], axis=1)
        return 100 * (1 - np.var(angles, axis=1)), ends

    def gradients(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        heading = np.cumsum(angles, axis=1)
        by_link = np.stack([-np.sin(heading), np.cos(heading)], axis=1)  # (N, 2, d) effect of turning one link alone
        by_joint = np.cumsum(by_link[:, :, ::-1], axis=2)[:, :, ::-1]  # a joint turns its own and every later link
        return -200 / dim * (angles - angles.mean(axis=1, keepdims=True)), by_joint

    reach = (-float(dim), float(dim))
    # Steps: DQD's experiments with the arm.
    return Problem("arm", dim, (reach, reach), evaluate, gradients, sigma=0.1, sigma_g=0.05)


def _linear_projection(name: str, dim: int, penalty: Elementwise, slope: Elementwise) -> Problem:
    """Minimise Σ penalty(x − OFFSET); measures are the sums of the first ⌊d/2⌋ and of the other clipped coordinates.

    A coordinate is clipped as clip(x) = x within ±LIMIT and LIMIT / x outside, which jumps from 5.12 to 1 at the limit.
    The gradients are exact on either side; at the limit itself they are those of the inside. A search that starts at
    x = 0 and moves along these gradients alone keeps the coordinates of each half equal, so it explores a plane for
    any d.
    """
    _check_dim(dim, least=2)
    worst = dim * float(penalty(np.array(-LIMIT - OFFSET)))
    first = np.arange(dim) < dim // 2
    member = np.stack([first, ~first]).astype(float)  # (2, d) which coordinates a measure sums

    def evaluate(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = np.asarray(x, float)
        clipped = np.divide(LIMIT, x, out=x.copy(), where=np.abs(x) > LIMIT)
        return 100 * (1 - penalty(x - OFFSET).sum(axis=1) / worst), clipped @ member.T

    def gradients(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = np.asarray(x, float)
        clipped_slope = np.divide(-LIMIT, np.square(x), out=np.ones_like(x), where=np.abs(x) > LIMIT)
        return -100 / worst * slope(x - OFFSET), clipped_slope[:, None, :] * member

    low, high = LIMIT * (dim // 2), LIMIT * (dim - dim // 2)
    # Steps: DQD's experiments with linear projections.
    return Problem(name, dim, ((-low, low), (-high, high)), evaluate, gradients, sigma=0.5, sigma_g=10.0)


def _check_dim(dim: int, least: int) -> None:
    if dim < least:
        raise ValueError(f"This problem needs at least {least} dimension{'s' * (least > 1)}, not {dim}.")
