"""The measure space on axes, for any number k of measures (1 to 6): names of the feet, panels and points.

One measure is a strip, two are a square, and more are a triangle of squares, one for every pair of measures.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure

from qdil.robots import register

Plane: TypeAlias = tuple[int, ...]  # the measures, counted from 0, along x and y; of one measure only x
Space: TypeAlias = dict[Plane, Axes]  # the axes of one measure space: one for every plane

STRIP = 0.16  # height of a strip, in units of its measure
STRIP_SIZE = (6.5, 1.55)  # inches
SMALL = 2.1  # inches across one square of a triangle
WIDEST = 13.0  # inches, of a row of triangles


def planes(k: int) -> list[Plane]:
    """The planes that show k measures: (0,) of one measure, otherwise every pair (i, j), i < j, row by row of j."""
    return [(0,)] if k == 1 else [(i, j) for j in range(1, k) for i in range(j)]


def measure_panels(
    count: int,
    k: int,
    robot: str | None,
    size: tuple[float, float],
    margin: tuple[float, float],
    in_a_row: int = 4,
    columns: int | None = None,
) -> tuple[Figure, list[Space]]:
    """A figure with ``count`` measure spaces of k measures, and the axes of each.

    ``size`` is the width and height in inches of a space of two measures; strips and triangles have their own sizes.
    ``in_a_row`` is the most of them side by side, and ``columns`` sets their number. ``margin`` is added to the
    figure's width and height for legends and colour bars (to the height alone for strips). Only the outer axes have
    labels. Raises ValueError for a ``count`` of 0.
    """
    if count < 1:
        raise ValueError("there is nothing to draw.")
    (width, height), most = _size(k, size, in_a_row)
    columns = columns or math.ceil(count / math.ceil(count / most))
    rows = math.ceil(count / columns)
    beside = margin[0] if k > 1 else 0.0  # a wider strip is also higher, which leaves no room for its title
    figure = Figure(figsize=(width * columns + beside, height * rows + margin[1]))
    squares = max(1, k - 1)  # of a triangle, in each direction
    grid = figure.subplots(rows * squares, columns * squares, squeeze=False)
    spaces = []
    for number in range(count):
        top, left = squares * (number // columns), squares * (number % columns)
        block = grid[top : top + squares, left : left + squares]
        space = {plane: block[max(0, plane[-1] - 1), plane[0]] for plane in planes(k)}
        _label_outer(space, k, robot, is_left=left == 0, is_lowest=number + columns >= count)
        spaces.append(space)
    _remove_unused(grid, spaces)
    return figure, spaces


def _size(k: int, size: tuple[float, float], in_a_row: int) -> tuple[tuple[float, float], int]:
    """Width and height in inches of a space of k measures, and how many fit side by side."""
    if k == 1:
        return STRIP_SIZE, 1
    if k == 2:
        return size, in_a_row
    side = SMALL * (k - 1)
    return (side, side), max(1, int(WIDEST / side))


def _remove_unused(grid: np.ndarray, spaces: Sequence[Space]) -> None:
    used = {ax for space in spaces for ax in space.values()}
    for ax in grid.flat:
        if ax not in used:
            ax.remove()


def _label_outer(space: Space, k: int, robot: str | None, is_left: bool, is_lowest: bool) -> None:
    """Label a space's axes: a triangle on its left and below, others only in the figure's first column or last row."""
    for plane, ax in space.items():
        label_measures(ax, robot, k, plane)
        if k > 2:
            is_left, is_lowest = plane[0] == 0, plane[1] == k - 1
            ax.tick_params(labelleft=is_left, labelbottom=is_lowest)
        if not is_left:
            ax.set_ylabel("")
        if not is_lowest:
            ax.set_xlabel("")


def set_title(space: Space, text: str) -> None:
    """Write ``text`` above a measure space."""
    first = next(iter(space.values()))
    first.set_title(text, loc="left" if len(space) > 1 else "center")


def on_plane(points: Any, plane: Plane) -> np.ndarray:
    """x and y (n, 2) of ``points`` (n, k) on a plane; points of one measure lie in the middle of the strip."""
    points = np.asarray(points, float)
    if len(plane) == 1:
        return np.column_stack([points[:, plane[0]], np.full(len(points), STRIP / 2)])
    return points[:, list(plane)]


def scatter(space: Mapping[Plane, Axes], points: Any, **style: Any) -> list[PathCollection]:
    """Draw ``points`` (n, k) on every plane of a measure space; ``style`` as in ``Axes.scatter``.

    Points are not clipped: a robot that never lifts a foot lies on the border.
    """
    return [ax.scatter(*on_plane(points, plane).T, **{"clip_on": False, **style}) for plane, ax in space.items()]


def foot_names(robot: str | None, k: int) -> list[str]:
    """The simulator's names of a robot's k feet; "foot 1", "foot 2", … if ``robot`` is None or not registered here."""
    names = register.find(robot).measure_names if robot in register.robot_names() else ()
    escaped = [name.replace("$", r"\$") for name in names]  # a $ would begin a formula
    return escaped if len(escaped) == k else [f"foot {i + 1}" for i in range(k)]


def measure_labels(robot: str | None = None, k: int = 2) -> list[str]:
    """Axis labels of k measures, with the names of the feet of ``robot`` if one is given."""
    numbered = [f"foot {i + 1}" for i in range(k)]
    named = [n if n == name else f"{n} ({name})" for n, name in zip(numbered, foot_names(robot, k), strict=True)]
    if k == 1:
        return [f"share of time {named[0]} touches the ground"]
    if k == 2:
        return [f"share of time {foot}\ntouches the ground" for foot in named]
    return ["share of time down:\n" + foot.replace(" (", "\n(") for foot in named]


def label_measures(ax: Axes, robot: str | None = None, k: int = 2, plane: Plane = (0, 1)) -> None:
    """Label the axes of a plane of k measures, and limit them to 0 to 1; the strip of one measure has no y axis."""
    labels = measure_labels(robot, k)
    size = "medium" if k <= 2 else "small"
    ax.set_xlabel(labels[plane[0]], size=size)
    ax.set(xlim=(0, 1), ylim=(0, 1), aspect="equal")
    if len(plane) == 1:
        ax.set(ylim=(0, STRIP), yticks=[])
    else:
        ax.set_ylabel(labels[plane[1]], size=size)
    ax.spines[:].set_visible(True)
