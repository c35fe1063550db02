"""The soft archive's threshold rule on its own, one solution at a time (section 2.1, Algorithm 2).

The paper prints Algorithm 2 with the threshold updated before the improvement is taken, which would make every
improvement (1 - α)(f - t_e): nothing at all for α = 1. The improvement here is over the threshold *before* the update,
as in the MAP-Annealing paper and in pyribs.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Visits(NamedTuple):
    """What one cell does with solutions that arrive one after the other, a row per arrival."""

    objective: np.ndarray  # (n,) of the arrival, f
    before: np.ndarray  # (n,) threshold that it met, t_e
    after: np.ndarray  # (n,) threshold that it left
    improvement: np.ndarray  # (n,) f - t_e if it was accepted, else 0


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
