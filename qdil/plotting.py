"""Pictures of archives and runs: heatmaps, learning curves, demonstrators, and an archive that redraws as it fills.

Every function takes arrays, tables or axes and returns what it drew; nothing here keeps state between calls or goes
through pyplot's current figure, so a figure shows once, where it is asked for.
"""

import io
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from ribs.archives import GridArchive
from ribs.visualize import grid_archive_heatmap

from qdil.config import Config
from qdil.imitation.demos import top_fifth
from qdil.ppga import Search
from qdil.robots.brax_robots import ROBOTS

# Okabe and Ito's colours, told apart with any kind of colour vision.
METHOD_COLOURS = {
    "true": "#000000",
    "mbo-true": "#009e73",
    "gail": "#0072b2",
    "mcond-gail": "#56b4e9",
    "mbo-gail": "#e69f00",
    "mconbo-gail": "#d55e00",
}
OTHER_COLOURS = ("#cc79a7", "#882255", "#999999")  # for methods without a colour of their own
GREEN, BLUE, RED = "#009e73", "#0072b2", "#d55e00"
EMPTY = "0.87"  # grey of an empty cell

METRICS = {
    "qd_score": "QD-score (sum of returns)",
    "coverage": "coverage (% of cells)",
    "best": "best return (reward units)",
    "average": "average return (reward units)",
}
X_LABELS = {"iteration": "QD iteration", "env_steps": "environment steps", "wall_seconds": "wall-clock time (s)"}
FIELD_LABELS = {
    "true_return": "true return per episode (reward units)",
    "fitness": "learned fitness per episode (reward units)",
    "length": "episode length (steps)",
    "rescored_return": "true return, scored again (reward units)",
    "rescored_fitness": "learned fitness, scored again (reward units)",
}


def method_colour(method: str, others: int = 0) -> str:
    """A method's colour; one without its own takes number ``others`` of the spare ones."""
    return METHOD_COLOURS.get(method, OTHER_COLOURS[others % len(OTHER_COLOURS)])


def measure_labels(robot: str | None = None) -> tuple[str, str]:
    """Axis labels of the measure space, naming the feet of ``robot`` where one is given."""
    names = [f" ({foot})" for foot in ROBOTS[robot].feet] if robot else ["", ""]
    first, second = (f"share of time foot {i + 1}{name}\ntouches the ground" for i, name in enumerate(names))
    return first, second


def label_measures(ax: Axes, robot: str | None = None) -> None:
    """Label the unit square of the two feet's ground contact and fix its limits."""
    first, second = measure_labels(robot)
    ax.set(xlabel=first, ylabel=second, xlim=(0, 1), ylim=(0, 1), aspect="equal")


def heatmap(
    archive: Mapping[str, Any],
    ax: Axes,
    vmin: float | None = None,
    vmax: float | None = None,
    field: str = "true_return",
    robot: str | None = None,
    colour_bar: bool = True,
) -> QuadMesh:
    """Draw ``archive`` on ``ax``: a cell's colour is ``field`` of its elite, an empty cell is grey.

    ``archive`` (see ``run.read_archive``) has, for n filled cells, ``index`` (n,), ``measures`` (n, 2) in [0, 1] and
    ``field`` (n,), and ``cells`` (2,), the cells per measure. ``vmin`` and ``vmax`` bound the colours, by default
    the values there are. Returns what was drawn, for a colour bar shared with other axes.
    Raises ValueError for an unknown ``field`` or measures that are not two.
    """
    dims = [int(cells) for cells in archive["cells"]]
    if field not in archive or field not in FIELD_LABELS:
        raise ValueError(f"field '{field}' cannot be drawn; choose one of {', '.join(FIELD_LABELS)} that is there.")
    if len(dims) != 2:
        raise ValueError(f"a heatmap needs two measures; this archive has {len(dims)}.")
    grid = GridArchive(solution_dim=1, dims=dims, ranges=[(0.0, 1.0)] * 2)
    measures = np.asarray(archive["measures"]).reshape(-1, 2)
    values = {"measures_0": measures[:, 0], "measures_1": measures[:, 1], "objective": archive[field]}
    rows = pd.DataFrame({"index": archive["index"], **values})
    colours = colormaps["viridis"].with_extremes(bad=EMPTY)
    edges = {"edgecolor": "white", "linewidth": min(0.5, 6 / max(dims))}
    grid_archive_heatmap(
        grid, ax, df=rows, cmap=colours, aspect="equal", vmin=vmin, vmax=vmax, cbar=None, pcm_kwargs=edges
    )
    label_measures(ax, robot)
    mesh = ax.collections[-1]
    assert isinstance(mesh, QuadMesh)
    if colour_bar:
        _colour_bar(mesh, [ax], field)
    return mesh


def _colour_bar(mesh: QuadMesh, axes: list[Axes], field: str) -> None:
    """A colour bar beside ``axes`` with the field's unit, and what grey means."""
    bar = axes[0].figure.colorbar(mesh, ax=axes, pad=0.02, shrink=0.9)
    bar.set_label(f"{FIELD_LABELS[field]}\ngrey: empty cell")


