"""Scoring candidates over whole episodes, in chunks that stop as soon as every robot has fallen or timed out."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdil.robots.environment import Environment
from qdil.search import networks
from qdil.search.rollout import Actors, split_each, start, where_each
from qdil.types import ObsStats, Params, Transitions


class Policies(NamedTuple):
    """Policies as an archive keeps them, axis (λ) in front."""

    theta: jax.Array  # (λ, P) flat parameters
    obs_mean: jax.Array  # (λ, O) the observation normaliser that each was found under
    obs_std: jax.Array  # (λ, O)


class Scores(NamedTuple):
    """What an evaluation says of each candidate: means over its episodes, axis (λ) in front."""

    fitness: jax.Array  # (λ,) sum of the reward model's rewards
    true_return: jax.Array  # (λ,)
    measures: jax.Array  # (λ, k)
    length: jax.Array  # (λ,) steps
    finite: jax.Array  # (λ,) bool


class _Tally(NamedTuple):
    alive: jax.Array  # (E,) bool
    finite: jax.Array  # (E,) bool
    fitness: jax.Array  # (E,)
    true_return: jax.Array  # (E,)
    proxy_sum: jax.Array  # (E, k)
    length: jax.Array  # (E,)


Rewards = Callable[[object, ObsStats, Transitions], tuple[object, jax.Array]]


def evaluate(
    env: Environment,
    rewards: Rewards,
    like: Params,
    policies: Policies,
    stats: ObsStats,
    reward_carry: object,
    key: jax.Array,
    episode_length: int,
    chunk: int,
    sample_actions: bool,
) -> Scores:
    """Roll out every one of λ ``policies`` for key.shape[1] whole episodes; ``key`` (λ, n) is one per episode.

    Each policy acts under its own observation statistics; the reward model reads all through ``stats``.
    ``rewards(carry, stats, transitions) -> (carry, (T, E))`` gives the fitness reward of a chunk, E = λ·n.
    ``sample_actions`` draws a ~ π_θ; otherwise the policy's mean acts. A robot that has finished is frozen
    and counts no more; the loop ends when all have.
    """
    candidates, episodes = key.shape
    params = jax.vmap(lambda t: networks.unflatten(t, like))(policies.theta)
    actors = start(env, key.reshape(-1), episode_length)

    def act(policy: Params, obs_mean: jax.Array, obs_std: jax.Array, key: jax.Array, obs: jax.Array) -> jax.Array:
        mean = networks.policy_mean(policy, stats._replace(mean=obs_mean, std=obs_std), obs)
        if not sample_actions:
            return mean
        noise = jax.vmap(lambda k: jax.random.normal(k, mean.shape[-1:]))(key)
        return mean + noise * jnp.exp(policy["log_std"])

    def step(carry, _):
        (robot, steps, limit, proxy_sum, key), alive, finite = carry
        key, act_key = split_each(key)
        by_policy = (candidates, episodes)
        obs = robot.obs.reshape(*by_policy, -1)
        action = jax.vmap(act)(params, policies.obs_mean, policies.obs_std, act_key.reshape(by_policy), obs)
        action = jnp.clip(action.reshape(candidates * episodes, -1), -1.0, 1.0)
        after, outcome = jax.vmap(env.step)(robot, action)
        steps, proxy_sum = steps + 1, proxy_sum + robot.proxy
        truncated = (steps >= limit) & ~outcome.terminated
        transition = Transitions(
            robot.obs, action, after.obs, robot.proxy, outcome.reward, outcome.terminated, truncated,
            proxy_sum / steps[:, None],
        )  # fmt: skip
        finite = finite & (outcome.finite | ~alive)
        still = alive & ~outcome.terminated & ~truncated
        frozen = where_each(still, after, robot)
        return (Actors(frozen, steps, limit, proxy_sum, key), still, finite), (transition, alive)

    def run_chunk(carry):
        actors, reward_carry, tally = carry
        (actors, alive, finite), (transitions, counted) = jax.lax.scan(
            step, (actors, tally.alive, tally.finite), None, chunk
        )
        reward_carry, fitness = rewards(reward_carry, stats, transitions)
        weight = counted.astype(jnp.float32)
        tally = _Tally(
            alive,
            finite,
            tally.fitness + jnp.sum(weight * fitness, axis=0),
            tally.true_return + jnp.sum(weight * transitions.reward, axis=0),
            tally.proxy_sum + jnp.sum(weight[..., None] * transitions.proxy, axis=0),
            tally.length + jnp.sum(weight, axis=0),
        )
        return actors, reward_carry, tally

    zeros = jnp.zeros(candidates * episodes)
    yes = jnp.ones(candidates * episodes, bool)
    tally = _Tally(yes, yes, zeros, zeros, jnp.zeros_like(actors.robot.proxy), zeros)
    _, _, tally = jax.lax.while_loop(lambda c: jnp.any(c[2].alive), run_chunk, (actors, reward_carry, tally))

    def mean(x: jax.Array) -> jax.Array:
        return jnp.mean(x.reshape(candidates, episodes, *x.shape[1:]), axis=1)

    finite = jnp.all(tally.finite.reshape(candidates, episodes), axis=1)
    measures = mean(tally.proxy_sum / tally.length[:, None])
    return Scores(mean(tally.fitness), mean(tally.true_return), measures, mean(tally.length), finite)
