"""What XLA is told changes rounding alone; it keeps physics on one core, and learning where every core has a device."""

import re
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdil.devices.start import cores
from qdil.engine.programs import search_programs
from qdil.devices.xla_options import for_learning, on_one_core
from qdil.config import make_config
from qdil.robots import brax_robots
from qdil.rl import vppo
from qdil.rl.evaluate import Policies
from qdil.rl.networks import flat_size


def test_how_physics_is_compiled_changes_rounding_alone():
    env = brax_robots.make("walker2d", "spring")
    robots = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 4))
    actions = jax.random.uniform(jax.random.key(1), (5, 4, env.action_size), minval=-1.0, maxval=1.0)

    def drive(robots, actions):
        def step(robots, action):
            after, outcome = jax.vmap(env.step)(robots, action)
            return after, (after.obs, outcome.reward, after.proxy)

        return jax.lax.scan(step, robots, actions)[1]

    as_usual = jax.jit(drive)(robots, actions)
    tuned = jax.jit(drive, compiler_options=on_one_core())(robots, actions)
    assert jnp.isfinite(as_usual[0]).all()
    for one, other in zip(as_usual, tuned, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-3)


def is_spread(program: str) -> bool:
    """Whether an operation of this compiled program is divided among threads."""
    return '"outer_dimension_partitions":["' in program


@pytest.mark.skipif(cores() < 2, reason="one core has no threads to spread over")
def test_learning_is_spread_over_cores_only_while_some_have_no_device():
    def compiled(devices: int) -> str:
        program = jax.jit(jnp.tanh, compiler_options=for_learning(devices))
        return program.lower(jnp.ones((512, 512))).compile().as_text()

    assert is_spread(compiled(cores() - 1))
    assert not is_spread(compiled(cores()))


ROBOTS = 1536  # so many that XLA would spread their windows and evaluations, if it were not told


@pytest.fixture(scope="module")
def programs():
    """The search's programs of one device, for windows and evaluations of two steps."""
    episodes = {"candidates": ROBOTS // 2, "episodes": 2, "eval_batch_size": ROBOTS, "eval_chunk_steps": 2}
    return search_programs(
        make_config("walker2d", "true", "smoke", devices=1, num_envs=ROBOTS, rollout_length=2, **episodes), 1
    )


@pytest.fixture(scope="module")
def window(programs):
    """A window's function, as it was before it was compiled; what it is called with; its compiled program."""
    train_state, stats, envs = jax.eval_shape(programs.init, jax.random.key(0))
    like = jax.eval_shape(programs.fork, train_state), stats, envs
    parts = programs.parts
    return partial(vppo.collect, parts.env, parts.settings), like, programs.collect.lower(*like).compile().as_text()


@pytest.fixture(scope="module")
def evaluation(programs):
    """The same of a chunk of an evaluation."""
    parts = programs.parts
    size, obs = flat_size(parts.like), parts.env.obs_size
    policies = Policies(*(jnp.zeros((ROBOTS // 2, width)) for width in (size, obs, obs)))
    keys = jax.random.split(jax.random.key(0), (ROBOTS // 2, 2))
    like = policies, *jax.eval_shape(programs.episodes.begin, keys)
    return parts.episodes.advance, like, programs.episodes.advance.lower(*like).compile().as_text()


@pytest.mark.skipif(cores() < 2, reason="one core has no threads to spread over")
@pytest.mark.parametrize("physics", ["window", "evaluation"])
def test_physics_stays_on_one_core_though_another_is_idle(physics, request):
    function, like, program = request.getfixturevalue(physics)
    assert is_spread(jax.jit(function).lower(*like).compile().as_text())
    assert not is_spread(program)


def test_whether_a_robot_fell_is_not_worked_out_for_each_of_its_numbers(window):
    """Kernels that choose between going on and starting anew do little else; with all that leads there, they do 90."""
    kernels = re.findall(r"\n%?\S+ \(.*\{\n((?:  .*\n)+?)\}", window[-1])
    of_robots = re.compile(rf"ROOT .* f32\[[\d,]*{ROBOTS}\].* select\(.*\n$")
    choices = [kernel.count("\n") for kernel in kernels if of_robots.search(kernel)]
    assert len(choices) > 15
    assert np.median(choices) < 30
