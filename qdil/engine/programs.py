"""Every program of a run, each declared once: its function, the layout of its arguments and of its results.

The programs of the search know nothing of rewards, so that all methods share them within a process (and, through the
compilation cache, between processes). Those of a method's reward hold no simulation and compile fast. A program may
depend on the settings that its class is given, and on no others.

Both kinds are kept for as long as the process lives, up to a number: ``search_programs`` and ``reward_programs`` are
the only caches of programs, and ``forget_programs`` empties them. A search's programs take about 5,000 of the 65,530
memory maps that Linux allows a process, a reward's about 600.
"""

import math
from dataclasses import replace
from functools import lru_cache, partial

import jax
import jax.numpy as jnp

from qdil.config import PPO, Config, Evaluation
from qdil.devices.mesh import AXIS, make_mesh
from qdil.devices.xla_options import ppo_options, single_threaded, unoptimised
from qdil.engine.program import CHUNKS, REPLICATED, ROLLOUT, SHARDED, program
from qdil.imitation import fitness, replay
from qdil.imitation.fitness import TrainingMemory
from qdil.imitation.reward_model import Demonstrations, reward_model
from qdil.qd import branching, restart
from qdil.rl import evaluate, networks, vppo
from qdil.rl.evaluate import Policies, RewardSum, Scores, Tally
from qdil.rl.normalise import init_obs_stats
from qdil.rl.rollout import EnvBatch, start
from qdil.rl.vppo import Experience, TrainState, Weighting
from qdil.robots import register
from qdil.robots.environment import Environment
from qdil.types import (
    ActionSample,
    Normaliser,
    ObsStats,
    Params,
    RewardContext,
    Rewards,
    RewardState,
    Transitions,
)

Store = Transitions | tuple[()]  # of candidates' steps (T, E); () if the reward model keeps none


