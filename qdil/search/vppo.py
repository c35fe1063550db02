"""VPPO: K copies of a policy trained side by side by PPO, each on its own weighting of the reward streams.

The same function serves both of Algorithm 1's uses. Gradients (line 4): K = 1+k copies of θ_μ, copy i on stream i.
Walk (line 17): the copies are *tied*, that is, they share one weighting and average their gradients, so
they remain one policy trained on all environments. One compiled program, stable shapes.

Departure from the authors' released program: its critics are one network per stream; here each copy has one critic
with a head per stream (fitness, δ_1 … δ_k). Advantages are linear in the rewards, so the advantage of any weighting
is the weighted sum over heads, and the walk's critic stays valid when xNES changes the weights.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree

from qdil.robots.environment import Environment
from qdil.search import networks
from qdil.search.normalise import ReturnStats, init_return_stats, normalise_obs, update_obs_stats, update_return_stats
from qdil.search.rollout import Act, Actors, where_each, window
from qdil.sharding import AXIS
from qdil.types import Choice, ObsStats, Params, Transitions


class Settings(NamedTuple):
    """PPO's constants; see ``qdil.config`` for units and sources."""

    window: int
    episode_length: int
    minibatches: int
    gamma: float
    lam: float
    clip: float
    value_coef: float
    entropy_coef: float
    max_grad_norm: float
    learning_rate: float
    target_kl: float


class Learner(NamedTuple):
    """Everything PPO adapts; with an axis (K) in front while copies train side by side."""

    policy: Params
    critic: Params
    policy_opt: optax.OptState
    critic_opt: optax.OptState
    returns: ReturnStats


class Batch(NamedTuple):
    """What the loss reads, axes (K, T, E/K)."""

    obs: jax.Array  # normalised (…, O)
    choice: Choice
    advantage: jax.Array  # (…) of the copy's own weighting, not yet normalised
    target: jax.Array  # (…, 1+k) normalised returns
    value: jax.Array  # (…, 1+k) the critic's output when the window was collected


def optimiser(settings: Settings) -> optax.GradientTransformation:
    """Adam after clipping the gradient's norm; policy and critic each have one."""
    return optax.chain(optax.clip_by_global_norm(settings.max_grad_norm), optax.adam(settings.learning_rate, eps=1e-5))


def init_learner(settings: Settings, policy: Params, critic: Params, streams: int) -> Learner:
    """A learner around a policy and a critic with ``streams`` = 1+k heads."""
    opt = optimiser(settings)
    return Learner(policy, critic, opt.init(policy), opt.init(critic), init_return_stats(streams))


def fork(learner: Learner, copies: int) -> Learner:
    """K identical copies, axis (K) in front of every leaf."""
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (copies, *jnp.shape(leaf))), learner)


def to_copies(x: jax.Array, copies: int, axis: int = 0) -> jax.Array:
    """Deal the environment axis out to the copies: (…, E, …) -> (K, …, E/K, …), environment e to copy e mod K."""
    shape = x.shape
    x = x.reshape(*shape[:axis], shape[axis] // copies, copies, *shape[axis + 1 :])
    return jnp.moveaxis(x, axis + 1, 0)


def from_copies(x: jax.Array, axis: int = 0) -> jax.Array:
    """Undo ``to_copies``."""
    x = jnp.moveaxis(x, 0, axis + 1)
    return x.reshape(*x.shape[:axis], -1, *x.shape[axis + 2 :])


def act_with_copies(policy: Params, stats: ObsStats, copies: int) -> Act:
    """Sample actions for E environments from K policies, each driving its own share."""

    def act_one(params: Params, noise: jax.Array, obs: jax.Array) -> tuple[jax.Array, jax.Array]:
        mean = networks.policy_mean(params, stats, obs)
        raw = mean + noise * jnp.exp(params["log_std"])
        return raw, networks.log_prob(params, mean, raw)

    def act(noise: jax.Array, obs: jax.Array) -> tuple[jax.Array, jax.Array]:
        raw, logp = jax.vmap(act_one)(policy, to_copies(noise, copies), to_copies(obs, copies))
        return from_copies(raw), from_copies(logp)

    return act


def gae(
    rewards: jax.Array,
    values: jax.Array,
    next_values: jax.Array,
    terminated: jax.Array,
    truncated: jax.Array,
    gamma: float,
    lam: float,
) -> jax.Array:
    """Generalised advantage estimates, axis (T) in front; ``next_values`` are of the true next observation.

    A fall (terminated) has no future; a time limit (truncated) bootstraps from the value of its last state.
    Neither lets the following episode's advantages through.
    """
    deltas = rewards + gamma * next_values * (1.0 - terminated) - values
    carries_on = (1.0 - terminated) * (1.0 - truncated)

    def backwards(advantage, now):
        delta, carries_on = now
        advantage = delta + gamma * lam * carries_on * advantage
        return advantage, advantage

    return jax.lax.scan(backwards, jnp.zeros_like(deltas[0]), (deltas, carries_on), reverse=True)[1]


def loss(
    policy: Params, critic: Params, batch: Batch, settings: Settings
) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    """PPO's clipped surrogate and clipped value loss of one copy; ``batch.advantage`` is normalised already."""
    obs, raw_action = networks.as_columns(batch.obs), networks.columns(batch.choice.raw_action)
    advantage = batch.advantage.reshape(-1)
    mean = networks.mlp_of_columns(policy["mean"], obs)
    log_ratio = networks.log_prob_of_columns(policy, mean, raw_action) - batch.choice.log_prob.reshape(-1)
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip)
    surrogate = jnp.minimum(ratio * advantage, clipped * advantage)
    value, before, target = networks.mlp_of_columns(critic, obs), *map(networks.columns, (batch.value, batch.target))
    near = before + jnp.clip(value - before, -settings.clip, settings.clip)
    errors = jnp.maximum(jnp.square(value - target), jnp.square(near - target))
    value_loss = 0.5 * jnp.mean(errors)
    total = -jnp.mean(surrogate) + settings.value_coef * value_loss - settings.entropy_coef * networks.entropy(policy)
    approx_kl = jnp.mean(ratio - 1.0 - log_ratio)  # Schulman's low-variance estimator
    return total, (approx_kl, value_loss)


