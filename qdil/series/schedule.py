"""Execution of the series: checks everything first, lets Snakemake schedule the notebooks, and reports on them."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from tqdm import tqdm

from qdil.config import ConfigError, make_config
from qdil.extras import needs
from qdil.files import read_json
from qdil.series import index
from qdil.series.index import NOTEBOOKS, ROOT

EXECUTED = ROOT / "results" / "notebooks"
SNAKEFILE = ROOT / "workflow" / "Snakefile"
SECONDS_BETWEEN_LOOKS = 0.5
SECONDS_BETWEEN_LINES = 30.0
LOG_LINES = 15  # of Snakemake's log, shown if it failed before any notebook did


class Order(NamedTuple):
    """Which notebooks to execute, and how."""

    names: Sequence[str] = ()  # empty: all of them
    budget: str = "smoke"
    env: str = "walker2d"
    seed: int = 1
    at_once: int = 2
    train: bool = False  # train missing runs at laptop and full, too; at smoke they always are
    minutes: float = 30.0  # limit for each notebook
    notebooks: Path = NOTEBOOKS
    executed: Path = EXECUTED  # executed copies go to its subfolder <budget>


def execute_all(order: Order) -> list[str]:
    """Execute notebooks as ordered; returns one sentence for each that failed. The others are executed all the same.

    Raises ConfigError before anything runs for an unknown name, robot, budget or seed, for a number below its least
    value, and for a notebook without the parameters that it will be given.
    """
    with needs("notebooks", "the execution of notebooks"):
        version("snakemake")  # it runs in another process; importing it here would take a second
        from qdil.series.execute import check_parameters

    if order.at_once < 1 or not order.minutes > 0:
        raise ConfigError("-j must be at least 1, and --timeout above 0 minutes.")
    make_config(order.env, "true", order.budget, order.seed)
    names = index.chosen(order.names, order.notebooks)
    for name in names:
        check_parameters(order.notebooks / f"{name}.ipynb")
    with tempfile.TemporaryDirectory(prefix="qdil-notebooks-") as folder:
        scratch = Path(folder)
        with open(scratch / "log", "w") as log:
            workflow = subprocess.Popen(_command(order, names, scratch), cwd=ROOT, stderr=log)
            try:
                _watch(workflow, names, scratch)
            finally:
                workflow.wait()
        return _failures(names, scratch, workflow.returncode)


def _command(order: Order, names: Iterable[str], scratch: Path) -> list[str]:
    """The command that makes Snakemake apply the workflow's rule ``notebooks``."""
    settings = {
        "budget": order.budget,
        "envs": order.env,
        "seed": order.seed,
        "train": int(order.train),
        "minutes": order.minutes,
        "notebooks": ",".join(names),
        "source": order.notebooks.resolve(),
        "executed": (order.executed / order.budget).resolve(),
        "scratch": scratch,
    }
    command = [sys.executable, "-m", "snakemake", "notebooks", "--snakefile", str(SNAKEFILE)]
    command += ["--cores", str(order.at_once), "--keep-going", "--nolock", "--rerun-incomplete"]
    command += ["--rerun-triggers", "mtime", "--quiet", "all"]
    return [*command, "--config", *(f"{name}={value}" for name, value in settings.items())]


def _watch(workflow: subprocess.Popen, names: Sequence[str], scratch: Path) -> None:
    """Wait for the workflow to end: a line for each notebook that ends, and their progress, see ``_Progress``."""
    progress, running = _Progress(len(names)), list(names)
    while True:
        ended = workflow.poll() is not None  # before the reports are read, so that the last one is not missed
        for name in tuple(running):
            report = scratch / f"{name}.json"
            if report.is_file():
                running.remove(name)
                progress.end(name, **read_json(report))
        progress.update(running, scratch)
        if ended:
            progress.bar.close()
            return
        time.sleep(SECONDS_BETWEEN_LOOKS)


class _Progress:
    """A bar over the notebooks on a terminal; elsewhere a line every ``SECONDS_BETWEEN_LINES``."""

    def __init__(self, count: int) -> None:
        self.bar = tqdm(total=count, unit="notebook", disable=not sys.stderr.isatty())
        self.last_line = time.monotonic()

    def update(self, running: Iterable[str], scratch: Path) -> None:
        """Show how many cells of the ``running`` notebooks are done."""
        from qdil.series.execute import progress

        cells = {name: progress(scratch / f"{name}.ipynb") for name in running}
        shown = ", ".join(f"{name} {of[0]} of {of[1]} cells" for name, of in cells.items() if of)
        self.bar.set_postfix_str(shown)
        if self.bar.disable and shown and time.monotonic() - self.last_line > SECONDS_BETWEEN_LINES:
            self.last_line = time.monotonic()
            print(shown, flush=True)

    def end(self, name: str, seconds: float, failure: str | None) -> None:
        """Print that a notebook has ended."""
        self.bar.write(f"{name}: {'failed' if failure else 'done'} after {seconds:.0f} s")
        self.bar.update()
        sys.stdout.flush()


def _failures(names: Sequence[str], scratch: Path, code: int) -> list[str]:
    """A sentence for each notebook that failed or was not executed, and the end of the log for other failures."""
    reports = {name: scratch / f"{name}.json" for name in names}
    results = {name: read_json(path)["failure"] for name, path in reports.items() if path.is_file()}
    failures = [failure for failure in results.values() if failure]
    missed = [name for name in names if name not in results]
    if missed:
        failures.append(f"not executed, because a run that they show could not be trained: {', '.join(missed)}")
    if code and (missed or not failures):
        failures.append("\n".join((scratch / "log").read_text().splitlines()[-LOG_LINES:]))
    return failures
