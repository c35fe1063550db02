"""Scoring candidates over whole episodes, in chunks that stop as soon as every robot has fallen or timed out.

The simulation does not depend on rewards, so one compiled program serves every method. The order of calls is ``begin``,
then ``advance`` and the reward model's scoring until every episode is finished, then ``finish``. Episodes have axis (E)
with E = λ·n: n episodes of each of λ candidates, those of one candidate side by side.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdil.config import Evaluation
from qdil.rl import networks
from qdil.rl.normalise import normalise_obs
from qdil.rl.rollout import (
    EnvBatch,
    action_noise,
    split_each,
    start,
    step_each,
    to_batch_first,
    to_batch_last,
    transition,
)
from qdil.robots.environment import Environment
from qdil.types import Normaliser, Params, RewardMemory, Transitions


class Policies(NamedTuple):
    """Policies as an archive keeps them, axis (λ) in front."""

    theta: jax.Array  # (λ, P) flat parameters
    obs_mean: jax.Array  # (λ, O) the observation normaliser that each was found under
    obs_std: jax.Array  # (λ, O)


class Scores(NamedTuple):
    """Means over each candidate's episodes, axis (λ) in front."""

    fitness: jax.Array  # (λ,) sum of the reward model's rewards
    true_return: jax.Array  # (λ,)
    measures: jax.Array  # (λ, k)
    length: jax.Array  # (λ,) steps
    finite: jax.Array  # (λ,) bool


class Tally(NamedTuple):
    """Sums over the steps of each episode so far, axis (E) in front."""

    unfinished: jax.Array  # (E,) bool
    finite: jax.Array  # (E,) bool
    true_return: jax.Array  # (E,)
    proxy_sum: jax.Array  # (E, k)
    length: jax.Array  # (E,)


class RewardSum(NamedTuple):
    """A reward model's rewards so far, axis (E) in front."""

    memory: RewardMemory  # what the model remembers within episodes
    fitness: jax.Array  # (E,) sum of its rewards


def begin(env: Environment, key: jax.Array, episode_length: int) -> tuple[EnvBatch, Tally]:
    """Start λ·n episodes, one per key (λ, n)."""
    envs = start(env, key.reshape(-1), episode_length)
    zeros = jnp.zeros(key.size)
    yes = jnp.ones(key.size, bool)
    return envs, Tally(yes, yes, zeros, jnp.zeros_like(envs.robot.proxy), zeros)


def advance(
    env: Environment, template: Params, evaluation: Evaluation, policies: Policies, envs: EnvBatch, tally: Tally
) -> tuple[EnvBatch, Tally, Transitions, jax.Array]:
    """Simulate ``eval_chunks_per_sync`` chunks of all unfinished episodes.

    Each policy acts under its own observation statistics. Returns C chunks of transitions (C, T, E), and ``counted``
    (C, T, E), which is True for steps of unfinished episodes that the chunk simulated.
    """

    def unflatten(theta: jax.Array) -> Params:
        policy = networks.unflatten(theta, template)
        return policy | {"mean": networks.outputs_in_rows(policy["mean"])}

    trees = policies._replace(theta=jax.vmap(unflatten)(policies.theta))  # once, and not at every step

    def one_chunk(carry, _):
        return _chunk(env, evaluation, trees, *carry)

    chunks = evaluation.eval_chunks_per_sync
    (envs, tally), (transitions, counted) = jax.lax.scan(one_chunk, (envs, tally), None, chunks)
    return envs, tally, transitions, counted


def finish(tally: Tally, fitness: jax.Array, episodes: int) -> Scores:
    """Means over the ``episodes`` of each candidate; ``fitness`` (E,) is the reward model's sum for every episode."""

    def mean(x: jax.Array) -> jax.Array:
        return jnp.mean(x.reshape(-1, episodes, *x.shape[1:]), axis=1)

    finite = jnp.all(tally.finite.reshape(-1, episodes), axis=1)
    measures = mean(tally.proxy_sum / tally.length[:, None])
    return Scores(mean(fitness), mean(tally.true_return), measures, mean(tally.length), finite)


def sum_counted(rewards: jax.Array, counted: jax.Array) -> jax.Array:
    """Sum over time (E,) of the rewards (T, E) of steps that count."""
    return jnp.sum(jnp.where(counted, rewards, 0.0), axis=0)


