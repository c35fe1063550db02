"""Demonstrations: how demonstrators are chosen (section 5.2), and when each foot touches the ground."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from qdil.imitation.selection import farthest_points, top_fifth
from qdil.plotting.colours import FEET, GREEN, RED
from qdil.plotting.measures import Space, foot_names, measure_panels, scatter, set_title
from qdil.plotting.style import styled

STAR = {"s": 190, "c": RED, "marker": "*", "ec": "white"}
RING = {"s": 190, "facecolors": "none", "ec": RED, "lw": 1.6}


@styled
def selection(expert: Mapping[str, Any], count: int, robot: str | None = None) -> Figure:
    """How ``count`` demonstrators are chosen, a panel per step: the best elite, then always the farthest point.

    ``expert`` is an archive with ``true_return`` (n,), ``measures`` (n, k) and ``cells`` (k,). The best fifth of the
    cells is the pool; a point's colour is its distance to the nearest demonstrator so far, and the ring marks the
    farthest point, which is chosen next. Raises ValueError for fewer elites than demonstrators.
    """
    points = np.asarray(expert["measures"])
    pool = points[top_fifth(np.asarray(expert["true_return"]), int(np.prod(expert["cells"])))]
    chosen = pool[farthest_points(pool, count)]
    k = points.shape[1]
    size, margin = (3.3, 3.6 if count > 1 else 4.2), (0.8, 0.0) if k > 1 else (0.0, 1.5)
    figure, spaces = measure_panels(count, k, robot, size, margin, in_a_row=count)
    scatter(spaces[0], points, s=14, c="0.8", label=f"the other elites ({len(points) - len(pool)})")
    scatter(spaces[0], pool, s=14, c=GREEN, label=f"best fifth of the cells ({len(pool)})")
    scatter(spaces[0], chosen[:1], **STAR, label="1: the best of all")
    if count > 1:
        _farthest(figure, spaces[1:], pool, chosen)
    legend = next(iter(spaces[0].values())).get_legend_handles_labels()
    figure.legend(*legend, loc="outside upper left", ncols=3 if count > 1 else 1)
    return figure


def _farthest(figure: Figure, spaces: list[Space], pool: np.ndarray, chosen: np.ndarray) -> None:
    """The steps after the first, which is ``chosen[0]``: distances to the demonstrators so far, and the farthest."""
    scale = Normalize(0, max(_distances(pool, chosen[:1]).max(), 1e-9))
    for step, space in enumerate(spaces, start=1):
        near = _distances(pool, chosen[:step])
        scatter(space, pool, s=14, c=near, cmap="viridis", norm=scale)
        scatter(space, chosen[:step], **STAR)
        scatter(space, chosen[step : step + 1], **RING)
        set_title(space, f"number {step + 1}: {near.max():.2f} away")
    axes = [ax for space in spaces for ax in space.values()]
    place = {"location": "bottom", "aspect": 40} if chosen.shape[1] == 1 else {"pad": 0.02}
    bar = figure.colorbar(ScalarMappable(scale, "viridis"), ax=axes, shrink=0.75, **place)
    bar.set_label("distance to the nearest\ndemonstrator so far")


def _distances(points: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """The distance of each of ``points`` (n, k) to the nearest of ``chosen`` (c, k)."""
    return np.linalg.norm(points[:, None] - chosen[None], axis=-1).min(axis=1)


@styled
def contact_strips(
    demos: Mapping[str, Any], step_seconds: float, robot: str | None = None, longest: int = 300
) -> Figure:
    """When each foot touches the ground, a gait diagram per demonstration of at most its first ``longest`` steps.

    ``demos`` has a row per step, ``proxy`` (N, k) and ``episode`` (N,), and per episode ``episode_return`` and
    ``episode_measures`` (d, k).
    """
    proxy, episode = np.asarray(demos["proxy"]), np.asarray(demos["episode"])
    episodes, k = np.unique(episode), proxy.shape[1]
    figure = Figure(figsize=(10, 0.5 + (0.35 + 0.3 * k) * len(episodes)))
    axes = figure.subplots(len(episodes), 1, sharex=True, squeeze=False)[:, 0]
    for number, ax in zip(episodes, axes, strict=True):
        contacts(ax, proxy[episode == number][:longest], step_seconds, foot_names(robot, k))
        measures = ", ".join(f"{m:.2f}" for m in demos["episode_measures"][number])
        summary = f"return {demos['episode_return'][number]:,.0f} in {np.sum(episode == number)} steps"
        text = f"demonstration {number + 1}: {summary}; m = ({measures})"
        ax.set_title(text, fontsize=9, loc="left")
    axes[-1].set_xlabel("time (s); coloured where the foot touches the ground")
    return figure


def contacts(ax: Axes, proxy: np.ndarray, step_seconds: float, names: list[str]) -> None:
    """Spans of ground contact of k feet, ``proxy`` (T, k), over time in seconds: a row per foot, foot 1 lowest."""
    k = proxy.shape[1]
    for foot in range(k):
        ax.broken_barh(spans(proxy[:, foot], step_seconds), (foot + 0.08, 0.84), color=FEET[foot], lw=0)
    ax.set(xlim=(0, max(len(proxy), 1) * step_seconds), ylim=(0, k))
    ax.set_yticks(np.arange(k) + 0.5, names)
    ax.yaxis.grid(False)


def spans(down: np.ndarray, step_seconds: float) -> list[tuple[float, float]]:
    """The stretches in which ``down`` (T,) of 0 and 1 is 1: the beginning and the length of each, in seconds."""
    change = np.diff(np.concatenate([[0.0], np.asarray(down, float), [0.0]]))
    begin, end = np.flatnonzero(change > 0), np.flatnonzero(change < 0)
    return [(float(a) * step_seconds, float(b - a) * step_seconds) for a, b in zip(begin, end, strict=True)]
