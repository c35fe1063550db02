"""The effect of a change on a method's final metrics, in percent of the unchanged method, with intervals."""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from qdil.evidence import arms, paper, tables
from qdil.evidence.readings import READINGS
from qdil.evidence.stats import Interval

COLUMNS = ["metric", "difference", "low", "high", "seeds"]
TITLES = {key: tables.COLUMNS[key] for key in paper.METRICS}


def effects(runs: tables.Runs, pairs: Mapping[str, tuple[str, str]]) -> pd.DataFrame:
    """A row per change and metric: the first experiment's mean minus the second's, in percent of the second's.

    ``pairs`` are (changed, unchanged) experiments by the name of the change; a pair without runs of both is left out.
    Index: those names. Columns: ``metric`` (its title), ``difference``, ``low`` and ``high`` in percent (the ends of a
    95 % interval as in verdicts: see ``arms.difference``; not-a-number if fewer than two seeds can be compared),
    ``seeds``, a text.
    """
    rows, names = [], []
    for name, pair in pairs.items():
        if any(experiment not in runs for experiment in pair):
            continue
        for key, title in TITLES.items():
            found = arms.difference(*(arms.read(runs[experiment], READINGS[key]) for experiment in pair))
            rows.append([title, *_percent(found), arms.seeds_text(found.seeds(), found.paired)])
            names.append(name)
    return pd.DataFrame(rows, columns=COLUMNS, index=pd.Index(names, name="change"))


def _percent(found: arms.Compared) -> Interval:
    """A difference and its interval in percent of the reference's mean; not-a-number where that is 0."""
    unchanged = abs(float(np.mean([*found.arms[1].values.values()])))
    scale = 100 / unchanged if unchanged else np.nan
    return Interval(*(scale * end for end in found.difference.interval()))


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
