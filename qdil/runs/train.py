"""Train a run in its folder, with checkpoints: config, metrics, history, archive, policies, summary and manifest."""

import time
from contextlib import ExitStack
from pathlib import Path

import jax
import numpy as np

from qdil import ppga
from qdil.config import Config, make_config, same_but_for_speed, to_json, with_current_names
from qdil.devices import hosts
from qdil.engine.engine import Engine
from qdil.errors import ConfigError
from qdil.files import read_json, sha256, write_csv, write_json, write_npz
from qdil.imitation import demos as demonstrations
from qdil.imitation.reward_model import Demonstrations
from qdil.methods import parse_method
from qdil.qd import archive, history
from qdil.qd.history import History
from qdil.runs import checkpoint, manifest, summary
from qdil.runs.checkpoint import Position
from qdil.runs.folder import demos_of, expert_seed_of, is_finished
from qdil.runs.report import Report

ARCHIVE_FIELDS = ("index", "measures", "fitness", "true_return", "length")
POLICY_FIELDS = ("index", "solution", "obs_mean", "obs_std")
FIRST_COLUMNS = [
    "iteration", "env_steps", "wall_seconds", "qd_score", "coverage", "best", "average", "learned_qd_score", "restarts",
]  # fmt: skip
SAVE_SECONDS = 20.0  # between two checkpoints (and rewrites of metrics.csv), by default
SAVE_SHARE = 0.03  # largest share of a run's time that goes into saving; slow disks get fewer checkpoints


def train(
    config: Config,
    folder: Path,
    demos_file: Path | None = None,
    report: Report | None = None,
    save_seconds: float = SAVE_SECONDS,
) -> bool:
    """Train ``config`` in ``folder``, or resume from its newest checkpoint. False if that run is already finished.

    ``demos_file``: demonstrations, by default ``folder.demos_of``'s. ``save_seconds``: the time between checkpoints.
    Raises ConfigError before anything compiles: for demonstrations that are missing or do not fit, for a run with
    other settings in the folder, and if another process is training there.
    """
    if not save_seconds >= 0:
        raise ConfigError(f"save_seconds={save_seconds} must be at least 0.")
    demos_file = learns_from(config, demos_file)

    def is_done() -> bool:
        return _is_done(config, folder, demos_file)

    if hosts.run_on_host0(is_done):  # before the lock, which needs a folder that can be written to
        return False
    demos, heldout = _checked(config, demos_file)
    with ExitStack() as stack:

        def lock_and_check_again() -> bool:
            stack.enter_context(checkpoint.locked(folder))
            return is_done()  # another process may have finished the run since

        if hosts.run_on_host0(lock_and_check_again):
            return False
        if report is not None:
            report.announce(folder, checkpoint.reached(folder))
        _train(config, folder, demos, heldout, demos_file, report, save_seconds)
    return True


def _train(
    config: Config,
    folder: Path,
    demos: Demonstrations | None,
    heldout: Demonstrations | None,
    demos_file: Path | None,
    report: Report | None,
    save_seconds: float,
) -> None:
    """Everything that happens while the folder is locked: train, score the elites again, write the results."""
    process = manifest.this_process()
    search = ppga.begin(config, demos, heldout)
    if hosts.is_first():
        write_json(folder / "config.json", to_json(config))
    saver = _Saver(folder, sha256(demos_file) if demos_file else None, save_seconds)
    search, position = _iterations(search, saver, process, report)
    began = time.monotonic()
    rescored = ppga.reevaluate(search, jax.random.fold_in(jax.random.key(config.seed), 1))
    if hosts.is_first():
        _write_archive(search, rescored, folder)
        _write_history(position.history, config.ppga.iterations, folder)
        seconds = position.seconds + time.monotonic() - began
        manifest.write(search, folder, position.processes, seconds, demos_file)
        checkpoint.remove(folder)


