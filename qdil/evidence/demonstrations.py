"""What the kept demonstrations are: read for every robot that has some, and summed up as in Table 3."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from qdil.config import make_config
from qdil.errors import ConfigError
from qdil.robots import register
from qdil.runs.demos import make_demos
from qdil.runs.experiments import EXPERT_SEED
from qdil.runs.folder import RESULTS, demos_path, folder_of

Demos = dict[str, np.ndarray]  # a demonstrations file's columns, a row per step, and what it says per episode


def of_robots(budget: str, root: Path = RESULTS) -> dict[str, Demos]:
    """The demonstrations of the budget's usual number, by robot, of those robots that have a file."""
    paths = {
        env: demos_path(budget, env, make_config(env, "true", budget).demos.demo_episodes, root)
        for env in sorted(register.robot_names())
    }
    return {env: read(path) for env, path in paths.items() if path.is_file()}


def record_missing(env: str, budget: str, root: Path = RESULTS) -> str:
    """Record a robot's demonstrations if there are none and its expert's policies are here; what happened, in words."""
    expert = make_config(env, "true", budget, EXPERT_SEED)
    path, folder = (
        demos_path(budget, env, expert.demos.demo_episodes, root),
        folder_of("true", env, budget, expert.seed, root),
    )
    if path.is_file():
        return f"loaded, they were recorded earlier: {path}"
    try:
        make_demos(env, budget, expert.demos.demo_episodes, EXPERT_SEED, folder, path)
    except ConfigError as error:
        return f"none recorded: {error}"
    return f"recorded just now: {path}"


def read(path: Path) -> Demos:
    """All columns of a demonstrations file, as ``qdil demos`` wrote it."""
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def episodes(demos: Demos, robot: str) -> pd.DataFrame:
    """A row per demonstration: steps, return and measures of the recorded episode, and what the archive said of it."""
    elite, recorded = (demos[name].astype(float) for name in ("elite_measures", "episode_measures"))
    table = {
        "steps (rows)": np.bincount(demos["episode"]),
        "return": demos["episode_return"].astype(float),
        "return in the archive": demos["elite_return"].astype(float),
    }
    for j, foot in enumerate(register.find(robot).measure_names):
        table[f"{foot} down"], table[f"{foot} down in the archive"] = recorded[:, j], elite[:, j]
    return pd.DataFrame(table, index=pd.RangeIndex(1, len(recorded) + 1, name="demonstration"))


def summary(by_robot: Mapping[str, Demos]) -> pd.DataFrame:
    """A row per robot, as Table 3 might have had it: episodes, rows, widths, mean length and return (± deviation)."""
    rows = {}
    for robot, demos in by_robot.items():
        lengths, returns = np.bincount(demos["episode"]), demos["episode_return"]
        rows[robot] = {
            "demonstrations": len(lengths),
            "rows": len(demos["obs"]),
            "numbers per state": demos["obs"].shape[1],
            "numbers per action": demos["action"].shape[1],
            "steps per episode": _spread(lengths),
            "return per episode": _spread(returns),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("robot")


def _spread(values: np.ndarray) -> str:
    """Mean ± standard deviation, of a single value the value alone."""
    return f"{values.mean():,.0f}" + (f" ± {values.std(ddof=1):,.0f}" if len(values) > 1 else "")


def luck(archives: Mapping[str, Mapping[str, np.ndarray]]) -> pd.DataFrame:
    """A row per archive: its average return as archived and over fresh episodes, and how far elites moved there.

    The move is the median distance between an elite's measures and its fresh ones, in units of the behaviour space.
    """
    rows = {}
    for name, archive in archives.items():
        before, after = (float(archive[which].mean()) for which in ("true_return", "rescored_return"))
        moved = np.linalg.norm(archive["measures"] - archive["rescored_measures"], axis=1)
        rows[name] = [before, after, 100 * (after / before - 1), float(np.median(moved))]
    columns = ["average, as archived", "average, scored again", "change, %", "move in behaviour space"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns)


def one_step(demos: Demos, row: int) -> pd.DataFrame:
    """What is stored of one step, a row per part: its shape and its first numbers."""
    says = {
        "obs": "state sₜ",
        "action": "action aₜ",
        "next_obs": "next state sₜ₊₁",
        "proxy": "contacts δ(sₜ)",
    }
    parts = {
        said: [len(demos[name][row]), "  ".join(f"{x:.2f}" for x in demos[name][row][:6])]
        for name, said in says.items()
    }
    return pd.DataFrame.from_dict(parts, orient="index", columns=["numbers", "the first of them"])
