"""The archives that the explorer shows, from run folders or from memory, checked; and as JSON for the front end."""

import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdil.errors import ConfigError
from qdil.explorer import rollouts
from qdil.explorer.projection import axes_choices, best_rows
from qdil.explorer.rollouts import Rollout
from qdil.imitation.demos import farthest_points, top_fifth
from qdil.names import title
from qdil.qd import landing
from qdil.rl.evaluate import Policies
from qdil.robots import brax_robots, register, shapes
from qdil.runs.folder import demos_name, read_archive, read_config

NEEDED = ("index", "measures", "fitness", "true_return", "length", "cells")
POLICY = ("solution", "obs_mean", "obs_std")
FRESH = ("rescored_return", "rescored_measures")
Archive = Mapping[str, Any]
Runs = str | Path | Archive | Sequence[Any] | Mapping[str, Any]


class Shown(NamedTuple):
    """One archive, and what the explorer shows with it."""

    name: str  # what menus call it
    config: Mapping[str, Any] | None  # the run's settings; None for an archive of unknown origin
    archive: Archive  # arrays as ``read_archive`` returns them, with the policies if the machine has them
    demonstrators: np.ndarray  # (d, k) measures of the demonstrators
    # New elites in order: iteration, index, true_return and fitness (n,), and iterations (), how many the run had; from
    # ``history.npz`` beside the archive (``qdil.qd.history``). None if the run kept none.
    history: Mapping[str, np.ndarray] | None
    why: str  # why its robots cannot be shown; empty if they can

    @property
    def k(self) -> int:
        """The number of measures, one for each foot."""
        return len(self.archive["cells"])

    @property
    def plays(self) -> bool:
        """Whether its robots can be rolled out and drawn."""
        return not self.why

    @property
    def feet(self) -> list[str]:
        """The names of the k feet."""
        if self.config:
            return list(register.find(self.config["env"]).measure_names)
        return [f"foot {i + 1}" for i in range(self.k)]


def read(runs: Runs, config: Mapping[str, Any] | None = None) -> list[Shown]:
    """The archives to show, in the order given.

    ``runs``: a run's folder; an archive in memory (with ``config``, the settings of its run, its robots can walk too);
    several of either, in a sequence or a mapping by name (a method's name is spelled as the paper does); or a mapping
    of names to sequences of folders, one per seed, of which the first is shown. Raises ConfigError for anything else,
    for no archive at all, for archives without 1 to 6 measures, and for runs of different robots.
    """
    found = [_one(name, what, config) for name, what in _named(runs)]
    if not found:
        raise ConfigError("there is no run to explore.")
    robots = {shown.config["env"] for shown in found if shown.config}
    if len(robots) > 1:
        raise ConfigError(f"these runs are of different robots ({', '.join(sorted(robots))}): explore them one by one.")
    if len({shown.k for shown in found}) > 1:
        measures = ", ".join(f"'{shown.name}' has {shown.k}" for shown in found)
        raise ConfigError(f"these archives have different numbers of measures ({measures}): explore them one by one.")
    return found


def _named(runs: Runs) -> list[tuple[str, Any]]:
    if isinstance(runs, str | Path):
        return [("", runs)]
    if isinstance(runs, Mapping):
        if "index" in runs:
            return [("", runs)]
        firsts = [(name, what) for name, what in runs.items() if not _is_several(what) or len(what)]
        return [(str(name), what[0] if _is_several(what) else what) for name, what in firsts]
    if _is_several(runs):
        return [("", what) for what in runs]
    raise ConfigError(f"'{type(runs).__name__}' cannot be explored: give a run's folder or an archive.")


def _is_several(what: Any) -> bool:
    return isinstance(what, Sequence) and not isinstance(what, str)


def _one(name: str, what: Any, config: Mapping[str, Any] | None) -> Shown:
    if isinstance(what, Mapping):
        why = "" if config and all(field in what for field in POLICY) else "no policies in this archive"
        return _checked(Shown(name or "archive", config, what, np.zeros((0, 0)), None, why))
    if not isinstance(what, str | Path):
        raise ConfigError(f"'{type(what).__name__}' cannot be explored: give a run's folder or an archive.")
    folder = Path(what)
    settings = read_config(folder)
    why = "" if (folder / "policies.npz").is_file() else "its policies are not on this machine"
    archive = read_archive(folder, policies=not why)
    method = str(settings["method"])
    named = title(method) if name in ("", method) else name
    return _checked(Shown(named, settings, archive, _demonstrators(folder, settings), _history(folder), why))


