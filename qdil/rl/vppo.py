"""VPPO: K copies of a policy trained side by side by PPO, each on its own weighting of the objectives.

The objectives are the fitness reward and the k proxies δ_j. The same functions serve both of Algorithm 1's uses.
Gradients (line 4): copy i of K = 1+k copies of θ_μ maximises objective i. Walk (line 17): the copies are *tied*, that
is, they share one weighting and average their gradients, so they remain one policy trained on all environments.

An update is ``collect`` (a rollout), then a fitness reward for every step of it, then ``learn``.

Departure from the authors' released program: its critics are one network per objective; here each copy has one critic
with a head per objective (fitness, δ_1 … δ_k). Advantages are linear in the rewards, so the advantage of any weighting
is the weighted sum over heads, and the walk's critic stays valid when xNES changes the weights.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree

from qdil.config import PPO
from qdil.devices.mesh import AXIS
from qdil.finite import all_finite
from qdil.rl import networks
from qdil.rl.normalise import ReturnStats, init_return_stats, normalise_obs, update_obs_stats, update_return_stats
from qdil.rl.rollout import Act, EnvBatch, rollout, split_each, where_each
from qdil.robots.environment import Environment
from qdil.types import ActionSample, ObsStats, Params, Rewards, Transitions


class TrainState(NamedTuple):
    """Everything PPO adapts; with an axis (K) in front while copies train side by side."""

    policy: Params
    critic: Params
    policy_opt: optax.OptState
    critic_opt: optax.OptState
    returns: ReturnStats


class Experience(NamedTuple):
    """A rollout with its rewards, axes (T, E)."""

    transitions: Transitions
    sample: ActionSample
    rewards: Rewards


class Weighting(NamedTuple):
    """What each copy maximises: a weighted sum of the objectives."""

    weights: jax.Array  # (K, 1+k) of (fitness, δ_1 … δ_k), one row per copy
    tied: jax.Array  # () bool, the copies are one policy; then the rows must be equal


class Info(NamedTuple):
    """Measurements of one update, means over robots and, but for ``q_share``, over copies."""

    approx_kl: jax.Array  # () nats, of the last epoch
    fitness_reward: jax.Array  # () per step
    learned_reward: jax.Array  # () per step, without the measure bonus
    true_reward: jax.Array  # () per step
    q_share: jax.Array  # (K,) the share of a copy's steps that get q of the measure bonus
    action_std: jax.Array  # () action units


class Batch(NamedTuple):
    """The data of the loss, axes (K, T, E/K)."""

    obs: jax.Array  # normalised (…, O)
    sample: ActionSample
    advantage: jax.Array  # (…) of the copy's own weighting, not yet normalised
    target: jax.Array  # (…, 1+k) normalised returns
    value: jax.Array  # (…, 1+k) the critic's output when the rollout was collected


def optimiser(ppo: PPO) -> optax.GradientTransformation:
    """Adam after clipping the gradient's norm; policy and critic each have one."""
    return optax.chain(optax.clip_by_global_norm(ppo.max_grad_norm), optax.adam(ppo.learning_rate, eps=1e-5))


def init_train_state(ppo: PPO, policy: Params, critic: Params, objectives: int) -> TrainState:
    """A policy and a critic with ``objectives`` = 1+k heads, before any training."""
    opt = optimiser(ppo)
    return TrainState(policy, critic, opt.init(policy), opt.init(critic), init_return_stats(objectives))


def replicate(train_state: TrainState, copies: int) -> TrainState:
    """K identical copies, axis (K) in front of every leaf."""
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (copies, *jnp.shape(leaf))), train_state)


def first_copy(train_state: TrainState, stats: ObsStats) -> tuple[TrainState, jax.Array, jax.Array]:
    """Copy 0, every copy's θ (K, P), and whether all copies and the statistics are finite numbers."""
    theta = jax.vmap(networks.flatten)(train_state.policy)
    return jax.tree.map(lambda leaf: leaf[0], train_state), theta, all_finite((train_state, stats))


def discard_update(envs: EnvBatch, policy: Params, copies: int) -> tuple[EnvBatch, jax.Array]:
    """The robots before a training phase that is discarded, with new noise; and θ_μ for every copy (K, P)."""
    key, _ = split_each(envs.key)
    return envs._replace(key=key), jnp.tile(networks.flatten(policy), (copies, 1))


