"""Several hosts as one machine: each runs the same program on its own devices, the first one writes the files.

Hosts find each other through ``jax.distributed`` where its variables are set: ``JAX_COORDINATOR_ADDRESS`` (host:port of
the first), ``JAX_NUM_PROCESSES`` and ``JAX_PROCESS_ID``. The run folder must be one that all of them see.
"""

import os
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils

from qdil.errors import ConfigError

VARIABLES = ("JAX_COORDINATOR_ADDRESS", "JAX_NUM_PROCESSES", "JAX_PROCESS_ID")


def join() -> None:
    """Connect to the other hosts, if the variables say that there are any; before JAX is used for anything else.

    Raises ConfigError where only some of the variables are set, or one is not a number.
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
        wait_for_all("joined")  # to connect while all have just started; compilation later sets them minutes apart


def is_first() -> bool:
    """Whether this process writes the files and speaks to the user."""
    return jax.process_index() == 0


def broadcast_from_host0(first_says: bool) -> bool:
    """What the first host says, on every host: decisions by the clock must not differ."""
    if jax.process_count() == 1:
        return first_says
    return bool(multihost_utils.broadcast_one_to_all(np.array(first_says)))


def run_on_host0(decide: Callable[[], bool]) -> bool:
    """What ``decide`` says on the first host, on every host; a ConfigError there is raised on all of them.

    What lies in a folder that all hosts see may change while they look: one must look for all.
    """
    if jax.process_count() == 1:
        return decide()
    answer, refusal = 2, ConfigError("the first host cannot go on and says why.")
    if is_first():
        try:
            answer = int(decide())
        except ConfigError as error:
            refusal = error
    answer = int(multihost_utils.broadcast_one_to_all(np.array(answer)))
    if answer == 2:
        raise refusal
    return bool(answer)


def wait_for_all(what: str) -> None:
    """Go on once every host is here."""
    if jax.process_count() > 1:
        multihost_utils.sync_global_devices(what)


def to_host(tree: Any) -> Any:
    """A tree's arrays as NumPy's, those that are spread over several hosts gathered on each of them."""
    return jax.tree.map(_to_host, tree)


def _to_host(leaf: Any) -> np.ndarray:
    whole = not isinstance(leaf, jax.Array) or leaf.is_fully_addressable or leaf.is_fully_replicated
    return np.asarray(leaf if whole else multihost_utils.process_allgather(leaf, tiled=True))
