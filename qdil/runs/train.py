"""A run as a folder: trains a configuration and writes config, metrics, history, archive, policies and manifest."""

import math
import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import jax
import numpy as np

from qdil import ppga
from qdil.config import Config, ConfigError, same_but_for_speed, to_json, with_current_names
from qdil.devices import hosts
from qdil.engine.engine import Engine
from qdil.files import read_json, sha256, write_csv, write_json, write_npz
from qdil.imitation import demos as demonstrations
from qdil.imitation.reward_model import Demonstrations
from qdil.methods import parse_method
from qdil.qd import archive, history
from qdil.qd.history import History
from qdil.runs import checkpoint, manifest
from qdil.runs.checkpoint import Position
from qdil.runs.folder import demos_path, is_finished

ARCHIVE_FIELDS = ("index", "measures", "fitness", "true_return", "length")
POLICY_FIELDS = ("index", "solution", "obs_mean", "obs_std")
FIRST_COLUMNS = [
    "iteration", "env_steps", "wall_seconds", "qd_score", "coverage", "best", "average", "learned_qd_score", "restarts",
]  # fmt: skip
SAVE_EVERY = 20.0  # seconds between checkpoints (and rewrites of metrics.csv) while a run goes on
SAVE_VARIABLE = "QDIL_SAVE_SECONDS"  # an environment variable that says otherwise
SAVE_SHARE = 0.03  # of a run's time, at most, goes into saving it

# Called after every iteration with its row of metrics. One that also has ``announce(folder, reached)`` hears, once,
# that a run is about to begin there, or to go on after these warm-up updates and iterations (``checkpoint.reached``).
Report = Callable[[ppga.Search, dict[str, float]], None]


def train(config: Config, folder: Path, demos_file: Path | None = None, report: Report | None = None) -> bool:
    """Run ``config`` in ``folder``, from where an earlier process left it. False if that run is already finished there.

    Raises ConfigError before anything compiles: demonstrations missing or unusable, a run of another configuration in
    the folder, or another process at work in it.
    """
    demos_file = _demos_file(config, demos_file)

    def is_done() -> bool:
        return _is_done(config, folder, demos_file)

    if hosts.run_on_host0(is_done):  # without the lock, for which the folder would have to be written to
        return False
    demos, save_every = _checked(config, demos_file), _save_every()
    with ExitStack() as stack:

        def lock_and_look_again() -> bool:
            stack.enter_context(checkpoint.locked(folder))
            return is_done()  # another process may have finished the run a moment ago

        if hosts.run_on_host0(lock_and_look_again):
            return False
        if announce := getattr(report, "announce", None):
            announce(folder, checkpoint.reached(folder))
        begun, search = manifest.begin(), ppga.begin(config, demos)
        if hosts.is_first():
            write_json(folder / "config.json", to_json(config))
        saving = _Saving(folder, sha256(demos_file) if demos_file else None, save_every)
        search, now = _iterations(search, saving, begun, report)
        again = ppga.reevaluate(search, jax.random.fold_in(jax.random.key(config.seed), 1))
        if hosts.is_first():
            _write_archive(search, again, folder)
            _write_history(now.history, config.ppga.iterations, folder)
            manifest.write(search, folder, now.begun, now.seconds, demos_file)
            checkpoint.remove(folder)
    return True


def _demos_file(config: Config, given: Path | None) -> Path | None:
    """The demonstrations that ``config`` learns from; None for a method that does not imitate."""
    if not parse_method(config.method).base.imitates:
        return None
    return given or demos_path(config.budget, config.env, config.demos.demo_episodes)


def _is_done(config: Config, folder: Path, demos_file: Path | None) -> bool:
    """Whether ``folder`` holds this very run, finished. Raises ConfigError if it holds another, finished or not."""
    _check_settings(config, folder)
    if not is_finished(folder):
        return False
    _check_demonstrations(folder, demos_file)
    checkpoint.remove(folder)  # there still, if the process was killed right after it had finished the run
    return True


def _check_settings(config: Config, folder: Path) -> None:
    """Raise ConfigError if ``folder`` holds a run, finished or not, with other settings."""
    if not (folder / "config.json").is_file():
        return
    there, wanted = with_current_names(read_json(folder / "config.json")), to_json(config)
    if not same_but_for_speed(there, wanted) if is_finished(folder) else there != wanted:
        what = "a finished run" if is_finished(folder) else "an unfinished run"
        raise ConfigError(
            f"{folder} holds {what} with other settings; choose another --out, or remove the folder to train anew."
        )


def _check_demonstrations(folder: Path, demos_file: Path | None) -> None:
    """Raise ConfigError if the finished run in ``folder`` learned from other demonstrations."""
    trained_on = read_json(folder / "manifest.json").get("demonstrations_sha256")
    if demos_file and demos_file.is_file() and trained_on != sha256(demos_file):
        raise ConfigError(
            f"{folder} holds a finished run on other demonstrations than {demos_file}; choose another --out, or remove "
            "the folder to train anew."
        )


