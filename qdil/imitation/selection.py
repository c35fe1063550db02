"""Which expert elites demonstrate (section 5.2): farthest points among the best. Importing this does not import JAX."""

import numpy as np


def top_fifth(fitness: np.ndarray, cells: int) -> np.ndarray:
    """Rows of the best elites: as many as a fifth of the archive's cells (500 of the paper's 2500), best first."""
    return np.argsort(-fitness, kind="stable")[: max(1, cells // 5)]


def farthest_points(measures: np.ndarray, count: int) -> np.ndarray:
    """Rows of ``count`` diverse ``measures`` (N, k): the first, then always the one farthest from all chosen.

    Raises ValueError if there are fewer points than asked for.
    """
    if len(measures) < count:
        raise ValueError(f"{count} demonstrations were asked for, but only {len(measures)} elites are there.")
    chosen = [0]
    while len(chosen) < count:
        distances = np.linalg.norm(measures[:, None] - measures[chosen][None], axis=-1)
        chosen.append(int(np.argmax(distances.min(axis=1))))
    return np.asarray(chosen)


def select(fitness: np.ndarray, measures: np.ndarray, cells: int, count: int) -> np.ndarray:
    """Rows of the ``count`` demonstrators: farthest points, from the best, among the top fifth."""
    pool = top_fifth(fitness, cells)
    return pool[farthest_points(measures[pool], count)]
