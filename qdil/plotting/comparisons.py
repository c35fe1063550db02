"""Comparisons: rewards by kind of step, simple curves, point clouds, couplings, demonstrations, effects."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdil.imitation.selection import top_fifth
from qdil.methods import method_names
from qdil.names import title
from qdil.plotting.colours import BLUE, GREEN, RED, SERIES, method_colour, styles
from qdil.plotting.measures import measure_panels, scatter, set_title
from qdil.plotting.style import METRICS, percent, short, styled

DASHES = ("-", "--", ":", "-.")  # so that lines differ in print, too


@styled
def rewards_by_kind(rewards: Mapping[str, Mapping[str, Any]], columns: int = 4) -> Figure:
    """A panel per reward model, with a box of its rewards per step for every kind of step.

    ``rewards`` has arrays of any shape, by model and kind. A box holds the middle half of the rewards, its whiskers
    nine tenths of them. Raises ValueError where there is nothing to draw.
    """
    figure, axes = _panels([title(model) for model in rewards], columns, height=2.5)
    for i, (ax, kinds) in enumerate(zip(axes, rewards.values(), strict=True)):
        values = [np.ravel(kinds[kind]) for kind in kinds]
        boxes = ax.boxplot(values, orientation="horizontal", whis=(5, 95), widths=0.65)
        for box, colour in zip(boxes["boxes"], SERIES * len(kinds), strict=False):
            box.set(facecolor=colour, alpha=0.75)
        ax.set_yticks(range(1, len(kinds) + 1), list(kinds) if i % columns == 0 else [""] * len(kinds))
        ax.invert_yaxis()
        ax.set_xlabel("reward per step")
    return figure


@styled
def curves(
    panels: Mapping[str, pd.DataFrame], x_label: str, y_label: str, columns: int = 4, from_zero: bool = False
) -> Figure:
    """A panel per title: the columns of a table as lines over its index, with one legend for all panels.

    A column named like a method has that method's colour. ``from_zero`` begins the y axis at 0, so that small changes
    of a share stay small. Raises ValueError where there is nothing to draw.
    """
    figure, axes = _panels([title(name) for name in panels], columns, height=3.1)
    line_styles = _line_styles(list(dict.fromkeys(str(name) for table in panels.values() for name in table.columns)))
    lines: dict[str, Any] = {}
    for i, (ax, table) in enumerate(zip(axes, panels.values(), strict=True)):
        marker = "o" if len(table) < 20 else None
        for name in table.columns:
            lines[title(str(name))] = ax.plot(table.index, table[name], **line_styles[str(name)], marker=marker, ms=4)[
                0
            ]
        ax.set(xlabel=x_label, ylabel=y_label if i % columns == 0 else "")
        if from_zero:
            ax.set_ylim(0, 1.05 * max(0.01, float(table.max(axis=None))))
        ax.locator_params(axis="x", integer=pd.api.types.is_integer_dtype(table.index))
    titles_name_lines = all(list(table.columns) == [name] for name, table in panels.items())
    if len(lines) > 1 and not titles_name_lines:
        _legend(figure, axes, list(lines.values()), list(lines))
    return figure


def _line_styles(names: list[str]) -> dict[str, dict[str, Any]]:
    """Colour and dash of lines: a method's own, or the next of ``SERIES`` and ``DASHES``."""
    line_styles: dict[str, dict[str, Any]] = {}
    for i, name in enumerate(names):
        if name in method_names():
            line_styles[name] = {key: value for key, value in styles([name])[name].items() if key in ("color", "ls")}
        else:
            line_styles[name] = {"color": SERIES[i % len(SERIES)], "ls": DASHES[i // len(SERIES) % len(DASHES)]}
    return line_styles


def _legend(figure: Figure, axes: Sequence[Axes], handles: Sequence[Any], labels: Sequence[str]) -> None:
    """A figure's legend: beside a single panel, below several."""
    place: dict[str, Any] = {"loc": "outside right upper"} if len(axes) == 1 else {"loc": "outside lower center"}
    figure.legend(handles, labels, ncols=1 if len(axes) == 1 else 6, **place)


@styled
def clouds(panels: Mapping[str, Mapping[str, Any]], x_label: str, y_label: str, equal: bool = True) -> Figure:
    """A panel per title: groups of points (n, 2) in the plane, by name; ``equal`` where both axes have one unit.

    Raises ValueError where there is nothing to draw.
    """
    figure, axes = _panels([title(name) for name in panels], 4, height=3.4)
    for ax, groups in zip(axes, panels.values(), strict=True):
        for (name, points), colour in zip(groups.items(), SERIES * len(groups), strict=False):
            x, y = np.asarray(points).T
            ax.scatter(x, y, s=20, color=colour, alpha=0.7, linewidths=0, label=title(name))
        ax.set(xlabel=x_label, ylabel=y_label, aspect="equal" if equal else "auto")
    _legend(figure, axes, *axes[0].get_legend_handles_labels())
    return figure


@styled
def coupling(steps: Any, atoms: Any, taken: Any) -> Figure:
    """PWIL's greedy coupling in the plane: a line from every step to each expert row whose mass it takes.

    ``steps`` (T, 2) are in the order of the episode, ``atoms`` (N, 2) are the expert rows, and ``taken`` (T, N) are
    masses. The width of a line is proportional to the mass.
    """
    steps, atoms, taken = (np.asarray(x, float) for x in (steps, atoms, taken))
    figure = Figure(figsize=(7.0, 3.9))
    ax = figure.subplots()
    ax.margins(0.12)
    for t, j in np.argwhere(taken > 0):
        xs, ys = zip(steps[t], atoms[j], strict=True)
        ax.plot(xs, ys, color="0.6", lw=6 * taken[t, j] / taken.max(), zorder=1)
    ax.scatter(atoms[:, 0], atoms[:, 1], s=130, marker="*", color=RED, zorder=2, label="expert rows")
    ax.scatter(steps[:, 0], steps[:, 1], s=150, color=BLUE, zorder=2, label="steps of the episode, numbered")
    for t, step in enumerate(steps):
        ax.annotate(str(t + 1), step, color="white", ha="center", va="center", zorder=3, fontsize=9)
    ax.set(xlabel="input 1 (spreads)", ylabel="input 2 (spreads)", aspect="equal")
    figure.legend(loc="outside lower center", ncols=2, markerscale=0.7)
    return figure


@styled
def demonstrators(archive: Mapping[str, Any], chosen: Mapping[int, Any], robot: str | None = None) -> Figure:
    """A panel per number of demonstrators: their measures (n, k) among the elites of the expert's archive.

    ``archive`` has ``true_return`` (N,), ``measures`` (N, k) and ``cells`` (k,). Raises ValueError where there is
    nothing to draw.
    """
    points = np.asarray(archive["measures"])
    pool = top_fifth(np.asarray(archive["true_return"]), int(np.prod(archive["cells"])))
    figure, spaces = measure_panels(len(chosen), points.shape[1], robot, size=(3.3, 3.7), margin=(1.2, 0.8))
    for space, (n, measures) in zip(spaces, chosen.items(), strict=True):
        scatter(space, points, s=14, color="0.8", label="expert's archive")
        scatter(space, points[pool], s=14, color=BLUE, label="best fifth of the cells")
        scatter(space, measures, s=150, color=RED, marker="*", label="demonstrators")
        set_title(space, f"{n} demonstrator{'' if n == 1 else 's'}")
    legend = next(iter(spaces[0].values())).get_legend_handles_labels()
    figure.legend(*legend, loc="outside lower center", ncols=3)
    return figure


@styled
def by_demonstrations(tables: Mapping[str, pd.DataFrame], metrics: Sequence[str] = tuple(METRICS)) -> Figure:
    """A row per table, a panel per metric: the metric against the number of demonstrations (Fig. 13).

    Each table has columns ``method``, ``n_demos``, ``metric``, ``value`` and ``spread`` (an error bar's half length,
    NaN for none), coverage as a share of the cells. Raises ValueError where there is nothing to draw.
    """
    if not tables:
        raise ValueError("there is nothing to draw.")
    figure = Figure(figsize=(3.2 * len(metrics) + 0.8, 2.7 * len(tables) + 0.5))
    grid = figure.subplots(len(tables), len(metrics), squeeze=False)
    for axes, (name, table) in zip(grid, tables.items(), strict=True):
        for ax, metric in zip(axes, metrics, strict=True):
            _by_demonstrations(ax, table[table["metric"] == metric], percent(metric))
        axes[0].set_ylabel(name)
    for ax, metric in zip(grid[0], metrics, strict=True):
        ax.set_title(METRICS[metric])
    lines = {label: line for ax in grid.flat for line, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    figure.legend(lines.values(), lines.keys(), loc="outside lower center", ncols=max(1, len(lines)))
    return figure


def _by_demonstrations(ax: Axes, rows: pd.DataFrame, scale: float) -> None:
    """One metric's ``rows``, a line per method with error bars; values are multiplied by ``scale``."""
    for method, points in rows.groupby("method", sort=False):
        points, colour = points.sort_values("n_demos"), method_colour(str(method))
        y, spread = scale * points["value"], scale * points["spread"].fillna(0)
        ax.errorbar(points["n_demos"], y, spread, color=colour, marker="o", label=title(str(method)))
    ax.set_xlabel("demonstrations")
    ax.yaxis.set_major_formatter(short)
    ax.set_xticks(sorted(rows["n_demos"].unique()))


@styled
def effects(table: pd.DataFrame, label: str, columns: str | None = None) -> Figure:
    """A row per change of a setting: its effect on a metric as a dot with its interval, beside a line at zero.

    ``table`` has columns ``difference``, ``low`` and ``high`` in the metric's units (``low`` and ``high`` NaN where
    there is no interval). ``columns`` names another column, with a panel for each of its values. ``label`` names the
    x axis. Raises ValueError where there is nothing to draw.
    """
    groups = {"": table} if columns is None else dict(list(table.groupby(columns, sort=False)))
    if table.empty:
        raise ValueError("there are no effects to draw.")
    rows = list(dict.fromkeys(table.index))
    figure = Figure(figsize=(3.2 * len(groups) + 2.6, 0.34 * len(rows) + 1.3))
    axes = figure.subplots(1, len(groups), squeeze=False, sharey=True)[0]
    for ax, (name, group) in zip(axes, groups.items(), strict=True):
        heights = [rows.index(row) for row in group.index]
        ax.axvline(0, color="0.6", lw=1)
        ax.hlines(heights, group["low"], group["high"], color=GREEN, lw=2.5)
        ax.plot(group["difference"], heights, "o", color="black", ms=5)
        ax.set(title=name if columns else "", xlabel=label)
    axes[0].set_yticks(range(len(rows)), rows)
    axes[0].set_ylim(len(rows) - 0.5, -0.5)
    return figure


def _panels(titles: Sequence[str], columns: int, height: float) -> tuple[Figure, list[Axes]]:
    """A figure with a titled panel for each of ``titles``, in rows of at most ``columns``."""
    if not titles:
        raise ValueError("there is nothing to draw.")
    across = min(columns, len(titles))
    down = math.ceil(len(titles) / across)
    beside = 2.6 if len(titles) == 1 else 0.0  # room for a legend beside a single panel
    figure = Figure(figsize=(3.3 * across + 1.2 + beside, height * down + 0.4))
    axes = list(figure.subplots(down, across, squeeze=False).flat)
    for spare in axes[len(titles) :]:
        spare.remove()
    for ax, text in zip(axes, titles, strict=False):
        ax.set_title(text)
    return figure, axes[: len(titles)]
