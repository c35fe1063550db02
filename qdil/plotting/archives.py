"""Pictures of archives: heatmaps, several side by side on one scale, and where the demonstrators stand."""

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

from qdil.imitation.demos import top_fifth
from qdil.plotting.style import BLUE, EMPTY, FIELD_LABELS, GREEN, RED, label, label_measures

MOST_IN_A_ROW = 4  # heatmaps beside each other
MOST_DRAWN_ONE_BY_ONE = 30  # cells per measure, beyond which a PDF holds them as one picture and stays small


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
    one_picture = max(dims) > MOST_DRAWN_ONE_BY_ONE
    grid_archive_heatmap(
        grid, ax, df=rows, cmap=colours, aspect="equal", vmin=vmin, vmax=vmax, cbar=None, rasterized=one_picture,
        pcm_kwargs=edges,
    )  # fmt: skip
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
    """One heatmap per experiment, all on one colour scale; ``archives`` as in ``heatmap``, by experiment.

    Each title gives the share of cells that are filled. Raises ValueError where there is nothing to draw.
    """
    if not archives:
        raise ValueError("there are no archives to draw.")
    if any(field not in archive for archive in archives.values()):
        raise ValueError(f"not every archive has the field '{field}'.")
    values = np.concatenate([np.asarray(archive[field], float) for archive in archives.values()])
    low, high = (values.min(), values.max()) if len(values) else (0.0, 1.0)
    high = high if high > low else low + 1.0
    rows = -(-len(archives) // MOST_IN_A_ROW)
    columns = -(-len(archives) // rows)
    figure = Figure(figsize=(3.6 * columns + 1.2, 3.9 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.flat[len(archives) :]:
        ax.remove()
    drawn = list(axes.flat[: len(archives)])
    for i, (ax, (experiment, archive)) in enumerate(zip(drawn, archives.items(), strict=True)):
        mesh = heatmap(archive, ax, low, high, field, robot, colour_bar=False)
        cells = int(np.prod(archive["cells"]))
        ax.set_title(f"{label(experiment)}:{_break(experiment)}{len(archive['index'])} of {cells} cells")
        if i % columns:
            ax.set_ylabel("")
        if i + columns < len(archives):
            ax.set_xlabel("")
    _colour_bar(mesh, drawn, field)
    return figure


def _break(experiment: str) -> str:
    """What parts a title's name from its numbers: a new line where the name is long."""
    return "\n" if len(label(experiment)) > 16 else " "


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
    for where, colour, marker, size, text in groups:
        ax.scatter(
            where[:, 0], where[:, 1], s=size, c=colour, marker=marker, edgecolors="white", linewidths=0.5, label=text
        )
    for collection in ax.collections:
        collection.set_clip_on(False)  # a robot that never lifts a foot stands on the border
    label_measures(ax, robot)
    ax.set_axisbelow(True)
    ax.grid(color="0.92")
    figure.legend(loc="outside right upper", frameon=False)
    return figure
