"""The page of a notebook: its banner, the runs that it shows, its figures, and the source of functions."""

import inspect
import os
from collections.abc import Callable, Iterator, Sequence, Sized
from pathlib import Path
from typing import Any, NamedTuple

import jax
import pandas as pd
from matplotlib.figure import Figure

from qdil import plotting
from qdil.config import make_config
from qdil.devices.start import use_all_cores
from qdil.evidence import claims, diagnosis
from qdil.extras import needs
from qdil.robots.register import PAPER_ROBOTS, robot_names
from qdil.runs import experiments, manifest, studies
from qdil.runs.folder import RESULTS, demos_of
from qdil.runs.missing import train_missing

with needs("notebooks", "what a notebook shows"):
    from IPython.display import Markdown, display

ROOT = Path(__file__).parent.parent.parent
BUDGET_NOTES = {  # about each budget, in the banner and on the site
    "smoke": "a test that every line runs; nothing has been learned, so draw no conclusion from these pictures",
    "laptop": "a small version of the experiment; the curves are real, the scale is not the paper's",
    "desk": "the paper's units and networks with fewer robots and iterations; archives are smaller than the paper's",
    "full": "the paper's own scale",
}

Runs = dict[str, list[Path]]  # folders of finished runs, by experiment


class Page(NamedTuple):
    """An open notebook: what its cell of parameters chose. ``open_page`` makes it."""

    budget: str
    env: str  # the robot
    seed: int

    def runs(self, study: str | Sequence[str], train: bool = False, seeds: Sequence[int] | None = None) -> Runs:
        """The finished runs of a study (or of experiments), by experiment; also displays a line that lists them.

        At ``smoke``, and with ``train``, missing runs are trained first. ``train`` also draws each archive as it fills.
        ``seeds`` None: the budget's.
        """
        wanted = studies.experiments_of([study], self.budget) if isinstance(study, str) else tuple(study)
        if train:
            train_missing(wanted, self.env, self.budget, seeds, report=plotting.LiveArchive)
        elif self.budget == "smoke":
            train_missing(wanted, self.env, self.budget, seeds)
        found = experiments.finished(wanted, self.env, self.budget, seeds)
        listed = [f"`{name}` ({', '.join(path.name.replace('-', ' ') for path in of)})" for name, of in found.items()]
        lines = [f"Loaded from `results/{self.budget}/{self.env}`: {'; '.join(listed) or 'nothing'}."]
        if missing := [f"`{name}`" for name in wanted if name not in found]:
            lines.append(f"**Not trained yet**, so not shown: {', '.join(missing)}.")
        display(Markdown("\n\n".join(lines)))
        return found

    def robots(self, names: Sequence[str]) -> Iterator[tuple[str, Runs]]:
        """Each robot with finished runs of some experiments, and those runs. Trains nothing.

        A heading with the robot's name and its missing experiments is displayed before each of them, and a line with
        the robots that have no such run at the end.
        """
        without = []
        for env in robot_names():
            found = experiments.finished(names, env, self.budget)
            missing = ", ".join(f"`{name}`" for name in names if name not in found)
            if found:
                display(Markdown(f"**{env}**" + (f": not trained yet, so not shown: {missing}." if missing else "")))
                yield env, found
            else:
                without.append(env)
        if without:
            display(Markdown(f"No finished runs at this budget: {', '.join(without)}."))

    def demonstrations(self) -> Path | None:
        """Demonstrations of the expert with the page's seed. Without a file: None, and a line with the commands.

        Notebooks skip the cells that need demonstrated steps if it is None.
        """
        path = demos_of(make_config(self.env, "true", self.budget, self.seed))
        if path.is_file():
            return path
        where = f"--env {self.env} --budget {self.budget} --seed {self.seed}"
        display(
            Markdown(
                f"**No demonstrations yet**: there is no `{path.as_posix()}`, so the cells below that need "
                f"demonstrated steps are left out. `qdil train --method true {where}` trains the expert, and "
                f"`qdil demos {where}` records its demonstrations."
            )
        )
        return None

    def show(self, figure: Figure | str | Sized | None, name: str | None = None, env: str | None = None) -> None:
        """Display a figure. One with a name is also written as PNG and PDF: ``results/figures/laptop-walker2d-NAME``.

        ``env`` is the robot in the figure, if it is not the page's own. A text is displayed instead of a figure that
        cannot be drawn; for None or anything empty, that text is "No run is finished yet.".
        """
        if isinstance(figure, Figure):
            display(figure)
            if name is not None:
                path = figures_folder(self.budget) / f"{self.budget}-{env or self.env}-{name}"
                plotting.save(figure, path)
        else:
            display(Markdown(figure if isinstance(figure, str) and figure else "No run is finished yet."))

    def diagnoses(self, runs: Runs, name: str | None = None) -> None:
        """Display the numbers of ``qdil diagnose`` for some runs as a table and as a figure, which has a ``name``."""
        found = diagnosis.of_runs(runs)
        numbers = diagnosis.tidy(found)
        if numbers.empty:
            self.show(None)
            return
        with pd.option_context("display.max_colwidth", None):
            display(diagnosis.table(found))
        self.show(plotting.findings(numbers), name)

    def verdicts(self, *claim_ids: str) -> None:
        """Display the verdicts on some claims, for the page's robot and from the runs of the page's budget."""
        if self.env not in PAPER_ROBOTS:
            self.show(f"The claims are about {', '.join(PAPER_ROBOTS)}, so there is no verdict on {self.env}.")
            return
        judged = claims.judge(budget=self.budget, envs=[self.env])
        with pd.option_context("display.max_colwidth", None):
            display(claims.table([verdict for verdict in judged if verdict.claim.id in claim_ids], all_rows=True))

    def source(self, function: Callable[..., Any]) -> None:
        """Display the source of a function or class of the library."""
        function = inspect.unwrap(function)
        name = f"{function.__module__}.{function.__qualname__}"
        display(Markdown(f"The source of `{name}`:\n\n```python\n{inspect.getsource(function).strip()}\n```"))


def open_page(budget: str, env: str, seed: int, note: str | None = None) -> Page:
    """Open a notebook's page and display its banner: budget, robot, seed, device and commit.

    Changes the working directory to the repository's root, so that ``results/…`` is the same folder wherever the
    notebook was started. ``note`` (Markdown) is a further line of the banner. Raises ConfigError for a budget, robot or
    seed that does not exist.
    """
    use_all_cores()  # before a user's module can start JAX's devices
    make_config(env, "true", budget, seed)
    os.chdir(ROOT)
    device = f"{jax.local_device_count()} × {jax.local_devices()[0].device_kind}"
    facts = {"budget": budget, "robot": env, "seed": seed, "device": device, "commit": manifest.commit()}
    banner = " · ".join(f"**{name}** {value}" for name, value in facts.items())
    lines = [banner, f"The *{budget}* budget is {BUDGET_NOTES[budget]}.", *([note] if note else [])]
    display(Markdown("\n>\n".join(f"> {line}" for line in lines)))
    return Page(budget, env, seed)


def figures_folder(budget: str, root: Path = RESULTS) -> Path:
    """The folder of a budget's figures; git ignores that of ``smoke``, since nothing has been learned there."""
    return root / budget / "figures" if budget == "smoke" else root / "figures"
