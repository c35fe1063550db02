"""Which expert elites demonstrate (section 5.2): farthest points among the best. Importing this does not import JAX."""

import numpy as np


def top_fifth(fitness: np.ndarray, cells: int) -> np.ndarray:
    """Indices of the best elites by ``fitness`` (N,), best first.

    Their number is a fifth of the archive's ``cells``: 500 of 2500 in the paper.
    """
    return np.argsort(-fitness, kind="stable")[: max(1, cells // 5)]


def farthest_points(measures: np.ndarray, count: int) -> np.ndarray:
    """Indices (count,) of diverse ``measures`` (N, k): the first, then always the one farthest from all chosen ones.

    "Farthest" means the largest distance to the nearest chosen point. This is farthest-first traversal. The paper asks
    for demonstrations "as diverse as possible" and gives no rule. Raises ValueError if N < ``count``.
    """
    if len(measures) < count:
        raise ValueError(f"{count} demonstrations were asked for, but there are only {len(measures)} elites.")
    chosen = [0]
    while len(chosen) < count:
        distances = np.linalg.norm(measures[:, None] - measures[chosen][None], axis=-1)
        chosen.append(int(np.argmax(distances.min(axis=1))))
    return np.asarray(chosen)


def select(fitness: np.ndarray, measures: np.ndarray, cells: int, count: int) -> np.ndarray:
    """Indices (count,) of the demonstrators: the best elite, then the farthest points among the top fifth."""
    pool = top_fifth(fitness, cells)
    return pool[farthest_points(measures[pool], count)]
