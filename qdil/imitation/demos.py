"""Demonstrations files: reading, checking and writing them; ``recording`` simulates what they hold.

A "demonstrator" is an elite of the expert's archive that was chosen; a "demonstration" is one episode of it.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from qdil.files import write_npz
from qdil.imitation.reward_model import Demonstrations
from qdil.imitation.selection import farthest_points as farthest_points
from qdil.imitation.selection import select as select
from qdil.imitation.selection import top_fifth as top_fifth
from qdil.robots.environment import Environment

FIELDS = ("obs", "action", "next_obs", "proxy")  # columns of a file that every reward model's ``Demonstrations`` has
MATCHED = {  # settings that a file records, so that a run learns from what its configuration names
    "demo_episodes": "{found} demonstrations, not {wanted}",
    "demo_attempts": "episodes chosen from {found} of each demonstrator, not {wanted}",
    "expert_seed": "demonstrations of the expert of seed {found}, not {wanted}",
}


def save(path: Path, recorded: dict[str, np.ndarray], env: Environment) -> None:
    """Write recorded episodes, with the robot's name and backend, to an .npz file."""
    write_npz(path, **recorded, robot=np.array(env.name), backend=np.array(env.backend))


def load(
    path: Path,
    robot: str,
    backend: str,
    needs_actions: bool = True,
    alignment: str = "aligned",
    seed: int = 0,
    expected: Mapping[str, int] | None = None,
) -> Demonstrations:
    """Read and check a demonstrations file of ``robot`` on ``backend``.

    With ``needs_actions`` False, a file without an ``action`` column, or with one of width 0, is accepted.
    ``alignment`` "shifted" pairs states and actions as the authors' released program does (``shifted``), with delays
    drawn from ``seed``. ``expected``: values of the settings ``MATCHED`` that the file must have been recorded with. A
    setting that the file does not name is not checked: files of earlier versions and of other sources name fewer.

    Raises ValueError in one sentence for a missing or unreadable file, for demonstrations of another robot or backend,
    for missing columns, unequal numbers of rows, no rows, settings other than ``expected``, or numbers that are not
    finite.
    """
    if not path.is_file():
        raise ValueError(f"no demonstrations at {path}: make them with 'qdil demos --env {robot}'.")
    data = _columns(path, (*FIELDS, "episode") if alignment == "shifted" else FIELDS)
    if str(data["robot"]) != robot or str(data["backend"]) != backend:
        raise ValueError(
            f"{path} holds demonstrations of {data['robot']} on {data['backend']}, not of {robot} on {backend}."
        )
    if needs_actions and data["action"].shape[1:] == (0,):
        raise ValueError(f"{path} has no actions: only the methods that end in -obs can learn from it.")
    _check_settings(path, data, expected or {})
    if alignment == "shifted":
        data = shifted(data, np.random.default_rng(seed))
    return Demonstrations(*(jnp.asarray(data[name], jnp.float32) for name in FIELDS))


def _check_settings(path: Path, data: Mapping[str, np.ndarray], expected: Mapping[str, int]) -> None:
    """Raise ValueError if a file was recorded with other settings than ``expected``, as far as it tells."""
    recorded = {name: int(data[name]) for name in MATCHED if name in data}
    if "episode" in data:
        recorded["demo_episodes"] = len(np.unique(data["episode"]))
    for name, what in MATCHED.items():
        found, wanted = recorded.get(name), expected.get(name)
        if None not in (found, wanted) and found != wanted:
            raise ValueError(f"{path} holds {what.format(found=found, wanted=wanted)}: add --set {name}={found}.")


def expert_of(path: Path) -> dict[str, Any] | None:
    """The expert that a file was recorded from, for manifests: its run, its seed, and the hash of its archive.

    The run is named by its place under ``results``. None for a file that does not name its expert.
    """
    with np.load(path, allow_pickle=False) as file:
        if "expert" not in file:
            return None
        return {
            "run": str(file["expert"]),
            "seed": int(file["expert_seed"]),
            "archive_sha256": str(file["expert_archive_sha256"]),
        }


