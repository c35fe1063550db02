"""Executing the notebooks headlessly with papermill, each into a copy with its outputs under ``results/notebooks``."""

import tempfile
import time
from pathlib import Path

import nbformat
import papermill
from papermill.exceptions import PapermillExecutionError

from qdil.config import ConfigError
from qdil.files import replace_file

ROOT = Path(__file__).parent.parent.parent
NOTEBOOKS = ROOT / "notebooks"
EXECUTED = ROOT / "results" / "notebooks"
KERNEL = "python3"  # ipykernel's own, which Jupyter starts with the interpreter that runs this
QUIET = ["--IPKernelApp.log_level=50"]  # the kernel's remarks about its own transport and shutdown help nobody here


def names_of_all() -> list[str]:
    """The numbered notebooks in reading order, without their suffix."""
    return sorted(path.stem for path in NOTEBOOKS.glob("[0-9][0-9]_*.ipynb"))


def execute_all(names: list[str], budget: str) -> list[str]:
    """Execute ``names`` (none: every notebook) at ``budget``; returns one sentence for each that failed.

    A copy with outputs goes to ``results/notebooks/<budget>/``, also where a cell failed. Prints a line per notebook
    with its seconds. Raises ConfigError, before anything runs, for a name that is not a notebook's.
    """
    known = names_of_all()
    for name in names:
        if name not in known:
            raise ConfigError(
                f"there is no notebook '{name}'; choose from {', '.join(known) or 'none: there are none'}."
            )
    failures = []
    for name in names or known:
        begin = time.monotonic()
        failure = execute(name, budget)
        took = time.monotonic() - begin
        print(f"{name}: {'failed' if failure else 'done'} after {took:.0f} s", flush=True)
        failures += [failure] if failure else []
    return failures


def execute(name: str, budget: str) -> str | None:
    """Execute one notebook; returns what went wrong, as 'NAME, cell N: ErrorName: message', or None.

    N is the number in the executed copy's ``In [N]``.
    """
    source = NOTEBOOKS / f"{name}.ipynb"
    if "budget" not in papermill.inspect_notebook(source):  # papermill would run it with the default, and succeed
        return f"{name}: ConfigError: no cell tagged 'parameters' sets 'budget'."
    with tempfile.TemporaryDirectory() as scratch:
        draft = Path(scratch) / source.name
        try:
            papermill.execute_notebook(
                source,
                draft,
                {"budget": budget},
                kernel_name=KERNEL,
                progress_bar=False,
                cwd=NOTEBOOKS,
                extra_arguments=QUIET,
            )
            return None
        except PapermillExecutionError as error:
            return f"{name}, cell {error.exec_count}: {error.ename}: {_first_line(error.evalue)}"
        except Exception as error:  # the kernel died or could not start; the other notebooks can still run
            return f"{name}, cell {_reached(draft)}: {type(error).__name__}: {_first_line(str(error))}"
        finally:
            if draft.is_file():
                _keep(draft, source, EXECUTED / budget / source.name)


def _keep(draft: Path, source: Path, target: Path) -> None:
    """Move an executed draft to its place, with paths in its metadata that mean something on any machine."""
    notebook = nbformat.read(draft, as_version=4)
    notebook.metadata.papermill.update(input_path=_shown(source), output_path=_shown(target))
    replace_file(target, lambda file: file.write(nbformat.writes(notebook).encode() + b"\n") and None)


def _reached(draft: Path) -> int:
    """The number of the last cell that was begun; 0 if none was."""
    cells = nbformat.read(draft, as_version=4).cells if draft.is_file() else []
    return max((cell.get("execution_count") or 0 for cell in cells), default=0)


def _shown(path: Path) -> str:
    """A path from the repository's root, with forward slashes."""
    return path.relative_to(ROOT).as_posix()


def _first_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[0] if lines else ""
