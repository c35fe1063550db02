"""Running statistics: one normaliser for observations, one for the returns that critics predict."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdil.devices.mesh import AXIS
from qdil.types import Normaliser, ObsStats

OBS_CLIP = 10.0  # normalised observations are cut at this many deviations (Brax's and the authors' choice)
RETURN_MEMORY = 50.0  # updates over which return statistics average, so that they follow an improving policy


def init_obs_stats(obs_size: int) -> ObsStats:
    """Statistics before any data: they leave an observation as it is."""
    return ObsStats(jnp.zeros(obs_size), jnp.ones(obs_size), jnp.zeros(obs_size), jnp.zeros(()))


def update_obs_stats(stats: ObsStats, obs: jax.Array, axis: str | None = AXIS) -> ObsStats:
    """Add a batch ``obs`` (..., O) from every device of ``axis`` (Chan et al.'s parallel form of Welford's sums)."""
    obs = obs.reshape(-1, obs.shape[-1])
    mean, size = jnp.mean(obs, axis=0), jnp.asarray(obs.shape[0], jnp.float32)
    if axis is not None:
        mean, size = jax.lax.pmean(mean, axis), jax.lax.psum(size, axis)
    variance = jnp.mean(jnp.square(obs - mean), axis=0)  # centred first: E[x²] − E[x]² loses small spreads in float32
    if axis is not None:
        variance = jax.lax.pmean(variance, axis)
    count = stats.seen + size
    delta = mean - stats.mean
    summed = stats.summed_variance + variance * size + jnp.square(delta) * stats.seen * size / count
    std = jnp.clip(jnp.sqrt(summed / count), 1e-4, 1e6)
    return ObsStats(stats.mean + delta * size / count, std, summed, count)


def normalise_obs(stats: Normaliser | ObsStats, obs: jax.Array) -> jax.Array:
    """``obs`` (..., O) in deviations from the mean, clipped to ±``OBS_CLIP``."""
    return jnp.clip((obs - stats.mean) / stats.std, -OBS_CLIP, OBS_CLIP)


class ReturnStats(NamedTuple):
    """Mean and spread of the returns of each objective (fitness, δ_1 … δ_k)."""

    mean: jax.Array  # (1+k,)
    std: jax.Array  # (1+k,)
    square: jax.Array  # (1+k,) mean square
    updates: jax.Array  # ()


def init_return_stats(objectives: int) -> ReturnStats:
    """Statistics before any return was seen."""
    return ReturnStats(jnp.zeros(objectives), jnp.ones(objectives), jnp.zeros(objectives), jnp.zeros(()))


def update_return_stats(stats: ReturnStats, mean: jax.Array, square: jax.Array) -> ReturnStats:
    """Move towards a batch's ``mean`` and mean ``square`` (1+k,); a plain average at first, then exponential."""
    updates = jnp.minimum(stats.updates + 1.0, RETURN_MEMORY)
    mean = stats.mean + (mean - stats.mean) / updates
    square = stats.square + (square - stats.square) / updates
    std = jnp.sqrt(jnp.maximum(square - jnp.square(mean), 1e-4))
    return ReturnStats(mean, std, square, updates)
