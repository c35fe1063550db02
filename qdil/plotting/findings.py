"""What runs show beside what healthy runs show: a row per number of ``qdil diagnose``, a mark per run."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdil.plotting.colours import GREEN, styles
from qdil.plotting.style import label, styled

RATIOS = (0.25, 8.0)  # ends of the rows of ratios, which are logarithmic
SCALES = "shares: 0 to 100 %; orders (rank correlations): −1 to 1; ratios: ¼ to 8, logarithmic"


@styled
def findings(table: pd.DataFrame) -> Figure:
    """A row per number with its healthy range as a bar, and a mark for every run, by experiment.

    ``table`` has a row per number and run, as from ``diagnosis.tidy``: ``title``, ``form`` ("share", "correlation" or
    "ratio"), ``low``, ``high``, ``healthy`` (the range in words), ``experiment`` and ``value``. Numbers beyond a row's
    ends are drawn there. Raises ValueError where there is nothing to draw.
    """
    if table.empty:
        raise ValueError("there are no numbers to draw.")
    titles, experiments = list(dict.fromkeys(table["title"])), list(dict.fromkeys(table["experiment"]))
    figure = Figure(figsize=(10, 1.2 + 0.3 * len(titles)))
    ax = figure.subplots()
    for row, title in enumerate(titles):
        _range(ax, row, table[table["title"] == title].iloc[0])
    looks = styles(experiments)
    for number, name in enumerate(experiments):
        _marks(ax, titles, table[table["experiment"] == name], (number + 1) / (len(experiments) + 1), looks[name])
    ax.set(xlim=(-0.02, 1.02), ylim=(len(titles) - 0.5, -0.5), xticks=[], xlabel=SCALES)
    ax.set_yticks(range(len(titles)), titles)
    ax.grid(False)
    ax.tick_params(left=False)
    figure.legend(loc="outside upper left", ncols=4, title="bar: healthy; a mark: a run")
    return figure


def position(value: Any, form: str) -> np.ndarray:
    """Where numbers of a ``form`` stand between the ends of a row, 0 and 1; beyond them, at the end."""
    value = np.asarray(value, float)
    if form == "ratio":
        low, high = np.log(RATIOS)
        value = (np.log(np.maximum(value, RATIOS[0])) - low) / (high - low)
    elif form == "correlation":
        value = (value + 1) / 2
    return np.clip(value, 0.0, 1.0)


def _range(ax: Axes, row: int, check: pd.Series) -> None:
    """A line over the whole row, the healthy range on it, and that range in words at its right."""
    low, high = (float(position(check[end], check["form"])) for end in ("low", "high"))
    ax.plot([0, 1], [row, row], color="0.85", lw=0.8, zorder=0)
    ax.barh(row, high - low, left=low, height=0.8, color=GREEN, alpha=0.2, lw=0)
    ax.annotate(check["healthy"], (1.03, row), xycoords=("axes fraction", "data"), va="center", fontsize=9)


def _marks(ax: Axes, titles: list[str], of_one: pd.DataFrame, height: float, style: dict[str, Any]) -> None:
    """A mark for every run of one experiment, at a ``height`` of 0 (top) to 1 within its row."""
    rows = [titles.index(title) + 0.7 * (height - 0.5) for title in of_one["title"]]
    places = [position(value, form) for value, form in zip(of_one["value"], of_one["form"], strict=True)]
    marker = "|" if style["marker"] == "None" else style["marker"]
    name = label(str(of_one["experiment"].iloc[0]))
    ax.plot(places, rows, **style | {"ls": "none", "marker": marker}, ms=6, mew=1.2, label=name, clip_on=False)
