"""Tests for NaN and infinity by the bits of a number.

They stay right under fast math, where the compiler may assume that no number is NaN or infinite.
"""

from typing import Any

import jax
import jax.numpy as jnp

_MAGNITUDE = 0x7FFFFFFF  # all but the sign of a float32
_INFINITY = 0x7F800000


def _magnitude_bits(x: jax.Array) -> jax.Array:
    """Integers in the order of |x|; those of infinity and NaN are the largest."""
    return jax.lax.bitcast_convert_type(jnp.asarray(x, jnp.float32), jnp.uint32) & jnp.uint32(_MAGNITUDE)


def is_smaller(x: jax.Array, bound: float) -> jax.Array:
    """|x| < ``bound``, elementwise; False for NaN."""
    return _magnitude_bits(x) < _magnitude_bits(jnp.asarray(bound, jnp.float32))


def all_finite(tree: Any) -> jax.Array:
    """() bool: whether no floating-point leaf of ``tree`` contains NaN or infinity."""
    leaves = [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    return jnp.all(jnp.stack([jnp.all(_magnitude_bits(leaf) < _INFINITY) for leaf in leaves] or [jnp.asarray(True)]))
