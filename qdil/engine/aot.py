"""Ahead-of-time compilation: threads compile a run's programs while Python traces the next one.

XLA uses little more than one core to compile a program, and less to load one from the cache. Python can trace only one
program at a time. A later call finds its compiled program if its arguments have the shapes and layouts that were
compiled here. For results of other programs, ``Program.lower`` returns both.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from qdil.config import Config
from qdil.engine.program import REPLICATED, SHARDED, Program, as_laid_out
from qdil.engine.programs import RewardPrograms, SearchPrograms
from qdil.imitation.reward_model import Demonstrations
from qdil.rl.evaluate import Policies
from qdil.rl.networks import flat_size
from qdil.rl.vppo import Experience, Weighting
from qdil.types import RewardContext


class Compiler:
    """Passes programs to threads that compile them; returns their results as shapes in their layouts."""

    def __init__(self, threads: ThreadPoolExecutor) -> None:
        self.threads = threads
        self.compiling: list[Future] = []
        self.names: list[str] = []

    def __call__(self, program: Program, *args: Any) -> Any:
        lowered, results = program.lower(*args)
        self.compiling.append(self.threads.submit(lowered.compile))
        self.names.append(program.name)
        return results


def compile_all(
    search: SearchPrograms,
    reward: RewardPrograms,
    config: Config,
    key: jax.Array,
    demos: Demonstrations | None,
    heldout: Demonstrations | None = None,
) -> list[str]:
    """Compile every program that a run with these arguments calls (see ``ppga.begin``); returns their names."""
    # Hosts must compile in the same order, so each uses a single thread if there are several.
    threads = ThreadPoolExecutor(2 if jax.process_count() == 1 else 1, "compile")
    try:
        compiler = Compiler(threads)
        _compile_in_order(compiler, search, reward, config, key, demos, heldout)
        for compiling in compiler.compiling:
            compiling.result()
    finally:
        threads.shutdown(cancel_futures=True)
    return compiler.names


def _compile_in_order(
    compiler: Compiler,
    search: SearchPrograms,
    reward: RewardPrograms,
    config: Config,
    key: jax.Array,
    demos: Demonstrations | None,
    heldout: Demonstrations | None = None,
) -> None:
    """Compile the simulation's programs first, because they take longest; the others in the order of their calls."""
    arguments = _arguments(config, search)
    occupied, bonus, weighting, number, learn_key, keys, policies, coefficients = arguments

    train_state, stats, envs = compiler(search.init, key)
    copies = compiler(search.replicate, train_state)
    envs, transitions, sample = compiler(search.collect, copies, stats, envs)
    evaluated, tally = compiler(search.begin_episodes, keys)
    lengths = tally.length
    _, tally, steps, counted = compiler(search.advance_episodes, policies, evaluated, tally)

    state, memory = compiler(reward.init, key, demos)
    context = RewardContext(stats.normaliser, occupied)
    _, rewards = compiler(reward.compute, state, memory, context, bonus, transitions)
    experience = Experience(transitions, sample, rewards)
    copies, stats, _ = compiler(search.learn, learn_key, number, copies, stats, experience, weighting, number)
    _, theta, _ = compiler(search.first_copy, copies, stats)
    compiler(search.discard_update, envs, train_state.policy)
    compiler(search.branch, train_state.policy, stats.normaliser, theta, coefficients)
    elite = (np.zeros(row.shape[1], np.float32) for row in policies)
    compiler(search.restart_at, train_state, stats, *elite)

    so_far = compiler(reward.begin_scoring, state)
    so_far = compiler(reward.score_chunk, state, so_far, context, steps, counted)
    compiler(search.finish_episodes, tally, so_far.fitness)
    if reward.model.learns:
        store = transitions if config.reward.replay_share > 0 else ()
        compiler(reward.update, key, state, context, demos, heldout, transitions, store)
        if store:
            compiler(reward.keep_steps, key, store, lengths, steps, counted)
        if config.reward.reward_schedule == "update":
            compiler(search.steps_of_first_copy, transitions)


def _arguments(config: Config, search: SearchPrograms) -> tuple[Any, ...]:
    """The arguments that are not results of a program, as shapes in their layouts."""
    mesh: Mesh = search.mesh
    env, candidates, objectives = search.env, config.ppga.candidates, search.objectives
    weighting = Weighting(jnp.eye(objectives), jnp.asarray(True))
    cells = (config.ppga.cells,) * len(env.measure_names)
    replicated = jnp.zeros(cells, bool), jnp.zeros(2), weighting, jnp.asarray(0, jnp.int32), jax.random.key(0)
    count = (candidates, config.evaluation.episodes)
    keys = jax.eval_shape(lambda: jax.random.split(jax.random.key(0), count))
    sizes = (flat_size(search.template), env.obs_size, env.obs_size)
    policies = [jnp.zeros((candidates, size)) for size in sizes]
    return (
        *(as_laid_out(one, REPLICATED, mesh) for one in replicated),
        as_laid_out(keys, SHARDED, mesh),
        Policies(*(as_laid_out(one, SHARDED, mesh) for one in policies)),
        jnp.zeros((candidates, objectives)),
    )
