"""Final metrics by the number of demonstrations: ours from runs, the paper's from its figures (Figs. 12, 13)."""

import numpy as np
import pandas as pd

from qdil.config import make_config, parse_settings
from qdil.evidence import paper, tables

COLUMNS = ["method", "n_demos", "metric", "value", "spread"]


def ours(runs: tables.Runs, env: str, budget: str, corrected: bool = False) -> pd.DataFrame:
    """A row per method, number of demonstrations and metric of ``runs``.

    ``value`` is the mean over seeds in reward units, coverage as a share of the cells; ``spread`` the standard
    deviation over seeds, not-a-number for a single seed. ``corrected``: the metrics' corrected readings. An experiment
    that does not name a number of demonstrations has the budget's.
    """
    rows = []
    for name, group in tables.final(runs).groupby(level="experiment", sort=False):
        method, *settings = str(name).split("+")
        count = make_config(env, method, budget, **parse_settings(settings)).demos.demo_episodes
        for metric in paper.METRICS:
            values = group[f"corrected_{metric}" if corrected else metric].to_numpy()
            rows.append([method, count, metric, values.mean(), values.std(ddof=1) if len(values) > 1 else np.nan])
    return pd.DataFrame(rows, columns=COLUMNS)


def published(env: str) -> pd.DataFrame:
    """The paper's numbers in the same columns, as far as known; ``spread`` is the standard error of three seeds."""
    known = _known(env)
    shares = known["metric"] == "coverage_pct"
    scale = np.where(shares, 0.01, 1.0)
    return pd.DataFrame(
        {
            "method": known["method"],
            "n_demos": known["n_demos"].astype(int),
            "metric": known["metric"].where(~shares, "coverage"),
            "value": known["value"] * scale,
            "spread": known["spread"] * scale,
        }
    ).reset_index(drop=True)


def notes(env: str) -> str:
    """Remarks on how the paper's numbers were read off its figure; empty if there are none."""
    return "; ".join(_known(env)["note"].dropna().unique())


def _known(env: str) -> pd.DataFrame:
    rows = paper.numbers()
    return rows[(rows["origin"] == paper.PAPER) & (rows["environment"] == env) & rows["n_demos"].notna()]
