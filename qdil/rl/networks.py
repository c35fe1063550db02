"""The Gaussian policy, the critic and the small perceptron both are made of; and policies as flat vectors."""

from collections.abc import Sequence
from itertools import pairwise

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from qdil.rl.normalise import normalise_obs
from qdil.types import Normaliser, ObsStats, Params

LOG_2PI = 1.8378770664093453


def init_mlp(key: jax.Array, sizes: Sequence[int], last_scale: float = 1.0) -> Params:
    """Weights of a tanh perceptron ``sizes[0] -> … -> sizes[-1]``: orthogonal, gain √2 (last layer ``last_scale``)."""
    layers = []
    layer_keys = jax.random.split(key, len(sizes) - 1)
    for i, (fan_in, fan_out) in enumerate(pairwise(sizes)):
        gain = last_scale if i == len(sizes) - 2 else 2.0**0.5
        layers.append(
            {"w": jax.nn.initializers.orthogonal(gain)(layer_keys[i], (fan_in, fan_out)), "b": jnp.zeros(fan_out)}
        )
    return layers


def mlp(layers: Params, x: jax.Array) -> jax.Array:
    """Apply ``init_mlp``'s network to ``x`` (..., sizes[0]): tanh between layers, linear at the end."""
    return _hidden(layers, x) @ layers[-1]["w"] + layers[-1]["b"]


def _hidden(layers: Params, x: jax.Array) -> jax.Array:
    for layer in layers[:-1]:
        x = jnp.tanh(x @ layer["w"] + layer["b"])
    return x


def outputs_in_rows(layers: Params) -> Params:
    """``layers`` for ``mlp_single``: the last weights (H, sizes[-1]) transposed to (sizes[-1], H)."""
    return [*layers[:-1], layers[-1] | {"w": layers[-1]["w"].T}]


def mlp_single(layers: Params, x: jax.Array) -> jax.Array:
    """``mlp`` for one input (sizes[0],), with the last weights transposed by ``outputs_in_rows``.

    Under ``vmap`` its last layer takes a tenth of the time.
    """
    return layers[-1]["w"] @ _hidden(layers, x) + layers[-1]["b"]


def columns(x: jax.Array) -> jax.Array:
    """Rows (..., F) as columns (F, n)."""
    return x.reshape(-1, x.shape[-1]).T


def as_columns(x: jax.Array) -> jax.Array:
    """``columns`` that are also contiguous in memory: without the barrier XLA would only change the array's layout."""
    return jax.lax.optimization_barrier(columns(x))


def mlp_of_columns(layers: Params, x: jax.Array) -> jax.Array:
    """``mlp`` for inputs that are columns: (sizes[0], n) -> (sizes[-1], n).

    Products of its gradient then sum along contiguous axes: XLA has fast kernels for those alone on a CPU.
    """
    for layer in layers[:-1]:
        x = jnp.tanh(layer["w"].T @ x + layer["b"][:, None])
    return layers[-1]["w"].T @ x + layers[-1]["b"][:, None]


def init_policy(key: jax.Array, obs_size: int, action_size: int, hidden: Sequence[int], initial_std: float) -> Params:
    """A policy π_θ(a|s) = N(mlp(s), diag(std²)) with a learned, state-independent ``log_std`` (A,)."""
    return {
        "mean": init_mlp(key, (obs_size, *hidden, action_size), last_scale=0.01),
        "log_std": jnp.full((action_size,), jnp.log(initial_std), jnp.float32),
    }


def policy_mean(params: Params, stats: Normaliser | ObsStats, obs: jax.Array) -> jax.Array:
    """The mean action (..., A) for raw observations (..., O)."""
    return mlp(params["mean"], normalise_obs(stats, obs))


def log_prob(params: Params, mean: jax.Array, raw_action: jax.Array) -> jax.Array:
    """log N(raw_action | mean, std²), summed over the action axis."""
    z = (raw_action - mean) * jnp.exp(-params["log_std"])
    return jnp.sum(-0.5 * (jnp.square(z) + LOG_2PI) - params["log_std"], axis=-1)


def log_prob_of_columns(params: Params, mean: jax.Array, raw_action: jax.Array) -> jax.Array:
    """``log_prob`` (n,) of actions and means that are columns (A, n).

    The sum is a product with a row of ones. A reduction over so few rows takes half as long as a large matrix product
    on a CPU.
    """
    z = (raw_action - mean) * jnp.exp(-params["log_std"])[:, None]
    ones = jnp.ones(len(z))
    squares = jnp.matmul(ones, jnp.square(z), precision=jax.lax.Precision.HIGHEST)
    return -0.5 * squares - jnp.sum(params["log_std"] + 0.5 * LOG_2PI)


def entropy(params: Params) -> jax.Array:
    """Differential entropy of the action distribution, in nats."""
    return jnp.sum(params["log_std"] + 0.5 * (1.0 + LOG_2PI))


def flat_size(params: Params) -> int:
    """Number of parameters in θ."""
    return sum(leaf.size for leaf in jax.tree.leaves(params))


def flatten(params: Params) -> jax.Array:
    """θ as one vector (P,): the form in which an archive keeps a policy."""
    return ravel_pytree(params)[0]


def unflatten(theta: jax.Array, template: Params) -> Params:
    """The policy whose ``flatten`` is ``theta`` (P,); ``template`` gives the structure."""
    return ravel_pytree(template)[1](theta)


def template_of(obs_size: int, action_size: int, hidden: Sequence[int]) -> Params:
    """A policy of zeros with this structure: what ``unflatten`` needs."""
    shapes = jax.eval_shape(lambda key: init_policy(key, obs_size, action_size, hidden, 1.0), jax.random.key(0))
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
