"""The numbers that claims compare, each read from the files of one finished run."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from qdil.evidence import corrected, tables
from qdil.runs.folder import read_archive


def c0_rise(metrics: pd.DataFrame) -> float:
    """The mean change of |c_0| of the xNES mean in an iteration that finds new cells (Appendix G).

    |c_0| is the weight of the fitness gradient. An iteration counts if more cells are filled after it than before and
    if the one before did not end in a restart: from a restarted xNES, whose c_0 is 0, |c_0| can only rise.
    Not-a-number if no iteration counts.
    """
    restarted = (
        metrics["restarts"].diff().fillna(metrics["restarts"]) > 0
    )  # a row's c_0 is from before its restart, or 0 or drawn anew
    began_afresh = restarted.shift(1, fill_value=False)
    counted = (metrics["coverage"].diff() > 0) & ~began_afresh
    return float(metrics["c0"].abs().diff()[counted].mean())


def roughness(archive: Mapping[str, Any], field: str = "true_return") -> float:
    """How much a cell differs from the next: the mean |difference| of neighbours over the mean |value| (Fig. 6).

    Neighbours are filled cells that share an edge (a face, for k > 2). Not-a-number if no two cells are neighbours or
    all values are 0.
    """
    grid = np.full([int(cells) for cells in archive["cells"]], np.nan)
    grid.flat[np.asarray(archive["index"])] = archive[field]
    steps = np.concatenate([np.abs(np.diff(grid, axis=axis)).ravel() for axis in range(grid.ndim)])
    steps, scale = steps[np.isfinite(steps)], float(np.mean(np.abs(archive[field]))) if len(archive["index"]) else 0.0
    return float(steps.mean()) / scale if len(steps) and scale > 0 else float("nan")


def _final(name: str) -> Callable[[Path], float]:
    return lambda folder: float(pd.read_csv(folder / "metrics.csv")[name].iloc[-1])


def _corrected(name: str) -> Callable[[Path], float]:
    return lambda folder: corrected.of_run(folder)[name]


READINGS: dict[str, Callable[[Path], float]] = {
    **{name: _final(name) for name in corrected.METRICS},
    **{name: _corrected(name) for name in (*corrected.CORRECTED, *corrected.SHARES)},
    "c0_rise": lambda folder: c0_rise(pd.read_csv(folder / "metrics.csv")),
    "roughness": lambda folder: roughness(read_archive(folder)),
}
NAMES = {
    **tables.COLUMNS,
    "c0_rise": "rise of |c₀| in an iteration that finds cells",
    "roughness": "difference between neighbouring cells, as a share of the mean return",
    "probability": "change of P(m ∈ A_e)",
}
