"""A Markov decision process so small that P(m ∈ A_e | π) is a finite sum, computed by dynamic programming.

An episode has at most T steps. Every step counts the proxy δ(s) ∈ {0,1}^k of its state; the episode's measures are
its counts divided by its length, as those of a robot are. The probability of every (length, counts) follows from
moving the probability mass of (state, counts) forward T steps. It is differentiable in the policy.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdil.imitation.bonus import is_empty


class Mdp(NamedTuple):
    """S states, A actions, k measure proxies."""

    start: jax.Array  # (S,) probability of the first state
    step: jax.Array  # (S, A, S) probability of the next state if the episode continues
    fall: jax.Array  # (S, A) probability that the episode ends with this step
    proxy: jax.Array  # (S, k) int32, 0 or 1

    @property
    def k(self) -> int:
        """The number of measures."""
        return self.proxy.shape[1]


class Episodes(NamedTuple):
    """N sampled episodes, axes (T, N) in front; steps after an episode's end do not count."""

    state: jax.Array  # (T, N) int32
    action: jax.Array  # (T, N) int32
    counts: jax.Array  # (T, N) bool, True while the episode lasts
    measures: jax.Array  # (N, k) of the whole episode
    length: jax.Array  # (N,) int32, steps


def random_mdp(key: jax.Array, states: int = 8, actions: int = 3, falls: float = 0.0, k: int = 2) -> Mdp:
    """An MDP whose states cycle through the 2^k contact patterns, with a few likely successors each.

    With k = 2 the patterns are none, foot 2, foot 1, both. ``falls`` in [0, 1] is the largest probability of a fall in
    a step; 0 gives episodes of exactly T steps.
    """
    start_key, step_key, fall_key = jax.random.split(key, 3)
    start = jax.random.dirichlet(start_key, jnp.ones(states))
    step = jax.random.dirichlet(step_key, jnp.full(states, 0.3), (states, actions))
    fall = falls * jnp.square(jax.random.uniform(fall_key, (states, actions)))
    pattern = jnp.arange(states, dtype=jnp.int32)
    return Mdp(start, step, fall, jnp.stack([pattern // 2**j % 2 for j in reversed(range(k))], axis=1))


def outcomes(mdp: Mdp, theta: jax.Array, horizon: int) -> jax.Array:
    """(T, T+1, …): P(length = t+1 and counts = (i, j, …) | π_θ), an axis per measure; all entries sum to 1.

    ``theta`` (S, A) are the logits of a softmax policy; ``horizon`` is T.
    """
    policy = jax.nn.softmax(theta, axis=1)
    ends = jnp.sum(policy * mdp.fall, axis=1)  # (S,) probability of a fall in this state
    goes = jnp.einsum("sa,sa,saz->sz", policy, 1.0 - mdp.fall, mdp.step)  # (S, S) probability of the next state

    def one_step(mass: jax.Array, last: jax.Array) -> tuple[jax.Array, jax.Array]:
        counted = mass
        for j in range(mdp.k):  # mass never wraps around, because counts are at most the number of steps
            touches = jnp.expand_dims(mdp.proxy[:, j] == 1, tuple(range(1, 1 + mdp.k)))
            counted = jnp.where(touches, jnp.roll(counted, 1, axis=1 + j), counted)
        share = jnp.where(last, 1.0, ends)  # the time limit ends every remaining episode
        return jnp.einsum("s...,sz->z...", counted, goes), jnp.einsum("s...,s->...", counted, share)

    begin = jnp.zeros((len(mdp.start), *(horizon + 1,) * mdp.k)).at[(slice(None), *(0,) * mdp.k)].set(mdp.start)
    return jax.lax.scan(one_step, begin, jnp.arange(horizon) == horizon - 1)[1]


def is_new(occupied: jax.Array, horizon: int) -> jax.Array:
    """(T, T+1, …): 1[m ∈ A_e] of every outcome, A_e the cells of the unit grid ``occupied`` (cells, …) not filled.

    Impossible outcomes (more counts than steps) get the value of the grid's border; their probability is 0.
    """
    counts = jnp.arange(horizon + 1) / jnp.arange(1, horizon + 1)[:, None]  # (T, T+1) counts / length
    shares = [_along(counts, j, occupied.ndim) for j in range(occupied.ndim)]
    return is_empty(occupied, jnp.minimum(jnp.stack(jnp.broadcast_arrays(*shares), axis=-1), 1.0))


def _along(counts: jax.Array, measure: int, k: int) -> jax.Array:
    """``counts`` (T, T+1) with its second axis where ``outcomes`` has that of ``measure``."""
    return jnp.expand_dims(counts, [1 + j for j in range(k) if j != measure])


@partial(jax.jit, static_argnames="horizon")
def probability(mdp: Mdp, theta: jax.Array, occupied: jax.Array, horizon: int) -> jax.Array:
    """P(m ∈ A_e | π_θ): the share of episodes whose measures fall into an empty cell."""
    return jnp.sum(outcomes(mdp, theta, horizon) * is_new(occupied, horizon))


@partial(jax.jit, static_argnames="horizon")
def bonus_return(
    mdp: Mdp,
    theta: jax.Array,
    occupied: jax.Array,
    horizon: int,
    gamma: jax.Array | float,
    p: jax.Array | float = 0.0,
    q: jax.Array | float = 1.0,
) -> jax.Array:
    """h(θ, A_e) of eq. 17: the expected discounted sum of p + q·1[m ∈ A_e] over an episode's steps.

    If every episode has T steps, this is (p + q·P)·(1-γ^T)/(1-γ). If episodes may end early, it is not.
    """
    weight = jnp.cumsum(gamma ** jnp.arange(horizon))  # (T,) sum of γ^t over an episode of t+1 steps
    bonus = p + q * is_new(occupied, horizon)
    returns = bonus * jnp.expand_dims(weight, tuple(range(1, bonus.ndim)))
    return jnp.sum(outcomes(mdp, theta, horizon) * returns)


@partial(jax.jit, static_argnames="horizon")
def mean_length(mdp: Mdp, theta: jax.Array, horizon: int) -> jax.Array:
    """Expected number of steps of an episode, 1 to T."""
    by_length = outcomes(mdp, theta, horizon).sum(axis=tuple(range(1, 1 + mdp.k)))
    return jnp.sum(by_length * jnp.arange(1, horizon + 1))


def sample(key: jax.Array, mdp: Mdp, theta: jax.Array, horizon: int, count: int) -> Episodes:
    """``count`` = N episodes of π_θ."""

    def one_step(carry, key):
        state, alive = carry
        act_key, fall_key, step_key = jax.random.split(key, 3)
        action = jax.random.categorical(act_key, theta[state])
        fell = jax.random.uniform(fall_key, state.shape) < mdp.fall[state, action]
        after = jax.random.categorical(step_key, jnp.log(mdp.step[state, action]))
        return (after, alive & ~fell), (state, action, alive)

    start_key, walk_key = jax.random.split(key)
    first = jax.random.categorical(start_key, jnp.log(mdp.start), shape=(count,))
    keys = jax.random.split(walk_key, horizon)
    _, (state, action, counts) = jax.lax.scan(one_step, (first, jnp.ones(count, bool)), keys)
    length = jnp.sum(counts, axis=0)
    touched = jnp.sum(mdp.proxy[state] * counts[..., None], axis=0)
    return Episodes(state, action, counts, touched / length[:, None], length)
