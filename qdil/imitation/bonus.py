"""The measure bonus r_diversity (eq. 2, Algorithm 3): p + q·1[m ∈ A_e], the same for every step of an episode.

m is the measure of the episode, A_e the part of measure space whose archive cells are empty.
"""

import jax
import jax.numpy as jnp

from qdil.qd.cells import cell_index
from qdil.types import Transitions


def is_empty(occupied: jax.Array, measures: jax.Array) -> jax.Array:
    """1[m ∈ A_e] (…,), 0 or 1, for ``measures`` (…, k) in [0, 1]; ``occupied`` is the bool grid of filled cells.

    ``occupied`` has k axes of ``cells`` each. A measure on a grid line belongs to the upper cell, as in the archive.
    """
    index = cell_index(measures, occupied.shape, jnp)
    return 1.0 - occupied[tuple(jnp.moveaxis(index, -1, 0))].astype(jnp.float32)


def episode_measures(transitions: Transitions) -> jax.Array:
    """(T, E, k): for every step, the measure of its episode: the mean of δ over the steps of that episode.

    A rollout may hold several episodes of one robot. An episode that began in an earlier rollout counts with all its
    steps. An episode that goes on after this rollout counts with its mean so far.
    """

    def backwards(later: jax.Array, step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        so_far, ended = step
        measure = jnp.where(ended[:, None], so_far, later)
        return measure, measure

    unfinished = transitions.measures_so_far[-1]
    steps = (transitions.measures_so_far, transitions.ended)
    return jax.lax.scan(backwards, unfinished, steps, reverse=True)[1]


def rollout_measures(transitions: Transitions) -> jax.Array:
    """(T, E, k): the mean of δ over the whole rollout, across resets, as in the authors' released program."""
    return jnp.broadcast_to(jnp.mean(transitions.proxy, axis=0), transitions.proxy.shape)


SCOPES = {"episode": episode_measures, "rollout": rollout_measures}  # by the values of ``bonus_scope``


def measure_bonus(
    transitions: Transitions, occupied: jax.Array, p: jax.Array | float, q: jax.Array | float, scope: str = "episode"
) -> jax.Array:
    """r_diversity (T, E) of eq. 2, reward per step, for every step of a rollout.

    ``p`` ≥ 0 is the reward for being alive, ``q`` ≥ 0 that for reaching an empty cell. ``scope`` selects the measure m:
    that of the step's "episode" (paper) or of its "rollout" (released program). Raises KeyError for any other scope.
    """
    return p + q * is_empty(occupied, SCOPES[scope](transitions))
