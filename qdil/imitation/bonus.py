"""The measure bonus (eq. 2, Algorithm 3): p + q·1[m ∈ A_e], the same for every step of an episode."""

import jax
import jax.numpy as jnp

from qdil.qd.cells import cell_index
from qdil.types import Transitions


def is_empty(occupied: jax.Array, measures: jax.Array) -> jax.Array:
    """1[m ∈ A_e] for ``measures`` (…, k) in [0, 1]^k and the grid ``occupied`` (cells, …) of filled cells."""
    index = cell_index(measures, occupied.shape, jnp)
    return 1.0 - occupied[tuple(jnp.moveaxis(index, -1, 0))].astype(jnp.float32)


def episode_measures(transitions: Transitions) -> jax.Array:
    """(T, E, k): the measure of the episode that each step belongs to.

    A window may hold several episodes of a robot: a step takes the mean of its own. The episode that the
    window cuts counts with its mean so far; one begun in an earlier window with all its steps.
    """

    def backwards(of_later, now):
        so_far, ended = now
        mine = jnp.where(ended[:, None], so_far, of_later)
        return mine, mine

    cut = transitions.measures_so_far[-1]
    return jax.lax.scan(backwards, cut, (transitions.measures_so_far, transitions.ended), reverse=True)[1]


def window_measures(transitions: Transitions) -> jax.Array:
    """(T, E, k): the mean of δ over the whole window, across resets, as in the authors' released program."""
    return jnp.broadcast_to(jnp.mean(transitions.proxy, axis=0), transitions.proxy.shape)


SCOPES = {"episode": episode_measures, "window": window_measures}


def measure_bonus(
    transitions: Transitions, occupied: jax.Array, p: jax.Array | float, q: jax.Array | float, scope: str = "episode"
) -> jax.Array:
    """r_diversity (T, E) of eq. 2 for every step of a window; ``scope`` "episode" (the paper's) or "window"."""
    return p + q * is_empty(occupied, SCOPES[scope](transitions))