def _across(x: jax.Array, tied: jax.Array) -> jax.Array:
    """Mean of (K, …) over the devices, and over the copies too where they are tied."""
    # A sum of rows: XLA's reduction over so few is slow on a CPU.
    return jax.lax.pmean(jnp.where(tied, sum(x) / len(x), x), AXIS)


def _judge(
    learner: Learner, transitions: Transitions, rewards: jax.Array, stats: ObsStats, settings: Settings
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """One copy's window: observations, normalised; the critic's output there; advantages; returns."""
    obs = normalise_obs(stats, transitions.obs)
    scale = learner.returns
    said = networks.mlp(learner.critic, obs)
    next_said = networks.mlp(learner.critic, normalise_obs(stats, transitions.next_obs))
    values, next_values = said * scale.std + scale.mean, next_said * scale.std + scale.mean
    ends = transitions.terminated[..., None].astype(jnp.float32), transitions.truncated[..., None].astype(jnp.float32)
    advantages = gae(rewards, values, next_values, *ends, settings.gamma, settings.lam)
    return obs, said, advantages, advantages + values


def _prepare(
    learner: Learner,
    transitions: Transitions,
    choice: Choice,
    rewards: jax.Array,
    weights: jax.Array,
    tied: jax.Array,
    stats: ObsStats,
    settings: Settings,
) -> tuple[Learner, Batch]:
    """Advantages and return targets of all copies' windows (K, T, E/K, …); moves their return statistics."""
    judge = jax.vmap(_judge, in_axes=(0, 0, 0, None, None))
    obs, said, advantages, returns = judge(learner, transitions, rewards, stats, settings)
    mean = _across(jnp.mean(returns, axis=(1, 2)), tied)
    square = _across(jnp.mean(jnp.square(returns), axis=(1, 2)), tied)
    after = jax.vmap(update_return_stats)(learner.returns, mean, square)
    target = (returns - after.mean[:, None, None]) / after.std[:, None, None]
    advantage = jnp.einsum("ktes,ks->kte", advantages, weights)
    # Clipping is to limit how far the critic moves, so it is measured from the critic's own output, before the shift.
    return learner._replace(returns=after), Batch(obs, choice, advantage, target, said)


def _minibatch_step(learner: Learner, batch: Batch, tied: jax.Array, settings: Settings) -> tuple[Learner, jax.Array]:
    """One gradient step of all copies; returns their KL (K,) too."""

    def gradients(policy: Params, critic: Params, batch: Batch) -> tuple[tuple[Params, Params], jax.Array]:
        grads, (approx_kl, _) = jax.grad(loss, argnums=(0, 1), has_aux=True)(policy, critic, batch, settings)
        return grads, approx_kl

    def step(learner: Learner, grads: tuple[Params, Params]) -> Learner:
        opt = optimiser(settings)
        policy_step, policy_opt = opt.update(grads[0], learner.policy_opt)
        critic_step, critic_opt = opt.update(grads[1], learner.critic_opt)
        return Learner(
            optax.apply_updates(learner.policy, policy_step),
            optax.apply_updates(learner.critic, critic_step),
            policy_opt,
            critic_opt,
            learner.returns,
        )

    mine = jax.vmap(gradients)(learner.policy, learner.critic, batch)
    together, separate = _as_rows(mine)  # one message crosses the devices
    grads, approx_kl = separate(_across(together, tied))
    return jax.vmap(step)(learner, grads), approx_kl


def _as_rows(tree: Any) -> tuple[jax.Array, Callable[[jax.Array], Any]]:
    """A tree with axis (K) in front of every leaf as one matrix, a row per copy; and the way back."""
    back = ravel_pytree(jax.tree.map(lambda leaf: leaf[0], tree))[1]
    return jax.vmap(lambda one: ravel_pytree(one)[0])(tree), jax.vmap(back)


def _normalised(advantage: jax.Array, tied: jax.Array) -> jax.Array:
    """Advantages (M, K, T/M, E/K), each copy's to zero mean and unit deviation within each minibatch."""
    moments = jnp.stack([jnp.mean(advantage, axis=(2, 3)), jnp.mean(jnp.square(advantage), axis=(2, 3))], axis=-1)
    mean, square = jnp.moveaxis(_across(moments.swapaxes(0, 1), tied), -1, 0).swapaxes(1, 2)[..., None, None]
    return (advantage - mean) * jax.lax.rsqrt(jnp.maximum(square - jnp.square(mean), 0.0) + 1e-8)


def _shuffled(batch: Batch, order: jax.Array, minibatches: int) -> Batch:
    """Cut (K, T, E) data into minibatches (M, K, T/M, E), the moments of time in random ``order`` (T,).

    All robots share the order, so that whole rows move: a minibatch holds some moments of every robot. Robots are out
    of step, so the moments are of all parts of their episodes.
    """

    def cut(x: jax.Array) -> jax.Array:
        x = jnp.take(x, order, axis=1)
        return jnp.moveaxis(x.reshape(x.shape[0], minibatches, -1, *x.shape[2:]), 1, 0)

    return jax.tree.map(cut, batch)


def _learn(
    learner: Learner, batch: Batch, key: jax.Array, tied: jax.Array, epochs: jax.Array, settings: Settings
) -> tuple[Learner, jax.Array]:
    """Up to ``epochs`` passes over the window; a copy whose mean KL (K,) passes the target stops after that one."""
    copies, length = batch.advantage.shape[:2]

    def epoch(carry):
        i, learner, active, kl, key = carry
        key, order_key = jax.random.split(key)
        parts = _shuffled(batch, jax.random.permutation(order_key, length), settings.minibatches)
        parts = parts._replace(advantage=_normalised(parts.advantage, tied))
        moved, kls = jax.lax.scan(lambda now, part: _minibatch_step(now, part, tied, settings), learner, parts)
        # What a copy that has stopped would have learned is thrown away once an epoch, not at every step.
        learner, kl = where_each(active, (moved, jnp.mean(kls, axis=0)), (learner, kl))
        return i + 1, learner, active & (kl <= settings.target_kl), kl, key

    def go_on(carry):
        i, _, active, _, _ = carry
        return (i < epochs) & jnp.any(active)

    begin = (jnp.zeros((), jnp.int32), learner, jnp.ones(copies, bool), jnp.zeros(copies), key)
    _, learner, _, kl, _ = jax.lax.while_loop(go_on, epoch, begin)
    return learner, kl


def collect(
    env: Environment, settings: Settings, learner: Learner, stats: ObsStats, actors: Actors
) -> tuple[Actors, Transitions, Choice]:
    """One window of steps (T, E), robot e driven by copy e mod K of ``learner``."""
    copies = learner.policy["log_std"].shape[0]
    act = act_with_copies(learner.policy, stats, copies)
    return window(env, act, actors, settings.window, settings.episode_length)


def learn(
    settings: Settings,
    key: jax.Array,
    learner: Learner,
    stats: ObsStats,
    transitions: Transitions,
    choice: Choice,
    fitness: jax.Array,
    weights: jax.Array,
    tied: jax.Array,
    epochs: jax.Array,
) -> tuple[Learner, ObsStats, dict[str, jax.Array]]:
    """What K copies learn from a window that ``collect`` gave, with one ``fitness`` reward (T, E) per step.

    The reward streams are ``fitness`` and δ. ``weights`` (K, 1+k) is the weighting each copy maximises; with ``tied``
    its rows must be equal. ``key`` shuffles, the same on every device. Moves the observation statistics too. Runs
    inside ``shard_map``.
    """
    copies = weights.shape[0]
    streams = jnp.concatenate([fitness[..., None], transitions.proxy], axis=-1)
    dealt, choice, streams = jax.tree.map(lambda x: to_copies(x, copies, axis=1), (transitions, choice, streams))
    learner, batch = _prepare(learner, dealt, choice, streams, weights, tied, stats, settings)
    learner, kl = _learn(learner, batch, key, tied, epochs, settings)
    info = {
        "approx_kl": jnp.mean(kl),
        "fitness_reward": jax.lax.pmean(jnp.mean(fitness), AXIS),
        "true_reward": jax.lax.pmean(jnp.mean(transitions.reward), AXIS),
        "action_std": jnp.mean(jnp.exp(learner.policy["log_std"])),
    }
    return learner, update_obs_stats(stats, transitions.obs), info
