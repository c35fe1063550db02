"""Archives: heatmaps of k measures, several archives on one colour scale, and the demonstrators among the elites."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from qdil.imitation.selection import top_fifth
from qdil.plotting.colours import BLUE, EMPTY, GREEN, RED
from qdil.plotting.measures import STRIP, Plane, Space, label_measures, measure_panels, planes, scatter, set_title
from qdil.plotting.style import FIELD_LABELS, label, styled
from qdil.qd.landing import corrected_archive

MOST_AS_VECTORS = 30  # cells per measure; a PDF holds larger heatmaps as pixels, so that it stays small


def project(archive: Mapping[str, Any], field: str, plane: Plane) -> np.ndarray:
    """The best value of ``field`` in every cell of a plane, over the cells of all other measures; NaN where none.

    ``archive`` as in ``heatmap``. The result has an axis for every measure of ``plane``, in that order.
    """
    cells = tuple(int(n) for n in archive["cells"])
    coordinates = np.unravel_index(np.asarray(archive["index"], int), cells)
    best = np.full([cells[measure] for measure in plane], np.nan)
    np.fmax.at(best, tuple(coordinates[measure] for measure in plane), np.asarray(archive[field], float))
    return best


def heatmap(
    archive: Mapping[str, Any],
    ax: Axes,
    vmin: float | None = None,
    vmax: float | None = None,
    field: str = "true_return",
    robot: str | None = None,
    colour_bar: bool = True,
    plane: Plane | None = None,
) -> QuadMesh:
    """Draw an archive of k measures on ``ax``: a cell's colour is ``field`` of its elite, an empty cell is grey.

    ``archive`` (see ``read_archive``) has, for n filled cells, ``index`` (n,) into the flattened grid and ``field``
    (n,), and ``cells`` (k,), the cells per measure. One measure is a strip, two are a square. Of more measures the
    axes show the two of ``plane`` (counted from 0; default: the first two), with the best value over the others.
    ``vmin`` and ``vmax`` bound the colours, by default the archive's own values. Returns the coloured cells, for a
    colour bar that several axes share.
    Raises ValueError for an unknown ``field``, or a ``plane`` that is not one of this archive's.
    """
    k = len(archive["cells"])
    plane = planes(k)[0] if plane is None else plane
    if len(plane) != min(k, 2) or len(set(plane)) != len(plane) or not set(plane) <= set(range(k)):
        raise ValueError(f"an archive of {k} measures has no plane {plane}; its planes are {planes(k)}.")
    mesh = _map(archive, ax, plane, vmin, vmax, field)
    label_measures(ax, robot, k, plane)
    if colour_bar:
        draw_colour_bar(mesh, [ax], field, k)
    return mesh


def _map(
    archive: Mapping[str, Any], ax: Axes, plane: Plane, vmin: float | None, vmax: float | None, field: str
) -> QuadMesh:
    """The coloured cells of ``heatmap``, each measure from 0 to 1."""
    if field not in archive or field not in FIELD_LABELS:
        raise ValueError(
            f"field '{field}' cannot be drawn; choose one of {', '.join(FIELD_LABELS)} that the archive has."
        )
    values = project(archive, field, plane)
    edges = [np.linspace(0, 1, n + 1) for n in values.shape] + [np.array([0.0, STRIP])]
    most = max(values.shape)
    ax.grid(False)
    return ax.pcolormesh(
        edges[0], edges[1], np.ma.masked_invalid(np.atleast_2d(values.T)),
        cmap=colormaps["viridis"].with_extremes(bad=EMPTY), vmin=vmin, vmax=vmax,
        edgecolor="white", linewidth=min(0.5, 6 / most), rasterized=most > MOST_AS_VECTORS,
    )  # fmt: skip


def value_label(field: str, k: int) -> str:
    """The label of a heatmap's colour bar: the field with its unit, what a projection shows, and what grey means."""
    if k <= 2:
        return f"{FIELD_LABELS[field]}\ngrey: empty cell"
    others = "the other measure" if k == 3 else f"the other {k - 2} measures"
    return f"{FIELD_LABELS[field]},\nbest value over {others}\ngrey: no filled cell"


def draw_colour_bar(mesh: QuadMesh, axes: list[Axes], field: str, k: int) -> None:
    """A colour bar beside ``axes``, or below a strip."""
    place: dict[str, Any] = {"location": "bottom", "shrink": 0.6, "aspect": 40} if k == 1 else {"shrink": 0.9}
    axes[0].figure.colorbar(mesh, ax=axes, pad=0.02, **place).set_label(value_label(field, k))


def bar_margin(k: int) -> tuple[float, float]:
    """Inches that the colour bar of k measures adds to a figure's width and height."""
    return (0.0, 1.0) if k == 1 else (1.2, 0.0)


def draw_archive(
    space: Space, archive: Mapping[str, Any], limits: tuple[float, float] | None = None, field: str = "true_return"
) -> QuadMesh:
    """Draw an archive (as in ``heatmap``) on every plane of a measure space that ``measure_panels`` has made.

    ``limits`` bound the colours, by default the archive's own values. Returns one map, for a shared colour bar.
    """
    low, high = limits or value_limits([archive], field)
    return [_map(archive, ax, plane, low, high, field) for plane, ax in space.items()][-1]


def value_limits(archives: Iterable[Mapping[str, Any]], field: str) -> tuple[float, float]:
    """The lowest and the highest value of ``field`` in the maps of ``archives``; they always differ."""
    maps = [project(archive, field, plane) for archive in archives for plane in planes(len(archive["cells"]))]
    values = np.concatenate([values[np.isfinite(values)] for values in maps])
    low, high = (values.min(), values.max()) if len(values) else (0.0, 1.0)
    return low, high if high > low else low + 1.0


