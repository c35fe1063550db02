"""Lemma 1: changes of P(m ∈ A_e | π) and of the objective, of small problems and of robots; the bonus in runs."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from qdil.lab.lemma.results import ROUNDING, RobotTrial
from qdil.plotting.colours import BLUE, GREEN, GREY, ORANGE, RED, method_colour, styles
from qdil.plotting.ppga import coefficient_columns
from qdil.plotting.style import label, styled
from qdil.qd.cells import cell_index

if TYPE_CHECKING:  # it brings JAX
    from qdil.lab.lemma.trials import Improvements, Learning

P = r"$P(m \in \mathcal{A}_e \mid \pi)$"


@styled
def episodes_on_archive(panels: Mapping[str, np.ndarray], occupied: np.ndarray) -> Figure:
    """The measures of episodes over an archive whose filled cells are grey, a panel per policy of the small problem.

    ``panels`` has by title the probabilities (T+1, T+1) of the counts (i, j) of an episode of T steps; ``occupied``
    is (cells, cells). A dot's area is its probability; orange dots lie in empty cells.
    """
    figure = Figure(figsize=(3.9 * len(panels), 3.9))
    for ax, (title, chances) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True):
        cells = len(occupied)
        steps = len(chances) - 1
        edges = np.linspace(0, 1, cells + 1)
        ax.pcolormesh(edges, edges, np.where(occupied, 0.0, np.nan).T, cmap="Greys", vmin=-0.3, vmax=1.0)
        first, second = np.meshgrid(np.arange(steps + 1) / steps, np.arange(steps + 1) / steps, indexing="ij")
        index = cell_index(np.stack([first, second], axis=-1), occupied.shape, np)
        new = ~np.asarray(occupied)[tuple(np.moveaxis(index, -1, 0))]
        for chosen, colour in ((new, RED), (~new, "0.35")):
            area = 2500 * np.asarray(chances)[chosen]
            ax.scatter(first[chosen], second[chosen], s=area, color=colour, linewidths=0, clip_on=False, zorder=3)
        ax.set(title=title, xlabel="measure $m_1$", ylabel="measure $m_2$", xlim=(0, 1), ylim=(0, 1), aspect="equal")
        ax.set_xticks(edges)
        ax.set_yticks(edges)
        ax.grid(color="0.85")
        ax.spines[:].set_visible(True)
    return figure


@styled
def changes(trials: Mapping[str, "Improvements"]) -> Figure:
    """Histograms of the change of P(m ∈ A_e | π), a panel per name, with the share of trials in which it fell."""
    figure = Figure(figsize=(3.5 * len(trials) + 0.5, 3.1))
    axes = figure.subplots(1, len(trials), sharey=True, squeeze=False)[0]
    widest = max(float(np.abs(several.change).max()) for several in trials.values()) or 1.0
    bins = np.linspace(-widest, widest, 61)
    for ax, (title, several) in zip(axes, trials.items(), strict=True):
        fell = several.change < -ROUNDING
        ax.hist([several.change[fell], several.change[~fell]], bins=bins, stacked=True, color=[RED, GREEN])
        ax.axvline(0, color="black", lw=0.8)
        ax.set_title(f"{title}\nfell in {100 * fell.mean():.1f} % of {len(fell)}")
        ax.set_xlabel(f"change of {P}")
    axes[0].set_ylabel("trials")
    return figure


def group_colours() -> dict[str, str]:
    """A colour for each of the four groups of trials: whether the objective rose, and whether P rose."""
    from qdil.lab.lemma.trials import GROUPS

    return dict(zip(GROUPS, (GREEN, GREY, RED, BLUE), strict=True))


@styled
def assumption(trials: Mapping[str, "Improvements"]) -> Figure:
    """The change of P against the change of the objective, a dot per trial and a panel per name.

    The lemma is about the right half, where the objective rose; it states that these trials lie in the upper quadrant.
    """
    from qdil.lab.lemma.trials import group

    figure = Figure(figsize=(4.3 * len(trials), 3.9))
    for ax, (title, several) in zip(figure.subplots(1, len(trials), squeeze=False)[0], trials.items(), strict=True):
        groups = group(several)
        for number, (name, colour) in enumerate(group_colours().items()):
            chosen = groups == number
            x, y = several.objective_change[chosen], several.change[chosen]
            ax.scatter(x, y, s=9, color=colour, linewidths=0, alpha=0.7, label=f"{name}: {100 * chosen.mean():.1f} %")
        ax.axhline(0, color="black", lw=0.8)
        ax.axvline(0, color="black", lw=0.8)
        ax.set_title(title)
        ax.set(xlabel=r"change of the objective $h$", ylabel=f"change of {P}")
        ax.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, markerscale=1.8)
    return figure


@styled
def fallen(tallies: Mapping[str, pd.DataFrame]) -> Figure:
    """How often P fell, stacked: with the objective (the assumption fails) and without it (the conclusion fails).

    ``tallies`` has for every varied setting, a panel each, a table with a row of ``trials.tally`` per value.
    """
    colours = group_colours()
    figure = Figure(figsize=(3.6 * len(tallies) + 0.4, 3.4))
    axes = figure.subplots(1, len(tallies), sharey=True, squeeze=False)[0]
    for ax, (title, table) in zip(axes, tallies.items(), strict=True):
        bottom = np.zeros(len(table))
        for name in ("both fell", "objective rose, P fell"):
            ax.bar(range(len(table)), table[name], bottom=bottom, color=colours[name], label=name)
            bottom += table[name].to_numpy()
        ax.set_xticks(range(len(table)), [f"{value:g}" for value in table.index])
        ax.set_xlabel(title)
    axes[0].set_ylabel("% of trials in which P fell")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


@styled
def bayes(table: pd.DataFrame) -> Figure:
    """P(π_new | m ∈ A_e), exact against counted (``trials.bayes_by_sampling``), with 95 % intervals of the counts."""
    from qdil.lab.lemma.robot import interval

    figure = Figure(figsize=(4.6, 4.1))
    ax = figure.subplots()
    shown = table[table["landed"] > 0]
    counted = (shown["by_new"] / shown["landed"]).to_numpy()
    bounds = np.array([interval(int(row.by_new), int(row.landed)) for row in shown.itertuples()])
    ax.errorbar(
        shown["exact"],
        counted,
        yerr=np.abs(bounds.T - counted),
        fmt="o",
        ms=4,
        lw=0.8,
        capsize=0,
        color=BLUE,
        alpha=0.7,
    )
    ends = [float(shown["exact"].min()) - 0.01, float(shown["exact"].max()) + 0.01]
    ax.plot(ends, ends, color="0.4", lw=1)
    ax.axvline(0.5, color="0.7", lw=0.8)
    ax.axhline(0.5, color="0.7", lw=0.8)
    chance = r"$P(\pi_{\mathrm{new}} \mid m \in \mathcal{A}_e)$"
    ax.set(xlabel=f"{chance}, Bayes' rule", ylabel=f"{chance}, counted")
    return figure


@styled
def learning(curves: Mapping[str, "Learning"]) -> Figure:
    """P(m ∈ A_e | π) and episode length by PPO update, means over the problems."""
    figure = Figure(figsize=(9, 3.4))
    axes = figure.subplots(1, 2)
    for (name, learned), colour in zip(curves.items(), (RED, BLUE, GREEN, ORANGE, GREY), strict=False):
        for ax, values in zip(axes, (learned.probability, learned.length), strict=True):
            ax.plot(np.arange(len(values)), values.mean(axis=1), color=colour, label=name)
    axes[0].set(xlabel="PPO updates", ylabel=f"{P}, mean")
    axes[1].set(xlabel="PPO updates", ylabel="length of an episode (steps), mean")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(curves))
    return figure


@styled
def robots(trials: Mapping[str, Sequence[RobotTrial]]) -> Figure:
    """P(m ∈ A_e | π) of robots before (hollow) and after (full), with 95 % intervals; a panel per robot."""
    from qdil.lab.lemma.robot import interval

    figure = Figure(figsize=(1.5 + 3.8 * len(trials), 3.5))
    axes = figure.subplots(1, len(trials), sharey=True, squeeze=False)[0]
    for ax, (name, several) in zip(axes, trials.items(), strict=True):
        for x, trial in enumerate(several):
            for shift, found, face in ((-0.12, trial.found_old, "white"), (0.12, trial.found_new, BLUE)):
                low, high = interval(found, trial.episodes)
                ax.plot([x + shift] * 2, [low, high], color=BLUE, lw=1)
                ax.plot(x + shift, found / trial.episodes, "o", color=BLUE, mfc=face)
        names = [f"{trial.seed}\n{100 * trial.known:.0f} %" for trial in several]
        ax.set_xticks(range(len(several)), names, fontsize=8)
        ax.set_title(name)
        ax.set_xlabel("seed, and share of episodes\nthat the archive knew")
    axes[0].set(ylabel=f"{P}\n(hollow: before, full: after)", ylim=(0, 1.04))
    return figure


@styled
def lengths(lengths: Mapping[str, np.ndarray], limit: int) -> Figure:
    """Episode lengths (steps) of elites, a box per experiment: the middle half, the median, and nine tenths.

    ``lengths`` has for every experiment the lengths (n,) of all its seeds; ``limit`` is the time limit in steps.
    """
    figure = Figure(figsize=(7.5, 0.8 + 0.45 * len(lengths)))
    ax = figure.subplots()
    drawn = ax.boxplot(
        [np.asarray(values) for values in lengths.values()],
        orientation="horizontal", whis=(5, 95), widths=0.6,
    )  # fmt: skip
    for box, name in zip(drawn["boxes"], lengths, strict=True):
        box.set_facecolor(method_colour(name))
        box.set_alpha(0.6)
    ax.set_yticks(range(1, len(lengths) + 1), [label(name) for name in lengths])
    ax.invert_yaxis()
    ax.axvline(limit, color="0.5", ls=":")
    ax.set(xlabel="episode length of the archive's elites (steps; dotted: the time limit)", xlim=(0, 1.02 * limit))
    return figure


@styled
def coefficients(metrics: Mapping[str, Sequence[pd.DataFrame]]) -> Figure:
    """|c_0|, its share of all coefficients, and newly filled cells in percent of the archive, by iteration.

    ``metrics`` has for every experiment a table of ``metrics.csv`` per seed, with any number of coefficients. Lines
    are running means over a twentieth of the run, averaged over seeds.
    """
    figure = Figure(figsize=(12, 3.4))
    axes = figure.subplots(1, 3)
    titles = ("$|c_0|$ of the walk", r"$|c_0|\,/\,\sum_j |c_j|$", "cells newly filled (% of the archive)")
    line_styles = styles(metrics)
    for name, tables in metrics.items():
        style = line_styles[name] | {"marker": "None"}
        shown = [_coefficients(table) for table in tables]
        shortest = min(map(len, shown))
        mean = pd.DataFrame(np.mean([table.iloc[:shortest] for table in shown], axis=0), columns=shown[0].columns)
        smooth = mean.rolling(max(1, shortest // 20), min_periods=1, center=True).mean()
        for ax, column in zip(axes, smooth, strict=True):
            ax.plot(np.arange(1, shortest + 1), smooth[column], label=label(name), **style)
    for ax, title in zip(axes, titles, strict=True):
        ax.set(xlabel="QD iteration", ylabel=title)
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes[2].set_yscale("symlog", linthresh=0.1)
    axes[2].set_ylim(bottom=0)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=min(4, len(metrics)))
    return figure


def _coefficients(table: pd.DataFrame) -> pd.DataFrame:
    """The three columns that ``coefficients`` draws, a row per iteration."""
    all_c = table[coefficient_columns(table)].abs()
    size = all_c["c0"].to_numpy()
    new = table["coverage"].diff().fillna(table["coverage"].iloc[0])
    return pd.DataFrame({"size": size, "share": size / np.maximum(all_c.sum(axis=1), 1e-12), "new": 100 * new})
