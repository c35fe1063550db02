"""Runs that are interrupted, damaged or started twice end with the same files, and nothing is lost."""

import json
import os
import shutil
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import jax
import numpy as np
import pytest
from fake_runs import same_run

from qdil import ppga
from qdil.config import make_config
from qdil.errors import ConfigError
from qdil.qd import archive, history
from qdil.runs import checkpoint, manifest
from qdil.runs import train as training
from qdil.runs.checkpoint import Position
from qdil.runs.demos import make_demos
from qdil.runs.folder import is_finished
from qdil.runs.report import AfterIteration

pytestmark = pytest.mark.physics

CONFIG = make_config("walker2d", "true", "smoke", iterations=4)


class Stopped(Exception):
    """Interrupts a run in these tests."""


def stop_after(iteration: int) -> AfterIteration:
    def stop(search, row):
        if row["iteration"] == iteration:
            raise Stopped

    return AfterIteration(stop)


def append_iterations(seen: list) -> AfterIteration:
    """Append the number of every iteration to ``seen``."""
    return AfterIteration(lambda search, row: seen.append(row["iteration"]))


@pytest.fixture(autouse=True)
def save_always(monkeypatch):
    monkeypatch.setattr(training, "SAVE_SHARE", 1e9)


def train(config, folder, demos=None, report=None):
    """``train`` that saves after every iteration."""
    return training.train(config, folder, demos, report, save_seconds=0.0)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    train(CONFIG, folder)
    return folder


@pytest.fixture
def interrupted(tmp_path) -> Path:
    """A run that died in its third iteration."""
    with pytest.raises(Stopped):
        train(CONFIG, tmp_path, report=stop_after(3))
    return tmp_path


def test_a_resumed_run_ends_as_if_nothing_had_happened(interrupted, uninterrupted):
    assert not is_finished(interrupted)
    seen = []
    assert train(CONFIG, interrupted, report=append_iterations(seen))
    assert seen == [3, 4]
    assert same_run(interrupted, uninterrupted)
    assert not (interrupted / "checkpoint").exists()


@pytest.fixture(scope="module")
def demos(uninterrupted, tmp_path_factory) -> Path:
    return make_demos("walker2d", "smoke", 1, 1, uninterrupted, tmp_path_factory.mktemp("demos") / "demos.npz")


RESUMED = [
    ("mconbo-gail", {"protocol": "improved", "bonus_scope": "step"}),  # a store of steps, and counts of visits
    ("mconbo-vail", {"protocol": "released", "threshold_min": 1e6}),  # restarts in every iteration
    ("pwil", {}),
]


@pytest.mark.parametrize(("method", "changes"), RESUMED)
def test_an_imitator_resumes_as_if_nothing_had_happened(method, changes, demos, tmp_path):
    """Its reward model, the optimiser and everything that is remembered of steps are restored, too."""
    config = make_config("walker2d", method, "smoke", iterations=3, **changes)
    train(config, tmp_path / "whole", demos)
    with pytest.raises(Stopped):
        train(config, tmp_path / "resumed", demos, stop_after(2))
    seen = []
    train(config, tmp_path / "resumed", demos, append_iterations(seen))
    assert seen == [2, 3]
    assert same_run(tmp_path / "resumed", tmp_path / "whole")


def test_the_manifest_of_a_resumed_run_lists_all_processes(tmp_path, uninterrupted, monkeypatch):
    alone = json.loads((uninterrupted / "manifest.json").read_text())
    assert alone["resumed"] == [] and "commits" not in alone and alone["start"] <= alone["end"]
    for commit, start, report in (("one", "2100-01-01", stop_after(3)), ("two", "2100-01-02", None)):
        monkeypatch.setattr(manifest, "this_process", lambda c=commit, s=start: {"commit": c, "start": s})
        with pytest.raises(Stopped) if report else nullcontext():
            train(CONFIG, tmp_path, report=report)
    both = json.loads((tmp_path / "manifest.json").read_text())
    assert (both["start"], both["resumed"]) == ("2100-01-01", ["2100-01-02"])
    assert (both["commit"], both["commits"]) == ("two", ["one", "two"])


def test_an_interrupted_warm_up_goes_on_too(tmp_path, uninterrupted, monkeypatch):
    rounds = []
    warm_up = ppga.warm_up

    def counted(search, updates):
        rounds.append(updates)
        return warm_up(search, updates)

    def dies_at_the_second(search, updates):
        if updates == 1:
            raise Stopped
        return counted(search, updates)

    monkeypatch.setattr(ppga, "warm_up", dies_at_the_second)
    with pytest.raises(Stopped):
        train(CONFIG, tmp_path)
    monkeypatch.setattr(ppga, "warm_up", counted)
    train(CONFIG, tmp_path)
    assert rounds == [2, 1]
    assert same_run(tmp_path, uninterrupted)


