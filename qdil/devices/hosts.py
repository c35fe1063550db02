"""Several hosts as one machine: each runs the same program on its own devices, and host 0 writes the files.

Hosts connect through ``jax.distributed`` if three environment variables are set: ``JAX_COORDINATOR_ADDRESS`` (host:port
of host 0), ``JAX_NUM_PROCESSES`` and ``JAX_PROCESS_ID``. The run folder must be on a disk that all hosts share.
"""

import os
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils

from qdil.errors import ConfigError

REFUSED = 2  # what host 0 sends, instead of 0 or 1, if it raised ConfigError

VARIABLES = ("JAX_COORDINATOR_ADDRESS", "JAX_NUM_PROCESSES", "JAX_PROCESS_ID")


def join() -> None:
    """Connect to the other hosts if the variables are set. Call it before JAX is used for anything else.

    Raises ConfigError if only some of the variables are set, or if one is not a number.
    """
    given = [name for name in VARIABLES if os.environ.get(name)]
    if not given:
        return
    if len(given) < len(VARIABLES):
        raise ConfigError(f"{given[0]} is set without {', '.join(n for n in VARIABLES if n not in given)}.")
    address, *numbers = (os.environ[name] for name in VARIABLES)
    if not all(number.isdecimal() for number in numbers):
        raise ConfigError(f"{VARIABLES[1]} and {VARIABLES[2]} must be numbers, not {' and '.join(numbers)}.")
    if not jax.distributed.is_initialized():
        jax.distributed.initialize(address, num_processes=int(numbers[0]), process_id=int(numbers[1]))
        wait_for_all("joined")  # connect now: compilation may separate the hosts by minutes, and connecting times out


def is_first() -> bool:
    """Whether this process is host 0, which writes the files and prints."""
    return jax.process_index() == 0


def broadcast_from_host0(value: bool) -> bool:
    """Host 0's ``value``, on every host. Clocks differ, so host 0 makes the decisions that depend on time."""
    if jax.process_count() == 1:
        return value
    return bool(multihost_utils.broadcast_one_to_all(np.array(value)))


def run_on_host0(decide: Callable[[], bool]) -> bool:
    """Call ``decide`` on host 0 alone and return its result on every host. Its ConfigError is raised on all of them.

    A shared folder may change while hosts look at it one after the other, so host 0 decides for all.
    """
    if jax.process_count() == 1:
        return decide()
    result, refusal = REFUSED, ConfigError("host 0 refused; its own message gives the reason.")
    if is_first():
        try:
            result = int(decide())
        except ConfigError as error:
            refusal = error
    result = int(multihost_utils.broadcast_one_to_all(np.array(result)))
    if result == REFUSED:
        raise refusal
    return bool(result)


def wait_for_all(what: str) -> None:
    """Return once every host has called this with the same ``what``."""
    if jax.process_count() > 1:
        multihost_utils.sync_global_devices(what)


def to_host(tree: Any) -> Any:
    """The tree's arrays as NumPy arrays; arrays sharded over several hosts are gathered on each of them."""
    return jax.tree.map(_to_host, tree)


def _to_host(leaf: Any) -> np.ndarray:
    is_local = not isinstance(leaf, jax.Array) or leaf.is_fully_addressable or leaf.is_fully_replicated
    return np.asarray(leaf if is_local else multihost_utils.process_allgather(leaf, tiled=True))
