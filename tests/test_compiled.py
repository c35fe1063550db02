"""How programs that move robots are compiled."""

import jax
import jax.numpy as jnp
import numpy as np

from qdil.compiled import physics_options
from qdil.robots import brax_robots


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
    tuned = jax.jit(drive, compiler_options=physics_options())(robots, actions)
    assert jnp.isfinite(as_usual[0]).all()
    for one, other in zip(as_usual, tuned, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-3)
