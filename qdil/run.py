"""A run as a folder: trains a configuration and writes config, metrics, archive, policies and manifest."""

import json
import platform
import subprocess
import time
from collections.abc import Callable
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np

from qdil import ppga
from qdil.config import Config, ConfigError, from_json, make_config, to_json
from qdil.files import sha256, write_csv, write_json, write_npz
from qdil.imitation import demos as demonstrations
from qdil.imitation.registry import bases, parse_method
from qdil.search import archive

RESULTS = Path("results")
PACKAGES = ("jax", "jaxlib", "brax", "mujoco", "mujoco-mjx", "ribs", "optax", "numpy")
ARCHIVE_FIELDS = ("index", "measures", "fitness", "true_return", "length")
POLICY_FIELDS = ("index", "solution", "obs_mean", "obs_std")
FIRST_COLUMNS = [
    "iteration", "env_steps", "wall_seconds", "qd_score", "coverage", "best", "average", "learned_qd_score", "restarts",
]  # fmt: skip
METRICS_EVERY = 5.0  # seconds between rewrites of metrics.csv while a run goes on

Report = Callable[[ppga.Search, dict[str, float]], None]  # called after every iteration with its row of metrics


def folder_of(config: Config, root: Path = RESULTS) -> Path:
    """``results/<budget>/<env>/<method>/seed-<n>``."""
    return root / config.budget / config.env / config.method / f"seed-{config.seed}"


def demos_path(budget: str, env: str, episodes: int, root: Path = RESULTS) -> Path:
    """Where ``qdil demos`` puts demonstrations and where training looks for them."""
    return root / budget / env / f"demos-{episodes}.npz"


def is_finished(folder: Path) -> bool:
    """A folder is a whole run once its manifest is there, which is written last."""
    return (folder / "manifest.json").is_file()


def train(config: Config, folder: Path, demos_file: Path | None = None, report: Report | None = None) -> bool:
    """Run ``config`` in ``folder``. Returns False, having done nothing, if that run is already finished there.

    Raises ConfigError before anything compiles: demonstrations missing or unusable, or a finished run of another
    configuration in the folder.
    """
    method = parse_method(config.method)
    imitates = bases()[method.base].imitates
    demos_file = (demos_file or demos_path(config.budget, config.env, config.demo_episodes)) if imitates else None
    if is_finished(folder):
        _check_finished(config, folder, demos_file)
        return False
    demos = None
    if demos_file:
        try:
            demos = demonstrations.load(
                demos_file, config.env, config.backend, not method.obs_only, config.expert_alignment, config.seed
            )
        except ValueError as error:
            raise ConfigError(str(error)) from None
    try:
        search = ppga.begin(config, demos)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    write_json(folder / "config.json", to_json(config))
    begun = {"commit": commit(), "start": datetime.now(UTC).isoformat(timespec="seconds")}
    search = _iterations(search, folder, report)
    _write_archive(search, folder)
    _write_manifest(search, folder, begun, demos_file)
    return True


def _check_finished(config: Config, folder: Path, demos_file: Path | None) -> None:
    """Raise ConfigError unless the finished run in ``folder`` is the one asked for."""
    advice = "choose another --out, or remove the folder to train anew"
    if json.loads((folder / "config.json").read_text()) != to_json(config):
        raise ConfigError(f"{folder} holds a finished run with other settings; {advice}.")
    trained_on = json.loads((folder / "manifest.json").read_text())["demonstrations_sha256"]
    if demos_file and demos_file.is_file() and trained_on != sha256(demos_file):
        raise ConfigError(f"{folder} holds a finished run on other demonstrations than {demos_file}; {advice}.")


def _iterations(search: ppga.Search, folder: Path, report: Report | None) -> ppga.Search:
    """Warm-up and all QD iterations, with ``metrics.csv`` kept up to date."""
    config, begin = search.config, time.monotonic()
    cells = int(search.archives.result.cells)
    search, warm_up_steps = ppga.warm_up(search, config.warmup_updates)
    env_steps, restarts, written = float(warm_up_steps), 0.0, 0.0
    rows: list[dict[str, float]] = []
    for number in range(1, config.iterations + 1):
        search, info = ppga.iteration(search)
        env_steps, restarts = env_steps + info.pop("steps"), restarts + info.pop("restarts")
        row = {
            "iteration": number,
            "env_steps": int(env_steps),
            "wall_seconds": round(time.monotonic() - begin, 3),
            **archive.metrics(archive.elite_arrays(search.archives), cells),
            "restarts": int(restarts),
            **info,
        }
        rows.append(row)
        if time.monotonic() - written > METRICS_EVERY or number == config.iterations:
            write_csv(folder / "metrics.csv", FIRST_COLUMNS + list(info), rows)
            written = time.monotonic()
        if report is not None:
            report(search, row)
    return search


