"""The recorded demonstrations: read for every robot that has some, and summed up as in Table 3."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from qdil.config import make_config
from qdil.errors import ConfigError
from qdil.robots import register
from qdil.runs.folder import RESULTS, demos_of, folder_of

Demos = dict[str, np.ndarray]  # a demonstrations file's columns: some have a row per step, some a row per episode


def of_robots(budget: str, seed: int = 1, root: Path = RESULTS) -> dict[str, Demos]:
    """The demonstrations of the experts with this seed, by robot, in the budget's usual number.

    A robot without a file is left out.
    """
    paths = {env: demos_of(make_config(env, "true", budget, seed), root) for env in sorted(register.robot_names())}
    return {env: read(path) for env, path in paths.items() if path.is_file()}


def record_missing(env: str, budget: str, seed: int = 1, root: Path = RESULTS) -> str:
    """Record the demonstrations of the expert with this seed, if there are none and its policies are on this machine.

    Returns a sentence about the outcome. Recording imports JAX.
    """
    config = make_config(env, "true", budget, seed)
    path = demos_of(config, root)
    if path.is_file():
        return f"loaded, they were recorded earlier: {path}"
    from qdil.runs.demos import make_demos

    try:
        make_demos(env, budget, config.demos.demo_episodes, seed, folder_of("true", env, budget, seed, root), path)
    except ConfigError as error:
        return f"none recorded: {error}"
    return f"recorded just now: {path}"


def read(path: Path) -> Demos:
    """All columns of a demonstrations file, as ``qdil demos`` wrote it."""
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def episodes(demos: Demos, robot: str) -> pd.DataFrame:
    """A row per demonstration: steps, return and measures of the recorded episode, and those of the demonstrator.

    The demonstrator's are means over fresh episodes, by which it was selected (in files of earlier versions: those that
    won its cell). ``falls`` counts the simulated episodes that ended in a fall; such files lack it.
    """
    elite, recorded = (demos[name].astype(float) for name in ("elite_measures", "episode_measures"))
    table = {
        "steps (rows)": np.bincount(demos["episode"]),
        "return": demos["episode_return"].astype(float),
        "return, as selected": demos["elite_return"].astype(float),
    }
    for j, foot in enumerate(register.find(robot).measure_names):
        table[f"{foot} down"], table[f"{foot} down, as selected"] = recorded[:, j], elite[:, j]
    if "falls" in demos:
        table[f"falls of {demos['demo_attempts']}"] = demos["falls"]
    return pd.DataFrame(table, index=pd.RangeIndex(1, len(recorded) + 1, name="demonstration"))


def summary(by_robot: Mapping[str, Demos]) -> pd.DataFrame:
    """A row per robot, in the manner of Table 3: episodes, rows, widths, mean length and return (± deviation)."""
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
    """Mean ± standard deviation; a single value alone."""
    return f"{values.mean():,.0f}" + (f" ± {values.std(ddof=1):,.0f}" if len(values) > 1 else "")


def luck(archives: Mapping[str, Mapping[str, np.ndarray]]) -> pd.DataFrame:
    """A row per archive: the average return as archived and over fresh episodes, and how far elites moved.

    The move is the median distance between an elite's archived measures and those of its fresh episodes, in units of
    the measure space.
    """
    rows = {}
    for name, archive in archives.items():
        archived, fresh = (float(archive[which].mean()) for which in ("true_return", "rescored_return"))
        moved = np.linalg.norm(archive["measures"] - archive["rescored_measures"], axis=1)
        rows[name] = [archived, fresh, 100 * (fresh / archived - 1), float(np.median(moved))]
    columns = ["average, as archived", "average, scored again", "change, %", "move in behaviour space"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns)


def one_step(demos: Demos, row: int) -> pd.DataFrame:
    """One stored step, a row per part: how many numbers it has, and the first of them."""
    titles = {"obs": "state sₜ", "action": "action aₜ", "next_obs": "next state sₜ₊₁", "proxy": "contacts δ(sₜ)"}
    parts = {
        title: [len(demos[name][row]), "  ".join(f"{x:.2f}" for x in demos[name][row][:6])]
        for name, title in titles.items()
    }
    return pd.DataFrame.from_dict(parts, orient="index", columns=["numbers", "the first of them"])
