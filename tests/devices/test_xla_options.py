"""XLA's options change rounding alone; learning uses several threads only while some cores host no device.

Whether XLA follows the options can be read from its text only: ``qdil bench`` reports that as figures.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdil.devices import xla_options
from qdil.robots import register


@pytest.mark.physics
def test_how_physics_is_compiled_changes_rounding_alone():
    env = register.make("walker2d")
    robots = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 4))
    actions = jax.random.uniform(jax.random.key(1), (5, 4, env.action_size), minval=-1.0, maxval=1.0)

    def drive(robots, actions):
        def step(robots, action):
            after, outcome = jax.vmap(env.step)(robots, action)
            return after, (after.obs, outcome.reward, after.proxy)

        return jax.lax.scan(step, robots, actions)[1]

    default = jax.jit(drive)(robots, actions)
    tuned = jax.jit(drive, compiler_options=xla_options.single_threaded(1))(robots, actions)
    assert jnp.isfinite(default[0]).all()
    for one, other in zip(default, tuned, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-3)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="the options are for CPUs")
def test_learning_has_one_thread_per_device_only_if_every_core_hosts_a_device(monkeypatch):
    monkeypatch.setattr(xla_options, "cores", lambda: 4)
    assert xla_options.ppo_options(3) is None
    assert xla_options.ppo_options(4) == xla_options.single_threaded(4)
    monkeypatch.setattr(jax, "process_count", lambda: 2)  # two hosts of four cores each
    assert xla_options.ppo_options(4) is None
    assert xla_options.ppo_options(8) == xla_options.single_threaded(8)


def test_other_devices_take_no_options_for_cpus(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert xla_options.single_threaded(1) is None and xla_options.unoptimised(1) is None
