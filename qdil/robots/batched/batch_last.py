"""A function of one robot made into one of many whose robots lie last in memory, as ``jax.vmap`` never lays them.

A simulator's arrays end in three coordinates, or four. With robots before them, a processor's vector units, eight or
sixteen numbers wide, get three at a time, from places far apart; with robots behind them, as many robots as they hold.

What is given is the function's trace, operation by operation. The rules below know how an operation on one robot's
arrays (…) becomes one on all robots' (…, E); an operation without a rule goes through ``jax.vmap``, which is right too,
and slower.
"""

import math
from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import Jaxpr, JaxprEqn, Literal

from qdil.robots.batched import fast_trig
from qdil.robots.batched.constant_indices import BY_NUMPY, is_known, reordered

FEW = 8  # a sum over so many is written out: XLA's reductions are made for more


class PerRobot(NamedTuple):
    """An array of which every robot has its own; all others are shared."""

    values: jax.Array  # (…, E)


Value = Any  # a ``PerRobot``, or an array that all robots share
Rule = Callable[[JaxprEqn, Sequence[Value], int], jax.Array]  # -> (…, E)
RULES: dict[str, Rule] = {}


def batch_last(function: Callable[..., Any], *like: Any) -> Callable[..., Any]:
    """``function`` of one robot's arrays, shaped ``like`` these, as a function of E robots'.

    Its arguments and results are trees of arrays with axis (E) in front, all of them, as with ``jax.vmap(function)``;
    numbers differ from it by rounding.
    """
    trace, shapes = jax.make_jaxpr(function, return_shape=True)(*like)
    consts = [np.asarray(const) for const in trace.consts]

    def of_many(*args: Any) -> Any:
        leaves = jax.tree.leaves(args)
        count = len(leaves[0])
        results = _run(trace.jaxpr, consts, [PerRobot(jnp.moveaxis(leaf, 0, -1)) for leaf in leaves], count)
        each = [jnp.moveaxis(_of_each(result, count), -1, 0) for result in results]
        return jax.tree.unflatten(jax.tree.structure(shapes), each)

    return of_many


def _run(jaxpr: Jaxpr, consts: Sequence[Any], args: Sequence[Value], count: int) -> list[Value]:
    """Every operation of a trace in its order."""
    known: dict[Any, Value] = dict(zip((*jaxpr.constvars, *jaxpr.invars), (*consts, *args), strict=True))

    def read(name: Any) -> Value:
        return np.asarray(name.val, _dtype(name)) if isinstance(name, Literal) else known[name]

    for eqn in jaxpr.eqns:
        results = _do(eqn, [read(name) for name in eqn.invars], count)
        known.update(zip(eqn.outvars, results, strict=True))
    return [read(name) for name in jaxpr.outvars]


def _do(eqn: JaxprEqn, given: Sequence[Value], count: int) -> list[Value]:
    """One operation: within, if it is a function of its own; once for all, if robots share what it needs; by a rule."""
    name = eqn.primitive.name
    if name in ("jit", "closed_call", "custom_jvp_call", "custom_vjp_call"):
        inner = eqn.params.get("jaxpr") or eqn.params["call_jaxpr"]
        return _run(inner.jaxpr, inner.consts, given, count)
    if name in BY_NUMPY and all(is_known(value) for value in given):
        return [BY_NUMPY[name](eqn, *given)]
    if not any(isinstance(value, PerRobot) for value in given):
        result = _bind(eqn, *given)
        return list(result) if eqn.primitive.multiple_results else [result]
    if name == "scan":
        return _scan(eqn, given, count)
    if name in RULES and not eqn.primitive.multiple_results:
        return [PerRobot(RULES[name](eqn, given, count))]
    return _by_vmap(eqn, given)


def _bind(eqn: JaxprEqn, *given: Any) -> Any:
    return eqn.primitive.bind(*given, **eqn.primitive.get_bind_params(eqn.params))


def _by_vmap(eqn: JaxprEqn, given: Sequence[Value]) -> list[Value]:
    axes = [-1 if isinstance(value, PerRobot) else None for value in given]
    bare = [value.values if isinstance(value, PerRobot) else value for value in given]
    result = jax.vmap(lambda *values: _bind(eqn, *values), in_axes=axes, out_axes=-1)(*bare)
    return [PerRobot(one) for one in (result if eqn.primitive.multiple_results else [result])]


