"""Both readings of a finished run's metrics: as claimed, and corrected over fresh episodes. Imports no JAX.

``qdil.qd.landing`` defines them; ``of_run`` reads them from a run's folder.
"""

from qdil.qd.landing import CORRECTED, METRICS, SHARES, claimed_metrics, corrected_archive, corrected_metrics
from qdil.runs.summary import read as of_run

__all__ = ["CORRECTED", "METRICS", "SHARES", "claimed_metrics", "corrected_archive", "corrected_metrics", "of_run"]
