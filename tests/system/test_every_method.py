"""Every method by its name on walker2d at smoke, from demonstrations of a robot that moves at random."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdil import ppga
from qdil.config import make_config
from qdil.imitation.reward_model import Demonstrations
from qdil.methods import bases, method_names, name_of, parse_method
from qdil.robots import brax_robots
from qdil.qd import archive
from qdil.rl.rollout import start, window


@pytest.fixture(scope="module")
def demos() -> Demonstrations:
    """An episode or more of random actions."""
    env = brax_robots.make("walker2d")

    def act(noise, obs):
        return jnp.clip(noise, -1.0, 1.0), jnp.zeros(len(noise))

    keys = jax.random.split(jax.random.key(0), 2)
    _, steps, _ = jax.jit(lambda k: window(env, act, start(env, k, 50), 60, 50))(keys)
    return Demonstrations(*(getattr(steps, n).reshape(-1, getattr(steps, n).shape[-1]) for n in Demonstrations._fields))


@pytest.mark.parametrize("name", method_names())
def test_every_method_trains(name, demos):
    method = parse_method(name)
    assert name_of(method) == name
    config = make_config("walker2d", name, "smoke", giril_steps=20)
    mine = demos._replace(action=demos.action[:, :0]) if method.obs_only else demos
    search = ppga.begin(config, mine if bases()[method.base].imitates else None)
    search, done, told = ppga.warm_up(search, 2)
    assert (done, told) == (1, {"steps": config.ppo.rollout_length * config.ppo.num_envs, "rolled_back": 0.0})
    search, info = ppga.iteration(search)
    elites = archive.elite_arrays(search.archives)
    assert len(elites["index"]) > 0 and np.isfinite(elites["fitness"]).all()
    assert info["rolled_back"] == info.get("reward_rolled_back", 0.0) == info["not_finite"] == 0.0
    if method.base == "true":
        np.testing.assert_array_equal(elites["fitness"], elites["true_return"])
    elif method.base == "zero":
        assert not elites["fitness"].any()
    else:
        assert not np.allclose(elites["fitness"], elites["true_return"])
