"""What XLA is told changes rounding alone, and keeps a device on its core where every core has one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdil._startup import cores
from qdil.compiler import for_speed
from qdil.robots import brax_robots


@pytest.mark.parametrize("devices", [0, cores()])
def test_how_physics_is_compiled_changes_rounding_alone(devices):
    env = brax_robots.make("walker2d", "spring")
    robots = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 4))
    actions = jax.random.uniform(jax.random.key(1), (5, 4, env.action_size), minval=-1.0, maxval=1.0)

    def drive(robots, actions):
        def step(robots, action):
            after, outcome = jax.vmap(env.step)(robots, action)
            return after, (after.obs, outcome.reward, after.proxy)

        return jax.lax.scan(step, robots, actions)[1]

    as_usual = jax.jit(drive)(robots, actions)
    tuned = jax.jit(drive, compiler_options=for_speed(devices))(robots, actions)
    assert jnp.isfinite(as_usual[0]).all()
    for one, other in zip(as_usual, tuned, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-3)


@pytest.mark.skipif(cores() < 2, reason="one core has no threads to spread over")
def test_a_big_operation_is_spread_over_cores_only_while_some_have_no_device():
    def spread(devices: int) -> bool:
        program = jax.jit(jnp.tanh, compiler_options=for_speed(devices))
        return "outer_dimension_partitions" in program.lower(jnp.ones((512, 512))).compile().as_text()

    assert spread(cores() - 1)
    assert not spread(cores())
