"""Two ways of improving a softmax policy on the measure bonus alone: along the exact gradient, and by sampled PPO."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from qdil.imitation.bonus import is_empty
from qdil.lab.lemma.mdp import Episodes, Mdp, bonus_return, sample
from qdil.rl.vppo import gae


class TabularPPO(NamedTuple):
    """One iteration of PPO with a table as policy. Constants that apply to a table too are those of the robots."""

    horizon: int = 12  # T, steps (ours)
    episodes: int = 128  # sampled per iteration (ours)
    minibatches: int = 4  # per epoch (ours)
    epochs: int = 4  # passes over the episodes (authors)
    gamma: float = 0.99  # discount (authors)
    lam: float = 0.95  # λ of GAE (authors)
    clip: float = 0.2  # of the ratio (authors)
    learning_rate: float = 0.03  # Adam's, in logits per step (ours: a logit moves further than a network's weight)
    p: float = 0.0  # of eq. 2, reward per step
    q: float = 1.0  # of eq. 2, reward per step


STATIC = ("horizon", "episodes", "minibatches", "epochs")  # the settings that shapes and loops depend on


def improve(key: jax.Array, mdp: Mdp, theta: jax.Array, occupied: jax.Array, settings: TabularPPO) -> jax.Array:
    """θ (S, A) after one iteration of PPO-clip on p + q·1[m ∈ A_e]: sample episodes, then several epochs of Adam.

    As for the robots, the reward of a step is that of its whole episode, GAE's critic sees only the state, and
    advantages are normalised within each minibatch. The critic is the mean return from each state in the sampled
    episodes. A time limit is an end, since Lemma 1's return ends with the episode. Raises ValueError if
    ``minibatches`` does not divide ``episodes``.
    """
    if settings.episodes % settings.minibatches:
        raise ValueError(f"minibatches={settings.minibatches} must divide episodes={settings.episodes}.")
    sample_key, order_key = jax.random.split(key)
    seen = sample(sample_key, mdp, theta, settings.horizon, settings.episodes)
    advantage = _advantages(seen, occupied, settings, len(mdp.start))
    before = _log_prob(theta, seen.state, seen.action)
    gradient = jax.grad(partial(_loss, seen=seen, advantage=advantage, before=before, clip=settings.clip))
    opt = optax.adam(settings.learning_rate)

    def minibatch(carry, rows):
        theta, state = carry
        move, state = opt.update(gradient(theta, rows), state)
        return (optax.apply_updates(theta, move), state), None

    def epoch(carry, key):
        rows = jax.random.permutation(key, settings.episodes).reshape(settings.minibatches, -1)
        return jax.lax.scan(minibatch, carry, rows)

    keys = jax.random.split(order_key, settings.epochs)
    return jax.lax.scan(epoch, (theta, opt.init(theta)), keys)[0][0]


def _loss(
    theta: jax.Array,
    rows: jax.Array,
    seen: Episodes,
    advantage: jax.Array,
    before: jax.Array,
    clip: jax.Array | float,
) -> jax.Array:
    """PPO-clip's loss of the episodes ``rows``; ``before`` (T, N) are the old policy's log-probabilities."""
    values, weight = advantage[:, rows], seen.counts[:, rows].astype(jnp.float32)
    steps = jnp.sum(weight)
    mean = jnp.sum(values * weight) / steps
    spread = jnp.sqrt(jnp.sum(jnp.square(values - mean) * weight) / steps + 1e-8)
    normalised = (values - mean) / spread
    ratio = jnp.exp(_log_prob(theta, seen.state[:, rows], seen.action[:, rows]) - before[:, rows])
    clipped = jnp.clip(ratio, 1.0 - clip, 1.0 + clip)
    return -jnp.sum(jnp.minimum(ratio * normalised, clipped * normalised) * weight) / steps


@partial(jax.jit, static_argnames="horizon")
def ascend(
    mdp: Mdp, theta: jax.Array, occupied: jax.Array, horizon: int, gamma: jax.Array | float, size: jax.Array | float
) -> jax.Array:
    """θ + size·∇h: one step along the exact gradient of the bonus's return (eq. 17), p = 0 and q = 1."""
    return theta + size * jax.grad(bonus_return, argnums=1)(mdp, theta, occupied, horizon, gamma)


def _advantages(seen: Episodes, occupied: jax.Array, settings: TabularPPO, states: int) -> jax.Array:
    """(T, N) GAE with the tabular critic; steps after an episode's end have advantage 0."""
    within = seen.counts.astype(jnp.float32)
    rewards = (settings.p + settings.q * is_empty(occupied, seen.measures)) * within
    nothing = jnp.zeros_like(rewards)
    returns = gae(rewards, nothing, nothing, nothing, nothing, settings.gamma, 1.0)  # discounted sums of later rewards
    visits = jnp.zeros(states).at[seen.state].add(within)
    critic = jnp.zeros(states).at[seen.state].add(returns * within) / jnp.maximum(visits, 1.0)
    values = critic[seen.state] * within
    next_values = jnp.concatenate([values[1:], nothing[:1]])  # zero after a fall and after the time limit
    return gae(rewards, values, next_values, nothing, nothing, settings.gamma, settings.lam)


def _log_prob(theta: jax.Array, state: jax.Array, action: jax.Array) -> jax.Array:
    """log π_θ(a | s) of every step."""
    return jax.nn.log_softmax(theta, axis=1)[state, action]
