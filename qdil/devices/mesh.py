"""One mesh over all devices (CPU cores or GPUs, of one host or several), and the two layouts that arrays have."""

import math
from collections.abc import Callable
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
    """The number of devices to use: ``requested``, or if 0 the largest number that divides every count.

    With several hosts all devices are used. Raises ConfigError if ``requested`` cannot be used.
    """
    available = jax.device_count()
    if jax.process_count() > 1 and requested in (0, available):
        requested = available  # a host without work would wait for ever
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
    """A sentence that names idle local devices and the counts that would use all; None if none is idle.

    None, too, if the user ``requested`` a number. Arguments: as for ``choose_num_devices``, with the robots of each
    VPPO copy and the candidates as counts.
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
    """The smallest multiple of ``of`` that is not below ``count``."""
    return math.ceil(count / of) * of


def replicated(mesh: Mesh) -> NamedSharding:
    """The same array on every device."""
    return NamedSharding(mesh, P())


def by_environment(mesh: Mesh) -> NamedSharding:
    """The leading (environment or candidate) axis split over the devices."""
    return NamedSharding(mesh, P(AXIS))


def laid_out(tree: Any, sharding: NamedSharding) -> Any:
    """A tree of arrays, equal on every host, in the given layout. The tree may contain random keys."""
    if sharding.is_fully_addressable:
        return jax.device_put(tree, sharding)
    return _copy(sharding)(tree)  # ``device_put`` does not move random keys to the devices of other hosts


@lru_cache(maxsize=16)
def _copy(sharding: NamedSharding) -> Callable[[Any], Any]:
    """A compiled identity function with this layout of its result; kept, so that it compiles once per shape."""
    return jax.jit(lambda tree: tree, out_shardings=sharding)
