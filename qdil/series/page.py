"""What every notebook opens with: where it runs, what its numbers are made of, and the runs that it shows."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
from matplotlib.figure import Figure

from qdil import plotting
from qdil.config import make_config
from qdil.devices.start import use_all_cores
from qdil.extras import needs
from qdil.robots.register import robot_names
from qdil.runs import experiments, manifest, studies
from qdil.runs.folder import RESULTS, demos_path
from qdil.runs.missing import train_missing

with needs("notebooks", "what a notebook shows"):
    from IPython.display import Markdown, display

ROOT = Path(__file__).parent.parent.parent
OPENED = {"budget": "smoke", "env": "walker2d"}  # by ``begin``; a notebook is a process of its own, and one page
SAYS = {
    "smoke": "a test that every line runs; nothing has been learned, so read no result out of these pictures",
    "laptop": "a small version of the experiment; the curves are real, the scale is not the paper's",
    "full": "the paper's own scale",
}


def begin(budget: str, env: str, seed: int, note: str | None = None) -> Markdown:
    """Work in the repository's root, wherever the notebook was started; the banner with budget, device and commit.

    ``note`` (Markdown) says which part of a notebook holds runs of another budget than the banner's, where one does.
    Raises ConfigError for a budget, robot or seed that does not exist.
    """
    make_config(env, "true", budget, seed)
    use_all_cores()
    os.chdir(ROOT)
    OPENED.update(budget=budget, env=env)
    device = f"{jax.local_device_count()} × {jax.local_devices()[0].device_kind}"
    facts = {"budget": budget, "robot": env, "seed": seed, "device": device, "commit": manifest.commit()}
    banner = " · ".join(f"**{name}** {value}" for name, value in facts.items())
    lines = [banner, f"The *{budget}* budget is {SAYS[budget]}.", *([note] if note else [])]
    return Markdown("\n>\n".join(f"> {line}" for line in lines))


def runs(
    study: str | Sequence[str], env: str, budget: str, train: bool = False, seeds: Sequence[int] | None = None
) -> dict[str, list[Path]]:
    """Folders of the finished runs, by experiment, of a study (or of experiments); shows which are there.

    At ``smoke``, or with ``train``, those that are missing are trained first. ``seeds`` None: the budget's.
    """
    wanted = studies.experiments_of([study], budget) if isinstance(study, str) else tuple(study)
    if train or budget == "smoke":
        train_missing(wanted, env, budget, seeds)
    there = experiments.finished(wanted, env, budget, seeds)
    listed = [f"`{name}` ({', '.join(path.name.replace('-', ' ') for path in paths)})" for name, paths in there.items()]
    missing = [f"`{name}`" for name in wanted if name not in there]
    lines = [f"Loaded from `results/{budget}/{env}`: {'; '.join(listed) or 'nothing'}."]
    if missing:
        lines.append(f"**Not trained yet**, so not shown: {', '.join(missing)}.")
    display(Markdown("\n\n".join(lines)))
    return there


def robots(names: Sequence[str], budget: str) -> Iterator[tuple[str, dict[str, list[Path]]]]:
    """Robots with finished runs of some experiments, and those runs; each in turn gets a heading with what is missing.

    Nothing is trained. The heading stands over whatever is displayed before the next robot is asked for.
    """
    for env in robot_names():
        there = experiments.finished(names, env, budget)
        missing = ", ".join(f"`{name}`" for name in names if name not in there)
        said = f": not trained yet, so not shown: {missing}." if there and missing else ""
        display(Markdown(f"**{env}**{said}" if there else f"**{env}**: no finished runs at this budget."))
        if there:
            yield env, there


def demonstrations(env: str, budget: str) -> Path | None:
    """The file of a robot's demonstrations, as many as the budget's methods learn from; None, and why, without one.

    For the parts of a notebook that ask reward models about demonstrated steps: they are left out where it is None.
    """
    path = demos_path(budget, env, make_config(env, "true", budget).demos.demo_episodes)
    if path.is_file():
        return path
    of = f"--env {env} --budget {budget}"
    display(
        Markdown(
            f"**No demonstrations yet**: there is no `{path.as_posix()}`, so what needs demonstrated steps is left out "
            f"below. `qdil train --method true {of}` trains the expert, and `qdil demos {of}` records it."
        )
    )
    return None


def show(figure: Figure | str | None, name: str | None, env: str | None = None) -> None:
    """Display a figure and write it as PNG and PDF, called after the page's budget and robot: ``laptop-walker2d-NAME``.

    ``env`` is the robot that it shows where that is not the page's own. A figure without a name is not written, for
    where what it is about has no run yet; nor is a text, for where there is nothing to draw. None is nothing at all.
    At ``smoke`` files go to a folder that git ignores.
    """
    if isinstance(figure, Figure):
        display(figure)
        if name is None:
            return
        plotting.save(figure, figures_folder(OPENED["budget"]) / f"{OPENED['budget']}-{env or OPENED['env']}-{name}")
    elif figure is not None:
        display(Markdown(figure))


def figures_folder(budget: str, root: Path = RESULTS) -> Path:
    """Where a budget's figures go: those of ``smoke`` apart, since they show nothing that was learned."""
    return root / budget / "figures" if budget == "smoke" else root / "figures"
