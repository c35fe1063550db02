"""Running statistics against NumPy over all the data at once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jax.sharding import PartitionSpec as P

from qdil.devices.mesh import AXIS, make_mesh
from qdil.rl.normalise import (
    OBS_CLIP,
    RETURN_MEMORY,
    init_obs_stats,
    init_return_stats,
    normalise_obs,
    update_obs_stats,
    update_return_stats,
)

update = jax.jit(lambda stats, obs: update_obs_stats(stats, obs, axis=None))


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_observation_batches_add_up_to_all_data(seed, batches):
    rng = np.random.default_rng(seed)
    centre, spread = rng.uniform(-5, 5, size=(batches, 1, 1, 2)), rng.uniform(0.5, 4, size=(batches, 1, 1, 2))
    data = (centre + spread * rng.normal(size=(batches, 8, 4, 2))).astype(np.float32)
    stats = init_obs_stats(2)
    for batch in data:
        stats = update(stats, batch)
    everything = data.reshape(-1, 2).astype(float)
    np.testing.assert_allclose(stats.mean, everything.mean(axis=0), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(stats.std, everything.std(axis=0), rtol=1e-3)
    assert stats.seen == len(everything)


@pytest.mark.skipif(jax.local_device_count() < 2, reason="one device only")
def test_observations_spread_over_devices_count_as_one_batch():
    obs = np.random.default_rng(0).normal([1, -3], [2, 0.5], size=(5, 8, 2)).astype(np.float32)
    spread = jax.shard_map(
        update_obs_stats, mesh=make_mesh(2), in_specs=(P(), P(None, AXIS)), out_specs=P(), check_vma=False
    )
    together, apart = update(init_obs_stats(2), obs), jax.jit(spread)(init_obs_stats(2), obs)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4), together, apart)


def test_normalised_observations_have_zero_mean_and_unit_spread_and_are_cut():
    obs = np.random.default_rng(0).normal([1, -3], [2, 0.5], size=(4000, 2)).astype(np.float32)
    stats = update(init_obs_stats(2), obs)
    seen = np.asarray(normalise_obs(stats, obs))
    np.testing.assert_allclose(seen.mean(axis=0), 0, atol=1e-4)
    np.testing.assert_allclose(seen.std(axis=0), 1, rtol=1e-3)
    assert normalise_obs(stats, jnp.array([1e6, -1e6])).tolist() == [OBS_CLIP, -OBS_CLIP]


def test_before_any_data_an_observation_stays_as_it_is():
    assert normalise_obs(init_obs_stats(2), jnp.array([0.25, -7.0])).tolist() == [0.25, -7.0]


def test_an_observation_that_never_changes_stays_finite():
    seen = normalise_obs(update(init_obs_stats(1), jnp.full((10, 3, 1), 2.0)), jnp.array([2.0]))
    assert seen.tolist() == [0]


def test_return_statistics_are_a_plain_average_at_first():
    batches = np.random.default_rng(0).normal([0, 5], [1, 3], size=(20, 64, 2))
    stats = init_return_stats(2)
    for batch in batches:
        stats = update_return_stats(stats, batch.mean(axis=0), np.square(batch).mean(axis=0))
    everything = batches.reshape(-1, 2)
    np.testing.assert_allclose(stats.mean, everything.mean(axis=0), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(stats.std, everything.std(axis=0), rtol=1e-4)


def test_return_statistics_then_follow_with_a_fixed_memory():
    stats = init_return_stats(1)
    for _ in range(int(RETURN_MEMORY) + 30):
        stats = update_return_stats(stats, jnp.zeros(1), jnp.ones(1))
    assert stats.mean[0] == 0
    for n in (1, 2, 3):
        stats = update_return_stats(stats, jnp.full(1, 10.0), jnp.full(1, 101.0))
        np.testing.assert_allclose(stats.mean, 10 * (1 - (1 - 1 / RETURN_MEMORY) ** n), rtol=1e-5)
