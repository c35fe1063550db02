"""The phases of a run as pure functions of its state: begin, train, branch, score, learn the reward, jump.

``qdil.ppga`` puts them in the order of Algorithm 1; ``qdil.compiled`` compiles them for a mesh of devices.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdil.config import Config, Method
from qdil.imitation.bonus import measure_bonus
from qdil.imitation.methods import reward_model
from qdil.imitation.reward_model import Demonstrations, RewardModel
from qdil.robots import brax_robots
from qdil.robots.environment import Environment
from qdil.search import networks, vppo
from qdil.search.evaluate import Policies, Scores, evaluate
from qdil.search.normalise import init_obs_stats
from qdil.search.rollout import Actors, start
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
    """What a run is made of and never changes."""

    config: Config
    env: Environment
    model: RewardModel
    method: Method
    settings: vppo.Settings
    like: Params  # a policy of zeros, for its structure

    @property
    def streams(self) -> int:
        """Reward streams and therefore copies of the policy: fitness and one per measure, 1 + k."""
        return 1 + len(self.env.measure_names)


def assemble(config: Config) -> Parts:
    """The parts that ``config`` names. Raises ConfigError or ValueError for what does not exist."""
    env = brax_robots.make(config.env, config.backend)
    return Parts(config, env, *reward_model(config, env), vppo_settings(config), policy_like(config, env))


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


def init(parts: Parts, key: jax.Array, demos: Demonstrations | None) -> State:
    """θ_0, a fresh critic and reward model, and robots at the beginning of episodes."""
    config, env = parts.config, parts.env
    key, policy_key, critic_key, reward_key, actor_key = jax.random.split(key, 5)
    critic = networks.init_mlp(critic_key, (env.obs_size, *config.critic_hidden, parts.streams))
    learner = vppo.init_learner(parts.settings, _policy(policy_key, config, env), critic, parts.streams)
    actors = start(env, jax.random.split(actor_key, config.num_envs), config.episode_length, in_step=False)
    reward = parts.model.init(reward_key, demos)
    carry = parts.model.begin(reward, config.num_envs)
    return State(key, learner, init_obs_stats(env.obs_size), actors, reward, carry)


def train(
    parts: Parts,
    state: State,
    occupied: jax.Array,
    weights: jax.Array,
    tied: jax.Array,
    num_updates: jax.Array,
    epochs: jax.Array,
) -> Trained:
    """``num_updates`` VPPO updates of K copies of θ_μ (Algorithm 1, lines 4 and 17). Runs inside ``shard_map``.

    The fitness reward is the model's, plus the measure bonus where the method has one (eq. 4), from the archive
    cells ``occupied`` now. ``weights`` (K, 1+k) and ``tied`` as in ``vppo.update``; ``state.learner`` becomes copy 0.
    """
    config, model = parts.config, parts.model

    def rewards(carry, stats, transitions):
        carry, reward = model.reward(state.reward, carry, RewardContext(stats, occupied), transitions)
        if parts.method.bonus:
            reward = reward + measure_bonus(transitions, occupied, config.bonus_p, config.bonus_q)
        return carry, reward

    def one_update(learner, stats, actors, carry):
        return vppo.update(parts.env, parts.settings, rewards, learner, stats, actors, carry, weights, tied, epochs)

    begin = (vppo.fork(state.learner, parts.streams), state.stats, state.actors, state.reward_carry)
    empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(one_update, *begin)[4:])
    out = jax.lax.fori_loop(0, num_updates, lambda _, now: one_update(*now[:4]), (*begin, *empty))
    learner, stats, actors, carry, transitions, info = out
    theta = jax.vmap(networks.flatten)(learner.policy)
    first = jax.tree.map(lambda leaf: leaf[0], learner)
    return Trained(State(state.key, first, stats, actors, state.reward, carry), theta, transitions, info)


def branch(state: State, theta: jax.Array, coefficients: jax.Array) -> tuple[Policies, jax.Array]:
    """Algorithm 1, lines 5-10: unit-length gradient rows, and the candidates θ_μ + |c_0| ∇f + Σ c_j ∇m_j.

    ``theta`` (K, P) are the copies' parameters after N1 updates from θ_μ, ``coefficients`` (λ, 1+k) xNES' samples.
    """
    theta_mu = networks.flatten(state.learner.policy)
    difference = theta - theta_mu
    jacobian = difference / jnp.maximum(jnp.linalg.norm(difference, axis=1, keepdims=True), 1e-12)
    signed = coefficients.at[:, 0].set(jnp.abs(coefficients[:, 0]))  # fitness is never minimised (section 4.1)
    candidates = theta_mu + signed @ jacobian
    stats = state.stats
    every = (len(candidates), stats.mean.shape[0])
    return Policies(candidates, jnp.broadcast_to(stats.mean, every), jnp.broadcast_to(stats.std, every)), jacobian


def score(parts: Parts, policies: Policies, state: State, occupied: jax.Array, key: jax.Array) -> Scores:
    """Whole episodes of λ policies, ``key`` (λ, n), scored by the reward model alone (Algorithm 1, line 11)."""
    config, model = parts.config, parts.model
    carry = model.begin(state.reward, key.shape[0] * key.shape[1])

    def rewards(carry, stats, transitions):
        return model.reward(state.reward, carry, RewardContext(stats, occupied), transitions)

    return evaluate(
        parts.env, rewards, parts.like, policies, state.stats, carry, key,
        config.episode_length, config.eval_chunk, config.sample_actions,
    )  # fmt: skip


def update_reward(
    parts: Parts, state: State, occupied: jax.Array, demos: Demonstrations, transitions: Transitions
) -> tuple[State, dict[str, jax.Array]]:
    """One round of the reward model's learning from demonstrations and fresh steps (Algorithm 1, line 18)."""
    key, update_key = jax.random.split(state.key)
    context = RewardContext(state.stats, occupied)
    reward, info = parts.model.update(update_key, state.reward, context, demos, transitions)
    return state._replace(key=key, reward=reward), info


def jump(parts: Parts, state: State, theta: jax.Array, obs_mean: jax.Array, obs_std: jax.Array) -> State:
    """θ_μ becomes an elite, with that elite's own observation statistics; optimisers start afresh, the critic stays.

    The statistics keep their weight of past data, so that the elite's normaliser moves no faster than before.
    """
    opt, policy = vppo.optimiser(parts.settings), networks.unflatten(theta, parts.like)
    learner = state.learner._replace(
        policy=policy, policy_opt=opt.init(policy), critic_opt=opt.init(state.learner.critic)
    )
    stats = ObsStats(obs_mean, obs_std, jnp.square(obs_std) * state.stats.seen, state.stats.seen)
    return state._replace(learner=learner, stats=stats)
