"""What stands in for the explorer where nothing can move: the heatmap, and moments of one robot's episode."""

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from PIL import Image

from qdil.explorer import film
from qdil.explorer import shown as showing
from qdil.explorer.rollouts import Rollout
from qdil.explorer.shown import Shown
from qdil.plotting import heatmap, to_png
from qdil.plotting.colours import RED

WIDTH, HEIGHT, DPI = 11.8, 6.6, 100  # inches and dots: the size of the frame that lies over it
MOMENTS = 3
SKETCH, SKETCH_COLOURS = 4.6, 200  # inches across; few colours make a small file
FEET = ("#e69f00", "#56b4e9")  # as in the front end


def picture(runs: Sequence[Shown], state: dict[str, Any]) -> bytes:
    """A PNG of ``state``: the run's heatmap with the chosen cell marked and, where it can walk, its robot and gait."""
    shown = runs[state["run"]]
    figure = Figure(figsize=(WIDTH, HEIGHT), dpi=DPI, layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=[5, 7], squeeze=False)[0]
    ax = _map(shown, left)
    index = np.asarray(shown.archive["index"])
    cells = [cell for run, cell in state["selected"] if run == state["run"] and cell in index]
    if not cells or not shown.plays:
        right.text(0.5, 0.5, shown.why or "no cell chosen", ha="center")
        return to_png(figure)
    row = int(np.flatnonzero(index == cells[0])[0])
    x, y = shown.archive["measures"][row]
    ax.scatter(x, y, marker="s", s=110, facecolors="none", edgecolors="black", linewidths=2)
    rollout = showing.roll_out(shown, cells[:1])[0]
    axes = right.subplot_mosaic([list(range(MOMENTS)), ["gait"] * MOMENTS], height_ratios=[3, 1])
    _moments(shown, rollout, [axes[i] for i in range(MOMENTS)])
    _gait(shown, rollout, axes["gait"])
    returned = float(shown.archive["true_return"][row])
    right.suptitle(f"The chosen cell's robot: return {returned:.0f}. Run this notebook to click other cells.", size=10)
    return to_png(figure)


def sketch(runs: Sequence[Shown], state: dict[str, Any]) -> bytes:
    """A small PNG of the map alone, in few colours: drawn in a moment, since no robot has to be simulated for it."""
    figure = Figure(figsize=(SKETCH, 1.36 * SKETCH), dpi=DPI, layout="constrained")
    _map(runs[state["run"]], figure)
    figure.supxlabel("Run this notebook to click cells and see their robots walk.", size=9)
    buffer = io.BytesIO()
    with Image.open(io.BytesIO(to_png(figure))) as drawn:
        drawn.convert("RGB").quantize(SKETCH_COLOURS, Image.Quantize.FASTOCTREE).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _map(shown: Shown, figure: Figure | SubFigure) -> Axes:
    """The archive's heatmap, with its demonstrators and its colour bar."""
    ax = figure.subplots()
    mesh = heatmap(shown.archive, ax, robot=shown.config["env"] if shown.config else None, colour_bar=False)
    bar = figure.colorbar(mesh, ax=ax, location="bottom", shrink=0.9)
    bar.set_label("true return per episode (reward units)\ngrey: empty cell")
    ax.set_title(shown.name)
    if len(shown.demonstrators):
        x, y = np.transpose(shown.demonstrators)
        ax.scatter(x, y, marker="*", s=150, c=RED, edgecolors="white", clip_on=False)
    return ax


def _moments(shown: Shown, rollout: Rollout, axes: list[Axes]) -> None:
    """The robot at moments of half a second in the middle of its episode."""
    steps = len(rollout.reward)
    taken = min(steps, max(MOMENTS, int(0.5 / rollout.seconds)))
    for ax, step in zip(axes, np.linspace((steps - taken) // 2, (steps + taken) // 2 - 1, MOMENTS), strict=True):
        ax.imshow(film.still(shown, rollout, int(step), 220, 340))
        ax.set_title(f"{step * rollout.seconds:.2f} s", size=9)
        ax.set_axis_off()


def _gait(shown: Shown, rollout: Rollout, ax: Axes) -> None:
    """When each foot is on the ground."""
    assert shown.config is not None
    about = showing.robot(shown.config["env"])
    for foot, colour in enumerate(FEET):
        starts = np.flatnonzero(rollout.contact[:, foot])
        spans = [(step * rollout.seconds, rollout.seconds) for step in starts]
        ax.broken_barh(spans, (-foot - 0.4, 0.8), color=colour)
    ax.set(yticks=[0, -1], yticklabels=about["feet"], xlabel="time (s); coloured: the foot touches the ground")
    ax.set_xlim(0, len(rollout.reward) * rollout.seconds)
