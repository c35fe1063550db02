"""What importing qdil sets for the process, and how programs that move robots are compiled."""

import json
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdil.compiled import physics_options
from qdil.robots import brax_robots

ASK = """
import json, os, time
import qdil, jax, jax.numpy as jnp
product = jax.jit(lambda x: x @ x)
x = jnp.ones((1024, 1024))
product(x).block_until_ready()
cpu, wall = time.process_time(), time.monotonic()
for _ in range(20):
    product(x).block_until_ready()
busy = (time.process_time() - cpu) / (time.monotonic() - wall)
print(json.dumps({"devices": jax.local_device_count(), "busy": busy, "flags": os.environ["XLA_FLAGS"]}))
"""


def _ask(flags: str) -> dict:
    environment = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    done = subprocess.run([sys.executable, "-c", ASK], env=environment, check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="the number of usable cores is not told here")
def test_every_core_is_a_device_and_does_its_matrix_products_alone():
    said = _ask("")
    assert said["devices"] == len(os.sched_getaffinity(0))
    assert said["busy"] < 1.3  # cores at work while one device multiplies; never less than it is, however loaded


def test_what_the_user_has_set_stays():
    mine = "--xla_cpu_multi_thread_eigen=true --xla_force_host_platform_device_count=3"
    said = _ask(mine)
    assert said["devices"] == 3 and said["flags"] == mine


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