@styled
def one_archive(
    archive: Mapping[str, Any], heading: str, field: str = "true_return", robot: str | None = None
) -> tuple[Figure, Space]:
    """A figure of one archive (as in ``heatmap``) with its colour bar, under ``heading``; and its axes.

    One measure is a strip, two are a square, and of more measures a triangle shows every pair.
    """
    k = len(archive["cells"])
    figure, [space] = measure_panels(1, k, robot, size=(4.4, 4.4), margin=bar_margin(k))
    draw_colour_bar(draw_archive(space, archive, field=field), list(space.values()), field, k)
    figure.suptitle(heading, fontsize=10)
    return figure, space


@styled
def archives_side_by_side(
    archives: Mapping[str, Mapping[str, Any]], field: str = "true_return", robot: str | None = None
) -> Figure:
    """The heatmaps of several experiments' archives, all on one colour scale; ``archives`` as in ``heatmap``.

    Each title gives the number of filled cells. One measure is a strip, two are a square, and of more measures a
    triangle shows every pair. Raises ValueError where there is nothing to draw, or where archives differ in k.
    """
    k = _measures_of(archives, field)
    limits = value_limits(archives.values(), field)
    figure, spaces = measure_panels(len(archives), k, robot, size=(3.6, 3.9), margin=bar_margin(k))
    for space, (experiment, archive) in zip(spaces, archives.items(), strict=True):
        mesh = draw_archive(space, archive, limits, field)
        name = label(experiment)
        line_break = "\n" if len(name) > 16 and k == 2 else " "
        set_title(space, f"{name}:{line_break}{_filled(archive)}")
    draw_colour_bar(mesh, [ax for space in spaces for ax in space.values()], field, k)
    return figure


def _measures_of(archives: Mapping[str, Mapping[str, Any]], field: str) -> int:
    """The number k of measures of all ``archives``. Raises ValueError if they cannot be drawn beside each other."""
    if not archives:
        raise ValueError("there are no archives to draw.")
    if any(field not in archive for archive in archives.values()):
        raise ValueError(f"not every archive has the field '{field}'.")
    if len({len(archive["cells"]) for archive in archives.values()}) > 1:
        raise ValueError("these archives differ in the number of measures: they cannot be drawn side by side.")
    return len(next(iter(archives.values()))["cells"])


def _filled(archive: Mapping[str, Any]) -> str:
    return f"{len(archive['index']):,} of {math.prod(map(int, archive['cells'])):,} cells"


@styled
def both_readings(archives: Mapping[str, Mapping[str, Any]], robot: str | None = None) -> Figure:
    """Each experiment's archive as claimed and, next to it, as it lands on fresh episodes, all on one colour scale.

    ``archives`` as in ``heatmap``, with ``rescored_return`` (n,) and ``rescored_measures`` (n, k); where an elite lands
    is defined in ``qdil.qd.landing``. Three or four archives of two measures have their claimed maps in one row and the
    landed maps below; otherwise the two maps of each archive are neighbours.
    Raises ValueError where there is nothing to draw or where archives differ in k, and ConfigError for an archive
    without scores on fresh episodes.
    """
    k = _measures_of(archives, "true_return")
    pairs = [
        ((name, "as claimed", one), (name, "as it lands", corrected_archive(one))) for name, one in archives.items()
    ]
    in_rows = k == 2 and len(pairs) in (3, 4)
    shown = [*(claimed for claimed, _ in pairs), *(landed for _, landed in pairs)] if in_rows else sum(pairs, ())
    columns = len(pairs) if in_rows else {1: 1, 2: min(2 * len(pairs), 4)}.get(k, 2)
    limits = value_limits((archive for _, _, archive in shown), "true_return")
    figure, spaces = measure_panels(len(shown), k, robot, size=(3.6, 4.1), margin=bar_margin(k), columns=columns)
    for space, (name, reading, archive) in zip(spaces, shown, strict=True):
        mesh = draw_archive(space, archive, limits)
        line_break = ": " if k == 1 else "\n"
        set_title(space, f"{label(name)}{line_break}{reading}, {_filled(archive)}")
    draw_colour_bar(mesh, [ax for space in spaces for ax in space.values()], "true_return", k)
    return figure


@styled
def behaviour_space(expert: Mapping[str, Any], demos: Mapping[str, Any], robot: str | None = None) -> Figure:
    """The demonstrators among the expert's elites (Fig. 4).

    ``expert`` is an archive as in ``heatmap`` with ``measures`` (n, k) and ``true_return`` (n,); ``demos`` has
    ``elite_measures`` (d, k) of the demonstrators, as the demonstrations file does. Raises ValueError without them.
    """
    if "elite_measures" not in demos:
        raise ValueError("these demonstrations have no elite_measures: their elites' places are not known.")
    points = np.asarray(expert["measures"])
    pool = top_fifth(np.asarray(expert["true_return"]), int(np.prod(expert["cells"])))
    groups = [
        (points, GREEN, "o", 22, f"expert's archive ({len(points)})"),
        (points[pool], BLUE, "s", 26, f"best fifth of the cells, by return ({len(pool)})"),
        (np.asarray(demos["elite_measures"]), RED, "*", 230, f"demonstrators ({len(demos['elite_measures'])})"),
    ]
    k = points.shape[1]
    figure, [space] = measure_panels(1, k, robot, size=(4.4, 3.9), margin=(2.6, 0.0) if k == 2 else (0.6, 1.1))
    for places, colour, marker, area, text in groups:
        scatter(space, places, s=area, c=colour, marker=marker, edgecolors="white", linewidths=0.5, label=text)
    handles, labels = next(iter(space.values())).get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper" if k == 2 else "outside lower center")
    return figure
