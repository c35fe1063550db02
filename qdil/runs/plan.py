"""The runs of the evidence, in the order in which they are trained. ``docs/protocol.md`` shows them. No JAX here."""

from typing import NamedTuple

from qdil.robots.register import PAPER_ROBOTS
from qdil.runs.experiments import FIRST_SEEDS, RESERVE_SEEDS
from qdil.runs.studies import experiments_of, under

THREE = FIRST_SEEDS[:3]


class Stage(NamedTuple):
    """Some experiments on some robots: every experiment gets the same seeds."""

    budget: str
    robots: tuple[str, ...]
    experiments: tuple[str, ...]
    seeds: tuple[int, ...]  # trained in any case
    further: tuple[int, ...]  # trained where a comparison stays inconclusive


def _of(*studies: str) -> tuple[str, ...]:
    return experiments_of(studies, "laptop")


OTHERS = tuple(robot for robot in PAPER_ROBOTS if robot != "walker2d")
METHODS = (  # every method once
    *("true", "gail", "mcond-gail", "mbo-gail", "mconbo-gail", "vail", "mconbo-vail", "mconbo-gail-obs"),
    *("mbo-true", "airl", "giril", "pwil", "maxent"),
)
CORE = tuple(dict.fromkeys((*METHODS, *_of("protocols", "later"))))
DETAILS = tuple(
    name for name in _of("every-base", "p-and-q", "demonstrations", "survival", "released") if name not in CORE
)
AT_DESK = (
    *(under(name, protocol) for protocol in ("paper", "released") for name in ("true", "gail", "mconbo-gail")),
    *("mbo-gail", "gail+protocol=improved", "mconbo-gail+protocol=improved"),
)
PLAN = (
    Stage("laptop", ("walker2d",), CORE, FIRST_SEEDS, RESERVE_SEEDS),
    Stage("laptop", OTHERS, CORE, THREE, FIRST_SEEDS[3:]),
    Stage("desk", ("walker2d",), AT_DESK, THREE, ()),
    Stage("desk", ("humanoid",), AT_DESK, THREE, ()),
    Stage("laptop", ("walker2d",), DETAILS, THREE, FIRST_SEEDS[3:] + RESERVE_SEEDS),
)


def planned(budget: str, robot: str) -> tuple[str, ...]:
    """The experiments that are planned for a robot at a budget, in order, each once."""
    names = (name for stage in PLAN if stage.budget == budget and robot in stage.robots for name in stage.experiments)
    return tuple(dict.fromkeys(names))
