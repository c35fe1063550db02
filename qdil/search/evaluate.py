"""Scoring candidates over whole episodes, in chunks that stop as soon as every robot has fallen or timed out.

Cut into pieces that a shell compiles one by one, so that the simulation is compiled once whatever rewards are paid.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdil.hosts import to_host
from qdil.robots.environment import Environment
from qdil.search import networks
from qdil.search.normalise import normalise_obs
from qdil.search.rollout import Actors, first, last, noise_of, split_each, start, step_each
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


class Tally(NamedTuple):
    """Sums over the episodes so far, axis (E) = λ·n in front."""

    alive: jax.Array  # (E,) bool
    finite: jax.Array  # (E,) bool
    true_return: jax.Array  # (E,)
    proxy_sum: jax.Array  # (E, k)
    length: jax.Array  # (E,)


class Paid(NamedTuple):
    """What a reward model has given so far, axis (E) in front."""

    carry: Any  # what it remembers within episodes
    fitness: jax.Array  # (E,) sum of its rewards


class Episodes(NamedTuple):
    """The pieces of an evaluation; all but ``run``'s loop is pure."""

    begin: Callable[[jax.Array], tuple[Actors, Tally]]  # key (λ, n), one per episode
    advance: Callable[[Policies, Actors, Tally], tuple[Actors, Tally, Transitions, jax.Array]]
    finish: Callable[[Tally, jax.Array], Scores]  # and the fitness (E,) of every episode


Pay = Callable[[Paid, Transitions, jax.Array], Paid]


def run(episodes: Episodes, pay: Pay, policies: Policies, paid: Paid, key: jax.Array) -> Scores:
    """Roll out every one of λ ``policies`` for key.shape[1] whole episodes; ``key`` (λ, n) is one per episode.

    ``pay(paid, transitions, counted)`` adds to what is ``paid`` the rewards of the ``counted`` steps (C, T, E) of C
    chunks. A robot that waited for its turn has no step in a chunk that counts.
    """
    actors, tally = episodes.begin(key)
    while to_host(tally.alive).any():
        actors, tally, transitions, counted = episodes.advance(policies, actors, tally)
        paid = pay(paid, transitions, counted)
    return episodes.finish(tally, paid.fitness)


def paid_in(rewards: jax.Array, counted: jax.Array) -> jax.Array:
    """Sum over time (E,) of the rewards (T, E) of steps that count."""
    return jnp.sum(jnp.where(counted, rewards, 0.0), axis=0)


