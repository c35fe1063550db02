"""Final metrics: a bar for every experiment with a dot for every seed, and a heatmap over a grid of settings."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from qdil.config import value_of
from qdil.names import SETTINGS
from qdil.plotting.colours import EMPTY, method_colour
from qdil.plotting.style import METRICS, MORE_METRICS, label, percent, short, styled
from qdil.runs.studies import config_of

LABELS = {**METRICS, **MORE_METRICS}
HATCHED: dict[str, Any] = {"facecolor": "white", "hatch": "////", "linewidth": 1.0}  # bars of corrected metrics


@styled
def bars(final: pd.DataFrame, metrics: str | Sequence[str] = tuple(METRICS)) -> Figure:
    """A panel for every metric with a bar for every experiment, over its seeds.

    A bar is the mean, its whiskers are ± one standard deviation, and every seed is a dot. Where ``final`` also has a
    metric's corrected reading (``qdil.qd.landing``), a hatched bar below shows it. ``final`` has a row per experiment
    and seed, as from ``tables.final``. Raises ValueError for a metric that is not a column of ``final``,
    or where there is nothing to draw.
    """
    chosen = [metrics] if isinstance(metrics, str) else list(metrics)
    for metric in chosen:
        _check(final, metric)
    experiments = list(dict.fromkeys(final.index.get_level_values("experiment")))
    both = any(f"corrected_{metric}" in final for metric in chosen)
    height = 1.0 + (0.45 if both else 0.32) * len(experiments) + 0.3 * both
    figure = Figure(figsize=(2.2 + 2.7 * len(chosen), max(2.0, height)))
    axes = figure.subplots(1, len(chosen), sharey=True, squeeze=False)[0]
    for ax, metric in zip(axes, chosen, strict=True):
        readings = [name for name in (metric, f"corrected_{metric}") if name in final]
        for i, reading in enumerate(readings):
            rows = np.arange(len(experiments)) + (0.2 if len(readings) > 1 else 0.0) * (2 * i - 1)
            _bars(ax, final[reading] * percent(metric), experiments, rows, 0.7 / len(readings), hatched=i == 1)
        ax.set_xlabel(LABELS[metric])
    axes[0].set_yticks(range(len(experiments)), [label(name) for name in experiments])
    axes[0].invert_yaxis()
    if both:
        kinds = [
            Patch(fc="0.6", label="as claimed"),
            Patch(**HATCHED, edgecolor="0.4", label="corrected (fresh episodes)"),
        ]
        figure.legend(handles=kinds, loc="outside lower center", ncols=2)
    return figure


def _check(final: pd.DataFrame, metric: str) -> None:
    if metric not in LABELS or metric not in final:
        raise ValueError(f"metric '{metric}' cannot be drawn; choose one of {', '.join(LABELS)} that the table has.")
    if final.empty:
        raise ValueError("there are no runs to draw.")


def _bars(
    ax: Axes, values: pd.Series, experiments: list[str], rows: np.ndarray, height: float, hatched: bool = False
) -> None:
    """A bar of ``height`` for every experiment, centred at its place in ``rows``."""
    for row, experiment in zip(rows, experiments, strict=True):
        seeds = values.xs(experiment, level="experiment").to_numpy(float)
        colour = method_colour(experiment)
        look: dict[str, Any] = {**HATCHED, "edgecolor": colour} if hatched else {"color": colour, "alpha": 0.75}
        ax.barh(row, seeds.mean(), height=height, **look)
        if len(seeds) > 1:
            ax.errorbar(seeds.mean(), row, xerr=seeds.std(ddof=1), color="black", lw=1)
        ax.plot(seeds, np.full(len(seeds), row), "o", ms=4, mfc="white", mec="black", mew=0.8)
    ax.axvline(0, color="black", lw=0.8)
    ax.yaxis.grid(False)
    ax.spines.left.set_visible(False)
    ax.tick_params(axis="y", length=0)
    ax.xaxis.set_major_locator(MaxNLocator(3))
    ax.xaxis.set_major_formatter(short)


@styled
def grid(final: pd.DataFrame, rows: str = "bonus_p", columns: str = "bonus_q", metric: str = "qd_score") -> Figure:
    """A metric's mean over seeds as a heatmap over two settings, with its number in every cell; grey: no run.

    ``final`` as in ``bars``. ``rows`` and ``columns`` are settings; their values are read from the experiments' names.
    Raises ValueError for a metric that is not a column, nothing to draw, or two experiments on one cell.
    """
    _check(final, metric)
    ys, xs, table = _on_grid(final[metric] * percent(metric), rows, columns)
    figure = Figure(figsize=(2.6 + 1.3 * len(xs), 1.6 + 0.9 * len(ys)))
    ax = figure.subplots()
    ax.grid(False)
    ax.spines[:].set_visible(True)
    image = ax.imshow(table, cmap=colormaps["viridis"].with_extremes(bad=EMPTY), origin="lower", aspect="auto")
    low, high = np.nanmin(table), np.nanmax(table)
    for (i, j), value in np.ndenumerate(table):
        colour = "white" if np.isfinite(value) and value < low + 0.6 * (high - low) else "black"
        text = f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
        ax.text(j, i, text if np.isfinite(value) else "no run", ha="center", va="center", color=colour)
    ax.set_xticks(range(len(xs)), [f"{x:g}" for x in xs])
    ax.set_yticks(range(len(ys)), [f"{y:g}" for y in ys])
    ax.set(xlabel=SETTINGS.get(columns, columns), ylabel=SETTINGS.get(rows, rows))
    counts = final.groupby(level="experiment").size()
    seeds = " to ".join(map(str, dict.fromkeys([counts.min(), counts.max()])))
    ax.set_title(f"mean over {seeds} seed{'s' if counts.max() > 1 else ''}")
    figure.colorbar(image, ax=ax).set_label(LABELS[metric])
    return figure


def _on_grid(values: pd.Series, rows: str, columns: str) -> tuple[list[float], list[float], np.ndarray]:
    """The values of the two settings (y,), (x,), and means over seeds (y, x), NaN where there is no run."""
    means = values.groupby(level="experiment", sort=False).mean()
    places = [(_setting(str(name), rows), _setting(str(name), columns)) for name in means.index]
    if len(set(places)) < len(places):
        raise ValueError(f"these experiments differ in more than {rows} and {columns}: a grid cannot show them.")
    ys, xs = sorted({y for y, _ in places}), sorted({x for _, x in places})
    table = np.full((len(ys), len(xs)), np.nan)
    for (y, x), mean in zip(places, means, strict=True):
        table[ys.index(y), xs.index(x)] = mean
    return ys, xs, table


def _setting(experiment: str, name: str) -> Any:
    """The value of a setting in an experiment: from the experiment's name, or the default."""
    return value_of(config_of(experiment, "walker2d", "full"), name)
