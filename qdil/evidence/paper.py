"""The paper's numbers, as far as the copy at hand has them: its tables have no bodies, some figures can be read off.

``paper_numbers.csv`` holds each number with its source. Two origins are kept apart here. ``PAPER`` is the paper's own
figures and its authors' result files. ``LATER`` is the table of the paper's later version (ICML 2025). Its methods
differ: "EBC-GAIL" is GAIL with the bonus, p = 0 and q = 2, without measure conditioning. A later number never replaces
the paper's.
"""

from functools import cache
from importlib.resources import files
from typing import NamedTuple

import pandas as pd

PAPER, LATER = "paper", "later version"
METRICS = ("qd_score", "coverage", "best", "average")
NOT_RECOVERABLE = "not recoverable"
NOT_IN_PAPER = "not in the paper"
# The later version's name for each of its methods; it has no measure conditioning, so no ``mconbo-`` arm.
LATER_NAMES = {
    **{base: base for base in ("gail", "vail", "diffail")},
    **{f"mbo-{base}": f"ebc-{base}" for base in ("gail", "vail", "diffail")},
}
# Experiments of the paper on all three robots, whether or not their numbers are known (Figs. 5, 8, 11, 15, Table 1).
EVERYWHERE = (
    *("true", "gail", "mcond-gail", "mconbo-gail", "mconbo-gail-obs", "vail", "mconbo-vail"),
    *("airl", "giril", "pwil", "maxent"),
)
ON_ONE_ROBOT = {  # experiments of the paper on a single robot (Figs. 12 to 14, 16)
    "mbo-true": "humanoid",
    **{f"{name}+demo_episodes={n}": "walker2d" for name in ("gail", "mconbo-gail") for n in (1, 2)},
    "mconbo-gail+demo_episodes=10": "walker2d",
}


class Spread(NamedTuple):
    """How far a number of the paper spreads over its seeds."""

    value: float  # in reward units, of coverage as a share of the cells
    kind: str  # such as "standard error"
    seeds: int


def has(env: str, experiment: str) -> bool:
    """Whether the paper has runs of an experiment on a robot. Fig. 10 (p and q) names no robot: true for any."""
    method, *settings = experiment.split("+")
    if method == "mconbo-gail" and settings and all(text.startswith(("bonus_p=", "bonus_q=")) for text in settings):
        return True
    return experiment in EVERYWHERE or ON_ONE_ROBOT.get(experiment) == env


@cache
def _numbers() -> pd.DataFrame:
    table = pd.read_csv(str(files("qdil.evidence") / "paper_numbers.csv"))
    iteration = table["note"].str.extract(r"at iteration (\d+)", expand=False)
    return table.assign(iteration=pd.to_numeric(iteration), origin=table["source"].map(_origin))


def _origin(source: str) -> str:
    return LATER if source.startswith("later version") else PAPER


def numbers() -> pd.DataFrame:
    """A row per number: source, environment, method, n_demos, n_seeds, metric, value, spread, spread_kind, note.

    ``coverage_pct`` is in percent, every other metric in reward units. Two columns are ours: ``origin`` (``PAPER`` or
    ``LATER``) and ``iteration`` (of numbers from the middle of a run; empty: its end).
    """
    return _numbers().copy()


def value(env: str, method: str, metric: str, n_demos: int = 4, origin: str = PAPER) -> float | None:
    """The paper's number for the end of a method's runs, a mean over seeds; None if it is not recoverable.

    ``metric`` is one of ``METRICS``; coverage is a share of the cells, as everywhere here. A method without
    demonstrations has the same number for any ``n_demos``. ``origin=LATER`` gives the later version's number for the
    same method (``LATER_NAMES``). Raises ValueError for an unknown metric or origin.
    """
    found = _found(env, method, metric, n_demos, origin)
    scale = 100.0 if metric == "coverage" else 1.0
    return None if found.empty else float(found["value"].mean()) / scale


def spread(env: str, method: str, metric: str, n_demos: int = 4, origin: str = PAPER) -> Spread | None:
    """How far the number that ``value`` gives spreads over its seeds; None if unknown."""
    found = _found(env, method, metric, n_demos, origin).dropna(subset="spread")
    if len(found) != 1:
        return None
    row = found.iloc[0]
    scale = 100.0 if metric == "coverage" else 1.0
    return Spread(float(row["spread"]) / scale, str(row["spread_kind"]), int(row["n_seeds"]))


def _found(env: str, method: str, metric: str, n_demos: int, origin: str) -> pd.DataFrame:
    if metric not in METRICS:
        raise ValueError(f"unknown metric '{metric}'; the paper has {', '.join(METRICS)}.")
    if origin not in (PAPER, LATER):
        raise ValueError(f"unknown origin '{origin}'; choose '{PAPER}' or '{LATER}'.")
    table = _numbers()
    name = LATER_NAMES.get(method) if origin == LATER else method
    of_metric = table["metric"] == ("coverage_pct" if metric == "coverage" else metric)
    at_end = table["iteration"].isna()
    with_demos = table["n_demos"].isna() | (table["n_demos"] == n_demos)
    same = (table["environment"] == env) & (table["method"] == name) & (table["origin"] == origin)
    return table[same & of_metric & with_demos & at_end]


def expert_progress(env: str) -> pd.Series:
    """The QD-score of the paper's expert by QD iteration, as far as known, the last iteration included."""
    table = _numbers()
    known = table[(table["environment"] == env) & (table["method"] == "true") & (table["metric"] == "qd_score")]
    ends = known["note"].str.extract(r"iteration (\d+)", expand=False).astype(int)
    return pd.Series(known["value"].to_numpy(), index=pd.Index(ends, name="iteration"), name="qd_score").sort_index()