def _chunk(env: Environment, evaluation: Evaluation, policies: Policies, envs: EnvBatch, tally: Tally):
    """One chunk of steps of unfinished episodes, in full batches.

    Unfinished episodes that do not fill a batch wait and go first in the next chunk. So no batch but the very last
    simulates finished episodes.
    """
    count, unfinished = len(tally.unfinished), jnp.sum(tally.unfinished)
    most = min(evaluation.eval_batch_size, count)
    size = max(size for size in range(1, most + 1) if count % size == 0)
    # Unfinished episodes come first, the shortest at the front: these are the episodes that waited in the last chunk.
    order = jnp.argsort(jnp.where(tally.unfinished, tally.length, jnp.inf), stable=True)
    begun = (envs, tally.unfinished, tally.finite)

    def simulate(rows: jax.Array, state: Any) -> Any:
        """A chunk of steps of the episodes ``rows``, each with its own candidate's policy."""
        own = jax.tree.map(lambda leaf: leaf[rows // evaluation.episodes], policies)
        return _drive(env, evaluation, own, *jax.tree.map(lambda leaf: leaf[rows], state))

    def one_batch(i, carry):
        state, seen = carry
        rows = jax.lax.dynamic_slice_in_dim(order, i * size, size)
        after, steps = simulate(rows, state)
        state = jax.tree.map(lambda old, new: old.at[rows].set(new), state, after)
        return state, jax.tree.map(lambda old, new: old.at[:, rows].set(new), seen, steps)

    shapes = jax.eval_shape(lambda: simulate(order, begun)[1])
    unseen = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
    batches = jnp.maximum(unfinished // size, jnp.minimum(unfinished, 1))
    (envs, alive, finite), (transitions, counted) = jax.lax.fori_loop(0, batches, one_batch, (begun, unseen))
    tally = Tally(
        alive,
        finite,
        tally.true_return + sum_counted(transitions.reward, counted),
        tally.proxy_sum + jnp.sum(jnp.where(counted[..., None], transitions.proxy, 0.0), axis=0),
        tally.length + jnp.sum(counted, axis=0),
    )
    return (envs, tally), (transitions, counted)


def _drive(
    env: Environment,
    evaluation: Evaluation,
    policies: Policies,
    envs: EnvBatch,
    unfinished: jax.Array,
    finite: jax.Array,
):
    """A chunk of steps of some episodes, each with its own policy, whose parameters are a tree here."""
    limit, (key, noise_key) = envs.limit, split_each(envs.key)

    def step(carry, noise):
        robot, steps, proxy_sum, unfinished, finite = carry
        obs, proxy = to_batch_first((robot.obs, robot.proxy))
        action = jax.vmap(partial(_act, evaluation.sample_actions))(*policies, noise, obs)
        after, outcome = step_each(env, robot, action)
        steps, proxy_sum = steps + 1, proxy_sum + proxy
        truncated = (steps >= limit) & ~outcome.terminated
        record = transition(robot, action, after, outcome, truncated, proxy_sum / steps[:, None])
        finite = finite & (outcome.finite | ~unfinished)
        continues = unfinished & ~outcome.terminated & ~truncated
        frozen = jax.tree.map(partial(jnp.where, continues), after, robot)
        return (frozen, steps, proxy_sum, continues, finite), (record, unfinished)

    # If the policy acts by its mean, XLA removes the noise.
    noise = action_noise(noise_key, evaluation.eval_chunk_steps, env.action_size)
    begun = (to_batch_last(envs.robot), envs.steps, envs.proxy_sum, unfinished, finite)
    (robot, steps, proxy_sum, unfinished, finite), seen = jax.lax.scan(step, begun, noise)
    return (EnvBatch(to_batch_first(robot), steps, limit, proxy_sum, key), unfinished, finite), seen


def _act(
    sample: bool, policy: Params, obs_mean: jax.Array, obs_std: jax.Array, noise: jax.Array, obs: jax.Array
) -> jax.Array:
    """An action (A,) in [-1, 1] of one policy: drawn from it, or its mean."""
    mean = networks.mlp_single(policy["mean"], normalise_obs(Normaliser(obs_mean, obs_std), obs))
    return jnp.clip(mean + noise * jnp.exp(policy["log_std"]) if sample else mean, -1.0, 1.0)