class SearchPrograms:
    """Programs that simulate, train and branch policies, independent of the reward."""

    def __init__(
        self, env: Environment, ppo: PPO, evaluation: Evaluation, episode_length: int, num_devices: int
    ) -> None:
        chunks = math.ceil(episode_length / evaluation.eval_chunk_steps)  # of an episode; further chunks would be empty
        self.env, self.ppo, self.episode_length = env, ppo, episode_length
        self.evaluation = replace(evaluation, eval_chunks_per_sync=min(evaluation.eval_chunks_per_sync, chunks))
        self.mesh = make_mesh(num_devices)
        self.template: Params = networks.template_of(env.obs_size, env.action_size, ppo.actor_hidden)
        self.objectives = 1 + len(env.measure_names)  # fitness and δ_1 … δ_k, and so the copies of the policy

    # Training (VPPO)

    @program(gives=(REPLICATED, REPLICATED, SHARDED), options=unoptimised)
    def init(self, key: jax.Array) -> tuple[TrainState, ObsStats, EnvBatch]:
        """θ_0, a fresh critic, an empty normaliser, and robots at the beginning of episodes."""
        env, ppo = self.env, self.ppo
        policy_key, critic_key, env_key = jax.random.split(key, 3)
        policy = networks.init_policy(policy_key, env.obs_size, env.action_size, ppo.actor_hidden, ppo.initial_std)
        critic = networks.init_mlp(critic_key, (env.obs_size, *ppo.critic_hidden, self.objectives))
        train_state = vppo.init_train_state(ppo, policy, critic, self.objectives)
        envs = start(env, jax.random.split(env_key, ppo.num_envs), self.episode_length, in_step=False)
        return train_state, init_obs_stats(env.obs_size), envs

    @program(gives=REPLICATED)
    def replicate(self, train_state: TrainState) -> TrainState:
        """K copies of θ_μ, its critic and optimisers."""
        return vppo.replicate(train_state, self.objectives)

    @program(takes=(REPLICATED, REPLICATED, SHARDED), gives=(SHARDED, ROLLOUT, ROLLOUT), options=single_threaded)
    def collect(
        self, copies: TrainState, stats: ObsStats, envs: EnvBatch
    ) -> tuple[EnvBatch, Transitions, ActionSample]:
        """A rollout of every robot, driven by its copy."""
        return vppo.collect(self.env, self.ppo.rollout_length, self.episode_length, copies, stats, envs)

    @program(
        takes=(REPLICATED, REPLICATED, REPLICATED, REPLICATED, ROLLOUT, REPLICATED, REPLICATED),
        gives=REPLICATED,
        options=ppo_options,
    )
    def learn(
        self,
        key: jax.Array,
        update: jax.Array,
        copies: TrainState,
        stats: ObsStats,
        experience: Experience,
        weighting: Weighting,
        epochs: jax.Array,
    ) -> tuple[TrainState, ObsStats, vppo.Info]:
        """Let the copies learn from a rollout; ``update`` () is its number within the training phase."""
        key = jax.random.fold_in(key, update)
        return vppo.learn(self.ppo, key, copies, stats, experience, weighting, epochs)

    @program(takes=(ROLLOUT,), gives=ROLLOUT)
    def steps_of_first_copy(self, transitions: Transitions) -> Transitions:
        """The steps of copy 0's robots (T, E/K), each K times, so that their shape stays (T, E)."""
        return vppo.steps_of_first_copy(transitions, self.objectives)

    @program(gives=REPLICATED)
    def first_copy(self, copies: TrainState, stats: ObsStats) -> tuple[TrainState, jax.Array, jax.Array]:
        """The end of a training phase: copy 0, every copy's θ (K, P), whether all numbers are finite."""
        return vppo.first_copy(copies, stats)

    @program(gives=(SHARDED, REPLICATED))
    def discard_update(self, envs: EnvBatch, policy: Params) -> tuple[EnvBatch, jax.Array]:
        """The end of a training phase that is discarded: the robots before it, and θ_μ for every copy."""
        return vppo.discard_update(envs, policy, self.objectives)

    # Branching, evaluation, restart

    @program(gives=(SHARDED, REPLICATED))
    def branch(
        self, policy: Params, normaliser: Normaliser, theta: jax.Array, coefficients: jax.Array
    ) -> tuple[Policies, jax.Array]:
        """Candidates and the Jacobian (eq. 16)."""
        return branching.branch(policy, normaliser, theta, coefficients)

    @program(takes=(SHARDED,), gives=SHARDED, options=unoptimised)
    def begin_episodes(self, key: jax.Array) -> tuple[EnvBatch, Tally]:
        """One episode per key (λ, n)."""
        return evaluate.begin(self.env, key, self.episode_length)

    @program(takes=(SHARDED, SHARDED, SHARDED), gives=(SHARDED, SHARDED, CHUNKS, CHUNKS), options=single_threaded)
    def advance_episodes(
        self, policies: Policies, envs: EnvBatch, tally: Tally
    ) -> tuple[EnvBatch, Tally, Transitions, jax.Array]:
        """Some chunks of steps of all unfinished episodes."""
        return evaluate.advance(self.env, self.template, self.evaluation, policies, envs, tally)

    @program(takes=(SHARDED, SHARDED), gives=SHARDED)
    def finish_episodes(self, tally: Tally, fitness: jax.Array) -> Scores:
        """Each candidate's means over its episodes."""
        return evaluate.finish(tally, fitness, self.evaluation.episodes)

    @program(gives=REPLICATED)
    def restart_at(
        self, train_state: TrainState, stats: ObsStats, theta: jax.Array, obs_mean: jax.Array, obs_std: jax.Array
    ) -> tuple[TrainState, ObsStats]:
        """θ_μ becomes an elite."""
        return restart.restart_at(self.ppo, self.template, train_state, stats, theta, obs_mean, obs_std)


