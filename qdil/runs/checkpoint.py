"""Checkpoints: a run's whole state between two iterations, in one file.

A checkpoint is an ``.npz`` file whose name contains its SHA-256. A truncated or altered file does not match its name;
``load`` then uses the one before it, so the two newest are kept. Nothing is pickled.
"""

import hashlib
import io
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
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
    """How far a run is, and what it has recorded so far."""

    warmed: int = 0  # warm-up updates done
    iteration: int = 0  # QD iterations done
    env_steps: float = 0.0
    restarts: float = 0.0
    seconds: float = 0.0  # wall time spent, interruptions not counted
    rows: tuple[dict[str, float], ...] = ()  # of metrics.csv
    history: History = empty()  # of history.npz
    rolled_back: float = 0.0  # training phases discarded during warm-up; added to the first row of metrics.csv
    age: int = 0  # iterations whose walks moved θ_μ since the last restart, or since the run began
    processes: tuple[dict[str, str], ...] = ()  # ``manifest.this_process`` of each process that worked on the run


def save(run_folder: Path, search: Search, position: Position, demos_sha256: str | None) -> None:
    """Write a checkpoint of ``search`` at ``position``, then remove older ones. All hosts must call it."""
    leaves = [_to_numpy(leaf) for leaf in jax.tree.leaves(search.state)]
    if not hosts.is_first():
        return
    values = {
        "position": {name: value for name, value in position._asdict().items() if name != "history"},
        "demos_sha256": demos_sha256,
        "xnes": search.xnes.rng.bit_generator.state,
        "rng": search.rng.bit_generator.state,
    }
    arrays = {f"state/{i}": leaf for i, leaf in enumerate(leaves)}
    arrays |= {f"soft/{name}": values for name, values in archive.content(search.archives.soft).items()}
    arrays |= {f"result/{name}": values for name, values in archive.content(search.archives.result).items()}
    arrays |= {f"history/{name}": values for name, values in position.history._asdict().items()}
    arrays |= {
        "xnes/mean": search.xnes.mean,
        "xnes/shape": search.xnes.shape,
        "xnes/sigma": np.array(search.xnes.sigma),
    }
    buffer = io.BytesIO()
    np.savez(buffer, values=np.array(json.dumps(values)), **arrays)  # type: ignore[arg-type]
    content = buffer.getvalue()
    name = f"{position.warmed:06d}-{position.iteration:06d}-{hashlib.sha256(content).hexdigest()}.npz"
    replace_file(run_folder / FOLDER / name, lambda file: file.write(content))
    for old in _newest_first(run_folder)[KEPT:]:
        if old.name != name:  # a checkpoint that could not be read may have a later name than this one
            old.unlink()


def load(run_folder: Path, search: Search, demos_sha256: str | None) -> tuple[Search, Position] | None:
    """Restore the newest undamaged checkpoint into a copy of ``search``, a run just begun; None if there is none.

    Raises ConfigError if it was made with other demonstrations or by another version of this program.
    """
    for path in _newest_first(run_folder):
        try:
            content = path.read_bytes()
        except OSError:  # the disk or the network failed: keep the file, which may be readable later
            continue
        if hashlib.sha256(content).hexdigest() != path.stem.rsplit("-", 1)[1]:
            path.unlink(missing_ok=True)  # damaged: it must not count as the newest again
            continue
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            return _restore(path, search, {name: file[name] for name in file.files}, demos_sha256)
    return None


def _restore(
    path: Path, search: Search, arrays: dict[str, np.ndarray], demos_sha256: str | None
) -> tuple[Search, Position]:
    template, tree = jax.tree.flatten(search.state)
    leaves = [arrays[name] for name in sorted((n for n in arrays if n.startswith("state/")), key=_number)]
    same_shapes = [_to_numpy(leaf).shape for leaf in template] == [leaf.shape for leaf in leaves]
    if not same_shapes or "values" not in arrays:
        raise ConfigError(f"{path} is of another version of qdil; remove its folder to train anew.")
    values = json.loads(str(arrays["values"]))
    if values["demos_sha256"] != demos_sha256:
        raise ConfigError(f"{path.parent.parent} was begun with other demonstrations; choose another --out.")
    state = jax.tree.unflatten(tree, [_like(old, new) for old, new in zip(template, leaves, strict=True)])
    archives, xnes, rng = deepcopy((search.archives, search.xnes, search.rng))
    for name, grid in archives._asdict().items():
        archive.refill(grid, _in_group(arrays, name))
    xnes.mean, xnes.shape, xnes.sigma = arrays["xnes/mean"], arrays["xnes/shape"], float(arrays["xnes/sigma"])
    xnes.rng.bit_generator.state, rng.bit_generator.state = values["xnes"], values["rng"]
    # JSON has no tuples.
    plain: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in values["position"].items()}
    position = Position(**plain, history=History(**_in_group(arrays, "history")))
    return search._replace(archives=archives, xnes=xnes, rng=rng, state=state), position


def _in_group(arrays: dict[str, np.ndarray], group: str) -> dict[str, np.ndarray]:
    """The arrays called ``group/name``, by name."""
    return {key.split("/")[1]: values for key, values in arrays.items() if key.startswith(f"{group}/")}


def reached(run_folder: Path) -> tuple[int, int] | None:
    """Warm-up updates and QD iterations that the newest checkpoint holds; None without a checkpoint."""
    newest = next(iter(_newest_first(run_folder)), None)
    if newest is None:
        return None
    warmed, iteration, _ = newest.name.split("-")
    return int(warmed), int(iteration)


def remove(run_folder: Path) -> None:
    """Remove all checkpoints of a finished run."""
    shutil.rmtree(run_folder / FOLDER, ignore_errors=True)


@contextmanager
def locked(run_folder: Path) -> Iterator[None]:
    """Lock the folder for this process, and remove half-written files of killed processes.

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
            # Without the file the lock is free: its holder removed the file after this process had opened it.
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
    """``new`` as an array with the type and layout of ``old``, so that no program compiles again."""
    value = jax.random.wrap_key_data(jax.numpy.asarray(new)) if _is_key(old) else new.astype(old.dtype)
    # JAX may move an uncommitted array, such as a key just split, to the devices of a computation: keep it that way.
    return laid_out(value, old.sharding) if old.committed else jax.numpy.asarray(value)
