"""The background algorithms: their archives, curves over several seeds, soft thresholds, evolution strategies."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from qdil.plotting.colours import BLUE, EMPTY, GREEN, GREY, ORANGE, PINK, RED, SKY
from qdil.plotting.style import styled

if TYPE_CHECKING:  # slow to import
    from ribs.archives import GridArchive

    from qdil.lab.background.algorithms import Result
    from qdil.lab.background.soft import Visits
    from qdil.lab.background.strategies import Chase

ALGORITHM_COLOURS = {
    "nslc": GREEN,
    "map-elites": GREY,
    "cma-me": ORANGE,
    "cma-mega": BLUE,
    "cma-maega": RED,
    "cma-mega-xnes": SKY,
    "cma-maega-xnes": PINK,
    "CMA-ES (pyribs)": BLUE,
    "CMA-ES (whole rank-one term)": GREEN,
    "xNES": RED,
}
OBJECTIVE = "objective of the cell's elite (best: 100)"
CURVES = {"qd_score": "QD-score (sum of objectives)", "coverage": "coverage (% of cells)", "best": "best objective"}


@styled
def archive_maps(archives: Mapping[str, "GridArchive"]) -> Figure:
    """Archives side by side on one colour scale, 0 to 100; a title gives the name and the share of filled cells."""
    figure = Figure(figsize=(3.1 * len(archives) + 1.0, 3.5))
    axes = figure.subplots(1, len(archives), squeeze=False)[0]
    for ax, (name, archive) in zip(axes, archives.items(), strict=True):
        mesh = archive_map(archive, ax)
        ax.set_title(f"{name}\n{len(archive)} of {int(archive.cells)} cells")
        ax.set_ylabel("measure $m_2$" if ax is axes[0] else "")
    figure.colorbar(mesh, ax=list(axes), pad=0.02, extend="min").set_label(f"{OBJECTIVE}\ngrey: empty cell")
    return figure


def archive_map(archive: "GridArchive", ax: Axes) -> QuadMesh:
    """Draw the elites' objectives, 0 to 100, on the grid of two measures; empty cells are grey."""
    stored = archive.data(["index", "objective"], return_type="dict")
    grid = np.full(int(archive.cells), np.nan)
    grid[stored["index"]] = stored["objective"]
    ax.grid(False)
    edges = [np.asarray(boundary) for boundary in archive.boundaries]
    colours = colormaps["viridis"].with_extremes(bad=EMPTY)
    values = np.ma.masked_invalid(grid.reshape(tuple(archive.dims)).T)
    mesh = ax.pcolormesh(*edges, values, cmap=colours, vmin=0, vmax=100, rasterized=True)
    ax.set(xlabel="measure $m_1$", aspect="equal", facecolor=EMPTY)
    ax.spines[:].set_visible(True)
    return mesh


@styled
def crowding(measures: Mapping[str, np.ndarray], ranges: Mapping[str, Sequence[tuple[float, float]]]) -> Figure:
    """The measures (N, 2) of random solutions within their ``ranges``, a panel per name."""
    figure = Figure(figsize=(3.1 * len(measures), 3.3))
    for ax, (name, points) in zip(figure.subplots(1, len(measures), squeeze=False)[0], measures.items(), strict=True):
        ax.scatter(*points.T, s=3, color=BLUE, alpha=0.5, linewidths=0)
        (left, right), (low, high) = ranges[name]
        ax.set(title=name, xlabel="measure $m_1$", ylabel="measure $m_2$", xlim=(left, right), ylim=(low, high))
        ax.set_aspect("equal")
    return figure


@styled
def curves(results: Mapping[str, Sequence["Result"]]) -> Figure:
    """QD-score, coverage and best objective by evaluations: median over seeds, band from the lowest to the highest."""
    figure = Figure(figsize=(12, 3.5))
    axes = figure.subplots(1, len(CURVES))
    for ax, (name, label) in zip(axes, CURVES.items(), strict=True):
        for algorithm, several in results.items():
            values = (100 if name == "coverage" else 1) * np.array([result.history[name] for result in several])
            _band(ax, several[0].history["evaluations"], values, algorithm, len(several))
        ax.set(xlabel="evaluations", ylabel=label)
    _zero_in_sight(axes[0])
    axes[1].set_ylim(0, 103)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(results))
    return figure


def _band(ax: Axes, x: np.ndarray, values: np.ndarray, label: str, seeds: int) -> None:
    """Median over the rows of ``values`` (seeds, n), and their range if there are several."""
    colour = ALGORITHM_COLOURS.get(label)
    (line,) = ax.plot(x, np.median(values, axis=0), color=colour, label=label)
    if seeds > 1:
        ax.fill_between(x, values.min(axis=0), values.max(axis=0), color=line.get_color(), alpha=0.2, linewidth=0)


