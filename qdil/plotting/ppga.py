"""One iteration of PPGA: proxies, trained copies, candidates, ranking, xNES and the walk, for k measures."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator

from qdil.plotting.archives import one_archive
from qdil.plotting.colours import BLACK, BLUE, FEET, GREEN, RED
from qdil.plotting.demonstrations import contacts
from qdil.plotting.measures import Plane, foot_names, label_measures, on_plane, planes
from qdil.plotting.style import styled

DASHES = ("-", "--", "-.", ":", (0, (5, 1.5, 1, 1.5)), (0, (8, 2)), (0, (1, 2.5)))  # of c_0, c_1, …
DIVERGING = "PuOr"  # for numbers with a sign; its ends differ to every kind of colour vision

Gaussian: TypeAlias = tuple[np.ndarray, np.ndarray]  # mean (d,) and covariance (d, d)


@styled
def proxies(proxy: np.ndarray, step_seconds: float, robot: str | None = None) -> Figure:
    """An episode's δ(s_t) (T, k) over time, and their running means, which end at the episode's measures."""
    k = proxy.shape[1]
    figure = Figure(figsize=(10, 2.4 + 0.5 * k))
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(k, 3.2))
    contacts(above, proxy, step_seconds, [f"$\\delta_{foot + 1}(s_t)$" for foot in range(k)])
    above.set_title("coloured: δ = 1, the foot touches the ground", fontsize=9, loc="left")
    time = step_seconds * np.arange(1, len(proxy) + 1)
    so_far = np.cumsum(proxy, axis=0) / np.arange(1, len(proxy) + 1)[:, None]
    for foot, name in enumerate(foot_names(robot, k)):
        text = f"{name}: $m_{foot + 1}$ = {so_far[-1, foot]:.2f}"
        below.plot(time, so_far[:, foot], color=FEET[foot], label=text)
        below.plot(time[-1], so_far[-1, foot], "o", color=FEET[foot], clip_on=False)
    below.set(xlabel="time (s)", ylabel="mean of δ so far", ylim=(-0.02, 1.02))
    below.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


@styled
def objectives(compared: pd.DataFrame) -> Figure:
    """The effect of training each copy on its own objective, a panel per objective, from ``dissect.compare``.

    Row 0 of ``compared`` is θ_μ, row i the copy trained on objective i. The copy that was trained on a panel's
    objective is filled. Whiskers are ± one standard error over repetitions.
    """
    names = list(dict.fromkeys(compared.columns.get_level_values(0)))
    figure = Figure(figsize=(3.9 * len(names), 3.2))
    axes = figure.subplots(1, len(names), squeeze=False)[0]
    rows = np.arange(len(compared))
    for i, (ax, objective) in enumerate(zip(axes, names, strict=True)):
        mean, error = compared[objective, "mean"].to_numpy(), np.nan_to_num(compared[objective, "error"].to_numpy())
        ax.axhline(mean[0], color="0.6", ls=":", lw=1)
        for row in rows:
            fill = RED if row == i + 1 else "white"
            ax.errorbar(row, mean[row], error[row], fmt="o", ms=8, color=RED, mfc=fill, ecolor="0.4")
        ax.set_xticks(rows, list(compared.index), rotation=20)
        ax.set(title=objective if i == 0 else f"share of time {objective}", xlim=(-0.5, len(compared) - 0.5))
    axes[0].set_ylabel("mean over whole episodes")
    return figure


@styled
def candidates(
    measures: np.ndarray, coefficients: np.ndarray, centre: Sequence[float], robot: str | None = None
) -> Figure:
    """One iteration's candidates in measure space (λ, k), a panel per coefficient (λ, 1+k).

    A star is θ_μ at ``centre``. The first panel's colour is |c_0|, the weight of the fitness gradient. If there are
    more than two measures, the panel of c_j shows measure j and the next one.
    """
    k = measures.shape[1]
    values = np.column_stack([np.abs(coefficients[:, 0]), coefficients[:, 1:]])
    names = ["$|c_0|$, weight of $\\nabla f$", *(f"$c_{j}$, weight of $\\nabla m_{j}$" for j in range(1, k + 1))]
    columns = min(3, k + 1)
    rows = math.ceil((k + 1) / columns)
    figure = Figure(figsize=(13, (3.7 if k > 1 else 2.2) * rows))
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    for spare in axes[k + 1 :]:
        spare.remove()
    for j, (ax, name) in enumerate(zip(axes, names, strict=False)):
        plane = _plane_of_coefficient(j, k)
        limit = max(np.abs(values[:, j]).max(), 1e-9)
        low, colours = (0.0, "viridis") if j == 0 else (-limit, DIVERGING)
        points = on_plane(measures, plane).T
        drawn = ax.scatter(*points, c=values[:, j], cmap=colours, vmin=low, vmax=limit, s=26, ec="0.4", lw=0.4)
        ax.plot(*on_plane([centre], plane)[0], "*", ms=17, mfc="white", mec="black")
        place = {"location": "bottom", "shrink": 0.9} if k == 1 else {"shrink": 0.85}
        figure.colorbar(drawn, ax=ax, **place).set_label(name)
        label_measures(ax, robot, k, plane)
        if k == 2 and j:
            ax.set_ylabel("")
    return figure


def _plane_of_coefficient(j: int, k: int) -> Plane:
    """The plane of k measures in which the panel of c_j shows candidates: of measure j and the next, in order."""
    if j == 0 or k == 1:
        return planes(k)[0]
    first, second = sorted((j - 1, j % k))
    return first, second


@styled
def ranking(improvement: np.ndarray, utilities: np.ndarray) -> Figure:
    """Candidates by archive improvement Δ (λ,), best first, and the weight (λ,) that xNES gives to each."""
    order = np.argsort(-improvement, kind="stable")
    rank = np.arange(1, len(order) + 1)
    figure = Figure(figsize=(10, 2.8))
    left, right = figure.subplots(1, 2)
    left.bar(rank, improvement[order], color=GREEN, width=1.0, ec="white", lw=0.3)
    left.set(xlabel="rank", ylabel="Δ (return units)", title="archive improvement of each candidate")
    right.bar(rank, utilities[order], color=np.where(utilities[order] > 0, BLUE, RED), width=1.0, ec="white", lw=0.3)
    right.axhline(0, color="0.4", lw=0.8)
    right.set(xlabel="rank", ylabel="utility", title="weight that xNES gives to each (the sum is zero)")
    return figure


@styled
def search_distribution(before: Gaussian, after: Gaussian, coefficients: np.ndarray, utilities: np.ndarray) -> Figure:
    """xNES before and after its update on one iteration's samples (λ, 1+k), a panel for c_0 and c_1, c_1 and c_2, ….

    Ellipses are one and two standard deviations. A sample is filled if its utility is positive. Fitness has the
    weight |c_0|, so c_0 and -c_0 mean the same.
    """
    k = coefficients.shape[1] - 1
    figure = Figure(figsize=(1.9 + 3.8 * k, 4.0))
    axes = figure.subplots(1, k, squeeze=False)[0]
    good = utilities > 0
    for i, ax in enumerate(axes):
        pair = (i, i + 1)
        low, high = coefficients[~good][:, pair].T, coefficients[good][:, pair].T
        ax.scatter(*low, s=16, facecolors="none", ec="0.6", label="ranked low")
        ax.scatter(*high, s=20, c=GREEN, label="ranked high")
        _ellipses(ax, before, pair, "0.35", "--", "before")
        _ellipses(ax, after, pair, RED, "-", "after")
        ax.set(xlabel=f"$c_{pair[0]}$", ylabel=f"$c_{pair[1]}$")
        ax.set_aspect("equal", adjustable="datalim")
        ax.autoscale_view()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
    return figure


def _ellipses(ax: Axes, gaussian: Gaussian, pair: tuple[int, int], colour: str, dash: str, name: str) -> None:
    """A Gaussian's ellipses of one and two standard deviations in the plane of two coefficients, and its mean."""
    mean, covariance = gaussian[0][list(pair)], gaussian[1][np.ix_(pair, pair)]
    sizes, axes = np.linalg.eigh(covariance)
    angle = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
    for deviations in (1, 2):
        width, height = 2 * deviations * np.sqrt(sizes[::-1])
        ax.add_patch(Ellipse((mean[0], mean[1]), width, height, angle=angle, fc="none", ec=colour, ls=dash, lw=1.4))
    ax.plot(*mean, "+", ms=11, mew=2, color=colour, label=name)


