"""Which rows an operation of a trace takes, where that is known while a function is traced.

A simulator sorts its links by kind of joint, works on each kind, and sorts them back. The numbers of those rows are
constants, but counted from the end in places, and brought into range by a few operations of the trace; NumPy does
these. Rows whose numbers are known are slices; others are looked up as a program runs.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.extend.core import JaxprEqn


def is_known(value: Any) -> bool:
    """Whether these are whole numbers, or truths, that NumPy has."""
    return isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "biu"


def _broadcast(eqn: JaxprEqn, value: np.ndarray) -> np.ndarray:
    shape, axes = eqn.params["shape"], eqn.params["broadcast_dimensions"]
    return np.broadcast_to(np.expand_dims(value, [axis for axis in range(len(shape)) if axis not in axes]), shape)


BY_NUMPY: dict[str, Callable[..., Any]] = {
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


def reordered(eqn: Any, where: Any) -> tuple[int, list[tuple[int, int]]] | None:
    """The axis along which a gather takes whole rows, none of them twice, and which, if they are known.

    As ranges (first, one past last) of rows that follow each other. Rows taken twice are many short ranges: looking
    them up is no slower.
    """
    numbers = eqn.params["dimension_numbers"]
    if not is_known(where) or len(numbers.start_index_map) != 1 or where.size == 0:
        return None
    shape, out, (axis,) = eqn.invars[0].aval.shape, eqn.outvars[0].aval.ndim, numbers.start_index_map
    whole = tuple(1 if i == axis else size for i, size in enumerate(shape))
    in_place = (*range(axis), *range(axis + where.ndim - 1, out))
    if (numbers.collapsed_slice_dims, numbers.offset_dims, eqn.params["slice_sizes"]) != ((axis,), in_place, whole):
        return None
    at = where.ravel().tolist()
    if min(at) < 0 or max(at) >= shape[axis] or len(set(at)) < len(at):
        return None
    return axis, _ranges(at)


def _ranges(at: Sequence[int]) -> list[tuple[int, int]]:
    breaks = [i for i in range(1, len(at)) if at[i] != at[i - 1] + 1]
    return [(at[a], at[b - 1] + 1) for a, b in zip([0, *breaks], [*breaks, len(at)], strict=True)]
