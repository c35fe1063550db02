"""An iteration of PPGA in pictures: proxies, what each copy moved, candidates, ranking, xNES, the walk."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator

from qdil.plotting.archives import heatmap
from qdil.plotting.demonstrations import contacts, foot_names
from qdil.plotting.robots import FEET
from qdil.plotting.style import BLUE, GREEN, RED, label_measures

COEFFICIENTS = {"c0": ("black", "-"), "c1": (FEET[0], "--"), "c2": (FEET[1], "-.")}
DIVERGING = "PuOr"  # for numbers with a sign; its ends differ to every kind of colour vision


def proxies(proxy: np.ndarray, step_seconds: float, robot: str | None = None) -> Figure:
    """An episode's δ(s_t) (T, 2), and their running means, which end at the episode's measures."""
    figure = Figure(figsize=(10, 3.4), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1.6))
    contacts(above, proxy, step_seconds)
    above.set_yticks([0.5, 1.5], ["$\\delta_1(s_t)$", "$\\delta_2(s_t)$"])
    above.set_title("coloured: δ = 1, the foot touches the ground", fontsize=9, loc="left")
    time = step_seconds * np.arange(1, len(proxy) + 1)
    so_far = np.cumsum(proxy, axis=0) / np.arange(1, len(proxy) + 1)[:, None]
    for foot, name in enumerate(foot_names(robot)):
        said = f"{name}: $m_{foot + 1}$ = {so_far[-1, foot]:.2f}"
        below.plot(time, so_far[:, foot], color=FEET[foot], label=said)
        below.plot(time[-1], so_far[-1, foot], "o", color=FEET[foot], clip_on=False)
    below.set(xlabel="time (s)", ylabel="mean of δ so far", ylim=(-0.02, 1.02))
    below.spines[["top", "right"]].set_visible(False)
    below.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


def streams(compared: pd.DataFrame) -> Figure:
    """What training each copy on its own stream did, a panel per objective, from ``dissect.compare``.

    Row 0 of ``compared`` is θ_μ, row i the copy trained on objective i; the copy that was paid for a panel's objective
    is filled. Whiskers are ± one standard error over repetitions.
    """
    objectives = list(dict.fromkeys(compared.columns.get_level_values(0)))
    figure = Figure(figsize=(3.9 * len(objectives), 3.2), layout="constrained")
    axes = figure.subplots(1, len(objectives), squeeze=False)[0]
    at = np.arange(len(compared))
    for i, (ax, objective) in enumerate(zip(axes, objectives, strict=True)):
        mean, error = compared[objective, "mean"].to_numpy(), np.nan_to_num(compared[objective, "error"].to_numpy())
        ax.axhline(mean[0], color="0.6", ls=":", lw=1)
        for j in at:
            fill = RED if j == i + 1 else "white"
            ax.errorbar(j, mean[j], error[j], fmt="o", ms=8, color=RED, mfc=fill, ecolor="0.4", capsize=3)
        ax.set_xticks(at, list(compared.index), rotation=20)
        ax.set(title=objective if i == 0 else f"share of time {objective}", xlim=(-0.5, len(compared) - 0.5))
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("mean over whole episodes")
    return figure


def candidates(
    measures: np.ndarray, coefficients: np.ndarray, centre: Sequence[float], robot: str | None = None
) -> Figure:
    """One iteration's candidates in measure space (λ, 2), a panel per coefficient (λ, 3); a star is θ_μ at ``centre``.

    The first panel's colour is |c_0|, the weight of the fitness gradient.
    """
    values = np.column_stack([np.abs(coefficients[:, 0]), coefficients[:, 1:]])
    names = ["$|c_0|$, weight of $\\nabla f$", "$c_1$, weight of $\\nabla m_1$", "$c_2$, weight of $\\nabla m_2$"]
    figure = Figure(figsize=(13, 3.7), layout="constrained")
    axes = figure.subplots(1, 3)
    for i, (ax, name) in enumerate(zip(axes, names, strict=True)):
        limit = max(np.abs(values[:, i]).max(), 1e-9)
        low, colours = (0.0, "viridis") if i == 0 else (-limit, DIVERGING)
        drawn = ax.scatter(*measures.T, c=values[:, i], cmap=colours, vmin=low, vmax=limit, s=26, ec="0.4", lw=0.4)
        ax.plot(*centre, "*", ms=17, mfc="white", mec="black")
        figure.colorbar(drawn, ax=ax, shrink=0.85).set_label(name)
        label_measures(ax, robot)
        ax.grid(color="0.92")
        ax.set_axisbelow(True)
        if i:
            ax.set_ylabel("")
    return figure


def ranking(improvement: np.ndarray, utilities: np.ndarray) -> Figure:
    """Candidates by archive improvement Δ (λ,), best first, and the weight (λ,) that xNES gives to each."""
    order = np.argsort(-improvement, kind="stable")
    rank = np.arange(1, len(order) + 1)
    figure = Figure(figsize=(10, 2.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.bar(rank, improvement[order], color=GREEN, width=1.0, ec="white", lw=0.3)
    left.set(xlabel="rank", ylabel="Δ (return units)", title="archive improvement of each candidate")
    right.bar(rank, utilities[order], color=np.where(utilities[order] > 0, BLUE, RED), width=1.0, ec="white", lw=0.3)
    right.axhline(0, color="0.4", lw=0.8)
    right.set(xlabel="rank", ylabel="utility", title="how much xNES makes of it (sums to zero)")
    for ax in (left, right):
        ax.spines[["top", "right"]].set_visible(False)
    return figure


Gaussian = tuple[np.ndarray, np.ndarray]  # mean (d,) and covariance (d, d)


def search_distribution(before: Gaussian, after: Gaussian, coefficients: np.ndarray, utilities: np.ndarray) -> Figure:
    """xNES before and after it saw one iteration's samples (λ, 3), as ellipses of one and two standard deviations.

    A sample is filled if its utility is positive. Fitness is weighed by |c_0|, so left and right of its 0 are alike.
    """
    figure = Figure(figsize=(9.5, 4.0), layout="constrained")
    axes = figure.subplots(1, 2)
    good = utilities > 0
    for ax, (i, j) in zip(axes, ((0, 1), (1, 2)), strict=True):
        ax.scatter(
            coefficients[~good, i], coefficients[~good, j], s=16, facecolors="none", ec="0.6", label="ranked low"
        )
        ax.scatter(coefficients[good, i], coefficients[good, j], s=20, c=GREEN, label="ranked high")
        _ellipses(ax, before, (i, j), "0.35", "--", "before")
        _ellipses(ax, after, (i, j), RED, "-", "after")
        ax.set(xlabel=f"$c_{i}$", ylabel=f"$c_{j}$")
        ax.set_aspect("equal", adjustable="datalim")
        ax.autoscale_view()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center", frameon=False)
    return figure


def _ellipses(ax: Axes, gaussian: Gaussian, plane: tuple[int, int], colour: str, dash: str, name: str) -> None:
    mean, covariance = gaussian[0][list(plane)], gaussian[1][np.ix_(plane, plane)]
    sizes, axes = np.linalg.eigh(covariance)
    turn = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
    for deviations in (1, 2):
        width, height = 2 * deviations * np.sqrt(sizes[::-1])
        ax.add_patch(Ellipse((mean[0], mean[1]), width, height, angle=turn, fc="none", ec=colour, ls=dash, lw=1.4))
    ax.plot(*mean, "+", ms=11, mew=2, color=colour, label=name)


def coefficients_over(metrics: pd.DataFrame) -> Figure:
    """The walk's weights c_μ over QD iterations, from a run's ``metrics.csv``; ticks below mark restarts."""
    figure = Figure(figsize=(10, 3.0), layout="constrained")
    ax = figure.subplots()
    for name, (colour, dash) in COEFFICIENTS.items():
        shown = "$|c_{\\mu,0}|$ (fitness)" if name == "c0" else f"$c_{{\\mu,{name[1]}}}$ (foot {name[1]})"
        ax.plot(metrics["iteration"], metrics[name], color=colour, ls=dash, lw=1.2, label=shown)
    restarted = metrics["restarts"].diff().fillna(metrics["restarts"]) > 0
    at = metrics["iteration"][restarted]
    ax.plot(at, np.zeros(len(at)), "|", ms=14, mew=1.2, color="0.5", transform=ax.get_xaxis_transform(), clip_on=False)
    ax.axhline(0, color="0.7", lw=0.8)
    ax.set(xlabel=f"QD iteration (grey ticks: {int(restarted.sum())} restarts)", ylabel="weight in the walk's reward")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


def path(followed: pd.DataFrame, archive: Mapping[str, Any], robot: str | None = None) -> Figure:
    """Where θ_μ went, iteration by iteration (columns m1, m2, restart), over the archive as it was then.

    A dashed line is a jump to an elite, not a walk.
    """
    figure = Figure(figsize=(6.4, 4.6), layout="constrained")
    ax = figure.subplots()
    heatmap(archive, ax, robot=robot)
    x, y = followed["m1"].to_numpy(), followed["m2"].to_numpy()
    for i in range(1, len(x)):
        jumped = bool(followed["restart"].iloc[i])
        arrow = {"arrowstyle": "->", "color": RED, "lw": 1.8, "ls": "--" if jumped else "-", "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", (x[i], y[i]), (x[i - 1], y[i - 1]), arrowprops=arrow)
    ax.plot(x[0], y[0], "o", ms=9, mfc="white", mec=RED, mew=2)
    ax.set_title("the search policy's path (from the ring on)", fontsize=10)
    return figure
