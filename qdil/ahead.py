"""Compile all of a run's programs before any is called, on threads, while the next one is still being traced.

XLA compiles one program on little more than one core, and loads one from the cache on less; tracing is Python's and
needs one at a time. What is compiled here is what the calls find later: the same shapes in the same layouts.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding
from jax.sharding import PartitionSpec as P

from qdil.config import Config
from qdil.imitation.reward_model import Demonstrations
from qdil.search.evaluate import Policies
from qdil.search.networks import flat_size
from qdil.sharding import AXIS, by_environment, make_mesh, replicated
from qdil.types import RewardContext


class _Ahead:
    """Hands programs to threads that compile them; gives back what they will return, as shapes in their layouts."""

    def __init__(self, num_devices: int, threads: ThreadPoolExecutor) -> None:
        mesh = make_mesh(num_devices)
        self.whole, self.split = replicated(mesh), by_environment(mesh)
        self.window = NamedSharding(mesh, P(None, AXIS))  # (T, E)
        self.chunks = NamedSharding(mesh, P(None, None, AXIS))  # (C, T, E)
        self.threads = threads
        self.going: list[Future] = []

    def __call__(self, program: Any, *args: Any, gives: Any = None) -> Any:
        """``gives``: the layout of each of the program's results, or one for all of them."""
        lowered = program.lower(*args)
        self.going.append(self.threads.submit(lowered.compile))
        if not isinstance(gives, tuple):
            return self.lay_out(lowered.out_info, gives)
        return tuple(self.lay_out(part, layout) for part, layout in zip(lowered.out_info, gives, strict=True))

    @staticmethod
    def lay_out(tree: Any, layout: NamedSharding | None) -> Any:
        return jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=layout), tree)


def compile_all(
    programs: Any, rewards: Any, config: Config, num_devices: int, key: jax.Array, demos: Demonstrations | None
) -> None:
    """Every program of ``qdil.compiled`` that a run with this ``config``, ``key`` and ``demos`` will call."""
    # Hosts that compile together must do so in the same order.
    threads = ThreadPoolExecutor(2 if jax.process_count() == 1 else 1, "compile")
    try:
        ahead = _Ahead(num_devices, threads)
        _all(ahead, programs, rewards, config, key, demos)
        for done in ahead.going:
            done.result()
    finally:
        threads.shutdown(cancel_futures=True)


def _all(
    ahead: _Ahead, programs: Any, rewards: Any, config: Config, key: jax.Array, demos: Demonstrations | None
) -> None:
    """In the order of their calls, but for the longest, the simulation, which go first."""
    whole, split, window, chunks = ahead.whole, ahead.split, ahead.window, ahead.chunks
    streams, env = programs.parts.streams, programs.parts.env
    cells = (config.cells,) * len(env.measure_names)
    given = jnp.zeros(cells, bool), jnp.zeros(2), jnp.eye(streams), jnp.asarray(True), jnp.asarray(0, jnp.int32), key
    occupied, bonus, weights, tied, number, learn_key = ahead.lay_out(given, whole)

    learner, stats, actors = ahead(programs.init, key, gives=(whole, whole, split))
    copies = ahead(programs.fork, learner, gives=whole)
    actors, transitions, choice = ahead(programs.collect, copies, stats, actors, gives=(split, window, window))
    every, pair = config.candidates, (config.candidates, config.episodes)
    keys = ahead.lay_out(jax.eval_shape(lambda: jax.random.split(jax.random.key(0), pair)), split)
    evaluated, tally = ahead(programs.episodes.begin, keys, gives=split)
    rows = [jnp.zeros((every, size)) for size in (flat_size(programs.parts.like), env.obs_size, env.obs_size)]
    policies = ahead.lay_out(Policies(*rows), split)
    _, tally, steps, counted = ahead(
        programs.episodes.advance, policies, evaluated, tally, gives=(split, split, chunks, chunks)
    )

    reward, carry = ahead(rewards.init, key, demos, gives=(whole, split))
    context = RewardContext(stats, occupied)
    carry, fitness = ahead(rewards.pay, reward, carry, context, bonus, transitions, gives=(split, window))
    how = weights, tied, number
    copies, stats, _ = ahead(
        programs.learn, learn_key, number, copies, stats, transitions, choice, fitness, *how, gives=(whole,) * 3
    )
    _, theta, _ = ahead(programs.unfork, copies, stats, gives=(whole, whole, whole))
    ahead(programs.give_up, actors, learner.policy)
    ahead(programs.branch, learner.policy, stats, theta, jnp.zeros((every, streams)))
    ahead(programs.jump, learner, stats, *(np.zeros(row.shape[1], np.float32) for row in rows))

    paid = ahead(rewards.begin, reward, gives=split)
    paid = ahead(rewards.pay_episodes, reward, paid, context, steps, counted, gives=split)
    ahead(programs.episodes.finish, tally, paid.fitness)
    if rewards.model.learns:
        ahead(rewards.update, key, reward, context, demos, transitions)
