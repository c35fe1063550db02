"""What a robot is to the rest of the library: a small value of pure functions, whatever simulates it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax


class RobotState(NamedTuple):
    """One robot at one moment t; with axis (E) in front, many robots."""

    physics: Any  # the simulator's own state, a tree of arrays that no other module reads
    obs: jax.Array  # (O,) observation s_t
    proxy: jax.Array  # (k,) Markovian measure proxy δ(s_t), 1 where a foot touches the ground


class Outcome(NamedTuple):
    """What one step yields besides the next state."""

    reward: jax.Array  # () the environment's own ("true") reward, finite
    terminated: jax.Array  # () bool, the episode ended by itself (a fall); rollouts apply the time limit
    finite: jax.Array  # () bool, False if the physics diverged, and then ``terminated`` is True


class Environment(NamedTuple):
    """A simulated robot, also known as the environment or, with a reward, as the Markov decision process.

    ``reset`` and ``step`` are pure functions of one robot that ``jax.vmap`` can map over many. To use a simulator of
    your own, fill in these fields and call ``qdil.robots.register.register_robot(name, environment=...)``.
    """

    name: str  # by which the robot is registered
    backend: str  # name of the simulator
    obs_size: int  # O
    action_size: int  # A
    measure_names: tuple[str, ...]  # one per measure, for Brax's robots its feet; k = len(measure_names)
    step_seconds: float  # simulated time of one step, s
    reset: Callable[[jax.Array], RobotState]  # random key -> state at the start of an episode
    step: Callable[[RobotState, jax.Array], tuple[RobotState, Outcome]]  # action (A,); the robot clips it to [-1, 1]
