"""The explorer's comparisons in numbers: archives against the first one, and learned fitness against true return."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import spearmanr

from qdil.qd.landing import corrected_metrics

FRESH = ("rescored_return", "rescored_measures")


def with_first(archives: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """A row for each archive: its filled cells, how many of them are empty in the first archive, and true returns.

    "better where both" is the percentage of cells filled in both where this archive has the higher return; "mean gap"
    is the mean difference there (reward units per episode). "land in own cell (%)", of archives whose elites were
    scored again, is the percentage that land in their own cell on fresh episodes. Archives are as ``read_archive``
    returns them, with equal grids.
    """
    first = next(iter(archives.values()))
    rows: dict[str, dict[str, float | None]] = {}
    for name, archive in archives.items():
        _, i, j = np.intersect1d(archive["index"], first["index"], return_indices=True)
        gap = np.asarray(archive["true_return"], float)[i] - np.asarray(first["true_return"], float)[j]
        rows[name] = {
            "cells": len(archive["index"]),
            "not in the first": len(archive["index"]) - len(gap),
            "better where both (%)": round(100 * float(np.mean(gap > 0))) if len(gap) else None,
            "mean gap (reward)": round(float(np.mean(gap)), 1) if len(gap) else None,
        }
        if all(field in archive for field in FRESH) and len(archive["index"]):
            rows[name]["land in own cell (%)"] = round(100 * corrected_metrics(archive)["relanded"])
    return pd.DataFrame.from_dict(rows, orient="index")


def rank_correlation(archives: Mapping[str, Mapping[str, Any]]) -> pd.Series:
    """Spearman's correlation of learned fitness and true return over the elites of each archive with two or more."""
    several = {name: archive for name, archive in archives.items() if len(archive["index"]) > 1}
    found = {name: spearmanr(one["fitness"], one["true_return"]).statistic for name, one in several.items()}
    return pd.Series(found, name="rank correlation of learned fitness and true return").round(2)