# Collect


def collect(
    env: Environment, rollout_length: int, episode_length: int, train_state: TrainState, stats: ObsStats, envs: EnvBatch
) -> tuple[EnvBatch, Transitions, ActionSample]:
    """One rollout of steps (T, E), robot e driven by copy e mod K of ``train_state``."""
    copies = train_state.policy["log_std"].shape[0]
    act = act_with_copies(train_state.policy, stats, copies)
    return rollout(env, act, envs, rollout_length, episode_length)


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


def to_copies(x: jax.Array, copies: int, axis: int = 0) -> jax.Array:
    """Deal the environment axis out to the copies: (…, E, …) -> (K, …, E/K, …), environment e to copy e mod K."""
    shape = x.shape
    x = x.reshape(*shape[:axis], shape[axis] // copies, copies, *shape[axis + 1 :])
    return jnp.moveaxis(x, axis + 1, 0)


def from_copies(x: jax.Array, axis: int = 0) -> jax.Array:
    """Undo ``to_copies``."""
    x = jnp.moveaxis(x, 0, axis + 1)
    return x.reshape(*x.shape[:axis], -1, *x.shape[axis + 2 :])


def steps_of_first_copy(transitions: Transitions, copies: int) -> Transitions:
    """Steps (T, E) of copy 0's robots alone: each is repeated K times, so that the shape stays the same."""

    def repeated(x: jax.Array) -> jax.Array:
        own = to_copies(x, copies, axis=1)[0]
        return jnp.repeat(own, copies, axis=1)

    return jax.tree.map(repeated, transitions)


# Learn


def learn(
    ppo: PPO,
    key: jax.Array,
    train_state: TrainState,
    stats: ObsStats,
    experience: Experience,
    weighting: Weighting,
    epochs: jax.Array,
) -> tuple[TrainState, ObsStats, Info]:
    """K copies learn from a rollout for up to ``epochs`` passes; the observation statistics move, too.

    ``key``, the same on every device, shuffles the time steps. Runs inside ``shard_map``.
    """
    copies = weighting.weights.shape[0]
    steps, sample, (fitness, learned, q_share) = experience
    rewards = jnp.concatenate([fitness[..., None], steps.proxy], axis=-1)
    transitions, sample, rewards = jax.tree.map(lambda x: to_copies(x, copies, axis=1), (steps, sample, rewards))
    train_state, batch = _prepare(train_state, transitions, sample, rewards, weighting, stats, ppo)
    train_state, kl = _train_epochs(train_state, batch, key, weighting.tied, epochs, ppo)
    shares = jnp.mean(to_copies(q_share, copies, axis=1), axis=(1, 2))
    means = (jnp.mean(fitness), jnp.mean(learned), jnp.mean(steps.reward), shares)
    fitness_mean, learned_mean, true_mean, shares = jax.lax.pmean(means, AXIS)
    std = jnp.mean(jnp.exp(train_state.policy["log_std"]))
    info = Info(jnp.mean(kl), fitness_mean, learned_mean, true_mean, shares, std)
    return train_state, update_obs_stats(stats, steps.obs), info


# Advantages and targets


def _prepare(
    train_state: TrainState,
    transitions: Transitions,
    sample: ActionSample,
    rewards: jax.Array,
    weighting: Weighting,
    stats: ObsStats,
    ppo: PPO,
) -> tuple[TrainState, Batch]:
    """Advantages and return targets of all copies' rollouts (K, T, E/K, …); moves their return statistics."""
    per_copy = jax.vmap(_values_and_gae, in_axes=(0, 0, 0, None, None))
    obs, value, advantages, returns = per_copy(train_state, transitions, rewards, stats, ppo)
    mean = _pmean(jnp.mean(returns, axis=(1, 2)), weighting.tied)
    square = _pmean(jnp.mean(jnp.square(returns), axis=(1, 2)), weighting.tied)
    after = jax.vmap(update_return_stats)(train_state.returns, mean, square)
    target = (returns - after.mean[:, None, None]) / after.std[:, None, None]
    advantage = jnp.einsum("ktes,ks->kte", advantages, weighting.weights)
    # Value clipping limits how far the critic moves, so it is measured from the critic's output before the shift of
    # the return statistics.
    return train_state._replace(returns=after), Batch(obs, sample, advantage, target, value)


def _values_and_gae(
    train_state: TrainState, transitions: Transitions, rewards: jax.Array, stats: ObsStats, ppo: PPO
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Of one copy's rollout: normalised observations, the critic's output there, advantages and returns."""
    obs = normalise_obs(stats, transitions.obs)
    scale = train_state.returns
    output = networks.mlp(train_state.critic, obs)
    next_output = networks.mlp(train_state.critic, normalise_obs(stats, transitions.next_obs))
    values, next_values = output * scale.std + scale.mean, next_output * scale.std + scale.mean
    ends = transitions.terminated[..., None].astype(jnp.float32), transitions.truncated[..., None].astype(jnp.float32)
    advantages = gae(rewards, values, next_values, *ends, ppo.gamma, ppo.gae_lambda)
    return obs, output, advantages, advantages + values


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

    After a fall (terminated) the value is 0; a time limit (truncated) bootstraps from the value of the last state.
    Advantages of the next episode do not flow back across either.
    """
    deltas = rewards + gamma * next_values * (1.0 - terminated) - values
    carries_on = (1.0 - terminated) * (1.0 - truncated)

    def backwards(advantage, step):
        delta, carries_on = step
        advantage = delta + gamma * lam * carries_on * advantage
        return advantage, advantage

    return jax.lax.scan(backwards, jnp.zeros_like(deltas[0]), (deltas, carries_on), reverse=True)[1]


# Epochs and minibatches


def _train_epochs(
    train_state: TrainState, batch: Batch, key: jax.Array, tied: jax.Array, epochs: jax.Array, ppo: PPO
) -> tuple[TrainState, jax.Array]:
    """Up to ``epochs`` passes over the rollout. A copy stops after the pass whose mean KL (K,) exceeds the target."""
    copies, length = batch.advantage.shape[:2]

    def epoch(carry):
        i, train_state, active, kl, key = carry
        key, order_key = jax.random.split(key)
        parts = _shuffled(batch, jax.random.permutation(order_key, length), ppo.minibatches)
        together = tied | (ppo.copies_scaled == "together")
        parts = parts._replace(advantage=_normalised(parts.advantage, together))
        moved, kls = jax.lax.scan(lambda state, part: _minibatch_step(state, part, tied, ppo), train_state, parts)
        # A stopped copy's learning is discarded once per epoch, which is cheaper than at every step.
        train_state, kl = where_each(active, (moved, jnp.mean(kls, axis=0)), (train_state, kl))
        return i + 1, train_state, active & (kl <= ppo.target_kl), kl, key

    def go_on(carry):
        i, _, active, _, _ = carry
        return (i < epochs) & jnp.any(active)

    begin = (jnp.zeros((), jnp.int32), train_state, jnp.ones(copies, bool), jnp.zeros(copies), key)
    _, train_state, _, kl, _ = jax.lax.while_loop(go_on, epoch, begin)
    return train_state, kl


def _shuffled(batch: Batch, order: jax.Array, minibatches: int) -> Batch:
    """Cut (K, T, E) data into minibatches (M, K, T/M, E), the time steps in random ``order`` (T,).

    All robots share the order, so that whole rows move: a minibatch holds the same time steps of every robot. Robots
    are in different parts of their episodes, so a minibatch still covers all parts.
    """

    def cut(x: jax.Array) -> jax.Array:
        x = jnp.take(x, order, axis=1)
        return jnp.moveaxis(x.reshape(x.shape[0], minibatches, -1, *x.shape[2:]), 1, 0)

    return jax.tree.map(cut, batch)


def _normalised(advantage: jax.Array, together: jax.Array) -> jax.Array:
    """Advantages (M, K, T/M, E/K), each copy's to zero mean and unit deviation within each minibatch.

    ``together`` () bool: the mean and deviation are those of all copies.
    """
    moments = jnp.stack([jnp.mean(advantage, axis=(2, 3)), jnp.mean(jnp.square(advantage), axis=(2, 3))], axis=-1)
    mean, square = jnp.moveaxis(_pmean(moments.swapaxes(0, 1), together), -1, 0).swapaxes(1, 2)[..., None, None]
    return (advantage - mean) * jax.lax.rsqrt(jnp.maximum(square - jnp.square(mean), 0.0) + 1e-8)


def _minibatch_step(train_state: TrainState, batch: Batch, tied: jax.Array, ppo: PPO) -> tuple[TrainState, jax.Array]:
    """One gradient step of all copies; returns their KL (K,) too."""

    def gradients(policy: Params, critic: Params, batch: Batch) -> tuple[tuple[Params, Params], jax.Array]:
        grads, (approx_kl, _) = jax.grad(loss, argnums=(0, 1), has_aux=True)(policy, critic, batch, ppo)
        return grads, approx_kl

    def step(train_state: TrainState, grads: tuple[Params, Params]) -> TrainState:
        opt = optimiser(ppo)
        policy_step, policy_opt = opt.update(grads[0], train_state.policy_opt)
        critic_step, critic_opt = opt.update(grads[1], train_state.critic_opt)
        return TrainState(
            optax.apply_updates(train_state.policy, policy_step),
            optax.apply_updates(train_state.critic, critic_step),
            policy_opt,
            critic_opt,
            train_state.returns,
        )

    per_copy = jax.vmap(gradients)(train_state.policy, train_state.critic, batch)
    rows, from_rows = _as_rows(per_copy)  # so that the devices exchange a single array
    grads, approx_kl = from_rows(_pmean(rows, tied))
    if ppo.copies_scaled == "together":
        grads = tuple(_clipped_together(grad, tied, ppo.max_grad_norm) for grad in grads)
    return jax.vmap(step)(train_state, grads), approx_kl


def _clipped_together(grads: Params, tied: jax.Array, max_norm: float) -> Params:
    """Gradients (K, …) of the mean loss over all copies, clipped by the norm of all of them (released program).

    Tied copies are one policy, whose gradient is clipped by the optimiser.
    """
    copies = len(jax.tree.leaves(grads)[0])
    norm = optax.tree.norm(grads) / copies
    scale = jnp.where(tied, 1.0, jnp.minimum(1.0, max_norm / norm) / copies)
    return jax.tree.map(lambda grad: scale * grad, grads)


def loss(policy: Params, critic: Params, batch: Batch, ppo: PPO) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    """PPO's clipped surrogate and clipped value loss of one copy; ``batch.advantage`` is normalised already."""
    obs, raw_action = networks.as_columns(batch.obs), networks.columns(batch.sample.raw_action)
    advantage = batch.advantage.reshape(-1)
    mean = networks.mlp_of_columns(policy["mean"], obs)
    log_ratio = networks.log_prob_of_columns(policy, mean, raw_action) - batch.sample.log_prob.reshape(-1)
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1.0 - ppo.clip, 1.0 + ppo.clip)
    surrogate = jnp.minimum(ratio * advantage, clipped * advantage)
    value, before, target = networks.mlp_of_columns(critic, obs), *map(networks.columns, (batch.value, batch.target))
    near = before + jnp.clip(value - before, -ppo.clip, ppo.clip)
    errors = jnp.maximum(jnp.square(value - target), jnp.square(near - target))
    value_loss = 0.5 * jnp.mean(errors)
    total = -jnp.mean(surrogate) + ppo.value_coef * value_loss - ppo.entropy_coef * networks.entropy(policy)
    approx_kl = jnp.mean(ratio - 1.0 - log_ratio)  # Schulman's low-variance estimator
    return total, (approx_kl, value_loss)


def _pmean(x: jax.Array, tied: jax.Array) -> jax.Array:
    """Mean of (K, …) over the devices, and over the copies too where they are tied."""
    # ``sum`` adds row by row, because XLA's reduction over so few rows is slow on a CPU.
    return jax.lax.pmean(jnp.where(tied, sum(x) / len(x), x), AXIS)


def _as_rows(tree: Any) -> tuple[jax.Array, Callable[[jax.Array], Any]]:
    """A tree with axis (K) in front of every leaf as one matrix, a row per copy; and the way back."""
    back = ravel_pytree(jax.tree.map(lambda leaf: leaf[0], tree))[1]
    return jax.vmap(lambda one: ravel_pytree(one)[0])(tree), jax.vmap(back)