def _checked(shown: Shown) -> Shown:
    missing = [field for field in NEEDED if field not in shown.archive]
    if missing:
        raise ConfigError(f"the archive '{shown.name}' has no {', '.join(missing)}.")
    if not 1 <= shown.k <= register.MOST_MEASURES:
        raise ConfigError(f"the explorer draws 1 to {register.MOST_MEASURES} measures; '{shown.name}' has {shown.k}.")
    if not shown.config:
        return shown
    env = shown.config["env"]
    if env not in register.robot_names():
        raise ConfigError(f"'{shown.name}' is of the unknown robot '{env}'.")
    if shown.k != register.count_measures(env):
        raise ConfigError(f"measures of '{shown.name}': {shown.k}; of {env}: {register.count_measures(env)}.")
    if shown.plays and robot(env) is None:
        return shown._replace(why=f"the robot {env} has no shapes to draw")
    return shown


def _demonstrators(folder: Path, config: Mapping[str, Any]) -> np.ndarray:
    """Measures (d, k) of the demonstrators in the file beside the run; without one, an array without rows."""
    name = demos_name(config.get("demo_episodes", 4), config.get("expert_seed") or config.get("seed", 1))
    for place in (folder.parent.parent, folder.parent, folder):
        path = place / name
        if path.is_file():
            with np.load(path, allow_pickle=False) as file:
                return file["elite_measures"] if "elite_measures" in file.files else np.zeros((0, 0))
    return np.zeros((0, 0))


def _history(folder: Path) -> Mapping[str, np.ndarray] | None:
    path = folder / "history.npz"
    if not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def roll_out(shown: Shown, cells: Sequence[int], seed: int = 0) -> list[Rollout]:
    """An episode of the elite of each of ``cells`` (cell numbers). Raises ConfigError for an empty cell."""
    if not shown.plays or shown.config is None:
        raise ConfigError(f"'{shown.name}' cannot be played: {shown.why}.")
    index = np.asarray(shown.archive["index"])
    for cell in cells:
        if cell not in index:
            raise ConfigError(f"cell {cell} of '{shown.name}' is empty.")
    rows = [int(np.flatnonzero(index == cell)[0]) for cell in cells]
    policies = Policies(*(np.asarray(shown.archive[name])[rows] for name in POLICY))  # type: ignore[arg-type]
    return rollouts.play(shown.config, policies, seed)


def best_cell(shown: Shown) -> int:
    """The cell with the highest true return; 0 in an empty archive."""
    returns = np.asarray(shown.archive["true_return"])
    return int(shown.archive["index"][np.argmax(returns)]) if len(returns) else 0


def spread_out(shown: Shown, count: int) -> list[int]:
    """At most ``count`` cells spread over the archive, the best first: farthest points in measures.

    All are cells that a click can choose: the best of a square on the map of some axes.
    """
    archive = shown.archive
    rows = np.unique(np.concatenate([best_rows(archive, axes) for axes in axes_choices(shown.k)]))
    if not len(rows):
        return []
    best_first = rows[np.argsort(-np.asarray(archive["true_return"])[rows], kind="stable")]
    points = np.asarray(archive["measures"], float)[best_first]
    chosen = best_first[farthest_points(points, min(count, len(points)))]
    return [int(cell) for cell in np.asarray(archive["index"])[chosen]]


def content(runs: Sequence[Shown], playable: Sequence[Sequence[int]] | None = None) -> dict[str, Any]:
    """What the front end shows of ``runs``, as JSON's plain values.

    ``playable``: for each run the cells that a page has recordings of; None where a kernel can play any.
    """
    env = next((shown.config["env"] for shown in runs if shown.config), None)
    feet = next((shown.feet for shown in runs if shown.config), runs[0].feet)
    values: dict[str, Any] = {
        "robot": robot(env) if env else None,
        "runs": [_run_content(shown, feet) for shown in runs],
    }
    if playable is not None:
        values["playable"] = [list(cells) for cells in playable]
    return json.loads(json.dumps(values))


