"""Corrected metrics: every elite is put into the cell where it lands on fresh episodes. Imports neither JAX nor pyribs.

An archive keeps the best of many noisy scores, so an elite's claimed return is too high on average, and its claimed
cell is often not its own. Flageat and Cully (*Uncertain Quality-Diversity*, IEEE Transactions on Evolutionary
Computation, 2023) therefore evaluate the final elites many times and fill a *corrected* archive with the means.

Here ``archive`` holds the arrays of a run's ``archive.npz``: ``index`` (n,) into the flattened grid, ``true_return``
(n,), ``cells`` (k,), and means over fresh episodes, ``rescored_return`` (n,) and ``rescored_measures`` (n, k).
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from qdil.errors import ConfigError
from qdil.qd.cells import cell_index

METRICS = ("qd_score", "coverage", "best", "average")  # the paper's (section 5.3)
CORRECTED = tuple(f"corrected_{name}" for name in METRICS)
SHARES = ("relanded", "relanded_near")
# Fields of the corrected archive and the fields of ``archive`` that they come from.
FRESH = {"measures": "rescored_measures", "true_return": "rescored_return", "fitness": "rescored_fitness",
         "length": "rescored_length"}  # fmt: skip
ELSEWHERE = -1  # the cell of an elite without a finite score on fresh episodes


def landing_cells(archive: Mapping[str, Any]) -> np.ndarray:
    """The cell (n,) into which each elite's mean measures fall on fresh episodes; ``ELSEWHERE`` if they are not finite.

    Measures on a grid line belong to the cell above it, as in the archive (``qdil.qd.cells``). Raises ConfigError for
    an archive without scores on fresh episodes.
    """
    missing = [name for name in ("rescored_return", "rescored_measures") if name not in archive]
    if missing:
        raise ConfigError(f"this archive has no {' and no '.join(missing)}: its elites were not scored again.")
    cells = [int(count) for count in archive["cells"]]
    measures, returns = (np.asarray(archive[name]) for name in ("rescored_measures", "rescored_return"))
    sound = np.isfinite(returns) & np.isfinite(measures).all(axis=1)
    at = cell_index(np.where(sound[:, None], measures, 0.0), cells, np)
    return np.where(sound, np.ravel_multi_index(tuple(at.T), cells), ELSEWHERE)


def corrected_archive(archive: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The archive as its elites land: of those that land in one cell, the one with the best mean return stays.

    Returns the fields of ``FRESH`` that ``archive`` has, by their new names, a row per filled cell in order of
    ``index`` (m,); ``cells`` (k,); and ``row`` (m,), each elite's row in ``archive``. Of equal returns the first row
    stays. Elites without a finite score land nowhere.
    """
    cell, returns = landing_cells(archive), np.asarray(archive["rescored_return"])
    landed = np.flatnonzero(cell != ELSEWHERE)
    best_first = landed[np.lexsort((-returns[landed], cell[landed]))]  # stable: the first of equal returns is in front
    index, first = np.unique(cell[best_first], return_index=True)
    row = best_first[first]
    fields = {name: np.asarray(archive[source])[row] for name, source in FRESH.items() if source in archive}
    return {"index": index, **fields, "cells": np.asarray(archive["cells"]), "row": row}


def claimed_metrics(archive: Mapping[str, Any]) -> dict[str, float]:
    """The paper's four metrics (section 5.3) of an archive from its ``true_return``.

    QD-score is the sum over filled cells, no offset (eq. 1), in reward units; coverage is a share of the cells. An
    empty archive has QD-score and coverage 0; its best and average are not-a-number.
    """
    returns = np.asarray(archive["true_return"], np.float64)
    filled = len(returns) > 0
    numbers = (
        returns.sum(),
        len(returns) / math.prod(int(count) for count in archive["cells"]),
        returns.max() if filled else np.nan,
        returns.mean() if filled else np.nan,
    )
    return {name: float(number) for name, number in zip(METRICS, numbers, strict=True)}


def corrected_metrics(archive: Mapping[str, Any]) -> dict[str, float]:
    """The four metrics of the corrected archive, by the names of ``CORRECTED``, and two shares of the elites.

    ``relanded`` is the share of elites that land in their own cell; ``relanded_near`` also counts those that land in a
    neighbouring one, diagonals included. An empty archive's shares are not-a-number.
    """
    of_landed = claimed_metrics(corrected_archive(archive))
    distance = _distances(archive)
    shares = [float(np.mean(distance <= most)) if len(distance) else float("nan") for most in (0, 1)]
    return dict(zip(CORRECTED, of_landed.values(), strict=True)) | dict(zip(SHARES, shares, strict=True))


def _distances(archive: Mapping[str, Any]) -> np.ndarray:
    """How many cells (n,) each elite lands from its own, along the measure in which that is most; inf for nowhere."""
    cells, landed = [int(count) for count in archive["cells"]], landing_cells(archive)
    own = np.stack(np.unravel_index(np.asarray(archive["index"], int), cells))
    there = np.stack(np.unravel_index(np.maximum(landed, 0), cells))
    return np.where(landed == ELSEWHERE, np.inf, np.abs(own - there).max(axis=0))
