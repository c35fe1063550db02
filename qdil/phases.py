"""The phases of a run as pure functions: begin, collect, pay, learn, branch, score, learn the reward, jump.

``qdil.ppga`` puts them in the order of Algorithm 1; ``qdil.compiled`` compiles them for a mesh of devices. Those that
take ``Parts`` know nothing of rewards, so that all methods share their compiled programs.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdil.config import Config
from qdil.finite import all_finite
from qdil.imitation.bonus import measure_bonus
from qdil.imitation.reward_model import Demonstrations, RewardModel
from qdil.robots import brax_robots
from qdil.robots.environment import Environment
from qdil.search import networks, vppo
from qdil.search.evaluate import Episodes, Paid, Policies, episodes, paid_in
from qdil.search.normalise import init_obs_stats
from qdil.search.rollout import Actors, split_each, start, where_each
from qdil.types import ObsStats, Params, RewardContext, Transitions


class State(NamedTuple):
    """Everything on the devices that one QD iteration changes; with the archives and xNES, the whole run."""

    key: jax.Array
    learner: vppo.Learner  # θ_μ, its critic and their optimisers
    stats: ObsStats  # the one observation normaliser
    actors: Actors  # robots in the middle of their episodes
    reward: Any  # the reward model's state ψ
    reward_carry: Any  # what the reward model remembers within the actors' episodes


class Trained(NamedTuple):
    """What VPPO gives back."""

    state: State
    theta: jax.Array  # (K, P) the copies' parameters after training
    transitions: Transitions  # the last window, (T, E)
    info: dict[str, jax.Array]


class Parts(NamedTuple):
    """What searches for policies, whatever rewards them."""

    config: Config
    env: Environment
    settings: vppo.Settings
    episodes: Episodes
    like: Params  # a policy of zeros, for its structure

    @property
    def streams(self) -> int:
        """Reward streams and therefore copies of the policy: fitness and one per measure, 1 + k."""
        return 1 + len(self.env.measure_names)


def assemble(config: Config) -> Parts:
    """The parts that ``config`` names. Raises ValueError for what does not exist."""
    env = brax_robots.make(config.env, config.backend)
    like = policy_like(config, env)
    c = config
    turns = min(c.eval_turns, -(-c.episode_length // c.eval_chunk))
    scored = episodes(env, like, c.episodes, c.episode_length, c.eval_chunk, turns, c.eval_tile, c.sample_actions)
    return Parts(config, env, vppo_settings(config), scored, like)


def vppo_settings(config: Config) -> vppo.Settings:
    """The part of the configuration that PPO reads."""
    c = config
    return vppo.Settings(
        c.window, c.episode_length, c.minibatches, c.gamma, c.gae_lambda, c.clip, c.value_coef, c.entropy_coef,
        c.max_grad_norm, c.learning_rate, c.target_kl,
    )  # fmt: skip


def _policy(key: jax.Array, config: Config, env: Environment) -> Params:
    return networks.init_policy(key, env.obs_size, env.action_size, config.actor_hidden, config.initial_std)


def policy_like(config: Config, env: Environment) -> Params:
    """A policy of the right structure, all zeros: what ``networks.unflatten`` needs."""
    shapes = jax.eval_shape(lambda key: _policy(key, config, env), jax.random.key(0))
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)


def init(parts: Parts, key: jax.Array) -> tuple[vppo.Learner, ObsStats, Actors]:
    """θ_0, a fresh critic, an empty normaliser, and robots at the beginning of episodes."""
    config, env = parts.config, parts.env
    policy_key, critic_key, actor_key = jax.random.split(key, 3)
    critic = networks.init_mlp(critic_key, (env.obs_size, *config.critic_hidden, parts.streams))
    learner = vppo.init_learner(parts.settings, _policy(policy_key, config, env), critic, parts.streams)
    actors = start(env, jax.random.split(actor_key, config.num_envs), config.episode_length, in_step=False)
    return learner, init_obs_stats(env.obs_size), actors


def init_reward(model: RewardModel, key: jax.Array, demos: Demonstrations | None, num_envs: int) -> tuple[Any, Any]:
    """ψ_0, trained already where the model learns before the run, and what it remembers of each training robot."""
    reward = model.init(key, demos)
    return reward, model.begin(reward, num_envs)


def pay(
    model: RewardModel,
    scope: str,
    reward: Any,
    carry: Any,
    context: RewardContext,
    bonus: jax.Array,
    transitions: Transitions,
) -> tuple[Any, jax.Array]:
    """The fitness reward (T, E) of a training window: the model's, plus the measure bonus (eq. 4).

    ``bonus`` is (p, q) of eq. 2, (0, 0) for methods without; ``scope`` as in ``measure_bonus``.
    """
    carry, rewards = model.reward(reward, carry, context, transitions)
    return carry, rewards + measure_bonus(transitions, context.occupied, bonus[0], bonus[1], scope)


def begin_paying(model: RewardModel, reward: Any, num_episodes: int) -> Paid:
    """Nothing paid yet, to any of that many episodes."""
    return Paid(model.begin(reward, num_episodes), jnp.zeros(num_episodes))


def pay_episodes(
    model: RewardModel, reward: Any, paid: Paid, context: RewardContext, transitions: Transitions, counted: jax.Array
) -> Paid:
    """The reward model's own reward alone (Algorithm 1, line 11), summed over the counted steps (C, T, E) of C chunks.

    Of a robot that waited for its turn in a chunk the model remembers what it did before.
    """

    def chunk(paid: Paid, steps: tuple[Transitions, jax.Array]) -> tuple[Paid, None]:
        transitions, counted = steps
        carry, rewards = model.reward(reward, paid.carry, context, transitions)
        return Paid(where_each(counted[0], carry, paid.carry), paid.fitness + paid_in(rewards, counted)), None

    return jax.lax.scan(chunk, paid, (transitions, counted))[0]


def unfork(learner: vppo.Learner, stats: ObsStats) -> tuple[vppo.Learner, jax.Array, jax.Array]:
    """Copy 0, every copy's θ (K, P), and whether all copies and the statistics are finite numbers."""
    theta = jax.vmap(networks.flatten)(learner.policy)
    return jax.tree.map(lambda leaf: leaf[0], learner), theta, all_finite((learner, stats))


