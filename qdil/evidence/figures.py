"""Figures and tables of finished runs, computed from their folders and written under ``results/figures``."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from qdil import plotting
from qdil.config import make_config
from qdil.errors import ConfigError
from qdil.evidence import tables
from qdil.evidence.markdown import markdown_table
from qdil.evidence.tables import Runs
from qdil.files import replace_file
from qdil.methods import method_names
from qdil.runs.experiments import finished
from qdil.runs.folder import RESULTS, read_archive
from qdil.runs.studies import STUDIES, experiments_of


def finished_runs(
    env: str, budget: str, root: Path = RESULTS, seeds: Sequence[int] | None = None
) -> dict[str, list[Path]]:
    """Folders of a robot's finished runs (of ``seeds``, or of all) by experiment: plain methods first."""
    names = dict.fromkeys((*method_names(), *experiments_of(STUDIES, budget)))
    if seeds is None:
        return tables.finished_seeds(names, env, budget, root)
    return finished(names, env, budget, seeds, root)


def of_study(runs: Runs, study: str) -> dict[str, Sequence[Path]]:
    """The part of ``runs`` that a study compares, in its order."""
    return {name: runs[name] for name in STUDIES[study] if name in runs}


def summary_table(runs: Runs) -> str:
    """The final metrics of runs as a Markdown table, each number read from the runs' own files.

    Several seeds give "mean ± standard deviation" and a column that counts them; one seed gives the number alone.
    Corrected metrics are those of the elites over fresh episodes, put where they land (``qdil.qd.landing``).
    """
    shown = tables.summary(runs)
    if all(len(folders) == 1 for folders in runs.values()):
        shown = shown.drop(columns="seeds")
    table = shown.rename(index=lambda name: f"`{name}`").rename_axis("method").reset_index()
    return markdown_table(table, right=shown.columns) + "\n"


def draw(runs: Runs, env: str) -> dict[str, Figure]:
    """Every figure of one robot's runs, by name: the main study's in full, curves and bars for each other study.

    If the main study has no runs, its figures show all runs. Archives are those of the first seed.
    """
    main = of_study(runs, "main") or runs
    metrics = tables.read_metrics(main)
    figures = {f"curves-{x}": plotting.learning_curves(metrics, x) for x in plotting.X_LABELS}
    first = {name: read_archive(folders[0]) for name, folders in main.items()}
    figures["archives"] = plotting.both_readings(first, robot=env)
    for study in STUDIES:
        compared = of_study(runs, study)
        if study != "main" and set(compared) - set(main):
            figures[f"{study}-curves"] = plotting.learning_curves(tables.read_metrics(compared))
            figures[f"{study}-bars"] = plotting.bars(tables.final(compared))
            if study == "p-and-q":
                for metric in ("qd_score", "corrected_qd_score"):
                    name = f"{study}-grid" if metric == "qd_score" else f"{study}-grid-corrected"
                    figures[name] = plotting.grid(tables.final(compared), metric=metric)
    return figures


def write_figures(env: str, budget: str, seeds: Sequence[int] | None = None, root: Path = RESULTS) -> list[Path]:
    """Draw the finished runs of ``seeds`` (None: all), each figure as PNG and PDF, and write two tables.

    Returns the files written. Raises ConfigError if there is no finished run to draw.
    """
    for seed in seeds or (1,):
        make_config(env, "true", budget, seed)
    runs = finished_runs(env, budget, root, seeds)
    if not runs:
        of = f" with seed {', '.join(map(str, seeds))}" if seeds else ""
        raise ConfigError(f"no finished runs of {env} at budget {budget}{of} in {root}.")
    base = root / "figures" / f"{budget}-{env}"
    written = [
        path
        for name, figure in draw(runs, env).items()
        for path in plotting.save(figure, base.with_name(f"{base.name}-{name}"))
    ]
    tables_of = {"summary": of_study(runs, "main") or runs, "all-runs": runs}
    for name, shown in tables_of.items():
        path, content = base.with_name(f"{base.name}-{name}.md"), summary_table(shown).encode()
        replace_file(path, lambda file, content=content: file.write(content))  # type: ignore[misc]
        written.append(path)
    return written
