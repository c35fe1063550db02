"""The handful of compiled functions behind a run: each is sharded over the mesh and compiled once.

Everything here is plumbing (meshes, layouts, closures over static settings); the algorithm is in ``qdil.ppga``.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.sharding import PartitionSpec as P

from qdil.config import Config
from qdil.imitation.bonus import measure_bonus
from qdil.imitation.methods import reward_model
from qdil.imitation.reward_model import Demonstrations
from qdil.robots import brax_robots
from qdil.robots.environment import Environment
from qdil.search import networks, vppo
from qdil.search.evaluate import Policies, Scores, evaluate
from qdil.search.normalise import init_obs_stats
from qdil.search.rollout import Actors, start
from qdil.sharding import AXIS, by_environment, choose_num_devices, make_mesh, replicated
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


class Compiled(NamedTuple):
    """The run's compiled functions and what they were built around."""

    env: Environment
    like: Params  # a policy, for its structure
    learns: bool  # whether the reward model has anything to learn
    num_devices: int
    init: Any  # (key, demos) -> State
    train: Any  # (state, occupied, weights (K, 1+k), tied, num_updates, epochs) -> Trained
    evaluate: Any  # (Policies, state, occupied, key (λ, n)) -> Scores
    branch: Any  # (state, theta (K, P), coefficients (λ, 1+k)) -> (candidates: Policies, jacobian (1+k, P))
    update_reward: Any  # (state, occupied, demos, transitions) -> (State, info)
    place: Any  # Policies -> Policies, laid out over the devices as ``evaluate`` expects them
    jump: Any  # (state, theta (P,), obs mean, obs std) -> State at an elite


def vppo_settings(config: Config) -> vppo.Settings:
    """The part of the configuration that PPO reads."""
    c = config
    return vppo.Settings(
        c.window, c.episode_length, c.minibatches, c.gamma, c.gae_lambda, c.clip, c.value_coef, c.entropy_coef,
        c.max_grad_norm, c.learning_rate, c.target_kl,
    )  # fmt: skip


def compile_run(config: Config) -> Compiled:
    """Build (not yet trace) every function of a run. Raises ConfigError/ValueError before anything compiles."""
    num_devices = choose_num_devices(config.devices, config.num_envs // 3, config.candidates)
    mesh = make_mesh(num_devices)
    env = brax_robots.make(config.env, config.backend)
    streams = 1 + len(env.measure_names)
    settings = vppo_settings(config)
    model, method = reward_model(config, env)
    like = policy_like(config, env)

    def init(key: jax.Array, demos: Demonstrations | None) -> State:
        key, policy_key, critic_key, reward_key, actor_key = jax.random.split(key, 5)
        critic = networks.init_mlp(critic_key, (env.obs_size, *config.critic_hidden, streams))
        learner = vppo.init_learner(settings, _policy(policy_key, config, env), critic, streams)
        actors = start(env, jax.random.split(actor_key, config.num_envs))
        reward = model.init(reward_key, demos)
        carry = model.begin(reward, config.num_envs)
        return State(key, learner, init_obs_stats(env.obs_size), actors, reward, carry)

    def train(state: State, occupied, weights, tied, num_updates, epochs) -> Trained:
        def rewards(carry, stats, transitions):
            context = RewardContext(stats, occupied)
            carry, reward = model.reward(state.reward, carry, context, transitions)
            if method.bonus:
                reward = reward + measure_bonus(transitions, occupied, config.bonus_p, config.bonus_q)
            return carry, reward

        def one_update(learner, stats, actors, carry):
            return vppo.update(env, settings, rewards, learner, stats, actors, carry, weights, tied, epochs)

        learner = vppo.fork(state.learner, streams)
        shapes = jax.eval_shape(one_update, learner, state.stats, state.actors, state.reward_carry)
        empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes[4:])
        begin = (learner, state.stats, state.actors, state.reward_carry, *empty)
        out = jax.lax.fori_loop(0, num_updates, lambda _, carry: one_update(*carry[:4]), begin)
        learner, stats, actors, carry, transitions, info = out
        theta = jax.vmap(networks.flatten)(learner.policy)
        first = jax.tree.map(lambda leaf: leaf[0], learner)
        after = State(state.key, first, stats, actors, state.reward, carry)
        return Trained(after, theta, transitions, info)

    def score(policies: Policies, state: State, occupied, key) -> Scores:
        carry = model.begin(state.reward, key.shape[0] * key.shape[1])

        def rewards(carry, stats, transitions):
            return model.reward(state.reward, carry, RewardContext(stats, occupied), transitions)

        return evaluate(
            env, rewards, like, policies, state.stats, carry, key,
            config.episode_length, config.eval_chunk, config.sample_actions,
        )  # fmt: skip

    def update_reward(state: State, occupied, demos, transitions: Transitions):
        key, update_key = jax.random.split(state.key)
        context = RewardContext(state.stats, occupied)
        reward, info = model.update(update_key, state.reward, context, demos, transitions)
        return state._replace(key=key, reward=reward), info

    def jump(state: State, theta, obs_mean, obs_std) -> State:
        return _jump(state, networks.unflatten(theta, like), obs_mean, obs_std, settings)

    everywhere, split = replicated(mesh), by_environment(mesh)
    state_specs: Any = _state_of(P(), P(AXIS))
    state_layout: Any = _state_of(everywhere, split)
    each: Any = P()  # specs stand where arrays will be
    trained_specs = Trained(state_specs, each, P(None, AXIS), each)  # type: ignore[arg-type]
    shard: dict[str, Any] = {"mesh": mesh, "check_vma": False}
    return Compiled(
        env,
        like,
        model.learns,
        num_devices,
        jax.jit(init, out_shardings=state_layout),
        jax.jit(
            jax.shard_map(train, in_specs=(state_specs, P(), P(), P(), P(), P()), out_specs=trained_specs, **shard)
        ),
        jax.jit(jax.shard_map(score, in_specs=(P(AXIS), state_specs, P(), P(AXIS)), out_specs=P(AXIS), **shard)),
        jax.jit(branch, out_shardings=(split, everywhere)),
        jax.jit(update_reward, out_shardings=(state_layout, everywhere)),
        lambda policies: jax.device_put(policies, split),
        jax.jit(jump, out_shardings=state_layout),
    )


def _policy(key: jax.Array, config: Config, env: Environment) -> Params:
    return networks.init_policy(key, env.obs_size, env.action_size, config.actor_hidden, config.initial_std)


def _state_of(whole: Any, split: Any) -> Any:
    """How each part of ``State`` lies on the devices: robots and what goes with them split, the rest whole."""
    return State(key=whole, learner=whole, stats=whole, actors=split, reward=whole, reward_carry=split)


def policy_like(config: Config, env: Environment) -> Params:
    """A policy of the right structure, all zeros: what ``networks.unflatten`` needs."""
    shapes = jax.eval_shape(lambda key: _policy(key, config, env), jax.random.key(0))
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)


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


def _jump(state: State, policy: Params, obs_mean, obs_std, settings: vppo.Settings) -> State:
    """θ_μ becomes an elite, with that elite's own observation statistics; optimisers start afresh, the critic stays.

    The statistics keep their weight of past data, so that the elite's normaliser moves no faster than before.
    """
    opt = vppo.optimiser(settings)
    learner = state.learner._replace(
        policy=policy, policy_opt=opt.init(policy), critic_opt=opt.init(state.learner.critic)
    )
    stats = ObsStats(obs_mean, obs_std, jnp.square(obs_std) * state.stats.seen, state.stats.seen)
    return state._replace(learner=learner, stats=stats)
