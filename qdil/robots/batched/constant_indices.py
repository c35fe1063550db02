"""Turning gathers whose indices are constants into slices, for ``batch_last``.

A simulator sorts its links by kind of joint, works on each kind, and restores the order. In the trace each sorting is a
gather: a lookup of rows by index. The indices are constants, but some count from the end, and a few integer operations
of the trace correct that. ``NUMPY_RULES`` carries out those operations while tracing, so that the indices stay known.
``gathered_ranges`` then finds the slices that replace the gather. Slices are faster: XLA fuses a gather into its
consumers and recomputes its source for each number that it reads.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.extend.core import JaxprEqn


def is_constant(value: Any) -> bool:
    """Whether these are integers or booleans whose values are known while tracing (NumPy's, not JAX's)."""
    return isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "biu"


def _broadcast(eqn: JaxprEqn, value: np.ndarray) -> np.ndarray:
    shape, axes = eqn.params["shape"], eqn.params["broadcast_dimensions"]
    return np.broadcast_to(np.expand_dims(value, [axis for axis in range(len(shape)) if axis not in axes]), shape)


# The operations that correct indices, by the name of their primitive: (operation, its constant operands) -> constant.
NUMPY_RULES: dict[str, Callable[..., Any]] = {
    "add": lambda eqn, a, b: a + b,
    "and": lambda eqn, a, b: a & b,
    "broadcast_in_dim": _broadcast,
    "convert_element_type": lambda eqn, a: a.astype(eqn.params["new_dtype"]),
    "eq": lambda eqn, a, b: a == b,
    "lt": lambda eqn, a, b: a < b,
    "ne": lambda eqn, a, b: a != b,
    "rem": lambda eqn, a, b: np.fmod(a, b),
    "select_n": lambda eqn, which, no, yes: np.where(which, yes, no),
    "sub": lambda eqn, a, b: a - b,
}


def gathered_ranges(eqn: Any, indices: Any) -> tuple[int, list[tuple[int, int]]] | None:
    """The axis along which a gather takes whole rows, and which rows, as ranges (first, one past the last).

    Rows that follow each other share a range. None if the indices are not constants, if the gather takes anything but
    whole rows along one axis, or if it takes a row twice (there would be many short slices, no faster than a gather).
    """
    numbers = eqn.params["dimension_numbers"]
    if not is_constant(indices) or len(numbers.start_index_map) != 1 or indices.size == 0:
        return None
    shape, ndim, (axis,) = eqn.invars[0].aval.shape, eqn.outvars[0].aval.ndim, numbers.start_index_map
    whole_row = tuple(1 if i == axis else size for i, size in enumerate(shape))
    kept_axes = (*range(axis), *range(axis + indices.ndim - 1, ndim))
    takes = (numbers.collapsed_slice_dims, numbers.offset_dims, eqn.params["slice_sizes"])
    if takes != ((axis,), kept_axes, whole_row):
        return None
    rows = indices.ravel().tolist()
    if min(rows) < 0 or max(rows) >= shape[axis] or len(set(rows)) < len(rows):
        return None
    return axis, _ranges(rows)


def _ranges(rows: Sequence[int]) -> list[tuple[int, int]]:
    """``rows`` in their order as ranges (first, one past the last) of consecutive numbers."""
    breaks = [i for i in range(1, len(rows)) if rows[i] != rows[i - 1] + 1]
    return [(rows[a], rows[b - 1] + 1) for a, b in zip([0, *breaks], [*breaks, len(rows)], strict=True)]
