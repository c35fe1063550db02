"""How reward models learn: which rows of expert and policy each step sees."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from probes import CONTEXT, area_under_curve, built, demos_of, steps_of

from qdil.config import make_config
from qdil.imitation.reward_model import Inputs
from qdil.imitation.training import first_batch, in_minibatches

N, BATCH, STEPS = 130, 5, 40


def numbered(shape, first=0):
    """Inputs whose every number is the row's own."""
    rows = jnp.arange(first, first + np.prod(shape), dtype=jnp.float32).reshape(*shape, 1)
    return Inputs(rows, rows, rows, rows)


def seen(how, batch=BATCH):
    """The rows of expert and policy (STEPS, size) that the steps of one update see."""
    config = make_config("walker2d", "gail", "smoke", expert_batches=how, reward_steps=STEPS, reward_batch=batch)

    def step(key, state, expert, policy):
        for rows in (expert, policy):  # a row stays whole
            assert all(part.shape == rows.obs.shape for part in rows)
        count, of_expert, of_policy = state
        return (count + 1, of_expert.at[count].set(expert.obs[:, 0]), of_policy.at[count].set(policy.obs[:, 0])), {
            "count": count
        }

    size = len(first_batch(numbered((N,)), batch).obs) if how == "first" else batch
    begun = (0, jnp.zeros((STEPS, size)), jnp.zeros((STEPS, size)))
    update = in_minibatches(step, config)
    (count, of_expert, of_policy), info = update(jax.random.key(0), begun, numbered((N,)), numbered((20, 30), 1000))
    assert count == STEPS and info == {"count": STEPS - 1}
    return np.asarray(of_expert), np.asarray(of_policy)


@pytest.mark.parametrize("how", ["random", "first"])
def test_policy_rows_are_drawn_from_all_robots_and_times(how):
    _, policy = seen(how)
    assert policy.shape == (STEPS, BATCH)
    assert policy.min() >= 1000 and policy.max() < 1600 and len(np.unique(policy)) > 150
    assert len(np.unique((policy - 1000) // 30)) == 20  # times
    assert len(np.unique((policy - 1000) % 30)) == 30  # robots


def test_random_expert_rows_are_drawn_from_all_demonstrations():
    expert, _ = seen("random")
    assert expert.shape == (STEPS, BATCH) and len(np.unique(expert)) > 0.6 * N
    assert len({tuple(rows) for rows in expert}) == STEPS


@pytest.mark.parametrize(("batch", "rows"), [(5, [0, 20, 40, 60, 80]), (100, [0, 20, 40, 60, 80, 100, 120])])
def test_the_first_batch_is_every_twentieth_row_at_every_step(batch, rows):
    expert, policy = seen("first", batch)
    np.testing.assert_array_equal(expert, np.tile(rows, (STEPS, 1)))
    assert policy.shape == expert.shape


@pytest.mark.compiles
@pytest.mark.parametrize("method", ["gail", "vail", "diffail"])
def test_a_model_that_learns_from_the_first_batch_ignores_all_other_rows(method):
    rng = np.random.default_rng(0)
    expert, policy = steps_of(rng, shift=2.0), steps_of(rng)
    demos = demos_of(expert)
    others = jax.tree.map(lambda x: x.at[1::20].set(-x[1::20]), demos)
    model = built(method, expert_batches="first", reward_steps=2)
    state = model.init(jax.random.key(1), demos)

    def learned(demos):
        return jax.tree.leaves(jax.jit(model.update)(jax.random.key(0), state, CONTEXT, demos, policy)[0])

    assert all(np.array_equal(a, b) for a, b in zip(learned(demos), learned(others), strict=True))
    moved = jax.tree.map(lambda x: x.at[20].add(1.0), demos)
    assert not all(np.array_equal(a, b) for a, b in zip(learned(demos), learned(moved), strict=True))


@pytest.mark.compiles
def test_the_first_batch_is_enough_to_tell_what_is_easy():
    rng = np.random.default_rng(0)
    model = built("gail", expert_batches="first", reward_steps=200, reward_learning_rate=3e-3, gradient_penalty=1.0)
    expert, policy, like_expert, like_policy = (steps_of(rng, shift=s) for s in (2.0, 0.0, 2.0, 0.0))
    begun = model.init(jax.random.key(1), demos_of(expert))
    state, _ = jax.jit(model.update)(jax.random.key(0), begun, CONTEXT, demos_of(expert), policy)
    high, low = (model.reward(state, (), CONTEXT, steps)[1] for steps in (like_expert, like_policy))
    assert area_under_curve(high, low) > 0.9
