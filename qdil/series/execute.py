"""Execution of one notebook with papermill, into a copy with its outputs. ``main`` is a process that does this."""

import argparse
import json
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import nbformat
import papermill
from papermill.exceptions import PapermillExecutionError

from qdil.config import ConfigError
from qdil.files import replace_file, write_json

ROOT = Path(__file__).parent.parent.parent
KERNEL = "python3"  # ipykernel's own name; Jupyter starts it with the interpreter that runs this process
QUIET = ["--IPKernelApp.log_level=50"]  # no log lines of the kernel about its transport and shutdown
LARGEST = 2_000_000  # bytes of an executed copy
PARAMETERS = ("budget", "env", "seed")  # of every notebook


def check_parameters(source: Path) -> None:
    """Raise ConfigError if a notebook's parameters cell lacks one of ``PARAMETERS``, perhaps because it is misspelt.

    papermill would ignore the parameter, execute the notebook with its own default, and succeed.
    """
    found = papermill.inspect_notebook(source)
    missing = [name for name in PARAMETERS if name not in found]
    if missing:
        raise ConfigError(
            f"{source.stem}: no cell tagged 'parameters' sets {', '.join(missing)} "
            f"(it sets {', '.join(found) or 'nothing'}), so that nothing was executed."
        )


def execute(source: Path, target: Path, draft: Path, parameters: Mapping[str, Any], limit: float) -> str | None:
    """Execute one notebook within ``limit`` seconds; returns its failure, "NAME, cell N: ErrorName: message", or None.

    N is the number in the executed copy's ``In [N]``. Output on standard error and a copy larger than ``LARGEST`` are
    failures, too. papermill writes the copy to ``draft``, cell by cell; at the end it moves to ``target``, also after a
    failure.
    """
    end = time.monotonic() + limit
    name, seconds_left = source.stem, lambda cell: max(end - time.monotonic(), 0.001)
    try:
        papermill.execute_notebook(
            source,
            draft,
            dict(parameters),
            kernel_name=KERNEL,
            progress_bar=False,
            cwd=source.parent,
            extra_arguments=QUIET,
            timeout_func=seconds_left,  # called before each cell, so the limit is for the whole notebook
        )
        return _noise_or_bulk(draft)
    except PapermillExecutionError as error:
        return f"{name}, cell {error.exec_count}: {error.ename}: {_first_line(error.evalue)}"
    except TimeoutError:
        return f"{name}, cell {reached(draft)}: TimeoutError: more than {limit / 60:g} minutes for the whole notebook"
    except Exception as error:  # the kernel died or could not start; the other notebooks can still run
        return f"{name}, cell {reached(draft)}: {type(error).__name__}: {_first_line(str(error))}"
    finally:
        if draft.is_file():
            _keep(draft, source, target)


def progress(draft: Path) -> tuple[int, int] | None:
    """How many code cells of the notebook at ``draft`` are done, and how many there are; None if it cannot be read."""
    try:
        cells = [cell for cell in json.loads(draft.read_text())["cells"] if cell["cell_type"] == "code"]
    except (OSError, ValueError):
        return None
    return sum(cell["metadata"].get("papermill", {}).get("status") == "completed" for cell in cells), len(cells)


def reached(draft: Path) -> int:
    """The number of the last code cell that was started; 0 if there is none."""
    cells = nbformat.read(draft, as_version=4).cells if draft.is_file() else []
    return sum(cell.cell_type == "code" and bool(cell.metadata.papermill.get("start_time")) for cell in cells)


def _noise_or_bulk(draft: Path) -> str | None:
    """The failure of a notebook without an error: output on standard error, or more than ``LARGEST`` bytes."""
    for cell in nbformat.read(draft, as_version=4).cells:
        for output in cell.get("outputs", []):
            if output.get("name") == "stderr":
                return f"{draft.stem}, cell {cell.execution_count}: on standard error: {_first_line(output.text)}"
    size = draft.stat().st_size
    return f"{draft.stem}: {size / 1e6:.1f} MB of output; {LARGEST / 1e6:g} MB is the limit" if size > LARGEST else None


def _keep(draft: Path, source: Path, target: Path) -> None:
    """Move an executed draft to ``target``, with paths in its metadata that are valid on any machine."""
    notebook = nbformat.read(draft, as_version=4)
    notebook.metadata.papermill.update(input_path=_portable(source), output_path=_portable(target))
    replace_file(target, lambda file: file.write(nbformat.writes(notebook).encode() + b"\n") and None)


def _portable(path: Path) -> str:
    """A path relative to the repository's root, with forward slashes; of a path outside it, the name alone."""
    return path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else path.name


def _first_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[0] if lines else ""


def main(argv: list[str] | None = None) -> int:
    """Execute one notebook for the workflow. Its draft and a report, ``NAME.json``, are written to ``--scratch``."""
    parser = argparse.ArgumentParser(prog="python -m qdil.series.execute", description=main.__doc__)
    parser.add_argument("source", type=Path)
    for option in ("--target", "--scratch"):
        parser.add_argument(option, type=Path, required=True)
    parser.add_argument("--budget", required=True)
    parser.add_argument("--env", required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--minutes", type=float, required=True, help="limit for the whole notebook")
    args = parser.parse_args(argv)
    os.environ["QDIL_EXPLORER"] = "page"  # an executed copy has no kernel, so no widgets
    source, begin = args.source.resolve(), time.monotonic()
    draft = args.scratch / source.name
    parameters = {name: getattr(args, name) for name in PARAMETERS}
    failure = execute(source, args.target.resolve(), draft, parameters, args.minutes * 60)
    seconds = round(time.monotonic() - begin, 1)
    write_json(args.scratch / f"{source.stem}.json", {"seconds": seconds, "failure": failure})
    return 1 if failure else 0


if __name__ == "__main__":
    sys.exit(main())
