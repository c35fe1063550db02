"""Robots from the side (Fig. 9), drawn from the shapes with which the simulator finds contacts."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from qdil.plotting.colours import FEET
from qdil.plotting.style import styled

if TYPE_CHECKING:  # it brings the simulator and JAX
    from qdil.robots.shapes import Pose, Shapes

BODY = "0.55"
ROUND = np.linspace(0, np.pi, 20)  # angles along a capsule's half circles, radians


@styled
def robots(names: Sequence[str]) -> Figure:
    """A panel per robot, each in the pose that its episodes begin in, all on one scale; feet in colour."""
    from qdil.robots.shapes import first_pose, shapes

    figure = Figure(figsize=(3.6 * len(names), 3.4))
    axes = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for ax, name in zip(axes, names, strict=True):
        robot(ax, shapes(name), first_pose(name))
        ax.grid(False)
        ax.set(title=name, xlabel="forward (m)", xlim=(-1.0, 1.0), ylim=(-0.15, 1.85))
    axes[0].set_ylabel("up (m)")
    return figure


def robot(ax: Axes, body: "Shapes", pose: "Pose") -> None:
    """Draw a robot from its right side on ``ax``, the parts nearest the viewer last; metres on both axes."""
    from qdil.robots.shapes import placed

    ends = placed(body, pose)
    for i in np.argsort(-ends[:, :, 1].mean(axis=1), kind="stable"):  # y points to the robot's left, away from us
        colour = BODY if body.foot[i] < 0 else FEET[body.foot[i]]
        ax.add_patch(_capsule(ends[i][:, [0, 2]], body.radius[i], colour))
    ax.axhspan(-10, 0, color="0.93", zorder=0)
    ax.axhline(0, color="0.5", lw=1, zorder=0)
    ax.set_aspect("equal")


def _capsule(ends: np.ndarray, radius: float, colour: str) -> PathPatch:
    """The outline of a capsule between two ends (2, 2); a circle if both ends are one point."""
    angle = np.arctan2(*(ends[1] - ends[0])[::-1])
    half = np.stack([np.cos(ROUND - np.pi / 2 + angle), np.sin(ROUND - np.pi / 2 + angle)], axis=1)
    outline = np.concatenate([ends[1] + radius * half, ends[0] - radius * half])
    edge = tuple(0.6 * np.array(to_rgb(colour)))
    return PathPatch(Path(outline, closed=False), fc=colour, ec=edge, lw=0.8, joinstyle="round")