def give_up(actors: Actors, policy: Params, copies: int) -> tuple[Actors, jax.Array]:
    """Robots as before a training phase that went wrong, with other noise to come; and θ_μ for every copy (K, P)."""
    key, _ = split_each(actors.key)
    return actors._replace(key=key), jnp.tile(networks.flatten(policy), (copies, 1))


def branch(policy: Params, stats: ObsStats, theta: jax.Array, coefficients: jax.Array) -> tuple[Policies, jax.Array]:
    """Algorithm 1, lines 5-10: unit-length gradient rows, and the candidates θ_μ + |c_0| ∇f + Σ c_j ∇m_j.

    ``policy`` is θ_μ, ``theta`` (K, P) the copies after N1 updates from there, ``coefficients`` (λ, 1+k) xNES' samples.
    """
    theta_mu = networks.flatten(policy)
    difference = theta - theta_mu
    jacobian = difference / jnp.maximum(jnp.linalg.norm(difference, axis=1, keepdims=True), 1e-12)
    signed = coefficients.at[:, 0].set(jnp.abs(coefficients[:, 0]))  # fitness is never minimised (section 4.1)
    candidates = theta_mu + signed @ jacobian
    every = (len(candidates), stats.mean.shape[0])
    return Policies(candidates, jnp.broadcast_to(stats.mean, every), jnp.broadcast_to(stats.std, every)), jacobian


def update_reward(
    model: RewardModel,
    key: jax.Array,
    reward: Any,
    context: RewardContext,
    demos: Demonstrations,
    transitions: Transitions,
) -> tuple[Any, dict[str, jax.Array]]:
    """One round of the reward model's learning from demonstrations and fresh steps (Algorithm 1, line 18).

    A round that ends in numbers that are not finite is undone and reported as ``reward_rolled_back``.
    """
    learned, info = model.update(key, reward, context, demos, transitions)
    healthy = all_finite(learned)
    kept = jax.tree.map(lambda new, old: jnp.where(healthy, new, old), learned, reward)
    return kept, {**info, "reward_rolled_back": 1.0 - healthy}


def jump(
    parts: Parts,
    learner: vppo.Learner,
    stats: ObsStats,
    theta: jax.Array,
    obs_mean: jax.Array,
    obs_std: jax.Array,
) -> tuple[vppo.Learner, ObsStats]:
    """θ_μ becomes an elite, with that elite's own observation statistics; optimisers start afresh, the critic stays.

    The statistics keep their weight of past data, so that the elite's normaliser moves no faster than before.
    """
    opt, policy = vppo.optimiser(parts.settings), networks.unflatten(theta, parts.like)
    learner = learner._replace(policy=policy, policy_opt=opt.init(policy), critic_opt=opt.init(learner.critic))
    return learner, ObsStats(obs_mean, obs_std, jnp.square(obs_std) * stats.seen, stats.seen)
