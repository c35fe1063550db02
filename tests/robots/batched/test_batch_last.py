"""Functions of many robots, with the batch axis last in memory, against ``jax.vmap`` of the same function."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from qdil.robots.batched import batch_last as module
from qdil.robots.batched.batch_last import batch_last

pytestmark = pytest.mark.compiles

ROBOTS = 5
SHARED = jnp.asarray(np.random.default_rng(1).normal(size=(4, 3)), jnp.float32)
LINKS = jnp.array([1, 0, 1, -1])


def drawn(*shape, seed=0):
    return jnp.asarray(np.random.default_rng(seed).normal(size=(ROBOTS, *shape)), jnp.float32)


def agree(function, *args):
    """``function`` of one robot, both ways, on robots' ``args`` (E, …)."""
    many = batch_last(function, *(jax.ShapeDtypeStruct(arg.shape[1:], arg.dtype) for arg in args))
    expected, found = jax.vmap(function)(*args), jax.jit(many)(*args)
    assert jax.tree.structure(expected) == jax.tree.structure(found)
    for one, other in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        assert one.shape == other.shape and one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    "function",
    [
        lambda x: jnp.sin(x) * 2.0 - SHARED,
        lambda x: jnp.where(x > 0, x, SHARED) / (1.0 + jnp.abs(x)),
        lambda x: jnp.where(x.sum() > 0, x, -x),  # one number chooses among arrays
        lambda x: jnp.maximum(SHARED, jnp.minimum(x, 0.5)),
        lambda x: jnp.clip(x, -0.5, 0.5).astype(jnp.int32),
        lambda x: jnp.broadcast_to(x[:, None], (4, 2, 3)),
        lambda x: x.reshape(2, 6).T,
        lambda x: x[1:4:2, ::-1],
        lambda x: (x[0], x[..., 1], x.max(axis=0), x.min(axis=1), jnp.all(x > 0, axis=1), jnp.any(x > 1)),
        lambda x: (x.sum(), x.sum(axis=0), x.mean(axis=1), jnp.tile(x, (7, 1)).sum(axis=0)),
        lambda x: jnp.concatenate([x, SHARED, x * 2], axis=1),
        lambda x: jnp.stack([x[0], SHARED[1], x[2]], axis=1),
        lambda x: jnp.tile(x, (2, 1)),
        lambda x: x[jnp.array([3, 0, 3])],
        lambda x: jnp.take(SHARED, jnp.argmax(x[:, 0]), axis=0),  # each robot takes another row of what they share
        lambda x: x[jnp.argmax(x[:, 0])],
        lambda x: jax.ops.segment_sum(x, LINKS, 3),  # what belongs to no link is left out
        lambda x: jnp.zeros((6, 3)).at[LINKS].add(x),
        lambda x: jnp.ones((6, 3)).at[jnp.array([2, 5])].set(x[:2]),
        lambda x: jnp.zeros((4, 3)).at[jnp.argmax(x[:, 0])].add(x[1]),
        lambda x: (jnp.cumsum(x, axis=0), jnp.sort(x, axis=0), jnp.linalg.norm(x)),  # without rules of their own
        lambda x: jax.nn.relu(x) + jax.nn.softplus(x),
        lambda x: jax.vmap(jnp.cross)(x, SHARED),
        lambda x: jax.lax.cond(x[0, 0] > 0, lambda y: y + SHARED, lambda y: -y, x),
        lambda x: jax.lax.while_loop(lambda y: y[0, 0] < 3, lambda y: y + 1.0, x),
        lambda x: jax.lax.top_k(x[:, 0], 2),  # two results
        lambda x: (SHARED * 2, x),  # a result that all share
    ],
)
def test_an_operation_is_what_vmap_makes_of_it(function):
    agree(function, drawn(4, 3))


@given(
    st.sampled_from(["ij,jk->ik", "ij,ij->i", "ij,kj->ki", "bij,bj->bi", "bij,bjk->bik", "bji,bjk->bki", "i,i->"]),
    st.data(),
)
def test_products_are_numpys(how, data):
    sizes = {letter: data.draw(st.integers(1, 4), letter) for letter in "ijkb"}
    long = data.draw(st.booleans())
    sizes["j"] = module.FEW + 1 if long else sizes["j"]
    left, right = (tuple(sizes[letter] for letter in side) for side in how.split("->")[0].split(","))
    known, shared = np.asarray(drawn(*left)[0]), np.asarray(drawn(*right, seed=1)[0])
    agree(lambda x, y: jnp.einsum(how, x, y), drawn(*left), drawn(*right, seed=2))
    agree(lambda x: jnp.einsum(how, x, shared), drawn(*left))
    agree(lambda x: jnp.einsum(how, known, x), drawn(*right, seed=3))
    found = batch_last(lambda x: jnp.einsum(how, x, shared), drawn(*left)[0])(drawn(*left))
    for one, x in zip(found, drawn(*left), strict=True):
        np.testing.assert_allclose(one, np.einsum(how, x, shared), rtol=1e-5, atol=1e-5)


@given(st.lists(st.integers(-4, 3), min_size=1, max_size=6), st.integers(0, 1))
def test_rows_are_taken_as_numpy_takes_them(at, axis):
    """From either end, some of them twice or not at all, along either axis."""
    rows = drawn(*((4, 3) if axis == 0 else (3, 4)))
    agree(lambda x: jnp.take(x, jnp.array(at), axis=axis), rows)
    agree(lambda x: x[jnp.array(at)] if axis == 0 else x[:, jnp.array(at)], rows)
    found = batch_last(lambda x: jnp.take(x, jnp.array(at), axis=axis), rows[0])(rows)
    np.testing.assert_array_equal(found, np.take(rows, at, axis=1 + axis))


def test_rows_in_another_order_are_not_looked_up():
    def operations(at):
        many = batch_last(lambda x: jnp.take(x, jnp.array(at), axis=0, mode="wrap"), jnp.zeros((4, 3)))
        return {eqn.primitive.name for eqn in jax.make_jaxpr(many)(jnp.zeros((7, 4, 3))).jaxpr.eqns}

    assert "gather" not in operations([3, 0, 1])
    assert "gather" not in operations([-1, 4, 1])
    assert "gather" in operations([1, 1, 0])


def test_a_loop_carries_each_robots_own():
    def function(x, rows):
        def step(carry, row):
            at, total = carry
            return (at + 1, total * 0.5 + row + SHARED[0]), (total, at)

        begun = (0, jnp.zeros(3))  # shared when the loop begins, and no more after it
        return jax.lax.scan(step, begun, rows), jax.lax.scan(lambda c, s: (c + s @ x, None), x[0], SHARED[:, :3])[0]

    agree(function, drawn(3, 3), drawn(6, 3, seed=2))


def test_the_batch_axis_stays_last_and_short_products_are_written_out():
    many = batch_last(lambda x: jnp.tanh(SHARED @ x)[1:] + SHARED[1:, 0], jnp.zeros(3))
    trace = jax.make_jaxpr(lambda x: many(x))(jnp.zeros((7, 3)))
    moved_in, *work, moved_out = trace.jaxpr.eqns
    shapes = [name.aval.shape for eqn in work for name in eqn.outvars if 7 in name.aval.shape]
    assert moved_in.primitive.name == moved_out.primitive.name == "transpose"
    assert len(shapes) > 5 and all(shape[-1] == 7 for shape in shapes)
    assert all(eqn.primitive.name != "dot_general" for eqn in work)
