"""NaN and infinity are found, with and without fast math, and never enter an archive, the normaliser or the policy."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from probes import counter

from qdil import ppga
from qdil.config import make_config
from qdil.finite import all_finite, is_smaller
from qdil.qd import archive
from qdil.rl import networks
from qdil.robots import register
from qdil.robots.environment import Environment, RobotState

pytestmark = pytest.mark.compiles

FLOATS = st.floats(width=32)


@given(FLOATS, st.floats(min_value=0, max_value=2.0**100, width=32))
def test_is_smaller_agrees_with_numpy(x, bound):
    assert bool(is_smaller(jnp.float32(x), bound)) == bool(np.abs(np.float32(x)) < np.float32(bound))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_bad_number_anywhere_is_found(bad):
    tree = {"a": jnp.ones((3, 2)), "b": [jnp.zeros(4), jnp.arange(3)], "key": jax.random.key(0)}
    assert bool(all_finite(tree))
    assert not bool(all_finite({**tree, "b": [jnp.zeros(4).at[2].set(bad)]}))


@pytest.mark.physics
def test_fast_math_hides_nothing():
    code = """
import jax, jax.numpy as jnp, numpy as np
from qdil.finite import all_finite, is_smaller
from qdil.robots import register
x = jnp.asarray([0.0, 1e30, np.nan, np.inf, -np.inf])
made = jax.jit(lambda x: jnp.stack([x[0] / x[0], x[1] * x[1], x[0], x[2] + 1, x[3] - x[3]]))
assert jax.jit(lambda x: is_smaller(made(x), 1e6))(x).tolist() == [False, False, True, False, False]
assert [bool(jax.jit(all_finite)(x[i : i + 1])) for i in range(5)] == [True, True, False, False, False]
robot = register.make("walker2d")
state = jax.jit(robot.reset)(jax.random.key(0))
bad = jax.tree.map(lambda leaf: leaf * jnp.nan if leaf.dtype == jnp.float32 else leaf, state.physics)
_, outcome = jax.jit(robot.step)(state._replace(physics=bad), jnp.zeros(robot.action_size))
assert not bool(outcome.finite) and bool(outcome.terminated) and float(outcome.reward) == 0.0
"""
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_enable_fast_math=true"
    subprocess.run([sys.executable, "-c", code], env={**os.environ, "XLA_FLAGS": flags}, check=True)


FAR = 2.5  # position beyond which the probe's physics diverges


def diverging() -> Environment:
    """The counter, with a divergence as robots of Brax show one: physics NaN, the last finite observation, no reward.

    The reward grows with the distance, so selection favours policies that are about to diverge.
    """
    probe = counter(np.inf, diverges_above=FAR)

    def step(state, action):
        after, outcome = probe.step(state, action)
        physics = jnp.where(outcome.finite, after.physics, jnp.nan)
        obs = jnp.where(outcome.finite, after.obs, state.obs)
        return RobotState(physics, obs, after.proxy), outcome._replace(reward=jnp.where(outcome.finite, obs[0], 0.0))

    return probe._replace(step=step)


def test_a_candidate_that_diverges_enters_neither_archive_nor_normaliser(monkeypatch):
    monkeypatch.setattr(register, "_ROBOTS", dict(register._ROBOTS))
    register.register_robot("diverging", environment=diverging())
    search = ppga.begin(make_config("diverging", "true", "smoke", episode_length=13, sigma0=8.0), None)
    add, tried = archive.add, []
    monkeypatch.setattr(
        archive, "add", lambda archives, found, *more: tried.append(found) or add(archives, found, *more)
    )
    infos = []
    for _ in range(4):
        search, info = ppga.iteration(search)
        infos.append(info)
    lost = [~candidates.finite for candidates in tried]
    assert sum(each.sum() for each in lost) > 0 and not all(each.all() for each in lost)
    assert [info.not_finite for info in infos] == [each.sum() for each in lost]
    elites = archive.elite_arrays(search.archives)
    assert len(elites["index"]) > 0 and all(np.isfinite(values).all() for values in elites.values())
    diverged = np.concatenate([found.theta[each] for found, each in zip(tried, lost, strict=True)])
    assert not (elites["solution"][:, None] == diverged[None]).all(axis=-1).any()
    stats = search.state.stats
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(stats)) and float(stats.mean[0]) < FAR
    rollouts = search.config.ppga.gradient_updates + search.config.ppga.walk_updates
    assert float(stats.seen) == 4 * rollouts * search.config.ppo.rollout_length * search.config.ppo.num_envs
    assert all(info.rolled_back == 0 for info in infos)


def test_a_training_phase_with_a_number_that_is_not_finite_is_discarded(monkeypatch):
    monkeypatch.setattr(register, "_ROBOTS", dict(register._ROBOTS))
    register.register_robot("counter", environment=counter(np.inf))
    search = ppga.begin(make_config("counter", "true", "smoke"), None)
    engine, occupied = search.engine, jnp.zeros((5, 5), bool)
    trained = engine.train_policy(search.state, occupied, np.array([1.0, np.nan, 0.0]), 1)
    assert float(trained.rolled_back) == 1.0
    theta = networks.flatten(search.state.train_state.policy)
    np.testing.assert_array_equal(trained.theta, jnp.tile(theta, (3, 1)))
    for before, after in zip(
        jax.tree.leaves((search.state.train_state, search.state.stats)),
        jax.tree.leaves((trained.state.train_state, trained.state.stats)),
        strict=True,
    ):
        np.testing.assert_array_equal(before, after)
    keys = [jax.random.key_data(state.envs.key) for state in (search.state, trained.state)]
    assert (np.asarray(keys[0]) != np.asarray(keys[1])).any(axis=1).all()  # or the next phase would repeat this one
    healthy = engine.train_copies(trained.state, occupied, 1)
    assert float(healthy.rolled_back) == 0.0 and bool(all_finite(healthy.theta))
