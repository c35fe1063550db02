"""Learning curves: the paper's four metrics by iteration, environment steps or time, over seeds."""

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdil.plotting.colours import styles
from qdil.plotting.style import METRICS, X_LABELS, X_UNITS, label, percent, short, styled

Tables: TypeAlias = pd.DataFrame | Sequence[pd.DataFrame]
POINTS = 200  # at most, of a curve over seeds that were measured at different x
MARKS = 6  # markers along a curve; different curves have them at different points
MOST_CHARACTERS = 160  # in a row of the legend


@styled
def learning_curves(metrics: Mapping[str, Tables], x: str = "iteration") -> Figure:
    """The paper's four metrics against ``x``: for every experiment the mean over seeds, and ± one standard deviation.

    ``metrics`` has for every experiment one table of ``metrics.csv``, or a list with a table per seed: columns
    ``qd_score``, ``best`` and ``average`` in reward units, ``coverage`` as a share of the cells, and ``x``, which is
    ``iteration``, ``env_steps`` or ``wall_seconds``. Lines of methods that maximise the true reward are dashed.
    Raises ValueError for another ``x`` or where there is nothing to draw.
    """
    if x not in X_LABELS:
        raise ValueError(f"x='{x}' is not an axis of learning curves; choose one of {', '.join(X_LABELS)}.")
    seeds = {name: [tables] if isinstance(tables, pd.DataFrame) else list(tables) for name, tables in metrics.items()}
    if not any(seeds.values()):
        raise ValueError("there are no metrics to draw.")
    columns = min(len(seeds), MOST_CHARACTERS // (6 + max(len(label(name)) for name in seeds)))
    figure = Figure(figsize=(13, 3.3 + 0.25 * ((len(seeds) - 1) // columns)))
    axes = figure.subplots(1, len(METRICS))
    line_styles = styles(seeds)
    for ax, (name, title) in zip(axes, METRICS.items(), strict=True):
        for i, (experiment, tables) in enumerate(seeds.items()):
            if tables:
                _draw(ax, tables, x, name, line_styles[experiment] | {"label": label(experiment)}, i)
        ax.set(xlabel=X_LABELS[x], title=title)
        ax.xaxis.get_major_locator().set_params(integer=x == "iteration", nbins=5)
        ax.yaxis.set_major_formatter(short)
    axes[1].set_ylim(0, 103)
    lines = axes[0].get_legend_handles_labels()
    figure.legend(*lines, loc="outside lower center", ncols=columns, title=_seeds(seeds))
    return figure


def _seeds(metrics: Mapping[str, Sequence[pd.DataFrame]]) -> str | None:
    """The legend's title: what lines and bands are, and over how many seeds; None if all experiments have one seed."""
    counts = {name: len(tables) for name, tables in metrics.items() if tables}
    if max(counts.values()) == 1:
        return None
    if len(set(counts.values())) == 1:
        over = f"{max(counts.values())} seeds"
    else:
        over = "seeds: " + ", ".join(f"{label(name)} {count}" for name, count in counts.items())
    return f"line: mean, band: ± one standard deviation over {over}"


def _draw(ax: Axes, tables: Sequence[pd.DataFrame], x: str, name: str, style: dict, number: int) -> None:
    points, values = over_seeds(tables, x, name)
    points, values, n = points / X_UNITS[x], percent(name) * values, len(points)
    every = 1 if n < 20 else (n * (number % MARKS) // MARKS**2, n // MARKS)
    ax.plot(points, values.mean(axis=0), markevery=every, ms=4, lw=1.4, **style)
    if len(values) > 1:
        spread = values.std(axis=0, ddof=1)
        low, high = values.mean(axis=0) - spread, values.mean(axis=0) + spread
        ax.fill_between(points, low, high, color=style["color"], alpha=0.18, lw=0)


def over_seeds(tables: Sequence[pd.DataFrame], x: str, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Points ``x`` (n,), and the metric ``name`` of every seed at these points (seeds, n).

    Seeds that were measured at different ``x``, such as environment steps, are interpolated at common points between
    the latest start and the earliest end, so that nothing is extrapolated.
    """
    own = [np.asarray(table[x], float) for table in tables]
    values = [np.asarray(table[name], float) for table in tables]
    if all(len(xs) == len(own[0]) and np.array_equal(xs, own[0]) for xs in own):
        return own[0], np.array(values)
    start, end = max(xs[0] for xs in own), min(xs[-1] for xs in own)
    points = np.linspace(start, max(start, end), min(POINTS, min(map(len, own))))
    return points, np.array([np.interp(points, xs, ys) for xs, ys in zip(own, values, strict=True)])
