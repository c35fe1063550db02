"""The robots by name, and how another module adds one. Importing this module does not import JAX or Brax."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from qdil import plugins
from qdil.errors import ConfigError
from qdil.robots.robot import BACKENDS, Robot

if TYPE_CHECKING:
    from qdil.robots.environment import Environment

MOST_MEASURES = 6  # a grid has cells^k cells, and each measure costs one more copy that VPPO trains


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
    measures (names of links, or of collision shapes where a link has no name); or an ``environment`` of your own
    (``qdil.robots.environment``), whose ``measure_names`` name its k measures and which takes the name ``name``. k is
    between 1 and 6. Call this function in a module of your own and name that module with ``qdil --import``, or in the
    entry-point group ``qdil.plugins`` of an installed package.

    Raises ConfigError for a name that is taken or is not made of small letters, digits, - and _; for a robot without
    feet or with more than 6; for a foot named twice; for an environment whose functions do not fit its fields. Whether
    feet are links of the robot is known only when the robot is built (``make``), which raises ConfigError, too. An
    environment that is registered again under its name takes the place of the first.
    """
    if not re.fullmatch("[a-z][a-z0-9_-]*", name):
        raise ConfigError(f"'{name}' cannot name a robot: use small letters, digits, - and _, a letter first.")
    if (brax_env is None) == (environment is None):
        raise ConfigError(f"robot '{name}': give either brax_env with feet, or an environment.")
    if isinstance(feet, str):
        raise ConfigError(f"robot '{name}': feet={feet!r} must be a list of names, for example ['{feet}'].")
    renamed = None if environment is None else _renamed(name, environment)
    robot = Robot(name, brax_env, tuple(feet), renamed)
    names = robot.measure_names
    if not 1 <= len(names) <= MOST_MEASURES:
        what = "feet" if environment is None else "measure_names"
        raise ConfigError(f"robot '{name}' has {len(names)} {what}; it needs between 1 and {MOST_MEASURES}.")
    if len(set(names)) < len(names):
        raise ConfigError(f"robot '{name}' names a foot twice: {', '.join(names)}.")
    taken = _ROBOTS.get(name, robot)
    if taken != robot and (renamed is None or taken.environment is None):  # a cell that is re-run makes it anew
        raise ConfigError(f"there is already a robot called '{name}'.")
    if renamed is not None:
        from qdil.robots.environment import problem_of

        if problem := problem_of(renamed):
            raise ConfigError(f"robot '{name}': {problem}.")
    _ROBOTS[name] = robot


def _renamed(name: str, environment: Environment) -> Environment:
    """``environment`` under its registered name. Raises ConfigError if it is something else."""
    from qdil.robots.environment import Environment

    if not isinstance(environment, Environment):
        raise ConfigError(f"robot '{name}': environment must be a qdil.robots.environment.Environment.")
    if isinstance(environment.measure_names, str):
        raise ConfigError(f"robot '{name}': measure_names must be a tuple of names, not one text.")
    return environment._replace(name=name, measure_names=tuple(environment.measure_names))


def robot_names() -> tuple[str, ...]:
    """The names of all robots, built-in ones first. Raises ConfigError for a plugin that cannot be loaded."""
    plugins.load()
    return tuple(_ROBOTS)


def find(name: str) -> Robot:
    """The robot of this name. Raises ConfigError if there is none."""
    if name not in robot_names():
        raise ConfigError(f"unknown robot '{name}'; choose one of {', '.join(robot_names())}.")
    return _ROBOTS[name]


def count_measures(name: str) -> int:
    """k, the number of a robot's measures. Raises ConfigError for an unknown robot."""
    return len(find(name).measure_names)


def backends_of(name: str) -> tuple[str, ...]:
    """The simulators that a robot runs on, the default first. Raises ConfigError for an unknown robot."""
    environment = find(name).environment
    return BACKENDS if environment is None else (environment.backend,)


def make(name: str, backend: str | None = None) -> Environment:
    """The simulated robot of this name, on its default backend if ``backend`` is None.

    Raises ConfigError for an unknown robot or backend, and for feet that are not links of the robot.
    """
    robot, backends = find(name), backends_of(name)
    if backend is not None and backend not in backends:
        raise ConfigError(f"unknown backend '{backend}' of {name}; choose one of {', '.join(backends)}.")
    if robot.environment is not None:
        return robot.environment
    from qdil.robots import brax_robots

    return brax_robots.make(robot, backend or backends[0])
