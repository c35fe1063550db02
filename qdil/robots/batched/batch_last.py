"""``batch_last``: like ``jax.vmap``, but with the batch axis last in memory, which makes a robot simulator faster.

The arrays of a simulator end in short axes: 3 coordinates of a vector, 4 of a quaternion. ``jax.vmap`` puts the batch
axis of E robots in front, (E, …, 3), so a processor's vector unit, which works on 8 or 16 neighbouring numbers at once,
finds only 3 of a kind side by side. With the batch axis last, (…, 3, E), it finds as many as there are robots.

JAX has no option for that, so ``batch_last`` traces the function of one robot (``jax.make_jaxpr``) and interprets the
trace operation by operation. Each rule below turns an operation on one robot's array (…) into the same operation on all
robots' arrays (…, E). ``jax.vmap`` batches an operation without a rule, which is also correct but slower.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import Jaxpr, JaxprEqn, Literal

from qdil.robots.batched import fast_trig
from qdil.robots.batched.constant_indices import NUMPY_RULES, gathered_ranges, is_constant

FEW = 8  # sums of at most so many terms are written out as additions, since XLA's reductions are slow for short sums


class Batched(NamedTuple):
    """A value that differs between robots."""

    values: jax.Array  # (…, E)


Value = Any  # a ``Batched``, or a plain array (…) that all robots share
Rule = Callable[[JaxprEqn, Sequence[Value], int], jax.Array]  # (operation, its operands, E) -> its result (…, E)
RULES: dict[str, Rule] = {}  # by the name of the operation's primitive


def batch_last(function: Callable[..., Any], *template: Any) -> Callable[..., Any]:
    """The function of E robots' arrays that applies ``function`` to each robot; ``template`` gives one robot's shapes.

    As with ``jax.vmap(function)``, its arguments and results are trees of arrays with axis (E) in front; here every
    argument must have it. It transposes arguments and results. Results differ from ``jax.vmap``'s by rounding only.
    """
    trace, shapes = jax.make_jaxpr(function, return_shape=True)(*template)
    consts = [np.asarray(const) for const in trace.consts]

    def batched(*args: Any) -> Any:
        leaves = jax.tree.leaves(args)
        count = len(leaves[0])
        results = _interpret(trace.jaxpr, consts, [Batched(jnp.moveaxis(leaf, 0, -1)) for leaf in leaves], count)
        batch_first = [jnp.moveaxis(_expand(result, count), -1, 0) for result in results]
        return jax.tree.unflatten(jax.tree.structure(shapes), batch_first)

    return batched


def _interpret(jaxpr: Jaxpr, consts: Sequence[Any], args: Sequence[Value], count: int) -> list[Value]:
    """Carry out every operation of a trace, in order, for ``count`` robots."""
    values: dict[Any, Value] = dict(zip((*jaxpr.constvars, *jaxpr.invars), (*consts, *args), strict=True))

    def read(variable: Any) -> Value:
        if isinstance(variable, Literal):
            return np.asarray(variable.val, _dtype(variable))
        return values[variable]

    for eqn in jaxpr.eqns:
        results = _apply(eqn, [read(variable) for variable in eqn.invars], count)
        values.update(zip(eqn.outvars, results, strict=True))
    return [read(variable) for variable in jaxpr.outvars]


def _apply(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> list[Value]:
    """The results of one operation, by the first of these that fits.

    An inner function is interpreted. Integer constants stay constants, by NumPy. What all robots share is computed
    once. Otherwise a rule applies, or else ``jax.vmap``.
    """
    name = eqn.primitive.name
    if name in ("jit", "closed_call", "custom_jvp_call", "custom_vjp_call"):
        inner = eqn.params.get("jaxpr") or eqn.params["call_jaxpr"]
        return _interpret(inner.jaxpr, inner.consts, operands, count)
    if name in NUMPY_RULES and all(is_constant(operand) for operand in operands):
        return [NUMPY_RULES[name](eqn, *operands)]
    if not any(isinstance(operand, Batched) for operand in operands):
        result = _bind(eqn, *operands)
        return list(result) if eqn.primitive.multiple_results else [result]
    if name == "scan":
        return _scan(eqn, operands, count)
    if name in RULES and not eqn.primitive.multiple_results:
        return [Batched(RULES[name](eqn, operands, count))]
    return _by_vmap(eqn, operands)


def _bind(eqn: JaxprEqn, *arrays: Any) -> Any:
    """The operation itself, on plain arrays."""
    return eqn.primitive.bind(*arrays, **eqn.primitive.get_bind_params(eqn.params))


def _by_vmap(eqn: JaxprEqn, operands: Sequence[Value]) -> list[Value]:
    """The operation as ``jax.vmap`` batches it, along the last axis."""
    axes = [-1 if isinstance(operand, Batched) else None for operand in operands]
    arrays = [operand.values if isinstance(operand, Batched) else operand for operand in operands]
    result = jax.vmap(lambda *one_robot: _bind(eqn, *one_robot), in_axes=axes, out_axes=-1)(*arrays)
    return [Batched(one) for one in (result if eqn.primitive.multiple_results else [result])]


def _scan(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> list[Value]:
    """A ``lax.scan`` whose body is interpreted for all robots. Its carry is batched, even if robots share its start."""
    inner, num_consts, num_carry = eqn.params["jaxpr"], eqn.params["num_consts"], eqn.params["num_carry"]
    consts, operands = operands[:num_consts], operands[num_consts:]
    first_carry, sequences = operands[:num_carry], operands[num_carry:]
    is_batched = [isinstance(sequence, Batched) for sequence in sequences]

    def body(carry: list[jax.Array], rows: list[jax.Array]) -> tuple[list[jax.Array], list[jax.Array]]:
        row_values = [Batched(row) if batched else row for row, batched in zip(rows, is_batched, strict=True)]
        results = _interpret(inner.jaxpr, inner.consts, [*consts, *map(Batched, carry), *row_values], count)
        expanded = [_expand(result, count) for result in results]
        return expanded[:num_carry], expanded[num_carry:]

    last_carry, outputs = lax.scan(
        body,
        [_expand(value, count) for value in first_carry],
        [value.values if batched else value for value, batched in zip(sequences, is_batched, strict=True)],
        eqn.params["length"],
        reverse=eqn.params["reverse"],
        unroll=eqn.params["unroll"],
    )
    return [Batched(value) for value in (*last_carry, *outputs)]


def _expand(value: Value, count: int) -> jax.Array:
    """A value as an array (…, E); a shared one is repeated for every robot."""
    if isinstance(value, Batched):
        return value.values
    return jnp.broadcast_to(jnp.asarray(value)[..., None], (*jnp.shape(value), count))


def _rule(*names: str) -> Callable[[Rule], Rule]:
    """Register a function as the rule of these primitives."""

    def register(rule: Rule) -> Rule:
        RULES.update(dict.fromkeys(names, rule))
        return rule

    return register


@_rule(
    "abs", "add", "and", "clamp", "convert_element_type", "copy", "cos", "div", "eq", "exp", "ge", "gt", "integer_pow",
    "is_finite", "le", "log", "lt", "max", "min", "mul", "ne", "neg", "not", "or", "pow", "rsqrt", "select_n", "sign",
    "sin", "sqrt", "square", "sub", "tan", "tanh", "xor",
)  # fmt: skip
def _elementwise(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> jax.Array:
    shape = (*_shape(eqn.outvars[0]), count)  # a scalar operand (E,) of ``clamp`` or ``select_n`` is broadcast, too
    return _bind(eqn, *(jnp.broadcast_to(_expand(value, count), shape) for value in operands))


@_rule("atan2", "acos", "asin")
def _angle(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> jax.Array:
    shape = (*_shape(eqn.outvars[0]), count)
    return getattr(fast_trig, eqn.primitive.name)(
        *(jnp.broadcast_to(_expand(value, count), shape) for value in operands)
    )


@_rule("broadcast_in_dim")
def _broadcast(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> jax.Array:
    shape, axes = eqn.params["shape"], eqn.params["broadcast_dimensions"]
    return lax.broadcast_in_dim(operands[0].values, (*shape, count), (*axes, len(shape)))


@_rule("reshape")
def _reshape(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> jax.Array:
    return jnp.reshape(operands[0].values, (*eqn.params["new_sizes"], count))


@_rule("transpose")
def _transpose(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> jax.Array:
    order = eqn.params["permutation"]
    return jnp.transpose(operands[0].values, (*order, len(order)))


@_rule("slice")
def _slice(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> jax.Array:
    first, limit, strides = (eqn.params[name] for name in ("start_indices", "limit_indices", "strides"))
    return lax.slice(operands[0].values, (*first, 0), (*limit, count), strides and (*strides, 1))


@_rule("squeeze", "reduce_and", "reduce_or", "reduce_max", "reduce_min")
def _same_axes(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> jax.Array:
    return _bind(eqn, operands[0].values)  # its axes are counted from the front, so the last one changes nothing


@_rule("reduce_sum")
def _sum(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> jax.Array:
    values, axes = operands[0].values, eqn.params["axes"]
    if len(axes) != 1 or values.shape[axes[0]] > FEW:
        return jnp.sum(values, axis=axes)
    return _sum_terms(jnp.moveaxis(values, axes[0], 0))


@_rule("concatenate", "stack")
def _concatenate(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> jax.Array:
    return _bind(eqn, *(_expand(value, count) for value in operands))


@_rule("tile")
def _tile(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> jax.Array:
    return jnp.tile(operands[0].values, (*eqn.params["reps"], 1))


@_rule("dot_general")
def _dot_general(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> jax.Array:
    """A product of small matrices written out as multiplications and additions.

    A simulator multiplies vectors of 3, for which calling a matrix kernel costs more than the product itself.
    """
    contracted, batch = eqn.params["dimension_numbers"]
    if math.prod(_shape(eqn.invars[0])[axis] for axis in contracted[0]) > FEW:
        return _by_vmap(eqn, operands)[0].values
    sides, free = [], []
    for variable, operand, summed_axes, batch_axes in zip(eqn.invars, operands, contracted, batch, strict=True):
        free_axes = [axis for axis in range(len(_shape(variable))) if axis not in (*summed_axes, *batch_axes)]
        batched = isinstance(operand, Batched)
        values = operand.values if batched else jnp.asarray(operand)[..., None]  # (…, E) or (…, 1)
        values = jnp.transpose(values, (*summed_axes, *batch_axes, *free_axes, values.ndim - 1))
        sides.append(values.reshape(-1, *values.shape[len(summed_axes) :]))  # (summed, batch…, free…, E)
        free.append(len(free_axes))
    left, right = sides
    before = 1 + len(batch[0])
    left = jnp.expand_dims(left, tuple(range(before + free[0], before + sum(free))))
    right = jnp.expand_dims(right, tuple(range(before, before + free[0])))
    return _sum_terms(a * b for a, b in zip(left, right, strict=True))


@_rule("gather")
def _gather(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> jax.Array:
    rows, indices = operands
    if isinstance(indices, Batched):
        return _by_vmap(eqn, operands)[0].values
    found = gathered_ranges(eqn, indices)
    if found is not None:
        axis, ranges = found
        parts = [lax.slice_in_dim(rows.values, first, end, axis=axis) for first, end in ranges]
        return jnp.concatenate(parts, axis).reshape(*_shape(eqn.outvars[0]), count)
    numbers = eqn.params["dimension_numbers"]
    names = ("indices_are_sorted", "unique_indices", "mode", "fill_value")
    return lax.gather(
        rows.values,
        indices,
        numbers._replace(offset_dims=(*numbers.offset_dims, len(_shape(eqn.outvars[0])))),
        (*eqn.params["slice_sizes"], count),
        **{name: eqn.params[name] for name in names},
    )


@_rule("scatter", "scatter-add")
def _scatter(eqn: JaxprEqn, operands: Sequence[Value], count: int) -> jax.Array:
    target, indices, updates = operands
    if isinstance(indices, Batched):
        return _by_vmap(eqn, operands)[0].values
    numbers, rows = eqn.params["dimension_numbers"], _expand(updates, count)
    names = ("indices_are_sorted", "unique_indices", "mode")
    scatter = lax.scatter_add if eqn.primitive.name == "scatter-add" else lax.scatter
    return scatter(
        _expand(target, count),
        indices,
        rows,
        numbers._replace(update_window_dims=(*numbers.update_window_dims, rows.ndim - 1)),
        **{name: eqn.params[name] for name in names},
    )


def _shape(variable: Any) -> tuple[int, ...]:
    """The shape (…) of one robot's array in a trace."""
    return variable.aval.shape


def _dtype(variable: Any) -> np.dtype:
    """The number type of one robot's array in a trace."""
    return variable.aval.dtype


def _sum_terms(terms: Iterable[jax.Array]) -> jax.Array:
    """The sum of some arrays, added one after the other."""
    *_, total = accumulate(terms)
    return total