@styled
def coefficients_over(metrics: pd.DataFrame) -> Figure:
    """The walk's weights c_μ over QD iterations, from a run's ``metrics.csv``; ticks below mark restarts.

    Every column c0, c1, …, ck of ``metrics`` is a line.
    """
    figure = Figure(figsize=(10, 3.0))
    ax = figure.subplots()
    for j in range(len(coefficient_columns(metrics))):
        text = "$|c_{\\mu,0}|$ (fitness)" if j == 0 else f"$c_{{\\mu,{j}}}$ (foot {j})"
        colour = BLACK if j == 0 else FEET[j - 1]
        ax.plot(metrics["iteration"], metrics[f"c{j}"], color=colour, ls=DASHES[j], lw=1.2, label=text)
    restarted = metrics["restarts"].diff().fillna(metrics["restarts"]) > 0
    at = metrics["iteration"][restarted]
    ax.plot(at, np.zeros(len(at)), "|", ms=14, mew=1.2, color="0.5", transform=ax.get_xaxis_transform(), clip_on=False)
    ax.axhline(0, color="0.7", lw=0.8)
    ax.set(xlabel=f"QD iteration (grey ticks: {int(restarted.sum())} restarts)", ylabel="weight in the walk's reward")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


def coefficient_columns(metrics: pd.DataFrame) -> list[str]:
    """The columns c0, c1, …, ck of a run's ``metrics.csv``, in order."""
    names = [name for name in metrics if name[0] == "c" and name[1:].isdigit()]
    return sorted(names, key=lambda name: int(name[1:]))


@styled
def path(followed: pd.DataFrame, archive: Mapping[str, Any], robot: str | None = None) -> Figure:
    """The path of θ_μ over its archive, an arrow per iteration.

    ``followed`` has a row per iteration, with columns m1, …, mk and restart; ``archive`` is as in ``heatmap``. A solid
    arrow is a walk, a dashed arrow a restart at an elite. Arrows bend if there is only one measure.
    """
    k = len(archive["cells"])
    figure, space = one_archive(archive, "the search policy's path (from the ring on)", robot=robot)
    measures = followed[[f"m{j + 1}" for j in range(k)]].to_numpy(float)
    for plane, ax in space.items():
        points = on_plane(measures, plane)
        for begin, end, restart in zip(points, points[1:], followed["restart"][1:], strict=False):
            arrow = {"arrowstyle": "->", "color": RED, "lw": 1.8, "ls": "--" if restart else "-"}
            bend = "arc3,rad=-0.2" if k == 1 else "arc3"
            style = {**arrow, "shrinkA": 0, "shrinkB": 0, "connectionstyle": bend}
            ax.annotate("", tuple(end), tuple(begin), arrowprops=style)
        ax.plot(*points[0], "o", ms=9, mfc="white", mec=RED, mew=2)
    return figure
