"""Which elites demonstrate (section 5.2), and which of their episodes are recorded. Importing this imports no JAX."""

from collections.abc import Mapping
from typing import Any

import numpy as np


def fresh(archive: Mapping[str, Any]) -> dict[str, Any]:
    """``archive`` with each elite's return and measures on fresh episodes in place of those that won its cell.

    An archive keeps the best of many noisy evaluations, so that its own values are too good on average. ``archive`` is
    that of a finished run: it has ``rescored_return`` (n,) and ``rescored_measures`` (n, k), which replace
    ``true_return`` and ``measures``. Raises ValueError without them.
    """
    for name in ("rescored_return", "rescored_measures"):
        if name not in archive:
            raise ValueError(f"the archive has no {name}: its elites were not scored on fresh episodes.")
    return {**archive, "true_return": archive["rescored_return"], "measures": archive["rescored_measures"]}


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


def select(returns: np.ndarray, measures: np.ndarray, cells: int, count: int) -> np.ndarray:
    """Indices (count,) of the demonstrators: the best elite, then the farthest points among the top fifth.

    ``returns`` (N,) and ``measures`` (N, k) are those of ``fresh`` episodes; ``cells`` is the number of the archive's
    cells, filled or not. Elites whose physics diverged in every fresh episode, so that these are not-a-number, are
    left out. Raises ValueError for fewer elites than ``count``.
    """
    sound = np.flatnonzero(np.isfinite(returns) & np.isfinite(measures).all(axis=1))
    pool = sound[top_fifth(returns[sound], cells)]
    return pool[farthest_points(measures[pool], count)]


def best_first(measures: np.ndarray, fell: np.ndarray, length: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Indices (A,) of a demonstrator's episodes, the one to record first.

    Episodes that do not fall come first. If all fall, those of at least the median length come first, since a robot
    that falls at once shows nothing. Otherwise the order is by the distance of an episode's ``measures`` (A, k) to
    ``target`` (k,), the demonstrator's mean over fresh episodes. ``fell`` (A,) bool; ``length`` (A,) steps.
    """
    preferred = length >= np.median(length) if np.all(fell) else ~fell
    distance = np.linalg.norm(measures - target, axis=1)
    return np.lexsort((distance, ~preferred))
