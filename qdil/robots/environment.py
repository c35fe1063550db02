"""What a robot is to the rest of the library: a small value of pure functions, whatever simulates it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax


class RobotState(NamedTuple):
    """One robot at one moment."""

    physics: Any  # the simulator's own state, opaque to everything else
    obs: jax.Array  # (O,) observation s_t
    proxy: jax.Array  # (k,) Markovian measure proxy δ(s_t), 1 where a foot touches the ground


class Outcome(NamedTuple):
    """What one step did besides moving the robot."""

    reward: jax.Array  # () the environment's own ("true") reward
    terminated: jax.Array  # () bool, the episode ended by itself (a fall); a time limit is not here
    finite: jax.Array  # () bool, False where the physics diverged (then also terminated)


class Environment(NamedTuple):
    """A simulated robot. ``reset`` and ``step`` are pure, for one robot, and meant for ``jax.vmap``.

    Another simulator joins by filling in these fields; nothing outside ``qdil.robots`` knows Brax.
    """

    name: str
    backend: str
    obs_size: int
    action_size: int
    measure_names: tuple[str, ...]  # one per foot; k = len(measure_names)
    step_seconds: float
    reset: Callable[[jax.Array], RobotState]  # key -> state
    step: Callable[[RobotState, jax.Array], tuple[RobotState, Outcome]]  # action (A,), any size: the robot clips
