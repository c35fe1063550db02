"""Seeing NaN and infinity by their bits, which stays true where a compiler was told that there are none (fast math)."""

from typing import Any

import jax
import jax.numpy as jnp

_MAGNITUDE = 0x7FFFFFFF  # all but the sign of a float32
_INFINITY = 0x7F800000


def _magnitude_bits(x: jax.Array) -> jax.Array:
    """Integers that order float32 numbers by size; infinity and NaN are the largest."""
    return jax.lax.bitcast_convert_type(jnp.asarray(x, jnp.float32), jnp.uint32) & jnp.uint32(_MAGNITUDE)


def is_smaller(x: jax.Array, bound: float) -> jax.Array:
    """|x| < ``bound`` for every number, False for NaN."""
    return _magnitude_bits(x) < _magnitude_bits(jnp.asarray(bound, jnp.float32))


def all_finite(tree: Any) -> jax.Array:
    """() bool: no floating-point leaf of ``tree`` holds NaN or infinity."""
    leaves = [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    return jnp.all(jnp.stack([jnp.all(_magnitude_bits(leaf) < _INFINITY) for leaf in leaves] or [jnp.asarray(True)]))