def archives_side_by_side(
    archives: Mapping[str, Mapping[str, Any]], field: str = "true_return", robot: str | None = None
) -> Figure:
    """One heatmap per method, all on one colour scale; ``archives`` as in ``heatmap``, by method.

    Each title gives the share of cells that are filled. Raises ValueError where there is nothing to draw.
    """
    if not archives:
        raise ValueError("there are no archives to draw.")
    if any(field not in archive for archive in archives.values()):
        raise ValueError(f"not every archive has the field '{field}'.")
    values = np.concatenate([np.asarray(archive[field], float) for archive in archives.values()])
    low, high = (values.min(), values.max()) if len(values) else (0.0, 1.0)
    high = high if high > low else low + 1.0
    figure = Figure(figsize=(3.6 * len(archives) + 1.2, 3.9), layout="constrained")
    axes = figure.subplots(1, len(archives), squeeze=False)[0]
    for ax, (method, archive) in zip(axes, archives.items(), strict=True):
        mesh = heatmap(archive, ax, low, high, field, robot, colour_bar=False)
        cells = int(np.prod(archive["cells"]))
        ax.set_title(f"{method}: {len(archive['index'])} of {cells} cells")
        if ax is not axes[0]:
            ax.set_ylabel("")
    _colour_bar(mesh, list(axes), field)
    return figure


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


def behaviour_space(expert: Mapping[str, Any], demos: Mapping[str, Any], robot: str | None = None) -> Figure:
    """Where the demonstrators stand among the expert's elites (Fig. 4).

    ``expert`` is an archive as in ``heatmap``; ``demos`` has ``elite_measures`` (d, 2) of the demonstrators, as the
    demonstrations file does. Raises ValueError if it does not.
    """
    if "elite_measures" not in demos:
        raise ValueError("these demonstrations do not say which elites they are of: there is no elite_measures.")
    pool = top_fifth(np.asarray(expert["true_return"]), int(np.prod(expert["cells"])))
    points = np.asarray(expert["measures"])
    groups = [
        (points, GREEN, "o", 22, f"expert's archive ({len(points)})"),
        (points[pool], BLUE, "s", 26, f"best fifth of the cells, by return ({len(pool)})"),
        (np.asarray(demos["elite_measures"]), RED, "*", 230, f"demonstrators ({len(demos['elite_measures'])})"),
    ]
    figure = Figure(figsize=(7.0, 3.9), layout="constrained")
    ax = figure.subplots()
    for where, colour, marker, size, label in groups:
        ax.scatter(
            where[:, 0], where[:, 1], s=size, c=colour, marker=marker, edgecolors="white", linewidths=0.5, label=label
        )
    for collection in ax.collections:
        collection.set_clip_on(False)  # a robot that never lifts a foot stands on the border
    label_measures(ax, robot)
    ax.set_axisbelow(True)
    ax.grid(color="0.92")
    figure.legend(loc="outside right upper", frameon=False)
    return figure


class LiveArchive:
    """Watch an archive fill: give it to ``run.train`` as ``report``, in a notebook.

    One picture, redrawn in place at most every ``seconds`` and once at the end, with the progress as its title. It is
    a plain PNG, so an executed copy keeps the last one and nothing else. Nothing shows if no iteration is run.
    """

    def __init__(self, config: Config, seconds: float = 5.0) -> None:
        self.config, self.seconds = config, seconds
        self.begin, self.drawn = time.monotonic(), float("-inf")
        self.first: tuple[int, float] | None = None  # the first iteration seen, and when: before it, all compiles
        self.handle: Any = None  # of the picture, once there is one

    def __call__(self, search: Search, row: Mapping[str, float]) -> None:
        """Show one iteration, if the last picture is old enough or this is the last iteration."""
        last = row["iteration"] == self.config.iterations
        self.first = self.first or (int(row["iteration"]), time.monotonic())
        if not last and time.monotonic() - self.drawn < self.seconds:
            return
        from IPython.display import Image, display

        text = self._progress(row, last)
        figure = live_figure(search.archives.result, text, self.config.env)
        picture = Image(to_png(figure), format="png", alt=text)
        if self.handle is None:
            self.handle = display(picture, display_id=True)
        else:
            self.handle.update(picture)
        self.drawn = time.monotonic()

    def _progress(self, row: Mapping[str, float], last: bool) -> str:
        done, total, now = int(row["iteration"]), self.config.iterations, time.monotonic()
        first, since = self.first or (done, now)
        if last:
            clock = f", finished in {now - self.begin:.0f} s"
        else:
            clock = f", about {(now - since) / (done - first) * (total - done):.0f} s left" if done > first else ""
        return (
            f"{self.config.method} on {self.config.env}: iteration {done} of {total}{clock}\n"
            f"coverage {row['coverage']:.0%}, QD-score {row['qd_score']:,.0f}, best return {row['best']:,.0f}"
        )


def live_figure(archive: GridArchive, title: str, robot: str | None = None) -> Figure:
    """The result archive of a search in progress, drawn from pyribs' own arrays."""
    content: dict[str, Any] = {name: archive.data(name) for name in ("index", "measures", "true_return")}
    figure = Figure(figsize=(5.6, 4.4), dpi=100, layout="constrained")
    ax = figure.subplots()
    heatmap({**content, "cells": archive.dims}, ax, robot=robot)
    figure.suptitle(title, fontsize=10)
    return figure


def to_png(figure: Figure) -> bytes:
    """A figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
