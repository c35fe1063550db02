"""What XLA made of the simulation, read from its text: two properties that make it fast on CPUs.

An update of XLA may change its text or lose a property, so these are figures of the bench and not tests.
"""

import re
import statistics

import jax
import jax.numpy as jnp

from qdil.config import make_config
from qdil.engine.program import SHARDED, as_laid_out
from qdil.engine.programs import SearchPrograms
from qdil.rl.evaluate import Policies
from qdil.rl.networks import flat_size
from qdil.robots import register

ROBOTS_PER_COPY = 512  # so many that XLA would split operations over threads if its options did not forbid it
PARALLEL = '"outer_dimension_partitions":["'


def compiled_code(env: str) -> dict[str, float]:
    """Figures of one robot; empty where JAX does not run on CPUs.

    ``*_parallel_operations``: operations split over threads; 0 with ``xla_options.single_threaded``.
    ``reset_kernel_lines``: median instructions of the kernels that select between a robot's next state and a new
    episode's first one. About 20; about 90 if XLA recomputes whether the robot fell for each number of its state.
    """
    if jax.default_backend() != "cpu":
        return {}
    programs = _programs(env)
    rollout, evaluation = _rollout_text(programs), _evaluation_text(programs)
    robots = programs.ppo.num_envs
    kernels = re.findall(r"\n%?\S+ \(.*\{\n((?:  .*\n)+?)\}", rollout)
    selects = re.compile(rf"ROOT .* f32\[[\d,]*{robots}\].* select\(.*\n$")
    lines = [kernel.count("\n") for kernel in kernels if selects.search(kernel)]
    return {
        "rollout_parallel_operations": float(rollout.count(PARALLEL)),
        "evaluation_parallel_operations": float(evaluation.count(PARALLEL)),
        **({"reset_kernel_lines": float(statistics.median(lines))} if lines else {}),
    }


def _programs(env: str) -> SearchPrograms:
    """The search's programs for one device, with rollouts and evaluations of two steps."""
    robot = register.make(env)
    robots = ROBOTS_PER_COPY * (1 + len(robot.measure_names))
    changes = {"num_envs": robots, "rollout_length": 2, "candidates": robots // 2, "episodes": 2}
    changes |= {"eval_batch_size": robots, "eval_chunk_steps": 2}
    config = make_config(env, "true", "smoke", **changes)
    return SearchPrograms(robot, config.ppo, config.evaluation, config.simulation.episode_length, num_devices=1)


def _rollout_text(programs: SearchPrograms) -> str:
    _, (train_state, stats, envs) = programs.init.lower(jax.random.key(0))
    _, copies = programs.replicate.lower(train_state)
    return programs.collect.lower(copies, stats, envs)[0].compile().as_text() or ""


def _evaluation_text(programs: SearchPrograms) -> str:
    env, candidates = programs.env, programs.ppo.num_envs // 2
    keys = jax.eval_shape(lambda: jax.random.split(jax.random.key(0), (candidates, 2)))
    _, (envs, tally) = programs.begin_episodes.lower(as_laid_out(keys, SHARDED, programs.mesh))
    widths = (flat_size(programs.template), env.obs_size, env.obs_size)
    policies = Policies(*(jnp.zeros((candidates, width)) for width in widths))
    return programs.advance_episodes.lower(policies, envs, tally)[0].compile().as_text() or ""