def _write_archive(search: ppga.Search, folder: Path) -> None:
    elites = archive.elite_arrays(search.archives)
    again = ppga.reevaluate(search, jax.random.fold_in(jax.random.key(search.config.seed), 1))
    cells = np.asarray(search.archives.result.dims)
    write_npz(folder / "archive.npz", **{name: elites[name] for name in ARCHIVE_FIELDS}, **again, cells=cells)
    write_npz(folder / "policies.npz", **{name: elites[name] for name in POLICY_FIELDS})


def _write_manifest(search: ppga.Search, folder: Path, begun: dict[str, str], demos_file: Path | None) -> None:
    files = ["config.json", "metrics.csv", "archive.npz", "policies.npz"]
    devices = jax.local_devices()[: search.compiled.num_devices]
    write_json(
        folder / "manifest.json",
        {
            **begun,
            "packages": {name: version(name) for name in PACKAGES},
            "python": platform.python_version(),
            "device": f"{len(devices)} x {devices[0].device_kind}",
            "seed": search.config.seed,
            "end": datetime.now(UTC).isoformat(timespec="seconds"),
            "demonstrations_sha256": sha256(demos_file) if demos_file else None,
            "sha256": {name: sha256(folder / name) for name in files},
        },
    )


def commit() -> str:
    """The repository's commit, marked where the working tree differs from it; "unknown" outside a repository."""
    here = Path(__file__).parent
    try:
        run = ["git", "-C", str(here)]
        head = subprocess.run([*run, "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
        changed = subprocess.run([*run, "status", "--porcelain", "--", str(here)], capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{head} with local changes" if changed.stdout.strip() else head


def read_config(folder: Path) -> dict[str, Any]:
    """The settings of the run in ``folder``. Raises ConfigError if there is no finished run."""
    if not is_finished(folder):
        raise ConfigError(f"there is no finished run in {folder}.")
    return json.loads((folder / "config.json").read_text())


def read_archive(folder: Path, policies: bool = False) -> dict[str, np.ndarray]:
    """The archive of a finished run, with its policies if asked for. Raises ConfigError where they are missing."""
    read_config(folder)
    names = ["archive.npz", "policies.npz"] if policies else ["archive.npz"]
    content: dict[str, np.ndarray] = {}
    for name in names:
        if not (folder / name).is_file():
            raise ConfigError(f"{folder} has no {name}: remove the folder and train it on this machine to get it.")
        with np.load(folder / name, allow_pickle=False) as file:
            content.update({key: file[key] for key in file.files})
    return content


def make_demos(
    env: str, budget: str, episodes: int, seed: int, expert: Path | None = None, out: Path | None = None
) -> Path:
    """Choose demonstrators from a finished expert run, record an episode of each, write the file and return its path.

    Elites: farthest points among the top fifth of the cells by return (section 5.2). Raises ConfigError if the expert
    is missing or has too few elites.
    """
    expert = expert or folder_of(make_config(env, "true", budget, seed))
    elites = read_archive(expert, policies=True)
    config = from_json(read_config(expert))
    if config.env != env:
        raise ConfigError(f"{expert} is a run of {config.env}, not of {env}.")
    try:
        rows = demonstrations.select(elites["true_return"], elites["measures"], int(np.prod(elites["cells"])), episodes)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    from qdil.phases import policy_like
    from qdil.robots import brax_robots

    robot = brax_robots.make(config.env, config.backend)
    chosen = {name: elites[name][rows] for name in ("solution", "obs_mean", "obs_std")}
    recorded = demonstrations.record(
        robot, policy_like(config, robot), chosen, jax.random.key(seed), config.episode_length, config.sample_actions
    )
    recorded["elite_index"] = elites["index"][rows]
    recorded["elite_measures"] = elites["measures"][rows]
    recorded["elite_return"] = elites["true_return"][rows]
    path = out or demos_path(budget, env, episodes)
    demonstrations.save(path, recorded, robot)
    return path
