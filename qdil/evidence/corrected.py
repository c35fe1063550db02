"""Both readings of a finished run's metrics: as claimed, and corrected over fresh episodes. Imports no JAX.

``qdil.qd.landing`` defines them. Runs keep them in ``summary.json``; for older runs they are computed from
``archive.npz``.
"""

from pathlib import Path

from qdil.files import read_json
from qdil.qd.landing import CORRECTED, METRICS, SHARES, claimed_metrics, corrected_archive, corrected_metrics
from qdil.runs.folder import read_archive

__all__ = ["CORRECTED", "METRICS", "SHARES", "claimed_metrics", "corrected_archive", "corrected_metrics", "of_run"]


def of_run(folder: Path) -> dict[str, float]:
    """The metrics of the finished run in ``folder`` by name: those of METRICS, of CORRECTED and of SHARES.

    Numbers that are not finite are not-a-number. Raises ConfigError if the run is not finished, if a file is missing or
    damaged, or if its elites were not scored again.
    """
    path = folder / "summary.json"
    if path.is_file():
        kept = read_json(path)
        return {
            name: float("nan") if kept[name] is None else float(kept[name]) for name in (*METRICS, *CORRECTED, *SHARES)
        }
    archive = read_archive(folder)
    return claimed_metrics(archive) | corrected_metrics(archive)
