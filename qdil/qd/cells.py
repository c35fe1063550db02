"""The grid over the measures: which cell a measure falls into, for NumPy and JAX alike. Imports neither."""

from collections.abc import Sequence
from typing import Any

# A measure this close below a grid line (in cells) counts as on it: wide enough for float32, on the host as on devices,
# so that shares like 39/50 fall into the same cell everywhere (pyribs' own 1e-6 is too narrow for that).
EDGE = 1e-4


def cell_index(measures: Any, cells: Sequence[int], xp: Any) -> Any:
    """The index (…, k) int32, per measure, of the cell that ``measures`` (…, k) in [0, 1]^k fall into.

    ``cells`` (k) are the cells per measure, ``xp`` is the array module of ``measures``: ``numpy`` or ``jax.numpy``.
    """
    position = xp.asarray(cells, measures.dtype) * measures + EDGE
    return xp.clip(position.astype(xp.int32), 0, xp.asarray(cells) - 1)