def _run_content(shown: Shown, feet: list[str]) -> dict[str, Any]:
    archive = shown.archive
    returns = np.asarray(archive["true_return"], float)
    is_expert = bool(shown.config) and shown.config is not None and shown.config.get("method") == "true"
    top = np.asarray(archive["index"])[top_fifth(returns, int(np.prod(archive["cells"])))] if is_expert else []
    return {
        "name": shown.name,
        "feet": feet,
        "cells": [int(n) for n in archive["cells"]],
        "index": [int(cell) for cell in archive["index"]],
        "measures": _rounded(archive["measures"]),
        **{name: _rounded(archive[name]) for name in ("true_return", "fitness", "length")},
        "demonstrators": _rounded(shown.demonstrators),
        "top": [int(cell) for cell in top],
        "best": best_cell(shown),
        "plays": shown.plays,
        "why": shown.why,
        "history": _history_content(shown.history),
        "fresh": _fresh_content(archive),
    }


def _fresh_content(archive: Archive) -> dict[str, Any] | None:
    """Mean returns over fresh episodes and the cells where elites land; None if they were not scored again.

    An elite without a finite score has return None and lands in ``landing.ELSEWHERE``.
    """
    if not all(name in archive for name in FRESH):
        return None
    cells = landing.landing_cells(archive)
    returns = [value if np.isfinite(value) else None for value in _rounded(archive["rescored_return"])]
    return {"true_return": returns, "cell": [int(cell) for cell in cells]}


def _history_content(history: Mapping[str, np.ndarray] | None) -> dict[str, Any] | None:
    if history is None:
        return None
    return {
        "iteration": history["iteration"].tolist(),
        "index": history["index"].tolist(),
        **{name: _rounded(history[name]) for name in ("true_return", "fitness")},
        "last": int(history["iterations"]),
    }


def _rounded(values: Any) -> Any:
    """Numbers to four decimals: short in a page, and finer than any text or colour."""
    return np.round(np.asarray(values, float), 4).tolist()


@cache
def robot(env: str) -> dict[str, Any] | None:
    """A robot's capsules for the front end: link numbers, ends in the links' frames, metres.

    None for a robot without capsules and for a user's own environment, which has no model to read shapes from.
    """
    if register.find(env).environment is not None:
        return None
    body, pose = shapes.shapes(env), shapes.first_pose(env)
    if not len(body.link):
        return None
    ends = shapes.placed(body, pose)
    around = body.radius[:, None, None]
    low, high = (ends - around).min(axis=(0, 1)), (ends + around).max(axis=(0, 1))
    leg = legs(env)
    capsules = [
        {"link": int(link), "ends": _rounded(two.ravel()), "radius": round(float(radius), 4), "foot": int(foot),
         "leg": int(leg[link])}
        for link, two, radius, foot in zip(*body, strict=True)
    ]  # fmt: skip
    return {
        "name": env,
        "feet": list(register.find(env).measure_names),
        "links": len(pose.position),
        "capsules": capsules,
        # Metres for the camera to hold: the height, or what fits from any side of the horizontal extent.
        "size": round(float(max(high[2] - low[2], 0.75 * np.hypot(*(high - low)[:2]))), 3),
        "middle": round(float(low[2] + high[2]) / 2, 3),
        "torso": round(float(pose.position[0, 2]), 3),
    }


@cache
def legs(env: str) -> np.ndarray:
    """(L,) for every link the foot whose leg it is part of; -1 for the root and for links of no leg or of several."""
    model, body = brax_robots.model(register.find(env)), shapes.shapes(env)
    chains: list[set[int]] = []
    for foot in range(register.count_measures(env)):
        chain = set[int]()
        for link in np.unique(body.link[body.foot == foot]):
            number = int(link) + 1  # MuJoCo's body 0 is the world
            while number > 0 and model.body_parentid[number] > 0:
                chain.add(number - 1)
                number = int(model.body_parentid[number])
        chains.append(chain)
    leg = np.full(model.nbody - 1, -1)
    for foot, chain in enumerate(chains):
        leg[list(chain.difference(*(other for i, other in enumerate(chains) if i != foot)))] = foot
    return leg
