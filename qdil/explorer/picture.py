"""The still picture of the explorer for places without scripts: the map, and moments of one robot's episode."""

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from PIL import Image

from qdil.explorer import drawing, film
from qdil.explorer import shown as showing
from qdil.explorer.rollouts import Rollout
from qdil.explorer.shown import Shown
from qdil.plotting import heatmap, to_png
from qdil.plotting.colours import RED
from qdil.plotting.measures import STRIP

WIDTH, HEIGHT, DPI = 11.8, 6.6, 100  # inches, inches, dots per inch: the size of the live frame over the picture
MOMENTS = 3
SKETCH, SKETCH_COLOURS = 4.6, 200  # inches across; few colours keep the file small


def picture(runs: Sequence[Shown], state: dict[str, Any]) -> bytes:
    """A PNG of ``state``: the run's map with the chosen cell marked and, if its robot can be shown, robot and gait."""
    shown = runs[state["run"]]
    figure = Figure(figsize=(WIDTH, HEIGHT), dpi=DPI, layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=[5, 7], squeeze=False)[0]
    axes_shown = state["axes"]
    ax = _map(shown, axes_shown, left)
    index = np.asarray(shown.archive["index"])
    cells = [cell for run, cell in state["selected"] if run == state["run"] and cell in index]
    if not cells or not shown.plays:
        right.text(0.5, 0.5, shown.why or "no cell chosen", ha="center")
        return to_png(figure)
    row = int(np.flatnonzero(index == cells[0])[0])
    measures = np.asarray(shown.archive["measures"])[[row]]
    _scatter(ax, measures, axes_shown, marker="s", s=110, fc="none", ec="black", lw=2)
    rollout = showing.roll_out(shown, cells[:1])[0]
    axes = right.subplot_mosaic([list(range(MOMENTS)), ["gait"] * MOMENTS], height_ratios=[3, 1])
    _moments(shown, rollout, [axes[i] for i in range(MOMENTS)])
    _gait(shown, rollout, axes["gait"])
    returned = float(shown.archive["true_return"][row])
    right.suptitle(f"The chosen cell's robot: return {returned:.0f}. Run this notebook to click other cells.", size=10)
    return to_png(figure)


def sketch(runs: Sequence[Shown], state: dict[str, Any]) -> bytes:
    """A small PNG of the map alone, in few colours. It is quick to make: no robot is simulated."""
    height = 1.36 if len(state["axes"]) > 1 else 0.66  # in widths: a square, or a strip
    figure = Figure(figsize=(SKETCH, height * SKETCH), dpi=DPI, layout="constrained")
    _map(runs[state["run"]], state["axes"], figure)
    figure.supxlabel("Run this notebook to click cells and see their robots walk.", size=9)
    buffer = io.BytesIO()
    with Image.open(io.BytesIO(to_png(figure))) as drawn:
        drawn.convert("RGB").quantize(SKETCH_COLOURS, Image.Quantize.FASTOCTREE).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _map(shown: Shown, axes: Sequence[int], figure: Figure | SubFigure) -> Axes:
    """The archive over one or two of its ``axes``, with its demonstrators and its colour bar."""
    ax = figure.subplots()
    env = shown.config["env"] if shown.config else None
    drawn = heatmap(shown.archive, ax, robot=env, colour_bar=False, plane=tuple(axes))
    bar = figure.colorbar(drawn, ax=ax, location="bottom", shrink=0.9)
    others = shown.k - len(axes)
    best = f"\nbest elite over the other {f'{others} feet' if others > 1 else 'foot'}" if others else ""
    bar.set_label(f"true return per episode (reward units)\ngrey: empty cell{best}")
    ax.set_title(shown.name)
    if len(shown.demonstrators):
        _scatter(ax, shown.demonstrators, axes, marker="*", s=150, c=RED, edgecolors="white", clip_on=False)
    return ax


def _scatter(ax: Axes, measures: np.ndarray, axes: Sequence[int], **style: Any) -> None:
    """Marks at ``measures`` (n, k) on the map of ``axes``; in the middle of a strip's height."""
    x = measures[:, axes[0]]
    y = measures[:, axes[1]] if len(axes) > 1 else np.full(len(x), STRIP / 2)
    ax.scatter(x, y, **style)


def _moments(shown: Shown, rollout: Rollout, axes: list[Axes]) -> None:
    """The robot at moments of half a second in the middle of its episode."""
    steps = len(rollout.reward)
    taken = min(steps, max(MOMENTS, int(0.5 / rollout.seconds)))
    for ax, step in zip(axes, np.linspace((steps - taken) // 2, (steps + taken) // 2 - 1, MOMENTS), strict=True):
        ax.imshow(film.still(shown, rollout, int(step), 220, 340))
        ax.set_title(f"{step * rollout.seconds:.2f} s", size=9)
        ax.set_axis_off()


def _gait(shown: Shown, rollout: Rollout, ax: Axes) -> None:
    """When each of the k feet is on the ground."""
    for foot in range(shown.k):
        starts = np.flatnonzero(rollout.contact[:, foot])
        spans = [(step * rollout.seconds, rollout.seconds) for step in starts]
        ax.broken_barh(spans, (-foot - 0.4, 0.8), color=drawing.FEET[foot] / 255)
    rows = [-foot for foot in range(shown.k)]
    ax.set(yticks=rows, yticklabels=shown.feet, xlabel="time (s); coloured: the foot touches the ground")
    ax.set_xlim(0, len(rollout.reward) * rollout.seconds)