@pytest.mark.parametrize("damage", ["flip", "truncate"])
def test_a_damaged_checkpoint_is_noticed_and_the_one_before_used(interrupted, uninterrupted, damage):
    newest, before = sorted((interrupted / "checkpoint").glob("*.npz"), reverse=True)
    content = bytearray(newest.read_bytes())
    if damage == "flip":
        content[len(content) // 2] ^= 1
    newest.write_bytes(content if damage == "flip" else content[: len(content) // 3])
    seen = []
    train(CONFIG, interrupted, report=append_iterations(seen))
    assert seen[0] == 2 and int(before.name.split("-")[1]) == 1
    assert same_run(interrupted, uninterrupted)


def test_a_checkpoint_that_cannot_be_read_is_passed_over_and_kept(interrupted, uninterrupted, monkeypatch):
    newest, before = sorted((interrupted / "checkpoint").glob("*.npz"), reverse=True)
    read_bytes, kept = Path.read_bytes, []

    def fails(path):
        if path == newest:
            raise OSError(5, "Input/output error")
        return read_bytes(path)

    monkeypatch.setattr(Path, "read_bytes", fails)

    def look(search, row):
        kept.append((row["iteration"], newest.exists()))

    train(CONFIG, interrupted, report=AfterIteration(look))
    assert kept[0] == (2, True) and int(before.name.split("-")[1]) == 1
    assert same_run(interrupted, uninterrupted)


def test_all_damaged_means_from_the_beginning(interrupted, uninterrupted):
    for path in (interrupted / "checkpoint").glob("*.npz"):
        path.write_bytes(b"")
    train(CONFIG, interrupted)
    assert same_run(interrupted, uninterrupted)


def test_a_full_disk_leaves_what_was_there(interrupted, uninterrupted, monkeypatch):
    before = {path.name for path in (interrupted / "checkpoint").glob("*.npz")}

    def no_space(file_descriptor):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", no_space)
        with pytest.raises(OSError, match="No space"):
            train(CONFIG, interrupted)
    assert {path.name for path in (interrupted / "checkpoint").glob("*.npz")} == before
    assert not list(interrupted.glob(".*"))
    train(CONFIG, interrupted)
    assert same_run(interrupted, uninterrupted)


def test_another_configuration_is_refused(interrupted):
    with pytest.raises(ConfigError, match="an unfinished run with other settings"):
        train(make_config("walker2d", "true", "smoke", iterations=5), interrupted)


HOLD = """
import sys, time
from filelock import FileLock
with FileLock(sys.argv[1]):
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_folder_is_one_processes_at_a_time_until_that_one_is_killed(interrupted, uninterrupted):
    command = [sys.executable, "-c", HOLD, str(interrupted / "checkpoint" / "lock")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
        try:
            assert other.stdout.readline() == "held\n"
            begin = time.monotonic()
            with pytest.raises(ConfigError, match=f"another process is training in {interrupted}; wait for it or"):
                train(CONFIG, interrupted)
            assert time.monotonic() - begin < 5
        finally:
            other.kill()
    train(CONFIG, interrupted)
    assert same_run(interrupted, uninterrupted)


def fails_to_begin(*args):
    raise AssertionError("it began to compile")


def test_a_busy_folder_is_refused_before_anything_compiles(interrupted, monkeypatch):
    monkeypatch.setattr(ppga, "begin", fails_to_begin)
    with checkpoint.locked(interrupted), pytest.raises(ConfigError, match="another process"):
        train(CONFIG, interrupted)


def test_a_run_that_finishes_just_before_the_lock_is_taken_is_left_alone(tmp_path, uninterrupted, monkeypatch):
    folder, locked = tmp_path / "run", checkpoint.locked

    def locked_late(run_folder):
        shutil.copytree(uninterrupted, run_folder)  # another process was faster
        return locked(run_folder)

    monkeypatch.setattr(checkpoint, "locked", locked_late)
    monkeypatch.setattr(ppga, "begin", fails_to_begin)
    assert not train(CONFIG, folder)
    assert {path.name for path in folder.iterdir()} == {path.name for path in uninterrupted.iterdir()}


@pytest.mark.skipif(os.name == "nt", reason="Windows does not remove a file that is open")
@pytest.mark.parametrize("moment", ["before it is opened", "before it is locked"])
def test_a_lock_that_was_removed_with_its_folder_locks_nothing(tmp_path, monkeypatch, moment):
    """A process that meets the lock of a run that finishes just then must not share the folder with the next one."""
    import fcntl

    module, name = (os, "open") if moment == "before it is opened" else (fcntl, "flock")
    real, calls = getattr(module, name), []

    def late(what, *args, **kwargs):
        # The lock's path, or the descriptor of the open lock.
        is_lock = module is fcntl or os.fspath(what) == str(tmp_path / "checkpoint" / "lock")
        if is_lock and not calls:
            checkpoint.remove(tmp_path)
        calls.append(what) if is_lock else None
        return real(what, *args, **kwargs)

    monkeypatch.setattr(module, name, late)
    with checkpoint.locked(tmp_path):
        assert len(calls) >= 2
        with pytest.raises(ConfigError, match="another process"), checkpoint.locked(tmp_path):
            pass


def test_files_of_killed_processes_are_removed(tmp_path, uninterrupted):
    folder = tmp_path / "run"
    shutil.copytree(uninterrupted, folder)
    (folder / "checkpoint").mkdir()
    (folder / "checkpoint" / "lock").touch()
    assert not train(CONFIG, folder)  # killed right after its manifest was written
    assert not (folder / "checkpoint").exists()

    (folder / "manifest.json").unlink()
    (folder / "checkpoint").mkdir()
    half = [folder / ".policies.npz.a1_b2c3d", folder / "checkpoint" / f".000002-000001-{'0' * 64}.npz.abcdefgh"]
    others = [folder / ".gitkeep", folder / ".notes.json"]
    for path in half + others:
        path.touch()
    train(CONFIG, folder)
    assert not any(path.exists() for path in half) and all(path.exists() for path in others)


def test_other_demonstrations_are_refused(tmp_path):
    search = ppga.begin(CONFIG, None)
    checkpoint.save(tmp_path, search, Position(iteration=1), "one")
    assert checkpoint.load(tmp_path, search, "one") is not None
    with pytest.raises(ConfigError, match="other demonstrations"):
        checkpoint.load(tmp_path, search, "another")


def test_load_restores_what_was_saved(tmp_path):
    """Every leaf, both grids with their thresholds, both generators."""
    config = make_config("walker2d", "true", "smoke", archive_learning_rate=0.3)
    search, _ = ppga.iteration(ppga.begin(config, None))
    returns = archive.returns(search.archives)
    past = history.append(history.empty(), 1, returns, int(search.archives.result.cells))
    position = Position(1, 2, 3.5, 4.0, 5.25, ({"a": 0.1},), past, 6.0, ({"commit": "c", "start": "s"},))
    checkpoint.save(tmp_path, search, position, None)
    fresh = ppga.begin(config, None)
    loaded, restored = checkpoint.load(tmp_path, fresh, None)
    assert restored._replace(history=None) == position._replace(history=None)
    assert len(past.cell) > 0
    for saved, read in zip(past, restored.history, strict=True):
        np.testing.assert_array_equal(saved, read)
    for saved, read in zip(jax.tree.leaves(search.state), jax.tree.leaves(loaded.state), strict=True):
        assert saved.dtype == read.dtype and saved.sharding == read.sharding and saved.committed == read.committed
        np.testing.assert_array_equal(in_numpy(saved), in_numpy(read))
    for saved, read in zip(search.archives, loaded.archives, strict=True):
        one, other = archive.content(saved), archive.content(read)
        assert set(one) == set(other) and "threshold" in one and len(one["index"]) > 0
        for name in one:
            np.testing.assert_array_equal(one[name], other[name])
    np.testing.assert_array_equal(search.xnes.ask(), loaded.xnes.ask())
    assert search.rng.integers(1 << 60) == loaded.rng.integers(1 << 60)
    # ``load`` leaves its argument unchanged.
    assert len(fresh.archives.result) == 0 and fresh.rng.bit_generator.state != loaded.rng.bit_generator.state


def in_numpy(leaf):
    is_key = jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)
    return np.asarray(jax.random.key_data(leaf) if is_key else leaf)


@pytest.mark.parametrize("seconds", [-1.0, float("nan")])
def test_a_time_between_checkpoints_below_zero_is_refused(tmp_path, seconds):
    with pytest.raises(ConfigError, match=f"save_seconds={seconds} must be at least 0."):
        training.train(CONFIG, tmp_path, save_seconds=seconds)
    assert not list(tmp_path.iterdir())


def test_checkpoints_are_written_as_often_as_asked(tmp_path, monkeypatch):
    """Every save of a run that asks for one an hour is its last, and with 0 seconds there is one per round."""
    saved, save = [], checkpoint.save
    monkeypatch.setattr(checkpoint, "save", lambda *args: saved.append(args[2].iteration) or save(*args))
    training.train(CONFIG, tmp_path / "hourly", save_seconds=3600.0)
    assert saved == [4]
    saved.clear()
    train(CONFIG, tmp_path / "always")
    assert saved == [0, 0, 1, 2, 3, 4]
