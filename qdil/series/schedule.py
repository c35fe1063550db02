"""Executing the series: everything checked first, then scheduled by Snakemake, watched from here and reported."""

import json
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
from qdil.series import index
from qdil.series.index import NOTEBOOKS, ROOT

EXECUTED = ROOT / "results" / "notebooks"
SNAKEFILE = ROOT / "workflow" / "Snakefile"
SECONDS_BETWEEN_LOOKS = 0.5
SECONDS_BETWEEN_LINES = 30.0
LOG_LINES = 15  # of Snakemake's log, shown where it failed before any notebook did


class Order(NamedTuple):
    """Which notebooks to execute, and how."""

    names: Sequence[str] = ()  # none: all of them
    budget: str = "smoke"
    env: str = "walker2d"
    seed: int = 1
    at_once: int = 2
    train: bool = False  # beyond smoke, too, train the runs that are missing
    minutes: float = 30.0  # limit for each notebook
    notebooks: Path = NOTEBOOKS
    executed: Path = EXECUTED  # copies go to its folder <budget>


def execute_all(order: Order) -> list[str]:
    """Execute notebooks as ordered; returns one sentence for each that failed, while the others went on.

    Raises ConfigError before anything runs for an unknown name, robot, budget or seed, a limit that is none, and a
    notebook that does not take the parameters that it will be given.
    """
    with needs("notebooks", "the execution of notebooks"):
        version("snakemake")  # a process of its own; importing it here would take a second
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
    """Snakemake on the workflow's rule ``notebooks``."""
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
    """Until the workflow ends: a bar for each notebook on a terminal, plain lines now and then elsewhere."""
    show = {name: (_Bar if sys.stderr.isatty() else _Lines)(name) for name in names}
    while True:
        ended = workflow.poll() is not None
        for name in [name for name in names if name in show]:
            report = scratch / f"{name}.json"
            if report.is_file():
                show.pop(name).end(**json.loads(report.read_text()))
            elif (draft := scratch / f"{name}.ipynb").is_file():
                show[name].look(draft)
        if ended:
            return
        time.sleep(SECONDS_BETWEEN_LOOKS)


class _Lines:
    """A notebook's progress as lines of a log."""

    def __init__(self, name: str) -> None:
        self.name, self.last = name, 0.0

    def look(self, draft: Path) -> None:
        from qdil.series.execute import progress

        self.last = self.last or time.monotonic()
        if time.monotonic() - self.last > SECONDS_BETWEEN_LINES and (cells := progress(draft)):
            self.last = time.monotonic()
            print(f"{self.name}: {cells[0]} of {cells[1]} cells", flush=True)

    def end(self, seconds: float, failure: str | None) -> None:
        print(f"{self.name}: {'failed' if failure else 'done'} after {seconds:.0f} s", flush=True)


class _Bar:
    """A notebook's progress as a bar."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.bar: tqdm | None = None

    def look(self, draft: Path) -> None:
        from qdil.series.execute import progress

        if cells := progress(draft):
            bar = self._bar(cells[1])
            bar.update(cells[0] - bar.n)

    def end(self, seconds: float, failure: str | None) -> None:
        bar = self._bar(1)
        bar.set_postfix_str("failed" if failure else "done")
        bar.update(0 if failure else bar.total - bar.n)
        bar.close()

    def _bar(self, cells: int) -> tqdm:
        self.bar = self.bar if self.bar is not None else tqdm(total=cells, desc=self.name, unit="cell")
        return self.bar


def _failures(names: Sequence[str], scratch: Path, code: int) -> list[str]:
    """A sentence for each notebook that failed or was not reached, and for a workflow that failed otherwise."""
    reports = {name: scratch / f"{name}.json" for name in names}
    told = {name: json.loads(path.read_text())["failure"] for name, path in reports.items() if path.is_file()}
    failures = [failure for failure in told.values() if failure]
    missed = [name for name in names if name not in told]
    if missed:
        failures.append(f"not executed, because what they need failed: {', '.join(missed)}")
    if code and (missed or not failures):
        failures.append("\n".join((scratch / "log").read_text().splitlines()[-LOG_LINES:]))
    return failures
