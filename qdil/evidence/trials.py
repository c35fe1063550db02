"""A table of trial runs that need not share a budget: their settings where they differ, and what they reached.

``python -m qdil.evidence.trials FOLDER… > trials.csv`` writes a row per finished run below the folders. Notes on how
settings were chosen keep such tables, so that a choice can be checked without its runs.
"""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from qdil.config.text import BEFORE, with_current_names
from qdil.evidence import corrected
from qdil.evidence.markdown import markdown_table
from qdil.files import read_json
from qdil.runs.folder import is_finished, read_archive

FIRST = ("env", "method", "seed")
REACHED = (*corrected.METRICS, *corrected.CORRECTED, *corrected.SHARES)


def table(folders: list[Path]) -> pd.DataFrame:
    """A row per run: robot, method, seed, the settings in which the runs differ, metrics in both readings, and cost.

    ``return_per_step``: mean return on fresh episodes over their mean length. ``stored_over_fresh``: how much too high
    the fitness is by which elites won their cells, the sum of stored over the sum of rescored fitness; not-a-number
    where fitness may be negative.
    """
    settings = pd.DataFrame([BEFORE | with_current_names(read_json(folder / "config.json")) for folder in folders])
    texts = settings.map(str)
    differ = [name for name in settings if name not in FIRST and texts[name].nunique() > 1]
    return pd.concat([settings[[*FIRST, *differ]], pd.DataFrame([_reached(folder) for folder in folders])], axis=1)


def _reached(folder: Path) -> dict[str, Any]:
    archive, last = read_archive(folder), pd.read_csv(folder / "metrics.csv").iloc[-1]
    numbers = corrected.of_run(folder)
    lengths = archive.get("rescored_length", archive["length"])  # older runs keep only those that won the cells
    stored, fresh = (archive[name].astype(float) for name in ("fitness", "rescored_fitness"))
    positive = stored.min() >= 0 and fresh.sum() > 0
    return {name: numbers[name] for name in REACHED} | {
        "return_per_step": float(np.sum(archive["rescored_return"]) / np.sum(lengths)),
        "mean_length": float(np.mean(lengths)),
        "stored_over_fresh": float(stored.sum() / fresh.sum()) if positive else float("nan"),
        "restarts": int(last["restarts"]),
        "million_steps": last["env_steps"] / 1e6,
        "seconds": last["wall_seconds"],
    }


SHOWN = {  # columns of a note's table: title and format of the numbers
    "million_steps": ("million steps", ".1f"),
    "qd_score": ("QD-score", ",.0f"),
    "corrected_qd_score": ("corrected QD-score", ",.0f"),
    "corrected_coverage": ("corrected coverage", ".0%"),
    "corrected_average": ("corrected average", ",.0f"),
    "relanded": ("own cell", ".0%"),
    "relanded_near": ("near", ".0%"),
    "return_per_step": ("return per step", ".2f"),
    "stored_over_fresh": ("stored / fresh fitness", ".2f"),
    "restarts": ("restarts", ".0f"),
}


def shown(path: Path, settings: Mapping[str, str], columns: Sequence[str]) -> str:
    """A kept table as Markdown: ``settings`` under their titles, then ``columns`` of ``SHOWN``."""
    kept = pd.read_csv(path)
    table = pd.DataFrame({title: kept[name].map(_text) for name, title in settings.items()})
    for name in columns:
        title, style = SHOWN[name]
        table[title] = ["" if pd.isna(value) else format(value, style) for value in kept[name]]
    return markdown_table(table, right=[SHOWN[name][0] for name in columns])


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def main(arguments: list[str]) -> None:
    """Print the table of all finished runs below the folders ``arguments``, as CSV."""
    configs = sorted(path for argument in arguments for path in Path(argument).rglob("config.json"))
    finished = [path.parent for path in configs if is_finished(path.parent)]
    table(finished).to_csv(sys.stdout, index=False, float_format="%.4g")


if __name__ == "__main__":
    main(sys.argv[1:])
