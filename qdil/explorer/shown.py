"""What the explorer shows: runs from their folders or archives from memory, checked, and as plain values."""

import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdil.errors import ConfigError
from qdil.explorer import rollouts
from qdil.explorer.rollouts import Rollout
from qdil.imitation.demos import farthest_points, top_fifth
from qdil.names import title
from qdil.rl.evaluate import Policies
from qdil.robots import brax_robots, register, shapes
from qdil.runs.folder import read_archive, read_config

NEEDED = ("index", "measures", "fitness", "true_return", "length", "cells")
POLICY = ("solution", "obs_mean", "obs_std")
Archive = Mapping[str, Any]
Runs = str | Path | Archive | Sequence[Any] | Mapping[str, Any]


class Shown(NamedTuple):
    """One archive with all that the explorer says of it."""

    name: str  # what menus call it
    config: Mapping[str, Any] | None  # the run's settings; None for an archive of unknown origin
    archive: Archive  # arrays as ``read_archive`` gives them, policies among them where they are there
    demonstrators: np.ndarray  # (d, 2) measures of the demonstrators
    # New elites in order: iteration, index, true_return and fitness (n,), and iterations (), how many the run had; from
    # ``history.npz`` beside the archive (``qdil.qd.history``). None if the run kept none.
    history: Mapping[str, np.ndarray] | None
    why: str  # why robots cannot be shown; empty where they can

    @property
    def plays(self) -> bool:
        """Whether there are policies to roll out."""
        return not self.why


def read(runs: Runs, config: Mapping[str, Any] | None = None) -> list[Shown]:
    """The archives to show, in the order given.

    ``runs``: a run's folder; an archive in memory (with ``config``, the settings of its run, its robots can walk too);
    several of either, in a sequence or a mapping by name (a method's name is spelled as the paper does); or a mapping
    of names to sequences of folders, one per seed, of which the first is shown. Raises ConfigError for what is none of
    these, for nothing at all, for archives without two measures, and for runs of different robots.
    """
    found = [_one(name, what, config) for name, what in _named(runs)]
    if not found:
        raise ConfigError("there is no run to explore.")
    robots = {shown.config["env"] for shown in found if shown.config}
    if len(robots) > 1:
        raise ConfigError(f"these runs are of different robots ({', '.join(sorted(robots))}): explore them one by one.")
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
        return _checked(Shown(name or "archive", config, what, np.zeros((0, 2)), None, why))
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
    if len(shown.archive["cells"]) != 2:
        raise ConfigError(f"the explorer draws two measures; '{shown.name}' has {len(shown.archive['cells'])}.")
    if shown.config and shown.config["env"] not in register.robot_names():
        raise ConfigError(f"'{shown.name}' is of the unknown robot '{shown.config['env']}'.")
    return shown


def _demonstrators(folder: Path, config: Mapping[str, Any]) -> np.ndarray:
    """Measures (d, 2) of the demonstrators that lie beside the run, (0, 2) where none do."""
    for place in (folder.parent.parent, folder.parent, folder):
        path = place / f"demos-{config.get('demo_episodes', 4)}.npz"
        if path.is_file():
            with np.load(path, allow_pickle=False) as file:
                return file["elite_measures"] if "elite_measures" in file.files else np.zeros((0, 2))
    return np.zeros((0, 2))


def _history(folder: Path) -> Mapping[str, np.ndarray] | None:
    path = folder / "history.npz"
    if not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def roll_out(shown: Shown, cells: Sequence[int], seed: int = 0) -> list[Rollout]:
    """An episode of the elite of each of ``cells`` (numbers of cells). Raises ConfigError for a cell without one."""
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
    """At most ``count`` filled cells spread over the archive, the best first: farthest points in measures."""
    points = np.asarray(shown.archive["measures"], float).reshape(-1, 2)
    if not len(points):
        return []
    best_first = np.argsort(-np.asarray(shown.archive["true_return"]), kind="stable")
    chosen = best_first[farthest_points(points[best_first], min(count, len(points)))]
    return [int(cell) for cell in np.asarray(shown.archive["index"])[chosen]]


def told(runs: Sequence[Shown], playable: Sequence[Sequence[int]] | None = None) -> dict[str, Any]:
    """All that the front end needs to know, as JSON's plain values.

    ``playable``: for each run the cells that a page has recordings of; None where a kernel can play any.
    """
    env = next((shown.config["env"] for shown in runs if shown.config), None)
    feet = list(register.find(env).measure_names) if env else ["foot 1", "foot 2"]
    content: dict[str, Any] = {"robot": robot(env) if env else None, "runs": [_told(shown, feet) for shown in runs]}
    if playable is not None:
        content["playable"] = [list(cells) for cells in playable]
    return json.loads(json.dumps(content))


def _told(shown: Shown, feet: list[str]) -> dict[str, Any]:
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
        "history": _told_history(shown.history),
    }


def _told_history(history: Mapping[str, np.ndarray] | None) -> dict[str, Any] | None:
    if history is None:
        return None
    return {
        "iteration": history["iteration"].tolist(),
        "index": history["index"].tolist(),
        **{name: _rounded(history[name]) for name in ("true_return", "fitness")},
        "last": int(history["iterations"]),
    }


def _rounded(values: Any) -> Any:
    """Numbers short enough for a page, and exact enough that nothing shown changes."""
    return np.round(np.asarray(values, float), 4).tolist()


@cache
def robot(env: str) -> dict[str, Any]:
    """A robot's capsules for the front end: link numbers, ends in the links' frames, metres."""
    body, pose = shapes.shapes(env), shapes.first_pose(env)
    ends = shapes.placed(body, pose)
    around = body.radius[:, None, None]
    low, high = (ends - around).min(axis=(0, 1)), (ends + around).max(axis=(0, 1))
    side = legs(env)
    capsules = [
        {"link": int(link), "ends": _rounded(two.ravel()), "radius": round(float(radius), 4), "foot": int(foot),
         "side": int(side[link])}
        for link, two, radius, foot in zip(*body, strict=True)
    ]  # fmt: skip
    return {
        "name": env,
        "feet": list(register.find(env).measure_names),
        "links": len(pose.position),
        "capsules": capsules,
        "size": round(float(max(high[2] - low[2], 0.75 * (high[0] - low[0]))), 3),
        "middle": round(float(low[2] + high[2]) / 2, 3),
        "torso": round(float(pose.position[0, 2]), 3),
    }


@cache
def legs(env: str) -> np.ndarray:
    """(L,) for every link the number of the foot whose leg it is part of, -1 for what the legs share or lack."""
    model = brax_robots.model(env)
    names = [model.body(i).name for i in range(model.nbody)]
    chains: list[set[int]] = []
    for foot in register.find(env).measure_names:
        chain, body = set[int](), names.index(foot)
        while body > 0:
            chain.add(body - 1)
            body = int(model.body_parentid[body])
        chains.append(chain)
    side = np.full(model.nbody - 1, -1)
    for k, chain in enumerate(chains):
        side[list(chain.difference(*(other for i, other in enumerate(chains) if i != k)))] = k
    return side
