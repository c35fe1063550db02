"""NaN and infinity are seen, with fast math as without."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from qdil import ppga
from qdil.config import make_config
from qdil.finite import all_finite, is_smaller
from qdil.search import networks

FLOATS = st.floats(width=32)


@given(FLOATS, st.floats(min_value=0, max_value=2.0**100, width=32))
def test_is_smaller_is_what_numpy_says(x, bound):
    assert bool(is_smaller(jnp.float32(x), bound)) == bool(np.abs(np.float32(x)) < np.float32(bound))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_bad_number_anywhere_is_seen(bad):
    tree = {"a": jnp.ones((3, 2)), "b": [jnp.zeros(4), jnp.arange(3)], "key": jax.random.key(0)}
    assert bool(all_finite(tree))
    assert not bool(all_finite({**tree, "b": [jnp.zeros(4).at[2].set(bad)]}))


def test_fast_math_hides_nothing():
    code = """
import qdil, jax, jax.numpy as jnp, numpy as np
from qdil.finite import all_finite, is_smaller
from qdil.robots import brax_robots
x = jnp.asarray([0.0, 1e30, np.nan, np.inf, -np.inf])
made = jax.jit(lambda x: jnp.stack([x[0] / x[0], x[1] * x[1], x[0], x[2] + 1, x[3] - x[3]]))
assert jax.jit(lambda x: is_smaller(made(x), 1e6))(x).tolist() == [False, False, True, False, False]
assert [bool(jax.jit(all_finite)(x[i : i + 1])) for i in range(5)] == [True, True, False, False, False]
robot = brax_robots.make("walker2d")
state = jax.jit(robot.reset)(jax.random.key(0))
bad = jax.tree.map(lambda leaf: leaf * jnp.nan if leaf.dtype == jnp.float32 else leaf, state.physics)
_, outcome = jax.jit(robot.step)(state._replace(physics=bad), jnp.zeros(robot.action_size))
assert not bool(outcome.finite) and bool(outcome.terminated) and float(outcome.reward) == 0.0
"""
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_enable_fast_math=true"
    subprocess.run([sys.executable, "-c", code], env={**os.environ, "XLA_FLAGS": flags}, check=True)


@pytest.fixture(scope="module")
def search():
    return ppga.begin(make_config("walker2d", "true", "smoke"), None)


def test_a_training_phase_that_turns_bad_is_undone(search):
    compiled = search.compiled
    occupied = jnp.zeros((5, 5), bool)
    bad = jnp.eye(3).at[1, 1].set(jnp.nan)
    trained = compiled.train(search.state, occupied, bad, False, 1, 2)
    assert float(trained.info["rolled_back"]) == 1.0
    theta = networks.flatten(search.state.learner.policy)
    np.testing.assert_array_equal(trained.theta, jnp.tile(theta, (3, 1)))
    for before, after in zip(
        jax.tree.leaves((search.state.learner, search.state.stats)),
        jax.tree.leaves((trained.state.learner, trained.state.stats)),
        strict=True,
    ):
        np.testing.assert_array_equal(before, after)
    keys = [jax.random.key_data(state.actors.key) for state in (search.state, trained.state)]
    assert (np.asarray(keys[0]) != np.asarray(keys[1])).any(axis=1).all()  # or it would go wrong in the same way again
    well = compiled.train(trained.state, occupied, jnp.eye(3), False, 1, 2)
    assert float(well.info["rolled_back"]) == 0.0 and bool(all_finite(well.theta))
