"""A run's whole state between two iterations, in one file that is either whole or ignored.

A checkpoint is an ``.npz`` whose name carries its own SHA-256, so that a truncated or altered one is noticed and the
one before it, which is kept until two newer ones are there, is used instead. Nothing is pickled.
"""

import hashlib
import io
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from filelock import BaseFileLock, FileLock, Timeout

from qdil.devices import hosts
from qdil.devices.mesh import laid_out
from qdil.errors import ConfigError
from qdil.files import replace_file, sweep
from qdil.ppga import Search
from qdil.qd import archive
from qdil.qd.history import History, empty

FOLDER = "checkpoint"
KEPT = 2


class Position(NamedTuple):
    """How far a run is, and what it has told so far."""

    warmed: int = 0  # warm-up updates done
    iteration: int = 0  # QD iterations done
    env_steps: float = 0.0
    restarts: float = 0.0
    seconds: float = 0.0  # wall time spent, interruptions not counted
    rows: tuple[dict[str, float], ...] = ()  # of metrics.csv
    history: History = empty()  # of history.npz
    rolled_back: float = 0.0  # phases of the warm-up; the first row of metrics.csv tells them with its own
    begun: tuple[dict[str, str], ...] = ()  # commit and start of every process whose work is in it


def save(run_folder: Path, search: Search, progress: Position, demos_sha256: str | None) -> None:
    """Write a checkpoint of ``search`` after ``progress``; older ones go once it is whole. All hosts must call it."""
    leaves = [_to_numpy(leaf) for leaf in jax.tree.leaves(search.state)]
    if not hosts.is_first():
        return
    plain = {name: value for name, value in progress._asdict().items() if name != "history"}
    told = {
        "progress": plain,
        "demos_sha256": demos_sha256,
        "xnes": search.xnes.rng.bit_generator.state,
        "rng": search.rng.bit_generator.state,
    }
    arrays = {f"state/{i}": leaf for i, leaf in enumerate(leaves)}
    arrays |= {f"soft/{name}": values for name, values in archive.content(search.archives.soft).items()}
    arrays |= {f"result/{name}": values for name, values in archive.content(search.archives.result).items()}
    arrays |= {f"history/{name}": values for name, values in progress.history._asdict().items()}
    arrays |= {
        "xnes/mean": search.xnes.mean,
        "xnes/shape": search.xnes.shape,
        "xnes/sigma": np.array(search.xnes.sigma),
    }
    buffer = io.BytesIO()
    np.savez(buffer, told=np.array(json.dumps(told)), **arrays)  # type: ignore[arg-type]
    content = buffer.getvalue()
    name = f"{progress.warmed:06d}-{progress.iteration:06d}-{hashlib.sha256(content).hexdigest()}.npz"
    replace_file(run_folder / FOLDER / name, lambda file: file.write(content))
    for old in _newest_first(run_folder)[KEPT:]:
        if old.name != name:  # newer names than this one are of checkpoints that could not be read
            old.unlink()


def load(run_folder: Path, search: Search, demos_sha256: str | None) -> tuple[Search, Position] | None:
    """The newest whole checkpoint put into ``search`` (a run just begun); None if there is none.

    Raises ConfigError if it was made with other demonstrations or by another version of this program.
    """
    for path in _newest_first(run_folder):
        try:
            content = path.read_bytes()
        except OSError:  # a disk or a network that fails just here; it may be whole again another time
            continue
        if hashlib.sha256(content).hexdigest() != path.stem.rsplit("-", 1)[1]:
            path.unlink(missing_ok=True)  # damaged: it must not pass for the newest again
            continue
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            return _restore(path, search, {name: file[name] for name in file.files}, demos_sha256)
    return None


def _restore(
    path: Path, search: Search, arrays: dict[str, np.ndarray], demos_sha256: str | None
) -> tuple[Search, Position]:
    told = json.loads(str(arrays["told"]))
    if told["demos_sha256"] != demos_sha256:
        raise ConfigError(f"{path.parent.parent} was begun with other demonstrations; choose another --out.")
    template, tree = jax.tree.flatten(search.state)
    leaves = [arrays[name] for name in sorted((n for n in arrays if n.startswith("state/")), key=_number)]
    same_shapes = [_to_numpy(leaf).shape for leaf in template] == [leaf.shape for leaf in leaves]
    if not same_shapes or "history/cell" not in arrays:
        raise ConfigError(f"{path} is of another version of qdil; remove its folder to train anew.")
    state = jax.tree.unflatten(tree, [_like(old, new) for old, new in zip(template, leaves, strict=True)])
    for name, one in search.archives._asdict().items():
        archive.refill(one, {key.split("/")[1]: values for key, values in arrays.items() if key.startswith(f"{name}/")})
    xnes = search.xnes
    xnes.mean, xnes.shape, xnes.sigma = arrays["xnes/mean"], arrays["xnes/shape"], float(arrays["xnes/sigma"])
    xnes.rng.bit_generator.state, search.rng.bit_generator.state = told["xnes"], told["rng"]
    plain: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in told["progress"].items()}
    past = History(*(arrays[f"history/{name}"] for name in History._fields))
    return search._replace(state=state), Position(**plain, history=past)


def reached(run_folder: Path) -> tuple[int, int] | None:
    """Warm-up updates and iterations that an unfinished run did before its newest checkpoint; None without one."""
    newest = next(iter(_newest_first(run_folder)), None)
    if newest is None:
        return None
    warmed, iteration, _ = newest.name.split("-")
    return int(warmed), int(iteration)


def remove(run_folder: Path) -> None:
    """Forget all checkpoints: the run is complete."""
    shutil.rmtree(run_folder / FOLDER, ignore_errors=True)


@contextmanager
def locked(run_folder: Path) -> Iterator[None]:
    """Hold the folder for this process, and clear what killed processes left half written.

    The operating system frees the lock of a process that ends, however it ends. Raises ConfigError if another process
    holds the folder.
    """
    lock = _acquire(run_folder)
    try:
        sweep(run_folder)
        sweep(run_folder / FOLDER)
        yield
    finally:
        lock.release()


def _acquire(run_folder: Path) -> BaseFileLock:
    """The folder's lock, acquired without waiting for it. Raises ConfigError if another process holds it."""
    lock = FileLock(run_folder / FOLDER / "lock")
    while True:
        try:
            lock.acquire(blocking=False)
            return lock
        except FileNotFoundError:
            continue  # the previous holder finished and removed the folder: ``acquire`` makes it again
        except Timeout:
            # Without a file, nobody holds it: the previous holder removed it between our opening and locking it.
            if Path(lock.lock_file).exists():
                raise ConfigError(
                    f"another process is training in {run_folder}; wait for it or choose another --out."
                ) from None


def _newest_first(run_folder: Path) -> list[Path]:
    return sorted((run_folder / FOLDER).glob("[0-9]*.npz"), reverse=True)


def _number(name: str) -> int:
    return int(name.split("/")[1])


def _is_key(leaf: Any) -> bool:
    return jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _to_numpy(leaf: Any) -> np.ndarray:
    return hosts.to_host(jax.random.key_data(leaf) if _is_key(leaf) else leaf)


def _like(old: Any, new: np.ndarray) -> Any:
    """``new`` as an array of the kind and layout of ``old``, so that nothing has to compile again."""
    value = jax.random.wrap_key_data(jax.numpy.asarray(new)) if _is_key(old) else new.astype(old.dtype)
    # An array that was never put anywhere, such as a key just split, must stay free to go where it is needed.
    return laid_out(value, old.sharding) if old.committed else jax.numpy.asarray(value)