def _scan(eqn: JaxprEqn, given: Sequence[Value], count: int) -> list[Value]:
    """A loop whose body is done for all robots; what it carries on becomes each robot's own."""
    inner, consts, carries = eqn.params["jaxpr"], eqn.params["num_consts"], eqn.params["num_carry"]
    shared, begun, each_turn = given[:consts], given[consts : consts + carries], given[consts + carries :]
    own = [isinstance(value, PerRobot) for value in each_turn]

    def body(carry: list[jax.Array], turn: list[jax.Array]) -> tuple[list[jax.Array], list[jax.Array]]:
        these = [PerRobot(value) if is_own else value for value, is_own in zip(turn, own, strict=True)]
        results = _run(inner.jaxpr, inner.consts, [*shared, *map(PerRobot, carry), *these], count)
        each = [_of_each(result, count) for result in results]
        return each[:carries], each[carries:]

    carry, turns = lax.scan(
        body,
        [_of_each(value, count) for value in begun],
        [value.values if is_own else value for value, is_own in zip(each_turn, own, strict=True)],
        eqn.params["length"],
        reverse=eqn.params["reverse"],
        unroll=eqn.params["unroll"],
    )
    return [PerRobot(value) for value in (*carry, *turns)]


def _of_each(value: Value, count: int) -> jax.Array:
    """The array (…, E) of a value, copied for every robot where they share it."""
    if isinstance(value, PerRobot):
        return value.values
    return jnp.broadcast_to(jnp.asarray(value)[..., None], (*jnp.shape(value), count))


def _rule(*names: str) -> Callable[[Rule], Rule]:
    def register(rule: Rule) -> Rule:
        RULES.update(dict.fromkeys(names, rule))
        return rule

    return register


@_rule(
    "abs", "add", "and", "clamp", "convert_element_type", "copy", "cos", "div", "eq", "exp", "ge", "gt", "integer_pow",
    "is_finite", "le", "log", "lt", "max", "min", "mul", "ne", "neg", "not", "or", "pow", "rsqrt", "select_n", "sign",
    "sin", "sqrt", "square", "sub", "tan", "tanh", "xor",
)  # fmt: skip
def _number_by_number(eqn: JaxprEqn, given: Sequence[Value], count: int) -> jax.Array:
    shape = (*_shape(eqn.outvars[0]), count)  # of all but single numbers, which stand for as many as there are
    return _bind(eqn, *(jnp.broadcast_to(_of_each(value, count), shape) for value in given))


@_rule("atan2", "acos", "asin")
def _angle(eqn: JaxprEqn, given: Sequence[Value], count: int) -> jax.Array:
    shape = (*_shape(eqn.outvars[0]), count)
    return getattr(fast_trig, eqn.primitive.name)(*(jnp.broadcast_to(_of_each(value, count), shape) for value in given))


@_rule("broadcast_in_dim")
def _broadcast(eqn: JaxprEqn, given: Sequence[Value], count: int) -> jax.Array:
    shape, axes = eqn.params["shape"], eqn.params["broadcast_dimensions"]
    return lax.broadcast_in_dim(given[0].values, (*shape, count), (*axes, len(shape)))


@_rule("reshape")
def _reshape(eqn: JaxprEqn, given: Sequence[Value], count: int) -> jax.Array:
    return jnp.reshape(given[0].values, (*eqn.params["new_sizes"], count))


@_rule("transpose")
def _transpose(eqn: JaxprEqn, given: Sequence[Value], count: int) -> jax.Array:
    order = eqn.params["permutation"]
    return jnp.transpose(given[0].values, (*order, len(order)))


@_rule("slice")
def _slice(eqn: JaxprEqn, given: Sequence[Value], count: int) -> jax.Array:
    first, limit, strides = (eqn.params[name] for name in ("start_indices", "limit_indices", "strides"))
    return lax.slice(given[0].values, (*first, 0), (*limit, count), strides and (*strides, 1))


@_rule("squeeze", "reduce_and", "reduce_or", "reduce_max", "reduce_min")
def _along_its_axes(eqn: JaxprEqn, given: Sequence[Value], count: int) -> jax.Array:
    return _bind(eqn, given[0].values)  # axes are counted from the front


