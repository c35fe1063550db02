"""The steps of Algorithm 1 as calls of a run's programs, with the host's loops around them."""

from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from qdil.config import Config
from qdil.devices.hosts import to_host
from qdil.devices.mesh import by_environment, choose_num_devices, laid_out, replicated
from qdil.engine import aot
from qdil.engine.programs import RewardPrograms, SearchPrograms, Store, reward_programs, search_programs
from qdil.imitation.fitness import TrainingMemory
from qdil.imitation.reward_model import Demonstrations, RewardModel
from qdil.methods import name_of, parse_method
from qdil.rl import networks, vppo
from qdil.rl.evaluate import Policies, Scores
from qdil.rl.rollout import EnvBatch
from qdil.rl.vppo import Experience, TrainState, Weighting
from qdil.robots import register
from qdil.robots.environment import Environment
from qdil.types import ObsStats, RewardContext, RewardState, Transitions

Tree = TypeVar("Tree")


class State(NamedTuple):
    """Everything on the devices that one QD iteration changes; with the archives and xNES, the whole run."""

    key: jax.Array
    train_state: TrainState  # θ_μ, its critic and their optimisers
    stats: ObsStats  # the one observation normaliser
    envs: EnvBatch  # robots in the middle of their episodes
    reward: RewardState  # ψ
    memory: TrainingMemory  # what the reward model and the bonus remember of the robots
    store: Store  # of candidates' steps, for the reward model's learning


class Trained(NamedTuple):
    """The end of a training phase."""

    state: State
    theta: jax.Array  # (K, P) the copies' parameters
    transitions: Transitions  # (T, E) the last rollout
    info: vppo.Info  # of the last update
    reward_info: dict[str, jax.Array]  # of the reward model's last learning; empty where it did not learn
    rolled_back: jax.Array  # () 1.0 if the phase was discarded because a number was not finite
    rollouts: int  # how many it collected, of ``rollout_length`` steps of every robot


