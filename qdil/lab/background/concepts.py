"""The paper's two problems in miniature, with one measure: where a search goes, and which gaits a reward prefers.

The examples are so small that gradients and the best discriminator are exact. They illustrate, in the spirit of Fig. 1,
and are no evidence: nothing here is learned from data or simulated.
"""

from typing import NamedTuple

import numpy as np

HILLS = ((0.14, 0.07, 0.3), (0.40, 0.07, 0.5), (0.64, 0.06, 0.3), (0.86, 0.07, 0.7))  # of f: centre, width, height
BEGIN = 0.35  # measure of the first search policy
SPREAD = 0.05  # standard deviation of an episode's measure around its policy's
RATE = 1e-3  # how far the search policy moves along a gradient
PATIENCE = 15  # iterations without a new cell after which the search restarts
GRID = np.linspace(-0.25, 1.25, 601)  # measures of episodes, over which expectations are summed
MIDDLES = (np.arange(400) + 0.5) / 400  # of 400 intervals from 0 to 1


class Explored(NamedTuple):
    """The course of a search of N iterations, on M cells of equal size between 0 and 1."""

    position: np.ndarray  # (N,) the search policy's measure
    visits: np.ndarray  # (M,) episodes that landed in each cell
    filled: np.ndarray  # (N,) cells filled so far


def fitness(measure: np.ndarray) -> np.ndarray:
    """f(m) of the policies with ``measure`` (N,): four hills, the highest far to the right."""
    heights = [height * np.exp(-(((measure - centre) / width) ** 2) / 2) for centre, width, height in HILLS]
    return np.sum(heights, axis=0)


def explore(q: float, iterations: int, cells: int, seed: int) -> Explored:
    """A search policy that climbs E[f(m) + q·1[m ∈ A_e]]; the measures m of its episodes are normal around its own.

    This is the policy gradient on the reward of eq. 4, computed exactly: each iteration takes one step along the
    gradient, plays one episode and fills that episode's cell. As PPGA does, it restarts at a filled cell after
    ``PATIENCE`` iterations without a new cell. q = 0 is a search without bonus. Measures are clipped to [0, 1].
    """
    rng = np.random.default_rng(seed)
    position, empty = BEGIN, np.ones(cells, bool)
    visits, positions, filled = np.zeros(cells, int), [], []
    fitness_on_grid, cell_on_grid = fitness(np.clip(GRID, 0, 1)), _cell(GRID, cells)
    for iteration in range(1, iterations + 1):
        likely = np.exp(-(((GRID - position) / SPREAD) ** 2) / 2)
        score = (GRID - position) / SPREAD**2  # ∇ log of the density: the policy gradient is E[score × reward]
        gradient = np.average(score * (fitness_on_grid + q * empty[cell_on_grid]), weights=likely)
        position = float(np.clip(position + RATE * gradient, 0, 1))
        cell = _cell(rng.normal(position, SPREAD), cells)
        empty[cell] = False
        visits[cell] += 1
        positions.append(position)
        filled.append(int(cells - empty.sum()))
        if iteration % PATIENCE == 0 and filled[-1] == filled[-PATIENCE]:
            position = float(rng.choice(np.flatnonzero(~empty)) + 0.5) / cells
    return Explored(np.array(positions), visits, np.array(filled))


def _cell(measure: np.ndarray | float, cells: int) -> np.ndarray:
    return np.clip(np.floor(np.asarray(measure) * cells), 0, cells - 1).astype(int)


def discriminator_reward(
    measure: np.ndarray, experts: np.ndarray, details: np.ndarray, width: float, sees_details: bool
) -> np.ndarray:
    """Mean reward −log(1−D*) (N,) of gaits with ``measure`` (N,), D* the best discriminator against uniform policies.

    A step is a point (m, u): its measure and a detail u ∈ [0, 1] that does not depend on the behaviour. Demonstrations
    are Gaussian bumps of ``width`` around ``experts`` (E,) and ``details`` (E,), one each. Against uniform policy data
    D* = p/(1+p) with p the density of demonstrations, so the reward is log(1+p); the mean is over policies' details.
    Without ``sees_details``, p is the density of the measure alone, and by Jensen's inequality the reward is no lower.
    """
    along_m = _bumps(measure, experts, width)  # (N, E)
    if not sees_details:
        return np.log1p(along_m.mean(axis=1))
    along_u = _bumps(MIDDLES, details, width)  # (400, E)
    density = np.einsum("ne,ue->nu", along_m, along_u) / len(experts)
    return np.log1p(density).mean(axis=1)


def _bumps(at: np.ndarray, centres: np.ndarray, width: float) -> np.ndarray:
    """Gaussian densities on [0, 1] around each of the ``centres`` (E,), at the points ``at`` (N,): (N, E)."""
    inside = np.exp(-(((MIDDLES[:, None] - centres) / width) ** 2) / 2)
    return np.exp(-(((at[:, None] - centres) / width) ** 2) / 2) / inside.mean(axis=0)