def learns_from(config: Config, given: Path | None) -> Path | None:
    """The demonstrations that ``config`` learns from; None for a method that does not imitate."""
    if not parse_method(config.method).base.imitates:
        return None
    return given or demos_of(config)


def _is_done(config: Config, folder: Path, demos_file: Path | None) -> bool:
    """Whether ``folder`` holds this run, finished. Raises ConfigError if it holds another run, finished or not."""
    _check_settings(config, folder)
    if not is_finished(folder):
        return False
    _check_demonstrations(folder, demos_file)
    checkpoint.remove(folder)  # left if the process was killed after writing the manifest
    return True


def _check_settings(config: Config, folder: Path) -> None:
    """Raise ConfigError if ``folder`` holds a run, finished or not, with other settings."""
    if not (folder / "config.json").is_file():
        return
    recorded, wanted = with_current_names(read_json(folder / "config.json")), to_json(config)
    # A run is resumed with exactly its own settings, those of speed included.
    agree = same_but_for_speed(recorded, wanted) if is_finished(folder) else recorded == wanted
    if not agree:
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


def _checked(config: Config, demos_file: Path | None) -> tuple[Demonstrations | None, Demonstrations | None]:
    """The demonstrations and the held-out ones; None for a method or a file without any.

    Raises ConfigError for demonstrations that are missing or do not fit the robot, and for devices that do not exist
    or do not divide the robots.
    """
    try:
        engine = Engine(config)  # compiles nothing yet
        if demos_file is None:
            return None, None
        if not demos_file.is_file():
            raise ConfigError(f"no demonstrations at {demos_file}: make them with '{_demos_command(config)}'.")
        needs_actions = not parse_method(config.method).obs_only
        demos = demonstrations.load(
            demos_file,
            config.env,
            config.simulation.backend,
            needs_actions,
            config.demos.expert_alignment,
            config.seed,
            {
                "demo_episodes": config.demos.demo_episodes,
                "demo_attempts": config.demos.demo_attempts,
                "expert_seed": expert_seed_of(config),
            },
        )
        demonstrations.check_fits(demos, engine.env)
        heldout = demonstrations.load_heldout(demos_file, needs_actions)
        if heldout is not None:
            demonstrations.check_fits(heldout, engine.env)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    return demos, heldout


def _demos_command(config: Config) -> str:
    """The command that records the demonstrations that a run learns from."""
    usual = make_config(config.env, "true", config.budget).demos
    command = f"qdil demos --env {config.env} --budget {config.budget} --seed {expert_seed_of(config)}"
    if config.demos.demo_episodes != usual.demo_episodes:
        command += f" --episodes {config.demos.demo_episodes}"
    if config.demos.demo_attempts != usual.demo_attempts:
        command += f" --attempts {config.demos.demo_attempts}"
    return command


def _iterations(
    search: ppga.Search, saver: "_Saver", process: dict[str, str], report: Report | None
) -> tuple[ppga.Search, Position]:
    """Run the rest of the warm-up and of the QD iterations; keep ``metrics.csv`` and the checkpoints up to date."""
    config = search.config
    search, position = checkpoint.load(saver.folder, search, saver.demos_sha256) or (search, Position())
    position = position._replace(processes=(*position.processes, process))
    hosts.wait_for_all("loaded")  # before host 0 writes a newer checkpoint
    start = time.monotonic() - position.seconds  # where the clock would have started without interruptions
    while position.iteration < config.ppga.iterations:
        if position.warmed < config.ppga.warmup_updates:
            search, position = _warm_up(search, position)
        else:
            search, position = _iteration(search, position, start)
            if report is not None:
                report(search, position.rows[-1])
        position = position._replace(seconds=time.monotonic() - start)
        saver.save_if_due(search, position, last=position.iteration == config.ppga.iterations)
    return search, position


