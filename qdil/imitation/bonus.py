"""The measure bonus r_diversity (eq. 2, Algorithm 3): p + q·1[m ∈ A_e], the same for every step of an episode.

m is the measure of the episode, A_e the part of measure space whose archive cells are empty.

The *single-step bonus* of a follow-up of the paper (WQDIL) is another one: p + q / (1 + ρ), where ρ is the share of
all training steps so far whose δ was the δ(s_t) of this step (``bonus_scope=step``). It asks how often a foot contact
occurred, and not whether an archive cell is filled. With k feet δ has 2^k values: the cells of WQDIL's *single-step
archive*. WQDIL has p = 0 and q = 1. Its bonus is near 1 for a new δ, and ½ for the only δ that ever occurs.

Reference
- X. Yu, Z. Wan, D. M. Bossens, Y. Lyu, Q. Guo, I. W. Tsang, 2025. Imitation from Diverse Behaviors: Wasserstein Quality
  Diversity Imitation Learning with Single-Step Archive Exploration. AAMAS. arXiv:2411.06965 (the single-step bonus).
"""

from functools import partial

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


# By values of ``bonus_scope``. Its third value, "step", reads no measure and no archive: ``visit_shares``.
SCOPES = {"episode": episode_measures, "rollout": rollout_measures}


def measure_bonus(
    transitions: Transitions, occupied: jax.Array, p: jax.Array | float, q: jax.Array | float, scope: str = "episode"
) -> jax.Array:
    """r_diversity (T, E) of eq. 2, reward per step, for every step of a rollout.

    ``p`` ≥ 0 is the reward for being alive, ``q`` ≥ 0 that for reaching an empty cell. ``scope`` selects the measure m:
    that of the step's "episode" (paper) or of its "rollout" (released program). Raises KeyError for any other scope.
    """
    return p + q * is_empty(occupied, SCOPES[scope](transitions))


def begin_visits(num_envs: int, k: int) -> jax.Array:
    """The visits (E, 2^k) that each robot has made to each value of δ before the run: none."""
    return jnp.zeros((num_envs, 2**k), jnp.int32)


def visit_shares(proxy: jax.Array, visits: jax.Array, axis: str | None = None) -> tuple[jax.Array, jax.Array]:
    """ρ (T, E): for every step, the share of all earlier steps, of all robots, whose δ was this step's.

    ``proxy`` (T, E, k) in {0, 1}; ``visits`` (E, 2^k) are those of each robot before this rollout. Every value of δ
    counts one visit more than it had, as in the authors' program, so that ρ is defined at the first step. If the
    robots are shared out over devices, ``axis`` names that mesh axis. Also returns the visits after the rollout.
    """
    total = partial(jax.lax.psum, axis_name=axis) if axis else lambda x: x
    value = jnp.sum(proxy.astype(jnp.int32) * 2 ** jnp.arange(proxy.shape[-1]), axis=-1)  # (T, E) of 0 to 2^k - 1
    visited = jax.nn.one_hot(value, visits.shape[1], dtype=jnp.int32)  # (T, E, 2^k)
    during = total(jnp.sum(visited, axis=1))  # (T, 2^k)
    earlier = jnp.cumsum(during, axis=0) - during
    # All robots' visits of a long run exceed 32-bit integers.
    counts = 1.0 + total(jnp.sum(visits.astype(jnp.float32), axis=0)) + earlier
    shares = counts / jnp.sum(counts, axis=-1, keepdims=True)
    return visits + jnp.sum(visited, axis=0), jnp.take_along_axis(shares, value, axis=-1)


def visit_bonus(shares: jax.Array) -> jax.Array:
    """1 / (1 + ρ) (…,), from ½ to 1: the higher, the more rarely a step's δ was visited."""
    return 1.0 / (1.0 + shares)
