"""``summary.json``: the metrics of a finished run, as claimed and corrected. Does not import JAX."""

from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from qdil.files import read_json, write_json
from qdil.qd.landing import CORRECTED, METRICS, SHARES, claimed_metrics, corrected_metrics
from qdil.runs.folder import read_archive

NAMES = (*METRICS, *CORRECTED, *SHARES)
FILE = "summary.json"


def write(folder: Path, archive: Mapping[str, Any]) -> None:
    """Write the metrics of ``archive``, the arrays of ``archive.npz``; numbers that are not finite become null.

    ``rescored_episodes`` is the number of fresh episodes of each elite, the most if they differ; 0 without elites.
    """
    numbers = claimed_metrics(archive) | corrected_metrics(archive)
    values: dict[str, Any] = {name: number if isfinite(number) else None for name, number in numbers.items()}
    write_json(folder / FILE, values | {"rescored_episodes": int(max(archive["rescored_episodes"], default=0))})


def read(folder: Path) -> dict[str, float]:
    """The metrics of the finished run in ``folder`` by their ``NAMES``; numbers that are not finite are not-a-number.

    A run of an older version has no ``summary.json``; its metrics are computed from ``archive.npz``. Raises ConfigError
    if the run is not finished, if a file is missing or damaged, or if its elites were not scored again.
    """
    if not (folder / FILE).is_file():
        archive = read_archive(folder)
        return claimed_metrics(archive) | corrected_metrics(archive)
    kept = read_json(folder / FILE)
    return {name: float("nan") if kept[name] is None else float(kept[name]) for name in NAMES}


def sentences(numbers: Mapping[str, float]) -> str:
    """``read``'s metrics in two lines of text, one per reading."""
    lines = []
    for reading, prefix in (("As claimed", ""), ("Corrected", "corrected_")):
        qd_score, coverage, best, average = (numbers[prefix + name] for name in METRICS)
        lines.append(
            f"{reading}: QD-score {qd_score:,.0f}, coverage {coverage:.1%}, best {best:,.0f}, average {average:,.0f}"
        )
    if numbers["coverage"] == 0:
        return "The archive is empty."
    lands = "of the elites land in their own cell, {:.0%} in it or beside it".format(numbers["relanded_near"])
    return f"{lines[0]}.\n{lines[1]}; {numbers['relanded']:.0%} {lands}."