def _checked(config: Config, demos_file: Path | None) -> Demonstrations | None:
    """The demonstrations, if any. Raises ConfigError for all that would otherwise be refused after the lock is taken.

    That is, demonstrations that cannot be used, and devices that are not there or do not divide the robots.
    """
    try:
        engine = Engine(config)  # compiles nothing yet
        if demos_file is None:
            return None
        demos = demonstrations.load(
            demos_file,
            config.env,
            config.simulation.backend,
            not parse_method(config.method).obs_only,
            config.demos.expert_alignment,
            config.seed,
            config.demos.demo_episodes,
        )
        demonstrations.check_fits(demos, engine.env)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    return demos


def _save_every() -> float:
    """Seconds between checkpoints. Raises ConfigError where the variable that sets them holds no such number."""
    text = os.environ.get(SAVE_VARIABLE, "")
    try:
        seconds = float(text) if text else SAVE_EVERY
    except ValueError:
        seconds = math.nan
    if not seconds >= 0:
        raise ConfigError(f"{SAVE_VARIABLE}={text} must be a number of seconds, at least 0.")
    return seconds


def _iterations(
    search: ppga.Search, saving: "_Saving", begun: dict[str, str], report: Report | None
) -> tuple[ppga.Search, Position]:
    """What is left of the warm-up and of the QD iterations, with ``metrics.csv`` and a checkpoint kept up to date."""
    config = search.config
    search, now = checkpoint.load(saving.folder, search, saving.demos_sha256) or (search, Position())
    now = now._replace(begun=(*now.begun, begun))
    hosts.wait_for_all("loaded")  # before the first writes a newer checkpoint
    began = time.monotonic() - now.seconds  # as if there had been no interruption
    while now.iteration < config.ppga.iterations:
        if now.warmed < config.ppga.warmup_updates:
            search, now = _warm_up(search, now)
        else:
            search, now = _iteration(search, now, began)
            if report is not None:
                report(search, now.rows[-1])
        now = now._replace(seconds=time.monotonic() - began)
        saving(search, now, last=now.iteration == config.ppga.iterations)
    return search, now


def _warm_up(search: ppga.Search, now: Position) -> tuple[ppga.Search, Position]:
    """A round of the warm-up, which has no row of its own in ``metrics.csv``."""
    search, done, info = ppga.warm_up(search, search.config.ppga.warmup_updates - now.warmed)
    return search, now._replace(
        warmed=now.warmed + done,
        env_steps=now.env_steps + info["steps"],
        rolled_back=now.rolled_back + info["rolled_back"],
    )


def _iteration(search: ppga.Search, now: Position, began: float) -> tuple[ppga.Search, Position]:
    """A QD iteration, its row of ``metrics.csv`` and its part of the history; the run ``began`` on this clock."""
    search, info = ppga.iteration(search)
    info = info._replace(rolled_back=info.rolled_back + now.rolled_back)
    now = now._replace(
        iteration=now.iteration + 1,
        env_steps=now.env_steps + info.steps,
        restarts=now.restarts + info.restarts,
        rolled_back=0.0,
    )
    elites, cells = archive.returns(search.archives), int(search.archives.result.cells)
    row = {
        "iteration": now.iteration,
        "env_steps": int(now.env_steps),
        "wall_seconds": round(time.monotonic() - began, 3),
        **archive.metrics(elites, cells),
        "restarts": int(now.restarts),
        **info.columns(),
    }
    past = history.append(now.history, now.iteration, elites, cells)
    return search, now._replace(rows=(*now.rows, row), history=past)


class _Saving:
    """Writes metrics and checkpoints every few seconds, and so seldom that it takes a small share of the time."""

    def __init__(self, folder: Path, demos_sha256: str | None, every: float) -> None:
        self.folder, self.demos_sha256, self.every = folder, demos_sha256, every
        self.next = time.monotonic() + every

    def __call__(self, search: ppga.Search, now: Position, last: bool) -> None:
        start = time.monotonic()
        if not hosts.broadcast_from_host0(start >= self.next or last):
            return
        if now.rows and hosts.is_first():
            write_csv(self.folder / "metrics.csv", list(dict.fromkeys(FIRST_COLUMNS + list(now.rows[-1]))), now.rows)
        checkpoint.save(self.folder, search, now, self.demos_sha256)
        took = time.monotonic() - start
        self.next = start + max(self.every, took / SAVE_SHARE)


def _write_archive(search: ppga.Search, again: dict[str, np.ndarray], folder: Path) -> None:
    elites = archive.elite_arrays(search.archives)
    cells = np.asarray(search.archives.result.dims)
    write_npz(folder / "archive.npz", **{name: elites[name] for name in ARCHIVE_FIELDS}, **again, cells=cells)
    write_npz(folder / "policies.npz", **{name: elites[name] for name in POLICY_FIELDS})


def _write_history(past: History, iterations: int, folder: Path) -> None:
    """``index`` names cells as in ``archive.npz``; ``iterations`` is how many there were."""
    arrays = {name: values for name, values in past._asdict().items() if name != "cell"}
    write_npz(folder / "history.npz", **arrays, index=past.cell, iterations=np.array(iterations))
