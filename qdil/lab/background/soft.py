"""The soft archive's threshold rule on its own, one solution at a time (section 2.1, Algorithm 2).

The paper prints Algorithm 2 with the threshold updated before the improvement is computed. Every improvement would
then be (1 - α)(f - t_e), which is 0 for α = 1. Here the improvement is over the threshold *before* the update, as in
the MAP-Annealing paper and in pyribs.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Visits(NamedTuple):
    """Solutions that arrive in one cell one after the other, a row per arrival."""

    objective: np.ndarray  # (n,) f of the solution
    before: np.ndarray  # (n,) threshold t_e before it arrived
    after: np.ndarray  # (n,) threshold after it arrived
    improvement: np.ndarray  # (n,) f - t_e if the solution was accepted, else 0


def visit(objectives: Sequence[float], learning_rate: float, threshold_min: float = 0.0) -> Visits:
    """Let solutions with ``objectives`` arrive in one empty cell of a soft archive.

    A solution with f > t_e is accepted, and t_e becomes (1 - α) t_e + α f with α = ``learning_rate`` in [0, 1]; the
    empty cell's t_e is ``threshold_min``. Raises ValueError for another learning rate.
    """
    if not 0 <= learning_rate <= 1:
        raise ValueError(f"learning_rate must be between 0 and 1, not {learning_rate}.")
    threshold, rows = float(threshold_min), []
    for objective in map(float, objectives):
        accepted = objective > threshold
        moved = (1 - learning_rate) * threshold + learning_rate * objective if accepted else threshold
        rows.append((objective, threshold, moved, objective - threshold if accepted else 0.0))
        threshold = moved
    return Visits(*np.array(rows, float).reshape(-1, 4).T)
