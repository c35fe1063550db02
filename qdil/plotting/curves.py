"""Learning curves: the paper's four metrics by iteration, environment steps or time."""

from collections.abc import Mapping

import pandas as pd
from matplotlib.figure import Figure

from qdil.plotting.style import METHOD_COLOURS, METRICS, X_LABELS, method_colour


def learning_curves(metrics: Mapping[str, pd.DataFrame], x: str = "iteration") -> Figure:
    """The paper's four metrics against ``x``, one line per method; dashed where the reward is the true one.

    ``metrics`` are tables of ``metrics.csv`` by method: columns ``qd_score``, ``best`` and ``average`` in reward units,
    ``coverage`` as a share of the cells, and ``x``: ``iteration``, ``env_steps`` or ``wall_seconds``.
    Raises ValueError for another ``x`` or where there is nothing to draw.
    """
    if x not in X_LABELS:
        raise ValueError(f"x='{x}' is not an axis of learning curves; choose one of {', '.join(X_LABELS)}.")
    if not metrics:
        raise ValueError("there are no metrics to draw.")
    spare = [method for method in metrics if method not in METHOD_COLOURS]
    figure = Figure(figsize=(13, 3.3), layout="constrained")
    axes = figure.subplots(1, len(METRICS))
    for ax, (name, label) in zip(axes, METRICS.items(), strict=True):
        for method, table in metrics.items():
            colour = method_colour(method, spare.index(method) if method in spare else 0)
            style = {"ls": "--" if method.endswith("true") else "-", "marker": "o" if len(table) < 20 else None}
            scale = 100.0 if name == "coverage" else 1.0
            ax.plot(table[x], scale * table[name], color=colour, label=method, **style)
        ax.set(xlabel=X_LABELS[x], title=label)
        ax.grid(color="0.92")
        ax.spines[["top", "right"]].set_visible(False)
        ax.xaxis.get_major_locator().set_params(integer=x != "wall_seconds", nbins=5)
    axes[1].set_ylim(0, 103)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(metrics), frameon=False)
    return figure
