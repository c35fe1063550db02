"""A run's phases, each compiled once and laid out over a mesh of devices; and the loops over them.

Two sets of programs: those of the search, which all methods with the same sizes share within a process (and, through
the compilation cache, between processes), and those of one method's reward, which hold no simulation and compile fast.
"""

from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.sharding import PartitionSpec as P

from qdil import ahead, compiler, phases
from qdil.config import Config
from qdil.imitation.methods import reward_model
from qdil.imitation.reward_model import Demonstrations, RewardModel
from qdil.phases import Parts, State, Trained
from qdil.registry import name_of, parse_method
from qdil.robots import brax_robots
from qdil.search import evaluate, vppo
from qdil.search.evaluate import Episodes, Paid, Policies, Scores
from qdil.sharding import AXIS, by_environment, choose_num_devices, laid_out, make_mesh, replicated
from qdil.types import RewardContext

# The settings that the search's programs depend on, and those that a reward's do.
SEARCH_SETTINGS = (
    "env", "backend", "candidates", "episodes", "sample_actions", "eval_chunk", "eval_turns", "eval_tile",
    "actor_hidden", "critic_hidden", "initial_std", "num_envs", "window", "episode_length", "minibatches", "gamma",
    "gae_lambda", "clip", "value_coef", "entropy_coef", "max_grad_norm", "learning_rate", "target_kl",
)  # fmt: skip
REWARD_SETTINGS = (
    "env", "backend", "candidates", "episodes", "num_envs", "episode_length", "bonus_scope", "expert_obs",
    "reward_hidden", "reward_learning_rate", "reward_steps", "reward_batch", "gradient_penalty", "penalty_mixing",
    "vail_beta", "vail_information", "vail_beta_rate", "vail_latent", "giril_steps", "giril_learning_rate",
    "giril_action_weight", "pwil_alpha", "pwil_beta", "pwil_coupling",
)  # fmt: skip


class SearchPrograms(NamedTuple):
    """Compiled functions of ``qdil.phases`` and ``qdil.search`` that know nothing of rewards."""

    parts: Parts
    init: Any
    fork: Any  # (learner) -> learner with K copies
    collect: Any
    learn: Any
    unfork: Any
    give_up: Any
    branch: Any
    episodes: Episodes
    jump: Any
    place: Any  # a tree with axis (λ) in front, laid out over the devices as evaluation expects it
    share: Any  # a tree given whole to every device; once for many calls, each of which would do it again


class RewardPrograms(NamedTuple):
    """Compiled functions of one method's reward."""

    model: RewardModel
    init: Any
    begin: Any  # (reward) -> what is paid to λ·n episodes before they begin
    pay: Any
    pay_episodes: Any
    update: Any


class Compiled(NamedTuple):
    """A run's compiled functions, in the form that Algorithm 1 asks for."""

    parts: Parts
    model: RewardModel
    num_devices: int
    ahead: Any  # (key, demos) -> None, compiles all that follow at once
    init: Any  # (key, demos) -> State
    train: Any  # (state, occupied, weights (K, 1+k), tied, num_updates, epochs) -> Trained
    branch: Any  # (state, theta (K, P), coefficients (λ, 1+k)) -> (candidates: Policies, jacobian (1+k, P))
    score: Any  # (Policies, state, occupied, key (λ, n)) -> Scores
    update_reward: Any  # (state, occupied, demos, transitions) -> (State, info)
    jump: Any  # (state, theta (P,), obs mean, obs std) -> State at an elite
    episodes: Episodes  # the pieces of ``score``
    place: Any  # a tree with axis (λ) in front, laid out over the devices as ``score`` expects it