@_rule("reduce_sum")
def _sum(eqn: JaxprEqn, given: Sequence[Value], count: int) -> jax.Array:
    values, axes = given[0].values, eqn.params["axes"]
    if len(axes) != 1 or values.shape[axes[0]] > FEW:
        return jnp.sum(values, axis=axes)
    return _added(jnp.moveaxis(values, axes[0], 0))


@_rule("concatenate", "stack")
def _joined(eqn: JaxprEqn, given: Sequence[Value], count: int) -> jax.Array:
    return _bind(eqn, *(_of_each(value, count) for value in given))


@_rule("tile")
def _tile(eqn: JaxprEqn, given: Sequence[Value], count: int) -> jax.Array:
    return jnp.tile(given[0].values, (*eqn.params["reps"], 1))


@_rule("dot_general")
def _products(eqn: JaxprEqn, given: Sequence[Value], count: int) -> jax.Array:
    """Written out: a simulator's products are of vectors of three, where calling a kernel costs more than the sum."""
    summed, together = eqn.params["dimension_numbers"]
    if math.prod(_shape(eqn.invars[0])[axis] for axis in summed[0]) > FEW:
        return _by_vmap(eqn, given)[0].values
    sides, free = [], []
    for name, value, gone, kept in zip(eqn.invars, given, summed, together, strict=True):
        rest = [axis for axis in range(len(_shape(name))) if axis not in (*gone, *kept)]
        own = isinstance(value, PerRobot)
        values = value.values if own else jnp.asarray(value)[..., None]  # (…, E) or (…, 1)
        values = jnp.transpose(values, (*gone, *kept, *rest, values.ndim - 1))
        sides.append(values.reshape(-1, *values.shape[len(gone) :]))  # (summed, together…, rest…, E)
        free.append(len(rest))
    left, right = sides
    both = len(together[0])
    left = jnp.expand_dims(left, tuple(range(1 + both + free[0], 1 + both + sum(free))))
    right = jnp.expand_dims(right, tuple(range(1 + both, 1 + both + free[0])))
    return _added(a * b for a, b in zip(left, right, strict=True))


@_rule("gather")
def _gather(eqn: JaxprEqn, given: Sequence[Value], count: int) -> jax.Array:
    rows, where = given
    if isinstance(where, PerRobot):
        return _by_vmap(eqn, given)[0].values
    known = reordered(eqn, where)
    if known is not None:
        axis, ranges = known
        parts = [lax.slice_in_dim(rows.values, *one, axis=axis) for one in ranges]
        return jnp.concatenate(parts, axis).reshape(*_shape(eqn.outvars[0]), count)
    numbers = eqn.params["dimension_numbers"]
    names = ("indices_are_sorted", "unique_indices", "mode", "fill_value")
    return lax.gather(
        rows.values,
        where,
        numbers._replace(offset_dims=(*numbers.offset_dims, len(_shape(eqn.outvars[0])))),
        (*eqn.params["slice_sizes"], count),
        **{name: eqn.params[name] for name in names},
    )


@_rule("scatter", "scatter-add")
def _scatter(eqn: JaxprEqn, given: Sequence[Value], count: int) -> jax.Array:
    into, where, rows = given
    if isinstance(where, PerRobot):
        return _by_vmap(eqn, given)[0].values
    numbers, new = eqn.params["dimension_numbers"], _of_each(rows, count)
    names = ("indices_are_sorted", "unique_indices", "mode")
    put = lax.scatter_add if eqn.primitive.name == "scatter-add" else lax.scatter
    return put(
        _of_each(into, count),
        where,
        new,
        numbers._replace(update_window_dims=(*numbers.update_window_dims, new.ndim - 1)),
        **{name: eqn.params[name] for name in names},
    )


def _shape(name: Any) -> tuple[int, ...]:
    """The shape (…) of one robot's array in a trace."""
    return name.aval.shape


def _dtype(name: Any) -> np.dtype:
    return name.aval.dtype


def _added(terms: Any) -> jax.Array:
    """Their sum, one after the other."""
    *_, total = accumulate(terms)
    return total
