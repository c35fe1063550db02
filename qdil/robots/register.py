"""The robots by name, and how another module adds one. Importing this module does not import JAX or Brax."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from qdil import plugins
from qdil.errors import ConfigError

if TYPE_CHECKING:
    from qdil.robots.environment import Environment

BACKENDS = ("spring", "positional", "generalized", "mjx")
MOST_MEASURES = 6  # a grid has cells^k cells, and every one more is another copy that VPPO trains


class Robot(NamedTuple):
    """How a robot is simulated, and which of its links are feet; or a simulated robot that a user made."""

    name: str
    brax_env: str | None  # its name among Brax's environments
    feet: tuple[str, ...]  # links, or shapes of links, whose ground contacts are the measures, one each
    environment: Environment | None = None  # instead of ``brax_env``

    @property
    def measure_names(self) -> tuple[str, ...]:
        """One name per measure; k of them."""
        return self.feet if self.environment is None else tuple(self.environment.measure_names)


BUILT_IN = (
    Robot("halfcheetah", "halfcheetah", ("bfoot", "ffoot")),
    Robot("walker2d", "walker2d", ("foot", "foot_left")),
    # The humanoid's model has no foot links: its feet are spheres at the shins' lower ends.
    Robot("humanoid", "humanoid", ("right_shin", "left_shin")),
    Robot("hopper", "hopper", ("foot",)),
    # The ant's lower legs are links without names, so its feet are named by their shapes.
    Robot("ant", "ant", ("left_foot_geom", "right_foot_geom", "third_foot_geom", "fourth_foot_geom")),
)
PAPER_ROBOTS = ("halfcheetah", "walker2d", "humanoid")  # those that the paper's claims are about
_ROBOTS: dict[str, Robot] = {robot.name: robot for robot in BUILT_IN}


def register_robot(
    name: str, *, brax_env: str | None = None, feet: Sequence[str] = (), environment: Environment | None = None
) -> None:
    """Make a robot known by ``name``: to the command line, folders, notebooks and the explorer.

    Give either ``brax_env``, a name that ``brax.envs`` knows, with the ``feet`` whose ground contacts are the k
    measures (names of links, or of shapes where a link has no name); or an ``environment`` of your own
    (``qdil.robots.environment``), whose ``measure_names`` say what its k measures are. k is between 1 and 6. Call it in
    a module of your own and name that module with ``qdil --import``, or in the entry-point group ``qdil.plugins`` of an
    installed package.

    Raises ValueError for a name that is taken or is not made of small letters, digits, - and _, for a robot without
    feet or with more than 6, and for a foot named twice. Whether feet are links of the robot is known once it is
    built: then ConfigError.
    """
    if (brax_env is None) == (environment is None):
        raise ValueError(f"robot '{name}': give either brax_env with feet, or an environment.")
    robot = Robot(name, brax_env, tuple(feet), environment)
    k = len(robot.measure_names)
    if not re.fullmatch("[a-z][a-z0-9_-]*", name):
        raise ValueError(f"'{name}' cannot name a robot: use small letters, digits, - and _ (it names folders).")
    if not 1 <= k <= MOST_MEASURES:
        raise ValueError(f"robot '{name}' has {k} feet: it needs between 1 and {MOST_MEASURES}, one for each measure.")
    if len(set(robot.measure_names)) < k:
        raise ValueError(f"robot '{name}' names a foot twice: {', '.join(robot.measure_names)}.")
    if _ROBOTS.get(name, robot) != robot:
        raise ValueError(f"there is already a robot called '{name}'.")
    _ROBOTS[name] = robot


def robot_names() -> tuple[str, ...]:
    """All robots, ours first."""
    plugins.load()
    return tuple(_ROBOTS)


def find(name: str) -> Robot:
    """The robot of this name. Raises ConfigError if there is none."""
    if name not in robot_names():
        raise ConfigError(f"unknown robot '{name}'; choose one of {', '.join(robot_names())}.")
    return _ROBOTS[name]


def count_measures(name: str) -> int:
    """k, the number of a robot's feet. Raises ConfigError for an unknown robot."""
    return len(find(name).measure_names)


def backends_of(name: str) -> tuple[str, ...]:
    """What can simulate a robot, the default first. Raises ConfigError for an unknown robot."""
    environment = find(name).environment
    return BACKENDS if environment is None else (environment.backend,)


def make(name: str, backend: str | None = None) -> Environment:
    """The simulated robot of this name (None: its default backend). Raises ConfigError for what does not exist."""
    robot, backends = find(name), backends_of(name)
    if backend is not None and backend not in backends:
        raise ConfigError(f"unknown backend '{backend}' of {name}; choose one of {', '.join(backends)}.")
    if robot.environment is not None:
        return robot.environment
    from qdil.robots import brax_robots

    return brax_robots.make(robot, backend or backends[0])
