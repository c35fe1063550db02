"""One or two of an archive's k axes as a map; each square of the map shows the best elite over the other axes.

The front end does the same in ``projection.js``. A cell's number counts row by row, the last axis fastest.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np


def axes_choices(k: int) -> list[tuple[int, ...]]:
    """What a map of k measures can show: its one axis, or every pair of axes, the first pair first."""
    return list(combinations(range(k), min(k, 2)))


def squares(archive: Mapping[str, Any], axes: Sequence[int]) -> np.ndarray:
    """(n,) the number of the square on the map of ``axes`` that holds each elite of ``archive``."""
    dims = [int(cells) for cells in archive["cells"]]
    places = np.unravel_index(np.asarray(archive["index"], int), dims)
    return np.ravel_multi_index([places[axis] for axis in axes], [dims[axis] for axis in axes])


def best_rows(archive: Mapping[str, Any], axes: Sequence[int]) -> np.ndarray:
    """(m,) rows of the elites that the m filled squares show, in order of the squares.

    A square shows the elite with the highest true return; of equal ones, the one with the lowest cell number.
    """
    square = squares(archive, axes)
    order = np.lexsort((archive["index"], -np.asarray(archive["true_return"], float), square))
    return order[np.unique(square[order], return_index=True)[1]]


def project(archive: Mapping[str, Any], axes: Sequence[int]) -> dict[str, np.ndarray]:
    """The map of ``axes`` as an archive of one or two measures: ``index`` holds the m filled squares, ascending.

    ``archive``: as ``read_archive`` returns it, with ``index`` (n,), ``measures`` (n, k), ``cells`` (k,) and fields
    (n,), all of which are kept for the shown elites.
    """
    rows, axes = best_rows(archive, axes), list(axes)
    kept = {name: np.asarray(archive[name])[rows] for name in ("true_return", "fitness", "length")}
    return kept | {
        "index": squares(archive, axes)[rows],
        "measures": np.asarray(archive["measures"])[rows][:, axes],
        "cells": np.asarray(archive["cells"])[axes],
    }