class Engine:
    """Everything that a run computes. A program compiles when it is first called.

    ``occupied`` (cells, …) bool marks the filled archive cells, for the bonus. Raises ConfigError if robots or
    candidates cannot be shared out over the devices.

    ``heldout``: demonstrations that no model learns from; the reward model's reward for them is measured.
    """

    def __init__(self, config: Config, heldout: Demonstrations | None = None) -> None:
        method = parse_method(config.method)
        self.config, self.heldout = config, heldout
        self.env: Environment = register.make(config.env, config.simulation.backend)
        per_copy = config.ppo.num_envs // (1 + self.k)
        self.num_devices = choose_num_devices(config.devices, per_copy, config.ppga.candidates)
        self.search: SearchPrograms = search_programs(
            self.env, config.ppo, config.evaluation, config.simulation.episode_length, self.num_devices
        )
        without_bonus = name_of(method._replace(bonus=False))
        self.reward: RewardPrograms = reward_programs(replace(config, method=without_bonus), self.num_devices)
        self.bonus = (config.bonus.bonus_p, config.bonus.bonus_q) if method.bonus else (0.0, 0.0)  # p, q of eq. 2

    @property
    def k(self) -> int:
        """Number of measures."""
        return len(self.env.measure_names)

    @property
    def objectives(self) -> int:
        """Fitness and one per measure: 1 + k."""
        return 1 + self.k

    @property
    def model(self) -> RewardModel:
        """The method's reward model, without the bonus."""
        return self.reward.model

    @property
    def learns_each_iteration(self) -> bool:
        """Whether the reward model learns once an iteration (line 18), and not after every VPPO update."""
        return self.model.learns and self.config.reward.reward_schedule == "iteration"

    def compile_all(self, key: jax.Array, demos: Demonstrations | None) -> None:
        """Compile every program that a run with this ``key`` and ``demos`` will call."""
        aot.compile_all(self.search, self.reward, self.config, key, demos, self.heldout)

    def init(self, key: jax.Array, demos: Demonstrations | None) -> State:
        """The state before the first update."""
        key, search_key, reward_key = jax.random.split(key, 3)
        train_state, stats, envs = self.search.init(search_key)
        store: Store = ()
        if self.model.learns and self.config.reward.replay_share > 0:  # it holds steps of θ_0 at first
            store = self.search.collect(self.search.replicate(train_state), stats, envs)[1]
        return State(key, train_state, stats, envs, *self.reward.init(reward_key, demos), store)

    # Training phases

    def train_copies(
        self, state: State, occupied: jax.Array, updates: int, demos: Demonstrations | None = None
    ) -> Trained:
        """Algorithm 1, line 4: copy i of θ_μ is trained on objective i alone; copy 0 takes θ_μ's place.

        With ``reward_schedule=update`` the reward model learns from ``demos`` and copy 0's steps after every update.
        """
        weights = np.eye(self.objectives, dtype=np.float32)
        return self._train(state, occupied, weights, False, updates, demos)

    def train_policy(
        self,
        state: State,
        occupied: jax.Array,
        weights: np.ndarray,
        updates: int,
        demos: Demonstrations | None = None,
        bonus: bool = True,
    ) -> Trained:
        """Algorithm 1, line 17: θ_μ alone is trained, on the objectives weighted by ``weights`` (1+k,).

        ``bonus`` False leaves the measure bonus out. With ``reward_schedule=update`` the reward model learns from
        ``demos`` and all steps after every update.
        """
        return self._train(state, occupied, self._tied(weights), True, updates, demos, bonus)

    def rollout(self, state: State, occupied: jax.Array) -> Trained:
        """One rollout of θ_μ on all robots. Only the running statistics learn from it."""
        weights = np.eye(self.objectives, dtype=np.float32)[0]
        return self._train(state, occupied, self._tied(weights), True, 1, None, epochs=0)

    def _tied(self, weights: np.ndarray) -> np.ndarray:
        """One weighting (1+k,) for every copy."""
        return np.tile(np.asarray(weights, np.float32), (self.objectives, 1))

    def _train(
        self,
        state: State,
        occupied: jax.Array,
        weights: np.ndarray,
        tied: bool,
        updates: int,
        demos: Demonstrations | None,
        bonus: bool = True,
        epochs: int | None = None,
    ) -> Trained:
        """``updates`` ≥ 1 VPPO updates of K copies of θ_μ; copy 0 takes θ_μ's place.

        If the phase ends with a number that is not finite, all of it is discarded and ``rolled_back`` is 1.
        """
        search, ppo = self.search, self.config.ppo
        key, learn_key = jax.random.split(state.key)
        weighting = Weighting(weights, np.bool_(tied))  # type: ignore[arg-type]
        p_and_q = np.asarray(self.bonus if bonus else (0.0, 0.0), np.float32)
        numbers, steps = (
            [np.int32(update) for update in range(updates)],
            np.int32(ppo.epochs if epochs is None else epochs),
        )
        arguments = (learn_key, numbers, weighting, steps, p_and_q, occupied)
        learn_key, numbers, weighting, steps, p_and_q, occupied = laid_out(arguments, replicated(search.mesh))
        before, copies, info = state, search.replicate(state.train_state), None
        state = state._replace(key=key)
        reward_info: dict[str, jax.Array] = {}
        for number in numbers:
            state, experience = self._experience(copies, state, occupied, p_and_q)
            # With about thirty launched programs in the queue, a launch blocks a thread that a device may need, and the
            # two wait for each other for ever. So the host waits for the previous update here.
            jax.block_until_ready(info)
            if demos is not None and self.model.learns and not self.learns_each_iteration:
                rows = experience.transitions if tied else search.steps_of_first_copy(experience.transitions)
                state, reward_info = self.update_reward(state, occupied, demos, rows)
            copies, stats, info = search.learn(learn_key, number, copies, state.stats, experience, weighting, steps)
            state = state._replace(stats=stats)
        assert info is not None, "a training phase has at least one update"
        state, theta, healthy = self._end_phase(before, state, copies)
        return Trained(state, theta, experience.transitions, info, reward_info, 1.0 - healthy, updates)

    def _experience(
        self, copies: TrainState, state: State, occupied: jax.Array, bonus: jax.Array
    ) -> tuple[State, Experience]:
        """A rollout of the copies with its rewards; the robots and what is remembered of them move on."""
        envs, transitions, sample = self.search.collect(copies, state.stats, state.envs)
        context = RewardContext(state.stats.normaliser, occupied)
        memory, rewards = self.reward.compute(state.reward, state.memory, context, bonus, transitions)
        return state._replace(envs=envs, memory=memory), Experience(transitions, sample, rewards)

    def _end_phase(self, before: State, state: State, copies: TrainState) -> tuple[State, jax.Array, jax.Array]:
        """The state after a phase, every copy's θ, 1.0; if a number is not finite, the state ``before`` it and 0.0."""
        train_state, theta, healthy = self.search.first_copy(copies, state.stats)
        if bool(healthy):
            return state._replace(train_state=train_state), theta, healthy
        envs, theta = self.search.discard_update(before.envs, before.train_state.policy)
        return before._replace(key=state.key, envs=envs), theta, healthy

    # Candidates

    def branch(self, state: State, theta: jax.Array, coefficients: np.ndarray) -> tuple[Policies, jax.Array]:
        """Candidates along ``coefficients`` (λ, 1+k) and the Jacobian (1+k, P), see ``qdil.qd.branching``."""
        c = jnp.asarray(coefficients, jnp.float32)
        return self.search.branch(state.train_state.policy, state.stats.normaliser, theta, c)

    def score(self, state: State, occupied: jax.Array, policies: Policies, key: jax.Array) -> Scores:
        """Score λ policies over n whole episodes each, with the present reward model (Algorithm 1, lines 9-11)."""
        return self.score_and_keep(state, occupied, policies, key, None)[1]

    def score_and_keep(
        self, state: State, occupied: jax.Array, policies: Policies, key: jax.Array, keep_key: jax.Array | None
    ) -> tuple[State, Scores]:
        """``score``; the store, if there is one, keeps steps that are drawn by ``keep_key``, or none without a key."""
        search, reward = self.search, self.reward
        count = (self.config.ppga.candidates, self.config.evaluation.episodes)
        context = RewardContext(state.stats.normaliser, laid_out(occupied, replicated(search.mesh)))
        so_far = reward.begin_scoring(state.reward)
        envs, tally = search.begin_episodes(self.place(jax.random.split(key, count)))
        while to_host(tally.unfinished).any():
            before = tally.length
            envs, tally, transitions, counted = search.advance_episodes(policies, envs, tally)
            if keep_key is not None and isinstance(state.store, Transitions):
                store = reward.keep_steps(keep_key, state.store, before, transitions, counted)
                state = state._replace(store=store)
            so_far = reward.score_chunk(state.reward, so_far, context, transitions, counted)
        return state, search.finish_episodes(tally, so_far.fitness)

    def place(self, tree: Tree) -> Tree:
        """A tree of arrays with axis (λ) in front, laid out over the devices as ``score`` expects it."""
        return laid_out(tree, by_environment(self.search.mesh))

    def elites(self, elites: dict[str, np.ndarray], rows: np.ndarray) -> Policies:
        """The λ elites in ``rows`` of an archive's arrays, placed."""
        # The arrays are on the host: to split an array on a device, JAX would compile one more program.
        arrays: Any = (elites[name][rows] for name in ("solution", "obs_mean", "obs_std"))
        return self.place(Policies(*arrays))

    def all_with_normaliser(self, theta: jax.Array, stats: ObsStats) -> Policies:
        """λ policies ``theta`` (λ, P) under one normaliser, placed."""
        mean, std = (jnp.broadcast_to(x, (len(theta), *x.shape)) for x in stats.normaliser)
        return self.place(Policies(theta, mean, std))

    # Reward model and restart

    def update_reward(
        self, state: State, occupied: jax.Array, demos: Demonstrations, transitions: Transitions
    ) -> tuple[State, dict[str, jax.Array]]:
        """Algorithm 1, line 18: the reward model learns from demonstrations and a rollout of the policy."""
        key, update_key = jax.random.split(state.key)
        context = RewardContext(state.stats.normaliser, laid_out(occupied, replicated(self.search.mesh)))
        reward, info = self.reward.update(
            update_key, state.reward, context, demos, self.heldout, transitions, state.store
        )
        return state._replace(key=key, reward=reward), info

    def restart_at(self, state: State, elite: dict[str, np.ndarray]) -> State:
        """Algorithm 1, line 21: θ_μ becomes ``elite``, with that elite's own observation statistics."""
        arrays: Any = (elite[name] for name in ("solution", "obs_mean", "obs_std"))
        train_state, stats = self.search.restart_at(state.train_state, state.stats, *arrays)
        return state._replace(train_state=train_state, stats=stats)

    def theta_mu(self, state: State) -> jax.Array:
        """θ_μ (P,)."""
        return networks.flatten(state.train_state.policy)
