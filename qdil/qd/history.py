"""The history of an archive: the iteration of every new elite, so that the filling of the archive can be replayed."""

from typing import NamedTuple

import numpy as np


class History(NamedTuple):
    """One row per new elite, in order of iteration and, within it, of cell."""

    iteration: np.ndarray  # (n,) int32, the QD iteration that added the elite, from 1
    cell: np.ndarray  # (n,) int32, the index of its cell
    true_return: np.ndarray  # (n,) float32
    fitness: np.ndarray  # (n,) float32, the fitness that won its cell


def empty() -> History:
    """The history of an empty archive."""
    return History(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32), np.zeros(0, np.float32))


def append(history: History, iteration: int, elites: dict[str, np.ndarray], cells: int) -> History:
    """``history`` with the elites of ``archive.returns`` after ``iteration`` that are new since its last row."""
    before = snapshot(history, iteration, cells)["fitness"]
    new = elites["fitness"] != before[elites["index"]]  # true for an empty cell too, whose fitness is not-a-number
    index = elites["index"][new].astype(np.int32)
    rows = History(np.full(len(index), iteration, np.int32), index, elites["true_return"][new], elites["fitness"][new])
    return History(*(np.concatenate(both).astype(both[0].dtype) for both in zip(history, rows, strict=True)))


def snapshot(history: History, iteration: int, cells: int) -> dict[str, np.ndarray]:
    """``true_return`` and ``fitness`` (cells,) of the archive after ``iteration``; NaN in cells that were empty."""
    until = np.searchsorted(history.iteration, iteration, side="right")
    grids = {}
    for name in ("true_return", "fitness"):
        grids[name] = np.full(cells, np.nan, np.float32)
        # If a cell had several elites, the assignment keeps the last.
        grids[name][history.cell[:until]] = getattr(history, name)[:until]
    return grids
