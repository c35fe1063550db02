"""The effect of a change on a method's final metrics, in percent of the unchanged method, with intervals."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from qdil.evidence import paper, stats, tables

COLUMNS = ["metric", "difference", "low", "high", "seeds"]
TITLES = {key: tables.COLUMNS[key] for key in paper.METRICS}


def effects(runs: tables.Runs, pairs: Mapping[str, tuple[str, str]]) -> pd.DataFrame:
    """A row per change and metric: the first experiment's mean minus the second's, in percent of the second's.

    ``pairs`` are (changed, unchanged) experiments by the name of the change; a pair without runs of both is left out.
    Index: those names. Columns: ``metric`` (its title), ``difference``, ``low`` and ``high`` in percent (the ends of a
    95 % bootstrap interval over seeds, not-a-number if an arm has fewer than two), ``seeds`` of both, as a text.
    """
    values = tables.final({name: runs[name] for pair in pairs.values() for name in pair if name in runs})
    rows, names = [], []
    for name, pair in pairs.items():
        if any(experiment not in runs for experiment in pair):
            continue
        arms = [values.xs(experiment, level="experiment") for experiment in pair]
        for key, title in TITLES.items():
            found = stats.contrast([arm[key].to_numpy() for arm in arms], _percent_above)
            rows.append([title, *found, f"{len(arms[0])} / {len(arms[1])}"])
            names.append(name)
    return pd.DataFrame(rows, columns=COLUMNS, index=pd.Index(names, name="change"))


def _percent_above(ours: Any, reference: Any, axis: int) -> Any:
    unchanged = np.mean(reference, axis=axis)
    with np.errstate(divide="ignore", invalid="ignore"):
        return 100 * (np.mean(ours, axis=axis) - unchanged) / np.abs(unchanged)


def table(found: pd.DataFrame) -> pd.DataFrame:
    """``effects`` as texts like "+3.1 % [−0.4, +6.2]": a row per change, a column per metric."""
    texts = [_text(row.difference, row.low, row.high) for row in found.itertuples()]
    rows = found.assign(text=texts).groupby(level="change", sort=False)
    shown = {name: {"seeds": group["seeds"].iloc[0], **dict(zip(group["metric"], group["text"], strict=True))}
             for name, group in rows}  # fmt: skip
    return pd.DataFrame.from_dict(shown, orient="index", columns=["seeds", *TITLES.values()]).rename_axis("change")


def _text(difference: float, low: float, high: float) -> str:
    if not np.isfinite(difference):
        return "none"
    text = f"{difference:+.1f} %"
    return f"{text} [{low:+.1f}, {high:+.1f}]" if np.isfinite([low, high]).all() else text
