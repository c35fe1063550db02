"""Writing files so that nobody ever sees half of one, and naming their contents by hash."""

import csv
import hashlib
import json
import os
import re
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from qdil.errors import ConfigError

# Names that ``replace_file`` gives its temporary neighbours; a process killed while it writes leaves one behind.
TEMPORARY = re.compile(r"\..+\.(csv|json|npz)\.[a-z0-9_]{8}")


def replace_file(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write ``path`` through a temporary neighbour that takes its name only once it is whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException as error:
        Path(name).unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename is None:  # a full disk does not say which file it was about
            error.filename = str(path)
        raise


def sweep(folder: Path) -> None:
    """Remove what killed processes left half written in ``folder``; nobody may be writing there."""
    for path in folder.glob(".*"):
        if TEMPORARY.fullmatch(path.name):
            path.unlink(missing_ok=True)


def write_npz(path: Path, **arrays: np.ndarray) -> None:
    """Arrays by name, compressed; equal arrays give equal bytes."""
    replace_file(path, lambda file: np.savez_compressed(file, **arrays))  # type: ignore[arg-type]


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Indented JSON, keys in the order given."""
    replace_file(path, lambda file: file.write((json.dumps(content, indent=2) + "\n").encode()))


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object. Raises ConfigError if the file holds none, and OSError if there is no such file."""
    try:
        content = json.loads(path.read_text())
    except ValueError:  # not JSON, or not even text
        content = None
    if not isinstance(content, dict):
        raise ConfigError(f"{path} is damaged: it holds no JSON object.")
    return content


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """Arrays by name. Raises ConfigError if the file is damaged, and OSError if there is no such file."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except OSError:
        raise
    except Exception:  # zipfile, zlib and numpy each have errors of their own for what is not an .npz
        raise ConfigError(f"{path} is damaged: it holds no arrays.") from None


def write_csv(path: Path, columns: list[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """A table with a header; what a row lacks stays empty."""
    lines: list[str] = []

    class _Lines:
        def write(self, text: str) -> int:
            lines.append(text)
            return len(text)

    writer = csv.DictWriter(_Lines(), columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    replace_file(path, lambda file: file.write("".join(lines).encode()))


def sha256(path: Path) -> str:
    """Hex digest of a file's bytes."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