def episodes(
    env: Environment,
    like: Params,
    num_episodes: int,
    episode_length: int,
    chunk: int,
    turns: int,
    tile: int,
    sample_actions: bool,
) -> Episodes:
    """Whole episodes, ``num_episodes`` of each policy, simulated ``turns`` chunks of ``chunk`` steps at a time.

    Each policy acts under its own observation statistics. ``sample_actions`` draws a ~ π_θ; otherwise the policy's
    mean acts. Of a device's robots those still going are simulated, at most ``tile`` together. Those that do not fill a
    tile wait for the next turn, so that none but the last few robots ever share theirs with any that have finished.
    """

    def begin(key: jax.Array) -> tuple[Actors, Tally]:
        actors = start(env, key.reshape(-1), episode_length)
        zeros = jnp.zeros(key.size)
        yes = jnp.ones(key.size, bool)
        return actors, Tally(yes, yes, zeros, jnp.zeros_like(actors.robot.proxy), zeros)

    def act(policy: Params, obs_mean: jax.Array, obs_std: jax.Array, noise: jax.Array, obs: jax.Array) -> jax.Array:
        zeros = jnp.zeros_like(obs_mean)
        mean = networks.mlp_of_one(policy["mean"], normalise_obs(ObsStats(obs_mean, obs_std, zeros, zeros), obs))
        return jnp.clip(mean + noise * jnp.exp(policy["log_std"]) if sample_actions else mean, -1.0, 1.0)

    def unflatten(theta: jax.Array) -> Params:
        policy = networks.unflatten(theta, like)
        return policy | {"mean": networks.outputs_in_rows(policy["mean"])}

    def drive(policies: Policies, actors: Actors, alive: jax.Array, finite: jax.Array):
        """A chunk of steps of some robots, each with its own policy, whose parameters are a tree here."""
        limit, (key, noise_key) = actors.limit, split_each(actors.key)

        def step(carry, noise):
            robot, steps, proxy_sum, alive, finite = carry
            obs, proxy = first((robot.obs, robot.proxy))
            action = jax.vmap(act)(*policies, noise, obs)
            after, outcome = step_each(env, robot, action)
            steps, proxy_sum = steps + 1, proxy_sum + proxy
            truncated = (steps >= limit) & ~outcome.terminated
            transition = Transitions(
                obs, action, first(after.obs), proxy, outcome.reward, outcome.terminated, truncated,
                proxy_sum / steps[:, None],
            )  # fmt: skip
            finite = finite & (outcome.finite | ~alive)
            still = alive & ~outcome.terminated & ~truncated
            frozen = jax.tree.map(partial(jnp.where, still), after, robot)
            return (frozen, steps, proxy_sum, still, finite), (transition, alive)

        noise = noise_of(noise_key, chunk, env.action_size)  # of no use, and left out by XLA, where the mean acts
        begun = (last(actors.robot), actors.steps, actors.proxy_sum, alive, finite)
        (robot, steps, proxy_sum, alive, finite), seen = jax.lax.scan(step, begun, noise)
        return (Actors(first(robot), steps, limit, proxy_sum, key), alive, finite), seen

    def turn(policies: Policies, actors: Actors, tally: Tally):
        """A chunk of steps of all whole tiles of robots that are still going, or of the last few."""
        count, going = len(tally.alive), jnp.sum(tally.alive)
        together = max(size for size in range(1, min(tile, count) + 1) if count % size == 0)
        # Those still going first, and of them who has lived least: who waited last time is not left behind.
        order = jnp.argsort(jnp.where(tally.alive, tally.length, jnp.inf), stable=True)
        begun = (actors, tally.alive, tally.finite)

        def some(rows: jax.Array, now: Any) -> Any:
            """A chunk of steps of the robots ``rows``, each with its own candidate's policy."""
            mine = jax.tree.map(lambda leaf: leaf[rows // num_episodes], policies)
            return drive(mine, *jax.tree.map(lambda leaf: leaf[rows], now))

        def one_tile(i, carry):
            now, seen = carry
            rows = jax.lax.dynamic_slice_in_dim(order, i * together, together)
            after, steps = some(rows, now)
            now = jax.tree.map(lambda all_, some: all_.at[rows].set(some), now, after)
            return now, jax.tree.map(lambda all_, some: all_.at[:, rows].set(some), seen, steps)

        shapes = jax.eval_shape(lambda: some(order, begun)[1])
        unseen = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
        tiles = jnp.maximum(going // together, jnp.minimum(going, 1))
        (actors, alive, finite), (transitions, counted) = jax.lax.fori_loop(0, tiles, one_tile, (begun, unseen))
        tally = Tally(
            alive,
            finite,
            tally.true_return + paid_in(transitions.reward, counted),
            tally.proxy_sum + jnp.sum(jnp.where(counted[..., None], transitions.proxy, 0.0), axis=0),
            tally.length + jnp.sum(counted, axis=0),
        )
        return (actors, tally), (transitions, counted)

    def advance(policies: Policies, actors: Actors, tally: Tally):
        policies = policies._replace(theta=jax.vmap(unflatten)(policies.theta))  # once, and not at every step
        begun = (actors, tally)
        (actors, tally), seen = jax.lax.scan(lambda now, _: turn(policies, *now), begun, None, turns)
        return actors, tally, *seen

    def finish(tally: Tally, fitness: jax.Array) -> Scores:
        def mean(x: jax.Array) -> jax.Array:
            return jnp.mean(x.reshape(-1, num_episodes, *x.shape[1:]), axis=1)

        finite = jnp.all(tally.finite.reshape(-1, num_episodes), axis=1)
        measures = mean(tally.proxy_sum / tally.length[:, None])
        return Scores(mean(fitness), mean(tally.true_return), measures, mean(tally.length), finite)

    return Episodes(begin, advance, finish)
