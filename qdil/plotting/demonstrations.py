"""Demonstrations in pictures: how demonstrators are chosen (section 5.2), and when their feet touch the ground."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from qdil.imitation.demos import farthest_points, top_fifth
from qdil.plotting.robots import FEET
from qdil.plotting.style import GREEN, RED, label_measures
from qdil.robots import register


def selection(expert: Mapping[str, Any], count: int, robot: str | None = None) -> Figure:
    """How ``count`` demonstrators are chosen, one panel a step: the best fifth, then always the farthest.

    ``expert`` is an archive with ``true_return`` (n,), ``measures`` (n, 2) and ``cells`` (2,). A point's colour is its
    distance from the nearest demonstrator so far; a ring marks the farthest, which comes next. Raises ValueError for
    fewer elites than demonstrators.
    """
    points = np.asarray(expert["measures"])
    pool = points[top_fifth(np.asarray(expert["true_return"]), int(np.prod(expert["cells"])))]
    chosen = pool[farthest_points(pool, count)]
    figure = Figure(figsize=(3.3 * count + 0.8, 3.6 if count > 1 else 4.2), layout="constrained")
    axes = figure.subplots(1, count, squeeze=False)[0]
    axes[0].scatter(*points.T, s=14, c="0.8", label=f"the other elites ({len(points) - len(pool)})")
    axes[0].scatter(*pool.T, s=14, c=GREEN, label=f"best fifth of the cells ({len(pool)})")
    axes[0].scatter(*chosen[0], s=190, c=RED, marker="*", ec="white", label="1: the best of all")
    scale = Normalize(0, max(_distances(pool, chosen[:1]).max(), 1e-9))
    for step, ax in enumerate(axes[1:], start=1):
        near = _distances(pool, chosen[:step])
        ax.scatter(*pool.T, s=14, c=near, cmap="viridis", norm=scale)
        ax.scatter(*chosen[:step].T, s=190, c=RED, marker="*", ec="white")
        ax.scatter(*chosen[step], s=190, facecolors="none", ec=RED, lw=1.6)
        ax.set_title(f"number {step + 1}: {near.max():.2f} away", fontsize=10)
    if count > 1:
        bar = figure.colorbar(ScalarMappable(scale, "viridis"), ax=list(axes[1:]), shrink=0.75, pad=0.02)
        bar.set_label("distance to the nearest\ndemonstrator so far")
    for ax in axes:
        label_measures(ax, robot)
        for drawn in ax.collections:
            drawn.set_clip_on(False)  # a robot that never lifts a foot stands on the border
    for ax in axes[1:]:
        ax.set_ylabel("")
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=3 if count > 1 else 1, frameon=False
    )
    return figure


def _distances(points: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """How far each of ``points`` (n, 2) is from the nearest of ``chosen`` (c, 2)."""
    return np.linalg.norm(points[:, None] - chosen[None], axis=-1).min(axis=1)


def contact_strips(
    demos: Mapping[str, Any], step_seconds: float, robot: str | None = None, longest: int = 300
) -> Figure:
    """When either foot touches the ground, a strip per demonstration: a gait diagram of its first ``longest`` steps.

    ``demos`` has a row per step: ``proxy`` (N, 2), ``episode`` (N,); and ``episode_return`` and ``episode_measures``.
    """
    episodes = np.unique(demos["episode"])
    figure = Figure(figsize=(10, 0.5 + 0.95 * len(episodes)), layout="constrained")
    axes = figure.subplots(len(episodes), 1, sharex=True, squeeze=False)[:, 0]
    for number, ax in zip(episodes, axes, strict=True):
        proxy = np.asarray(demos["proxy"])[np.asarray(demos["episode"]) == number]
        contacts(ax, proxy[:longest], step_seconds)
        first, second = demos["episode_measures"][number]
        said = f"return {demos['episode_return'][number]:,.0f} in {len(proxy)} steps"
        ax.set_title(f"demonstration {number + 1}: {said}; m = ({first:.2f}, {second:.2f})", fontsize=9, loc="left")
    for ax in axes:
        ax.set_yticks([0.5, 1.5], foot_names(robot))
    axes[-1].set_xlabel("time (s); coloured where the foot touches the ground")
    return figure


def foot_names(robot: str | None) -> list[str]:
    """What the two feet are called, foot 1 first; the simulator's names where a robot is given."""
    return list(register.find(robot).measure_names) if robot else ["foot 1", "foot 2"]


def contacts(ax: Axes, proxy: np.ndarray, step_seconds: float) -> None:
    """Spans of ground contact of two feet, ``proxy`` (T, 2), over time: foot 1 below, foot 2 above."""
    for foot, colour in enumerate(FEET):
        ax.broken_barh(spans(proxy[:, foot], step_seconds), (foot + 0.08, 0.84), color=colour, lw=0)
    ax.set(xlim=(0, max(len(proxy), 1) * step_seconds), ylim=(0, 2))
    ax.spines[["top", "right"]].set_visible(False)


def spans(down: np.ndarray, step_seconds: float) -> list[tuple[float, float]]:
    """Where a row of 0 and 1 (T,) is 1: the beginning and the length of each stretch, in seconds."""
    change = np.diff(np.concatenate([[0.0], np.asarray(down, float), [0.0]]))
    begin, end = np.flatnonzero(change > 0), np.flatnonzero(change < 0)
    return [(float(a) * step_seconds, float(b - a) * step_seconds) for a, b in zip(begin, end, strict=True)]
