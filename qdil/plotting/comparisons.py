"""Pictures that compare: rewards by kind of step, simple curves, point clouds, couplings, demonstrations, effects."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdil.imitation.demos import top_fifth
from qdil.methods import method_names
from qdil.plotting.colours import method_colour, styles
from qdil.plotting.style import BLUE, GREEN, METRICS, RED, label_measures, percent, short

SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")  # Okabe and Ito's, in our order
DASHES = ("-", "--", ":", "-.")  # so that lines differ in print, too


def rewards_by_kind(rewards: Mapping[str, Mapping[str, Any]], columns: int = 4) -> Figure:
    """A panel per reward model: a box of its rewards per step for every kind of step.

    ``rewards`` are arrays of any shape, by model and kind (see ``evidence.steps.paid``). A box holds the middle half
    of the steps, its whiskers nine tenths. Raises ValueError where there is nothing to draw.
    """
    figure, axes = _panels(list(rewards), columns, height=2.5)
    for i, (ax, (model, kinds)) in enumerate(zip(axes, rewards.items(), strict=True)):
        values = [np.ravel(kinds[kind]) for kind in kinds]
        boxes = ax.boxplot(
            values, orientation="horizontal", whis=(5, 95), showfliers=False, widths=0.65, patch_artist=True,
            medianprops={"color": "black"},
        )  # fmt: skip
        for box, colour in zip(boxes["boxes"], SERIES * len(kinds), strict=False):
            box.set(facecolor=colour, alpha=0.75)
        ax.set_yticks(range(1, len(kinds) + 1), list(kinds) if i % columns == 0 else [""] * len(kinds))
        ax.invert_yaxis()
        ax.set(title=model, xlabel="reward per step")
        _plain(ax)
    return figure


def curves(
    panels: Mapping[str, pd.DataFrame], x_label: str, y_label: str, columns: int = 4, from_zero: bool = False
) -> Figure:
    """A panel per title: the columns of a table as lines over its index, with one legend for all.

    A column that is called like a method has that method's colour. ``from_zero`` shows values from 0 on, for shares,
    whose small changes should look small. Raises ValueError where there is nothing to draw.
    """
    figure, axes = _panels(list(panels), columns, height=3.1)
    names = list(dict.fromkeys(name for table in panels.values() for name in table.columns))
    lines: dict[str, Any] = {}
    for i, (ax, (title, table)) in enumerate(zip(axes, panels.items(), strict=True)):
        for name in table.columns:
            at = names.index(name)
            style: dict[str, Any] = {"color": SERIES[at % len(SERIES)], "ls": DASHES[at // len(SERIES) % len(DASHES)]}
            if name in method_names():
                style = {key: value for key, value in styles([str(name)])[str(name)].items() if key in style}
            style |= {"marker": "o" if len(table) < 20 else None, "ms": 4}
            lines[str(name)] = ax.plot(table.index, table[name], **style)[0]
        ax.set(title=title, xlabel=x_label, ylabel=y_label if i % columns == 0 else "")
        if from_zero:
            ax.set_ylim(0, 1.05 * max(0.01, float(table.max(axis=None))))
        ax.locator_params(axis="x", integer=pd.api.types.is_integer_dtype(table.index))
        _plain(ax)
    titled = all(list(table.columns) == [title] for title, table in panels.items())
    if len(lines) > 1 and not titled:
        where = {"loc": "outside right upper"} if len(axes) == 1 else {"loc": "outside lower center", "ncols": 6}
        figure.legend(lines.values(), lines.keys(), frameon=False, **where)
    return figure


def clouds(panels: Mapping[str, Mapping[str, Any]], x_label: str, y_label: str, equal: bool = True) -> Figure:
    """A panel per title: groups of points (n, 2) in the plane, by name; ``equal`` where both axes have one unit.

    Raises ValueError where there is nothing to draw.
    """
    figure, axes = _panels(list(panels), 4, height=3.4)
    for ax, (title, groups) in zip(axes, panels.items(), strict=True):
        for (name, points), colour in zip(groups.items(), SERIES * len(groups), strict=False):
            at = np.asarray(points)
            ax.scatter(at[:, 0], at[:, 1], s=20, color=colour, alpha=0.7, linewidths=0, label=name)
        ax.set(title=title, xlabel=x_label, ylabel=y_label, aspect="equal" if equal else "auto")
        _plain(ax)
    handles, labels = axes[0].get_legend_handles_labels()
    where = {"loc": "outside right upper"} if len(axes) == 1 else {"loc": "outside lower center", "ncols": 6}
    figure.legend(handles, labels, frameon=False, **where)
    return figure


def coupling(steps: Any, atoms: Any, taken: Any) -> Figure:
    """PWIL's greedy coupling in the plane: a line from every step to the expert rows that it took mass from.

    ``steps`` (T, 2) in the order in which they happened, ``atoms`` (N, 2), ``taken`` (T, N) masses: a line is as wide
    as the mass is large.
    """
    steps, atoms, taken = (np.asarray(x, float) for x in (steps, atoms, taken))
    figure = Figure(figsize=(7.0, 3.9), layout="constrained")
    ax = figure.subplots()
    ax.margins(0.12)
    for t, j in np.argwhere(taken > 0):
        xs, ys = zip(steps[t], atoms[j], strict=True)
        ax.plot(xs, ys, color="0.6", lw=6 * taken[t, j] / taken.max(), zorder=1)
    ax.scatter(atoms[:, 0], atoms[:, 1], s=130, marker="*", color=RED, zorder=2, label="expert rows")
    ax.scatter(steps[:, 0], steps[:, 1], s=150, color=BLUE, zorder=2, label="steps of the episode, numbered")
    for t, where in enumerate(steps):
        ax.annotate(str(t + 1), where, color="white", ha="center", va="center", zorder=3, fontsize=9)
    ax.set(xlabel="input 1 (spreads)", ylabel="input 2 (spreads)", aspect="equal")
    figure.legend(loc="outside lower center", ncols=2, markerscale=0.7, frameon=False)
    _plain(ax)
    return figure


def demonstrators(archive: Mapping[str, Any], chosen: Mapping[int, Any], robot: str | None = None) -> Figure:
    """A panel per number of demonstrators: where they stand (n, 2) among the elites of the expert's archive.

    ``archive`` has ``true_return`` (N,), ``measures`` (N, 2) and ``cells`` (2,). Raises ValueError where there is
    nothing to draw.
    """
    points = np.asarray(archive["measures"])
    pool = top_fifth(np.asarray(archive["true_return"]), int(np.prod(archive["cells"])))
    titles = [f"{n} demonstrator{'' if n == 1 else 's'}" for n in chosen]
    figure, axes = _panels(titles, 4, height=3.7)
    groups = [(points, "0.8", "o", 14, "expert's archive"), (points[pool], BLUE, "o", 14, "best fifth of the cells")]
    for ax, title, where in zip(axes, titles, chosen.values(), strict=True):
        for at, colour, marker, size, name in [*groups, (np.asarray(where), RED, "*", 150, "demonstrators")]:
            ax.scatter(at[:, 0], at[:, 1], s=size, color=colour, marker=marker, label=name, clip_on=False)
        label_measures(ax, robot)
        ax.set(title=title, ylabel=ax.get_ylabel() if ax is axes[0] else "")
        _plain(ax)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def by_demonstrations(tables: Mapping[str, pd.DataFrame], metrics: Sequence[str] = tuple(METRICS)) -> Figure:
    """A row per table, a panel per metric: the metric against the number of demonstrations (Fig. 13).

    Each table has columns ``method``, ``n_demos``, ``metric``, ``value`` and ``spread`` (an error bar's half length,
    NaN for none), coverage as a share of the cells. Raises ValueError where there is nothing to draw.
    """
    if not tables:
        raise ValueError("there is nothing to draw.")
    figure = Figure(figsize=(3.2 * len(metrics) + 0.8, 2.7 * len(tables) + 0.5), layout="constrained")
    grid = figure.subplots(len(tables), len(metrics), squeeze=False)
    for row, (axes, (title, table)) in enumerate(zip(grid, tables.items(), strict=True)):
        for ax, metric in zip(axes, metrics, strict=True):
            scale = percent(metric)
            mine = table[table["metric"] == metric]
            for method, rows in mine.groupby("method", sort=False):
                rows, colour = rows.sort_values("n_demos"), method_colour(str(method))
                y, spread = scale * rows["value"], scale * rows["spread"].fillna(0)
                ax.errorbar(rows["n_demos"], y, spread, color=colour, marker="o", capsize=3, label=str(method))
            ax.set(title=METRICS[metric] if row == 0 else "", xlabel="demonstrations")
            ax.yaxis.set_major_formatter(short)
            ax.set_xticks(sorted(mine["n_demos"].unique()))
            _plain(ax)
        axes[0].set_ylabel(title)
    named = {label: line for ax in grid.flat for line, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=max(1, len(named)), frameon=False)
    return figure


def effects(table: pd.DataFrame, label: str, columns: str | None = None) -> Figure:
    """A row per change: its effect on a metric as a dot with an interval, and a line where there is none.

    ``table`` has columns ``difference``, ``low`` and ``high`` in the metric's units (``low`` and ``high`` NaN where
    there is no interval), and with ``columns`` one more that deals the rows out to panels. ``label`` names the axis.
    Raises ValueError where there is nothing to draw.
    """
    groups = {"": table} if columns is None else dict(list(table.groupby(columns, sort=False)))
    if table.empty:
        raise ValueError("there are no effects to draw.")
    rows = list(dict.fromkeys(table.index))
    figure = Figure(figsize=(3.2 * len(groups) + 2.6, 0.34 * len(rows) + 1.3), layout="constrained")
    axes = figure.subplots(1, len(groups), squeeze=False, sharey=True)[0]
    for ax, (title, mine) in zip(axes, groups.items(), strict=True):
        at = [rows.index(name) for name in mine.index]
        ax.axvline(0, color="0.6", lw=1)
        ax.hlines(at, mine["low"], mine["high"], color=GREEN, lw=2.5)
        ax.plot(mine["difference"], at, "o", color="black", ms=5)
        ax.set(title=title if columns else "", xlabel=label)
        _plain(ax)
    axes[0].set_yticks(range(len(rows)), rows)
    axes[0].set_ylim(len(rows) - 0.5, -0.5)
    return figure


def _panels(titles: Sequence[str], columns: int, height: float) -> tuple[Figure, list[Axes]]:
    """A figure with a panel per title, in rows of at most ``columns``."""
    if not titles:
        raise ValueError("there is nothing to draw.")
    across = min(columns, len(titles))
    down = -(-len(titles) // across)
    beside = 2.6 if len(titles) == 1 else 0.0  # room for a legend beside a panel that is alone
    figure = Figure(figsize=(3.3 * across + 1.2 + beside, height * down + 0.4), layout="constrained")
    axes = list(figure.subplots(down, across, squeeze=False).flat)
    for spare in axes[len(titles) :]:
        spare.remove()
    return figure, axes[: len(titles)]


def _plain(ax: Axes) -> None:
    ax.grid(color="0.92")
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