def load_heldout(path: Path, needs_actions: bool = True) -> Demonstrations | None:
    """The steps of a demonstrations file that nothing learns from: further episodes of the demonstrators.

    None for a file without them, or without their actions where ``needs_actions``. Raises ValueError for columns of
    unequal numbers of rows, and for numbers that are not finite.
    """
    with np.load(path, allow_pickle=False) as file:
        data = {name: file[f"heldout_{name}"] for name in FIELDS if f"heldout_{name}" in file.files}
    if "obs" in data and not needs_actions:
        data.setdefault("action", np.zeros((len(data["obs"]), 0), np.float32))
    if set(FIELDS) - set(data) or not len(data["obs"]):
        return None
    if len({len(column) for column in data.values()}) > 1 or not all(np.isfinite(c).all() for c in data.values()):
        raise ValueError(f"{path} has held-out steps of unequal numbers of rows, or numbers that are not finite.")
    return Demonstrations(*(jnp.asarray(data[name], jnp.float32) for name in FIELDS))


def _columns(path: Path, needed: tuple[str, ...]) -> dict[str, np.ndarray]:
    """A file's arrays by name: ``FIELDS`` in float32, ``action`` of width 0 if it is missing. Raises ValueError."""
    try:
        with np.load(path, allow_pickle=False) as file:
            data = {name: file[name] for name in file.files}
    except Exception as error:  # zipfile, zlib and numpy raise errors of different types for other files
        raise ValueError(f"{path} is damaged or not a demonstrations file ({type(error).__name__}).") from None
    missing = [name for name in (*needed, "robot", "backend") if name not in data]
    if missing == ["action"]:
        missing, data["action"] = [], np.zeros((*data["obs"].shape[:1], 0), np.float32)
    if missing:
        raise ValueError(f"{path} is not a demonstrations file: it has no {', '.join(missing)}.")
    counts = {data[name].shape[0] if data[name].ndim == (1 if name == "episode" else 2) else 0 for name in needed}
    if len(counts) != 1 or 0 in counts:
        raise ValueError(f"{path} has columns of {sorted(counts)} rows; all must be tables with equally many rows.")
    with np.errstate(over="ignore"):  # numbers beyond float32 become infinite and are refused next
        data |= {name: data[name].astype(np.float32) for name in FIELDS if data[name].dtype.kind == "f"}
    if not all(data[name].dtype == np.float32 and np.isfinite(data[name]).all() for name in FIELDS):
        raise ValueError(f"{path} contains numbers that are not finite, or no numbers at all.")
    return data


def made_up(env: Environment, rows: int, seed: int = 0) -> Demonstrations:
    """``rows`` steps of noise in the shapes of a robot's demonstrations: for timing, not for learning."""
    rng, widths = np.random.default_rng(seed), (env.obs_size, env.action_size, env.obs_size, len(env.measure_names))
    return Demonstrations(*(jnp.asarray(rng.normal(size=(rows, width)), jnp.float32) for width in widths))


def check_fits(demos: Demonstrations, env: Environment) -> None:
    """Raise ValueError unless the columns of ``demos`` have the robot's widths; actions may be missing."""
    widths = {"obs": env.obs_size, "action": env.action_size, "next_obs": env.obs_size, "proxy": len(env.measure_names)}
    for name, width in widths.items():
        found = getattr(demos, name).shape[1]
        if found != width and not (name == "action" and found == 0):
            raise ValueError(f"the demonstrations have {name} of width {found}, but {env.name} has {width}.")


def shifted(data: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Rows as the authors' released program pairs them: action a_t with state s_{t+1+j} instead of s_t.

    j is drawn from 0 to 19 for every episode. Actions near the end of an episode that have no such state are dropped.
    The last state of an episode stands in for the unknown state after it.
    """
    parts = []
    for episode in np.unique(data["episode"]):
        steps = {name: data[name][data["episode"] == episode] for name in FIELDS}
        length = len(steps["obs"])
        delay = min(int(rng.integers(20)), length - 1)
        after = np.minimum(np.arange(delay, length) + 1, length - 1)
        parts.append({
            "obs": steps["next_obs"][delay:],
            "action": steps["action"][: length - delay],
            "next_obs": steps["next_obs"][after],
            "proxy": steps["proxy"][after],
        })  # fmt: skip
    return {name: np.concatenate([part[name] for part in parts]) for name in FIELDS}