def _warm_up(search: ppga.Search, position: Position) -> tuple[ppga.Search, Position]:
    """One round of the warm-up, which has no row in ``metrics.csv``."""
    search, done, info = ppga.warm_up(search, search.config.ppga.warmup_updates - position.warmed)
    return search, position._replace(
        warmed=position.warmed + done,
        env_steps=position.env_steps + info["steps"],
        rolled_back=position.rolled_back + info["rolled_back"],
    )


def _iteration(search: ppga.Search, position: Position, start: float) -> tuple[ppga.Search, Position]:
    """One QD iteration, its row of ``metrics.csv`` and its part of the history.

    ``start``: when the run started, by ``time.monotonic``.
    """
    search, info = ppga.iteration(search)
    info = info._replace(rolled_back=info.rolled_back + position.rolled_back)
    walk_age, age = _ages(search.config, bool(info.restarts), position.age)
    position = position._replace(
        iteration=position.iteration + 1,
        env_steps=position.env_steps + info.steps,
        restarts=position.restarts + info.restarts,
        rolled_back=0.0,
        age=age,
    )
    elites, cells = archive.returns(search.archives), int(search.archives.result.cells)
    row = {
        "iteration": position.iteration,
        "env_steps": int(position.env_steps),
        "wall_seconds": round(time.monotonic() - start, 3),
        **archive.metrics(elites, cells),
        "restarts": int(position.restarts),
        "age": walk_age,
        **info.columns(),
    }
    past = history.append(position.history, position.iteration, elites, cells)
    return search, position._replace(rows=(*position.rows, row), history=past)


def _ages(config: Config, restarted: bool, age: int) -> tuple[int, int]:
    """The age of θ_μ in an iteration's walk, and in the next iteration's unless that restarts before its walk.

    The age is the number of iterations whose walks moved θ_μ since the last restart, or since the run began; ``age`` is
    that before this iteration's walk.
    """
    if restarted and config.ppga.restart_order == "before-walk":
        return 0, 1
    return age, 0 if restarted else age + 1


class _Saver:
    """Writes metrics and a checkpoint every ``save_seconds``, or less often: at most ``SAVE_SHARE`` of the time."""

    def __init__(self, folder: Path, demos_sha256: str | None, save_seconds: float) -> None:
        self.folder, self.demos_sha256, self.save_seconds = folder, demos_sha256, save_seconds
        self.due = time.monotonic() + save_seconds

    def save_if_due(self, search: ppga.Search, position: Position, last: bool) -> None:
        """Save if it is time to, or if this is the ``last`` iteration."""
        start = time.monotonic()
        if not hosts.broadcast_from_host0(start >= self.due or last):
            return
        rows = position.rows
        if rows and hosts.is_first():
            write_csv(self.folder / "metrics.csv", list(dict.fromkeys(FIRST_COLUMNS + list(rows[-1]))), rows)
        checkpoint.save(self.folder, search, position, self.demos_sha256)
        took = time.monotonic() - start
        self.due = start + max(self.save_seconds, took / SAVE_SHARE)


def _write_archive(search: ppga.Search, rescored: dict[str, np.ndarray], folder: Path) -> None:
    """The archive, its policies and the summary of its metrics; ``rescored`` as ``ppga.reevaluate`` returns it."""
    elites = archive.elite_arrays(search.archives)
    cells = np.asarray(search.archives.result.dims)
    kept = {**{name: elites[name] for name in ARCHIVE_FIELDS}, **rescored, "cells": cells}
    write_npz(folder / "archive.npz", **kept)
    summary.write(folder, kept)
    write_npz(folder / "policies.npz", **{name: elites[name] for name in POLICY_FIELDS})


def _write_history(past: History, iterations: int, folder: Path) -> None:
    """``index`` numbers cells as in ``archive.npz``; ``iterations`` is the number of QD iterations."""
    arrays = {name: values for name, values in past._asdict().items() if name != "cell"}
    write_npz(folder / "history.npz", **arrays, index=past.cell, iterations=np.array(iterations))
