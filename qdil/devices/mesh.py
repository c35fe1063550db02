"""One mesh over all devices (CPU cores or GPUs, of one host or several) and the two layouts that arrays here have."""

from functools import lru_cache
from typing import Any

import jax
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from qdil.errors import ConfigError

AXIS = "devices"


def make_mesh(num_devices: int) -> Mesh:
    """A one-dimensional mesh over the first ``num_devices`` devices."""
    devices = np.asarray(jax.devices()[:num_devices])
    return Mesh(devices, (AXIS,), axis_types=(AxisType.Auto,))


def choose_num_devices(requested: int, *counts: int) -> int:
    """Devices to use: ``requested``, or if 0 the most devices that divide every count; all, where hosts are several.

    Raises ConfigError when that cannot be met.
    """
    available = jax.device_count()
    if jax.process_count() > 1 and requested in (0, available):
        requested = available  # a host without a share would wait for ever
    elif jax.process_count() > 1:
        raise ConfigError(f"devices={requested} leaves some of the {available} devices of several hosts without work.")
    if requested == 0:
        return max(d for d in range(1, available + 1) if all(c % d == 0 for c in counts))
    if requested > available:
        raise ConfigError(f"devices={requested} was asked for, but this process has {available}.")
    for count in counts:
        if count % requested:
            raise ConfigError(
                f"devices={requested} must divide the robots of each VPPO copy (num_envs/3) and the candidates, "
                f"here {' and '.join(map(str, counts))}."
            )
    return requested


def idle_devices(requested: int, per_copy: int, candidates: int) -> str | None:
    """A sentence on local devices left without work although nobody asked for that, and on what would divide.

    Arguments as of ``choose_num_devices``: the robots of each VPPO copy, and the candidates.
    """
    available, used = jax.device_count(), choose_num_devices(requested, per_copy, candidates)
    if requested or used == available:
        return None
    envs, more = 3 * _multiple(per_copy, available), _multiple(candidates, available)
    return (
        f"Using {used} of {available} devices, the most that divide the {per_copy} robots of each VPPO copy and the "
        f"{candidates} candidates; num_envs={envs} and candidates={more} would use all of them."
    )


def _multiple(count: int, of: int) -> int:
    """The least multiple that is not below ``count``."""
    return -(-count // of) * of


def replicated(mesh: Mesh) -> NamedSharding:
    """The same array on every device."""
    return NamedSharding(mesh, P())


def by_environment(mesh: Mesh) -> NamedSharding:
    """The leading (environment or candidate) axis split over the devices."""
    return NamedSharding(mesh, P(AXIS))


def laid_out(tree: Any, sharding: NamedSharding) -> Any:
    """A tree of arrays that every host has whole, random keys among them, as arrays in the given layout."""
    if sharding.is_fully_addressable:
        return jax.device_put(tree, sharding)
    return _copy(sharding)(tree)  # random keys cannot be put where other hosts' devices are


@lru_cache(maxsize=16)
def _copy(sharding: NamedSharding) -> Any:
    """A compiled function that does nothing but lay out; one per layout, so that it compiles once per shape."""
    return jax.jit(lambda tree: tree, out_shardings=sharding)