def compile_run(config: Config) -> Compiled:
    """Build every function of a run; each compiles when first called. Raises ConfigError or ValueError before that."""
    num_devices = choose_num_devices(config.devices, config.num_envs // 3, config.candidates)
    method = parse_method(config.method)
    programs = search_programs(_only(SEARCH_SETTINGS, config), num_devices)
    # The bonus is an argument of the programs, so methods that differ in it alone share them.
    without_bonus = method._replace(bonus=False)
    rewards = reward_programs(_only(REWARD_SETTINGS, config, method=name_of(without_bonus)), num_devices)
    return Compiled(
        programs.parts,
        rewards.model,
        num_devices,
        ahead=partial(ahead.compile_all, programs, rewards, config, num_devices),
        init=partial(_init, programs, rewards),
        train=partial(_train, programs, rewards, bonus_of(config)),
        branch=lambda state, theta, c: programs.branch(state.learner.policy, state.stats, theta, c),
        score=partial(_score, programs, rewards),
        update_reward=partial(_update_reward, programs, rewards),
        jump=partial(_jump, programs),
        episodes=programs.episodes,
        place=programs.place,
    )


def _only(names: tuple[str, ...], config: Config, **changes: Any) -> Config:
    """``config`` with every setting but ``names`` as by default, so that equal programs are recognised."""
    return replace(Config(), **{name: getattr(config, name) for name in names}, **changes)


@lru_cache(maxsize=4)  # each takes some 5,000 of the 65,530 memory maps that Linux allows a process
def search_programs(config: Config, num_devices: int) -> SearchPrograms:
    """The search's programs for the ``SEARCH_SETTINGS`` of ``config``."""
    parts = phases.assemble(config)
    mesh = make_mesh(num_devices)
    whole, split = replicated(mesh), by_environment(mesh)
    shard = partial(_sharded, mesh)
    window, chunks = P(None, AXIS), P(None, None, AXIS)  # (T, E), (C, T, E)
    all_, each = P(), P(AXIS)
    pieces, physics = parts.episodes, compiler.on_one_core()

    def learn(key: jax.Array, update: jax.Array, *args: Any) -> Any:
        return vppo.learn(parts.settings, jax.random.fold_in(key, update), *args)

    return SearchPrograms(
        parts,
        init=jax.jit(
            partial(phases.init, parts), out_shardings=(whole, whole, split), compiler_options=compiler.in_haste()
        ),
        fork=jax.jit(partial(vppo.fork, copies=parts.streams), out_shardings=whole),
        collect=shard(
            partial(vppo.collect, parts.env, parts.settings),
            (all_, all_, each),
            (each, window, window),
            compiler_options=physics,
        ),
        learn=shard(
            learn,
            (all_, all_, all_, all_, window, window, window, all_, all_, all_),
            all_,
            compiler_options=compiler.for_learning(num_devices),
        ),
        unfork=jax.jit(phases.unfork, out_shardings=whole),
        give_up=jax.jit(partial(phases.give_up, copies=parts.streams), out_shardings=(split, whole)),
        branch=jax.jit(phases.branch, out_shardings=(split, whole)),
        episodes=Episodes(
            shard(pieces.begin, (each,), each, compiler_options=compiler.in_haste()),
            shard(pieces.advance, (each, each, each), (each, each, chunks, chunks), compiler_options=physics),
            shard(pieces.finish, (each, each), each),
        ),
        jump=jax.jit(partial(phases.jump, parts), out_shardings=whole),
        place=lambda tree: laid_out(tree, split),
        share=lambda tree: laid_out(tree, whole),
    )


@lru_cache(maxsize=32)  # some 600 maps each
def reward_programs(config: Config, num_devices: int) -> RewardPrograms:
    """The programs of the reward that ``config.method`` names, for the ``REWARD_SETTINGS`` of ``config``."""
    model = reward_model(config, brax_robots.make(config.env, config.backend))
    mesh = make_mesh(num_devices)
    whole, split = replicated(mesh), by_environment(mesh)
    shard = partial(_sharded, mesh)
    window, chunks = P(None, AXIS), P(None, None, AXIS)
    all_, each = P(), P(AXIS)

    def update(key: jax.Array, reward: Any, context: RewardContext, demos: Any, transitions: Any) -> Any:
        """Every device learns the same reward model from all robots' steps: one exchange of data, then none."""
        everyones = jax.tree.map(lambda x: jax.lax.all_gather(x, AXIS, axis=1, tiled=True), transitions)
        return phases.update_reward(model, key, reward, context, demos, everyones)

    return RewardPrograms(
        model,
        init=jax.jit(partial(phases.init_reward, model, num_envs=config.num_envs), out_shardings=(whole, split)),
        begin=jax.jit(
            partial(phases.begin_paying, model, num_episodes=config.candidates * config.episodes), out_shardings=split
        ),
        pay=shard(partial(phases.pay, model, config.bonus_scope), (all_, each, all_, all_, window), (each, window)),
        pay_episodes=shard(partial(phases.pay_episodes, model), (all_, each, all_, chunks, chunks), each),
        update=shard(update, (all_, all_, all_, all_, window), all_),
    )


def _sharded(mesh: Any, function: Any, in_specs: Any, out_specs: Any, compiler_options: Any = None) -> Any:
    """``function`` compiled to run on every device of ``mesh`` with its share of what is split."""
    split = jax.shard_map(function, mesh=mesh, in_specs=in_specs, out_specs=out_specs, check_vma=False)
    return jax.jit(split, compiler_options=compiler_options)


def bonus_of(config: Config) -> tuple[float, float]:
    """(p, q) of eq. 2, zeros for a method without the bonus."""
    return (config.bonus_p, config.bonus_q) if parse_method(config.method).bonus else (0.0, 0.0)


def _init(programs: SearchPrograms, rewards: RewardPrograms, key: jax.Array, demos: Demonstrations | None) -> State:
    key, search_key, reward_key = jax.random.split(key, 3)
    learner, stats, actors = programs.init(search_key)
    return State(key, learner, stats, actors, *rewards.init(reward_key, demos))


def _train(
    programs: SearchPrograms,
    rewards: RewardPrograms,
    bonus: tuple[float, float],
    state: State,
    occupied: jax.Array,
    weights: jax.Array,
    tied: bool,
    num_updates: int,
    epochs: int,
) -> Trained:
    """``num_updates`` ≥ 1 VPPO updates of K copies of θ_μ (Algorithm 1, lines 4 and 17); copy 0 is kept as learner.

    ``weights`` (K, 1+k), ``tied`` and ``epochs`` as in ``vppo.learn``. The bonus reads the archive cells ``occupied``.
    A phase that ends in numbers that are not finite is undone, whole, and reported as ``rolled_back``.
    """
    key, learn_key = jax.random.split(state.key)
    numbers = [np.int32(update) for update in range(num_updates)]
    how = weights, np.bool_(tied), np.int32(epochs)
    learn_key, numbers, how, paid, occupied = programs.share(
        (learn_key, numbers, how, np.asarray(bonus, np.float32), occupied)
    )
    learner, stats, actors, carry = programs.fork(state.learner), state.stats, state.actors, state.reward_carry
    info: dict[str, jax.Array] = {}
    for number in numbers:
        actors, transitions, choice = programs.collect(learner, stats, actors)
        carry, fitness = rewards.pay(state.reward, carry, RewardContext(stats, occupied), paid, transitions)
        # Past some thirty programs in line, a launch blocks a thread that a device may need: they would wait for ever.
        jax.block_until_ready(info)
        learner, stats, info = programs.learn(learn_key, number, learner, stats, transitions, choice, fitness, *how)
    first, theta, healthy = programs.unfork(learner, stats)
    if bool(healthy):
        state = State(key, first, stats, actors, state.reward, carry)
    else:
        actors, theta = programs.give_up(state.actors, state.learner.policy)
        state = state._replace(key=key, actors=actors)
    return Trained(state, theta, transitions, {**info, "rolled_back": 1.0 - healthy})


def _score(
    programs: SearchPrograms,
    rewards: RewardPrograms,
    policies: Policies,
    state: State,
    occupied: jax.Array,
    key: jax.Array,
) -> Scores:
    """Whole episodes of λ policies, scored by the reward model as it is now."""
    context = RewardContext(state.stats, programs.share(occupied))

    def pay(paid: Paid, transitions: Any, counted: jax.Array) -> Paid:
        return rewards.pay_episodes(state.reward, paid, context, transitions, counted)

    return evaluate.run(programs.episodes, pay, policies, rewards.begin(state.reward), key)


def _update_reward(
    programs: SearchPrograms, rewards: RewardPrograms, state: State, occupied: jax.Array, demos: Any, transitions: Any
) -> tuple[State, dict[str, jax.Array]]:
    key, update_key = jax.random.split(state.key)
    context = RewardContext(state.stats, programs.share(occupied))
    reward, info = rewards.update(update_key, state.reward, context, demos, transitions)
    return state._replace(key=key, reward=reward), info


def _jump(programs: SearchPrograms, state: State, theta: Any, obs_mean: Any, obs_std: Any) -> State:
    learner, stats = programs.jump(state.learner, state.stats, theta, obs_mean, obs_std)
    return state._replace(learner=learner, stats=stats)