class RewardPrograms:
    """Programs of one method's reward. The bonus is an argument, so methods that differ in it alone share them."""

    def __init__(self, config: Config, env: Environment, num_devices: int) -> None:
        self.config = config
        self.model = reward_model(config, env)
        self.rule, self.k = fitness.bonus_rule(config), len(env.measure_names)
        self.mesh = make_mesh(num_devices)

    @program(gives=(REPLICATED, SHARDED))
    def init(self, key: jax.Array, demos: Demonstrations | None) -> tuple[RewardState, TrainingMemory]:
        """ψ_0, trained already if the model learns before the run, and the memory of each training robot."""
        reward = self.model.init(key, demos)
        return reward, fitness.begin_training(self.model, self.rule, reward, self.config.ppo.num_envs, self.k)

    @program(takes=(REPLICATED, SHARDED, REPLICATED, REPLICATED, ROLLOUT), gives=(SHARDED, ROLLOUT))
    def compute(
        self,
        reward: RewardState,
        memory: TrainingMemory,
        context: RewardContext,
        bonus: jax.Array,
        transitions: Transitions,
    ) -> tuple[TrainingMemory, Rewards]:
        """The fitness reward of a rollout (eq. 4) and its parts; ``bonus`` (2,) is (p, q)."""
        return fitness.compute_reward(self.model, self.rule, reward, memory, context, bonus, transitions, AXIS)

    @program(gives=SHARDED)
    def begin_scoring(self, reward: RewardState) -> RewardSum:
        """A reward sum of zero for each of λ·n episodes."""
        episodes = self.config.ppga.candidates * self.config.evaluation.episodes
        return fitness.begin_scoring(self.model, reward, episodes)

    @program(takes=(REPLICATED, SHARDED, REPLICATED, CHUNKS, CHUNKS), gives=SHARDED)
    def score_chunk(
        self,
        reward: RewardState,
        so_far: RewardSum,
        context: RewardContext,
        transitions: Transitions,
        counted: jax.Array,
    ) -> RewardSum:
        """Add the model's rewards for some chunks of steps."""
        return fitness.score_chunk(self.model, reward, so_far, context, transitions, counted)

    @program(takes=(REPLICATED, ROLLOUT, SHARDED, CHUNKS, CHUNKS), gives=ROLLOUT)
    def keep_steps(
        self, key: jax.Array, store: Transitions, before: jax.Array, transitions: Transitions, counted: jax.Array
    ) -> Transitions:
        """The store after some chunks of an evaluation, which all have the same ``key``."""
        key = jax.random.fold_in(key, jax.lax.axis_index(AXIS))
        share, length = self.config.reward.replay_share, self.config.simulation.episode_length
        picks = replay.pick(key, share, store.reward.size, len(before), length)
        return replay.keep(store, picks, before, transitions, counted)

    @program(takes=(REPLICATED, REPLICATED, REPLICATED, REPLICATED, REPLICATED, ROLLOUT, ROLLOUT), gives=REPLICATED)
    def update(
        self,
        key: jax.Array,
        reward: RewardState,
        context: RewardContext,
        demos: Demonstrations,
        heldout: Demonstrations | None,
        transitions: Transitions,
        store: Store,
    ) -> tuple[RewardState, dict[str, jax.Array]]:
        """A round of the model's learning. Every device learns the same model from all robots' steps.

        With a ``store``, its steps follow the rollout's in time, so that half of all policy rows are from either.
        Nothing learns from ``heldout``: it serves a measurement (``fitness.calibration``).
        """
        gather = partial(jax.lax.all_gather, axis_name=AXIS, axis=1, tiled=True)
        fresh = steps = jax.tree.map(gather, transitions)
        if isinstance(store, Transitions):
            steps = jax.tree.map(lambda new, old: jnp.concatenate([new, gather(old)]), steps, store)
        learned, info = fitness.update_reward(self.model, key, reward, context, demos, steps)
        return learned, info | fitness.calibration(self.model, learned, context, demos, heldout, fresh)


@lru_cache(maxsize=4)
def search_programs(
    env: Environment, ppo: PPO, evaluation: Evaluation, episode_length: int, num_devices: int
) -> SearchPrograms:
    """The search's programs for these settings; the same object for the same settings."""
    return SearchPrograms(env, ppo, evaluation, episode_length, num_devices)


@lru_cache(maxsize=32)
def reward_programs(config: Config, num_devices: int) -> RewardPrograms:
    """The programs of a run's reward; the same object for the same configuration."""
    return RewardPrograms(config, register.make(config.env, config.simulation.backend), num_devices)


def forget_programs() -> None:
    """Empty both caches and JAX's own: for a process that trains many configurations."""
    search_programs.cache_clear()
    reward_programs.cache_clear()
    jax.clear_caches()
