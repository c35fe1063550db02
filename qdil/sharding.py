"""One mesh over the local devices (CPU cores or GPUs) and the two layouts that every array here has."""

import jax
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

AXIS = "devices"


def make_mesh(num_devices: int) -> Mesh:
    """A one-dimensional mesh over the first ``num_devices`` local devices."""
    devices = np.asarray(jax.local_devices()[:num_devices])
    return Mesh(devices, (AXIS,), axis_types=(AxisType.Auto,))


def choose_num_devices(requested: int, *counts: int) -> int:
    """Devices to use: ``requested``, or if 0 the most local devices that divide every count.

    Raises ValueError in one sentence when an explicit request cannot be met.
    """
    available = jax.local_device_count()
    if requested == 0:
        return max(d for d in range(1, available + 1) if all(c % d == 0 for c in counts))
    if requested > available:
        raise ValueError(f"devices={requested} was asked for, but this process has {available}.")
    for count in counts:
        if count % requested:
            raise ValueError(
                f"devices={requested} must divide the robots of each VPPO copy (num_envs/3) and the candidates, "
                f"here {' and '.join(map(str, counts))}."
            )
    return requested


def replicated(mesh: Mesh) -> NamedSharding:
    """The same array on every device."""
    return NamedSharding(mesh, P())


def by_environment(mesh: Mesh) -> NamedSharding:
    """The leading (environment or candidate) axis split over the devices."""
    return NamedSharding(mesh, P(AXIS))
