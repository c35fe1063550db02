"""Files that are written completely or not at all, and their hashes."""

import csv
import hashlib
import io
import json
import os
import re
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from qdil.errors import ConfigError

# Names of the temporary files of ``replace_file``. A process that is killed while it writes leaves one behind.
TEMPORARY = re.compile(r"\..+\.(csv|json|npz)\.[a-z0-9_]{8}")


def replace_file(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write a temporary file in the same folder and rename it to ``path`` once it is complete."""
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
        if isinstance(error, OSError) and error.filename is None:  # as on a full disk
            error.filename = str(path)
        raise


def sweep(folder: Path) -> None:
    """Remove temporary files of killed processes from ``folder``. No other process may be writing there."""
    for path in folder.glob(".*"):
        if TEMPORARY.fullmatch(path.name):
            path.unlink(missing_ok=True)


def write_npz(path: Path, **arrays: np.ndarray) -> None:
    """Write arrays by name, compressed. Equal arrays give equal bytes."""
    replace_file(path, lambda file: np.savez_compressed(file, **arrays))  # type: ignore[arg-type]


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write indented JSON with the keys in the given order."""
    replace_file(path, lambda file: file.write((json.dumps(content, indent=2) + "\n").encode()))


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object. Raises ConfigError if the file does not hold one, and OSError if it does not exist."""
    try:
        content = json.loads(path.read_text())
    except ValueError:  # not JSON, or not even text
        content = None
    if not isinstance(content, dict):
        raise ConfigError(f"{path} is damaged: it holds no JSON object.")
    return content


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """Read arrays by name. Raises ConfigError if the file is damaged, and OSError if it does not exist."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except OSError:
        raise
    except Exception:  # zipfile, zlib and NumPy raise errors of different types
        raise ConfigError(f"{path} is damaged: it holds no arrays.") from None


def write_csv(path: Path, columns: list[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write a table with a header. Columns that a row does not have stay empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    replace_file(path, lambda file: file.write(text.getvalue().encode()))


def sha256(path: Path) -> str:
    """Hex digest of a file's bytes."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