def _zero_in_sight(ax: Axes) -> None:
    """Begin the y axis just below 0 if a few elites have a hugely negative objective, and note that on the axes."""
    low, high = ax.get_ylim()
    floor = -0.1 * abs(high)
    if low < floor:
        ax.set_ylim(floor, high)
        ax.annotate("cut off below", (0.02, 0.02), xycoords="axes fraction", color="0.4", fontsize=8)


@styled
def thresholds(visits: Mapping[float, "Visits"]) -> Figure:
    """A cell's threshold t_e and the improvement Δ of every arrival in the cell, by learning rate α."""
    figure = Figure(figsize=(10, 3.4))
    left, right = figure.subplots(1, 2)
    shades = colormaps["viridis"](np.linspace(0, 0.85, len(visits)))
    for (alpha, rows), shade in zip(visits.items(), shades, strict=True):
        arrivals = np.arange(1, len(rows.objective) + 1)
        left.step(np.r_[0, arrivals], np.r_[rows.before[:1], rows.after], where="post", color=shade)
        right.plot(arrivals, rows.improvement, ".-", color=shade, label=f"α = {alpha:g}")
    left.plot(arrivals, rows.objective, "x", color="0.3", label="objective of the arrival")
    left.set(xlabel="arrivals in the cell", ylabel="threshold $t_e$")
    right.set(xlabel="arrival number", ylabel=r"improvement $\Delta = f - t_e$")
    figure.legend(loc="outside right upper")
    return figure


@styled
def swept(results: Mapping[Any, Sequence["Result"]], name: str) -> Figure:
    """Final QD-score and coverage by the value of the setting ``name``: a dot per seed, a line through the medians."""
    from qdil.lab.background.compare import ends

    final = ends(results)
    places = {label: i for i, label in enumerate(results)}
    figure = Figure(figsize=(9, 3.2))
    axes = figure.subplots(1, 2)
    for ax, metric in zip(axes, ("qd_score", "coverage"), strict=True):
        values = (100 if metric == "coverage" else 1) * final[metric]
        ax.plot(final["label"].map(places), values, "o", color=RED, alpha=0.5, markersize=5)
        medians = values.groupby(final["label"], sort=False).median()
        ax.plot(list(places.values()), medians.to_numpy(), color=RED)
        ax.set_xticks(list(places.values()), [f"{value:g}" for value in places])
        ax.set(xlabel=name, ylabel=CURVES[metric])
    _zero_in_sight(axes[0])
    axes[1].set_ylim(0, 103)
    return figure


@styled
def chases(results: Mapping[float, Mapping[str, Sequence["Chase"]]]) -> Figure:
    """Distance to the optimum and width of the distribution by iteration, a column per noise, median and range."""
    figure = Figure(figsize=(3.6 * len(results) + 0.6, 5.4))
    axes = figure.subplots(2, len(results), sharex=True, sharey="row", squeeze=False)
    for column, (noise, by_strategy) in zip(axes.T, results.items(), strict=True):
        for strategy, several in by_strategy.items():
            steps = np.arange(1, len(several[0].distance) + 1)
            for ax, field in zip(column, ("distance", "width"), strict=True):
                values = np.maximum([getattr(chase, field) for chase in several], 1e-12)
                _band(ax, steps, values, strategy, len(several))
                ax.set_yscale("log")
        column[0].set_title(f"noise {noise:g}")
        column[1].set_xlabel("iteration")
    axes[0, 0].set_ylabel("distance of the mean\nto the optimum")
    axes[1, 0].set_ylabel("width of the\ndistribution")
    axes[0, 0].set_ylim(bottom=1e-3)
    axes[1, 0].set_ylim(bottom=1e-4)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


@styled
def under_noise(rows: pd.DataFrame) -> Figure:
    """The QD-score as claimed (hollow) and without noise (full), by case and algorithm, a mark per seed.

    ``rows`` as from ``compare.under_noise``.
    """
    cases = list(rows["case"].unique())
    figure = Figure(figsize=(4.2 * len(cases), 3.4))
    axes = figure.subplots(1, len(cases), sharey=True, squeeze=False)[0]
    for ax, case in zip(axes, cases, strict=True):
        by_algorithm = rows[rows["case"] == case].groupby("algorithm", sort=False)
        for place, (algorithm, several) in enumerate(by_algorithm):
            x = place + (np.linspace(-0.2, 0.2, len(several)) if len(several) > 1 else np.zeros(1))
            colour = ALGORITHM_COLOURS.get(str(algorithm), "0.3")
            ax.plot(x, several["claimed_qd_score"], "o", mfc="none", color=colour)
            ax.plot(x, several["true_qd_score"], "o", color=colour)
        names = [str(name).replace("-xnes", "\nxnes") for name, _ in by_algorithm]
        ax.set_xticks(range(len(names)), names, fontsize=8)
        ax.set_title(case)
        ax.xaxis.grid(False)
    axes[0].set_ylabel("QD-score\n(hollow: claimed, full: true)")
    _zero_in_sight(axes[0])
    return figure
