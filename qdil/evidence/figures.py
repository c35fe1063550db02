"""Figures and a table of finished runs, computed from their folders and written under ``results/figures``."""

from pathlib import Path

import pandas as pd

from qdil import plotting, run
from qdil.config import ConfigError, make_config
from qdil.files import replace_file
from qdil.registry import method_names


def finished_runs(env: str, budget: str, seed: int, root: Path) -> dict[str, Path]:
    """Folders of the finished runs of one robot, budget and seed, by method."""
    folders = {name: root / budget / env / name / f"seed-{seed}" for name in method_names()}
    return {name: folder for name, folder in folders.items() if run.is_finished(folder)}


def summary_table(folders: dict[str, Path]) -> str:
    """The final metrics of runs by method as a Markdown table, each number read from the run's own files.

    "scored again" is the elites' average true return over fresh episodes, free of the luck that won them their cells.
    """
    columns = ["method", "QD-score", "coverage", "best", "average", "average, scored again", "million steps", "minutes"]
    lines = ["| " + " | ".join(columns) + " |", "| " + " | ".join(["---"] + ["---:"] * (len(columns) - 1)) + " |"]
    for method, folder in folders.items():
        last = pd.read_csv(folder / "metrics.csv").iloc[-1]
        again = float(run.read_archive(folder)["rescored_return"].mean())
        numbers = [
            f"{last['qd_score']:,.0f}",
            f"{last['coverage']:.1%}",
            f"{last['best']:.0f}",
            f"{last['average']:.0f}",
            f"{again:.0f}",
            f"{last['env_steps'] / 1e6:.1f}",
            f"{last['wall_seconds'] / 60:.1f}",
        ]
        lines.append("| " + " | ".join([f"`{method}`", *numbers]) + " |")
    return "\n".join(lines) + "\n"


def write_figures(env: str, budget: str, seed: int, root: Path = run.RESULTS) -> list[Path]:
    """Learning curves by iteration, steps and time, all archives on one scale, a table; returns the files written.

    Raises ConfigError where there is no finished run to draw.
    """
    make_config(env, "true", budget, seed)
    folders = finished_runs(env, budget, seed, root)
    if not folders:
        raise ConfigError(f"no finished runs of {env} at budget {budget} with seed {seed} in {root}.")
    metrics = {method: pd.read_csv(folder / "metrics.csv") for method, folder in folders.items()}
    archives = {method: run.read_archive(folder) for method, folder in folders.items()}
    figures = {f"curves-{x}": plotting.learning_curves(metrics, x) for x in plotting.X_LABELS}
    figures["archives"] = plotting.archives_side_by_side(archives, robot=env)
    written = []
    for name, figure in figures.items():
        path = root / "figures" / f"{budget}-{env}-{name}.png"
        content = plotting.to_png(figure)
        replace_file(path, lambda file, content=content: file.write(content))  # type: ignore[misc]
        written.append(path)
    table = root / "figures" / f"{budget}-{env}-summary.md"
    replace_file(table, lambda file: file.write(summary_table(folders).encode()))
    return [*written, table]
