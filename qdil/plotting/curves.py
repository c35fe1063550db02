"""Learning curves: the paper's four metrics by iteration, environment steps or time, over seeds."""

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdil.plotting.colours import styles
from qdil.plotting.style import METRICS, X_LABELS, X_UNITS, label, percent, short

Tables: TypeAlias = pd.DataFrame | Sequence[pd.DataFrame]
POINTS = 200  # of a curve over seeds whose own points do not lie at the same x
MARKS = 6  # markers along a curve, the curves' out of step with each other
MOST_CHARACTERS = 160  # in a row of the legend


def learning_curves(metrics: Mapping[str, Tables], x: str = "iteration") -> Figure:
    """The paper's four metrics against ``x``: a line per experiment, its mean over seeds, in a band of ± one standard
    deviation; dashed where the reward is the true one.

    ``metrics`` are tables of ``metrics.csv`` by experiment, one or a list of them, a table per seed: columns
    ``qd_score``, ``best`` and ``average`` in reward units, ``coverage`` as a share of the cells, and ``x``:
    ``iteration``, ``env_steps`` or ``wall_seconds``.
    Raises ValueError for another ``x`` or where there is nothing to draw.
    """
    if x not in X_LABELS:
        raise ValueError(f"x='{x}' is not an axis of learning curves; choose one of {', '.join(X_LABELS)}.")
    seeds = {name: [tables] if isinstance(tables, pd.DataFrame) else list(tables) for name, tables in metrics.items()}
    if not any(seeds.values()):
        raise ValueError("there are no metrics to draw.")
    columns = min(len(seeds), MOST_CHARACTERS // (6 + max(len(label(name)) for name in seeds)))
    figure = Figure(figsize=(13, 3.3 + 0.25 * ((len(seeds) - 1) // columns)), layout="constrained")
    axes = figure.subplots(1, len(METRICS))
    looks = styles(seeds)
    for ax, (name, title) in zip(axes, METRICS.items(), strict=True):
        for i, (experiment, tables) in enumerate(seeds.items()):
            if tables:
                _draw(ax, tables, x, name, looks[experiment] | {"label": label(experiment)}, i)
        ax.set(xlabel=X_LABELS[x], title=title)
        ax.grid(color="0.92")
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        ax.xaxis.get_major_locator().set_params(integer=x == "iteration", nbins=5)
        ax.yaxis.set_major_formatter(short)
    axes[1].set_ylim(0, 103)
    lines = axes[0].get_legend_handles_labels()
    figure.legend(*lines, loc="outside lower center", ncols=columns, frameon=False, title=_seeds(seeds))
    return figure


def _seeds(metrics: Mapping[str, Sequence[pd.DataFrame]]) -> str | None:
    """What a line and its band are, over how many seeds; nothing where every experiment has one."""
    counts = {name: len(tables) for name, tables in metrics.items() if tables}
    if max(counts.values()) == 1:
        return None
    if len(set(counts.values())) == 1:
        over = f"{max(counts.values())} seeds"
    else:
        over = "seeds: " + ", ".join(f"{label(name)} {count}" for name, count in counts.items())
    return f"line: mean, band: ± one standard deviation over {over}"


def _draw(ax: Axes, tables: Sequence[pd.DataFrame], x: str, name: str, style: dict, number: int) -> None:
    where, values = over_seeds(tables, x, name)
    values = percent(name) * values
    where, n, few = where / X_UNITS[x], len(where), len(where) < 20
    every = 1 if few else (n * (number % MARKS) // MARKS**2, n // MARKS)
    ax.plot(where, values.mean(axis=0), markevery=every, ms=4, lw=1.4, **style)
    if len(values) > 1:
        spread = values.std(axis=0, ddof=1)
        low, high = values.mean(axis=0) - spread, values.mean(axis=0) + spread
        ax.fill_between(where, low, high, color=style["color"], alpha=0.18, lw=0)


def over_seeds(tables: Sequence[pd.DataFrame], x: str, name: str) -> tuple[np.ndarray, np.ndarray]:
    """``x`` (n,) and the metric ``name`` of every seed there (seeds, n).

    Where seeds were not measured at the same ``x``, as with environment steps, each is interpolated at points between
    the latest start and the earliest end, so that nothing is extrapolated.
    """
    own = [np.asarray(table[x], float) for table in tables]
    values = [np.asarray(table[name], float) for table in tables]
    if all(len(xs) == len(own[0]) and np.array_equal(xs, own[0]) for xs in own):
        return own[0], np.array(values)
    start, end = max(xs[0] for xs in own), min(xs[-1] for xs in own)
    where = np.linspace(start, max(start, end), min(POINTS, min(map(len, own))))
    return where, np.array([np.interp(where, xs, ys) for xs, ys in zip(own, values, strict=True)])
