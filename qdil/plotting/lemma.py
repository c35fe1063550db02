"""Pictures of Lemma 1: changes of P(m ∈ A_e | π), what the objective did meanwhile, robots, and the bonus in runs."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdil.lab.lemma.robot import Trial, interval
from qdil.lab.lemma.trials import GROUPS, ROUNDING, Learning, Trials, group
from qdil.plotting.colours import method_colour, styles
from qdil.plotting.style import BLUE, GREEN, RED, label

P = r"$P(m \in \mathcal{A}_e \mid \pi)$"
COLOURS = dict(zip(GROUPS, (GREEN, "#999999", RED, BLUE), strict=True))


def episodes_on_archive(panels: Mapping[str, np.ndarray], occupied: np.ndarray) -> Figure:
    """Where episodes' measures fall, over an archive whose filled cells are grey: a panel per policy.

    ``panels`` have (T+1, T+1) probabilities of the counts (i, j) of an episode of T steps, by title; ``occupied``
    (cells, cells). A dot's area is its probability; orange ones lie in empty cells.
    """
    figure = Figure(figsize=(3.9 * len(panels), 3.9), layout="constrained")
    for ax, (title, chances) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True):
        cells = len(occupied)
        steps = len(chances) - 1
        edges = np.linspace(0, 1, cells + 1)
        ax.pcolormesh(edges, edges, np.where(occupied, 0.0, np.nan).T, cmap="Greys", vmin=-0.3, vmax=1.0)
        first, second = np.meshgrid(np.arange(steps + 1) / steps, np.arange(steps + 1) / steps, indexing="ij")
        index = tuple(np.clip((cells * x + 1e-4).astype(int), 0, cells - 1) for x in (first, second))
        new = ~np.asarray(occupied)[index]
        for chosen, colour in ((new, RED), (~new, "0.35")):
            area = 2500 * np.asarray(chances)[chosen]
            ax.scatter(first[chosen], second[chosen], s=area, color=colour, linewidths=0, clip_on=False, zorder=3)
        ax.set(title=title, xlabel="measure $m_1$", ylabel="measure $m_2$", xlim=(0, 1), ylim=(0, 1), aspect="equal")
        ax.set_xticks(edges)
        ax.set_yticks(edges)
        ax.grid(color="0.85")
    return figure


def changes(trials: Mapping[str, Trials]) -> Figure:
    """Histograms of the change of P(m ∈ A_e | π), a panel per name, with the share of trials in which it fell."""
    figure = Figure(figsize=(3.5 * len(trials) + 0.5, 3.1), layout="constrained")
    axes = figure.subplots(1, len(trials), sharey=True, squeeze=False)[0]
    widest = max(float(np.abs(several.change).max()) for several in trials.values()) or 1.0
    bins = np.linspace(-widest, widest, 61)
    for ax, (title, several) in zip(axes, trials.items(), strict=True):
        fell = several.change < -ROUNDING
        ax.hist([several.change[fell], several.change[~fell]], bins=bins, stacked=True, color=[RED, GREEN])
        ax.axvline(0, color="black", lw=0.8)
        ax.set_title(f"{title}\nfell in {100 * fell.mean():.1f} % of {len(fell)}", fontsize=10)
        ax.set_xlabel(f"change of {P}")
        _plain(ax)
    axes[0].set_ylabel("trials")
    return figure


def assumption(trials: Mapping[str, Trials]) -> Figure:
    """The change of P against the change of the objective, a dot per trial and a panel per name.

    The lemma speaks of the right half: there, what it promises is the upper quadrant.
    """
    figure = Figure(figsize=(4.3 * len(trials), 3.9), layout="constrained")
    for ax, (title, several) in zip(figure.subplots(1, len(trials), squeeze=False)[0], trials.items(), strict=True):
        groups = group(several)
        for number, (name, colour) in enumerate(COLOURS.items()):
            here = groups == number
            x, y = several.objective_change[here], several.change[here]
            ax.scatter(x, y, s=9, color=colour, linewidths=0, alpha=0.7, label=f"{name}: {100 * here.mean():.1f} %")
        ax.axhline(0, color="black", lw=0.8)
        ax.axvline(0, color="black", lw=0.8)
        ax.set_title(title, fontsize=10)
        ax.set(xlabel=r"change of the objective $h$", ylabel=f"change of {P}")
        ax.legend(fontsize=8, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, markerscale=1.8)
        _plain(ax)
    return figure


def fallen(tallies: Mapping[str, pd.DataFrame]) -> Figure:
    """How often P fell, stacked: with the objective (the assumption fails) and without it (the conclusion does).

    ``tallies`` have a row of ``trials.tally`` per value, by what is varied: a panel each.
    """
    figure = Figure(figsize=(3.6 * len(tallies) + 0.4, 3.4), layout="constrained")
    axes = figure.subplots(1, len(tallies), sharey=True, squeeze=False)[0]
    for ax, (title, table) in zip(axes, tallies.items(), strict=True):
        bottom = np.zeros(len(table))
        for name in ("both fell", "objective rose, P fell"):
            ax.bar(range(len(table)), table[name], bottom=bottom, color=COLOURS[name], label=name)
            bottom += table[name].to_numpy()
        ax.set_xticks(range(len(table)), [f"{value:g}" for value in table.index])
        ax.set_xlabel(title)
        _plain(ax)
    axes[0].set_ylabel("% of trials in which P fell")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def bayes(table: pd.DataFrame) -> Figure:
    """P(π_new | m ∈ A_e), exact against counted (``trials.bayes_by_sampling``), with 95 % intervals of the counts."""
    figure = Figure(figsize=(4.6, 4.1), layout="constrained")
    ax = figure.subplots()
    shown = table[table["landed"] > 0]
    counted = (shown["by_new"] / shown["landed"]).to_numpy()
    bounds = np.array([interval(int(row.by_new), int(row.landed)) for row in shown.itertuples()])
    ax.errorbar(shown["exact"], counted, yerr=np.abs(bounds.T - counted), fmt="o", ms=4, lw=0.8, color=BLUE, alpha=0.7)
    ends = [float(shown["exact"].min()) - 0.01, float(shown["exact"].max()) + 0.01]
    ax.plot(ends, ends, color="0.4", lw=1)
    ax.axvline(0.5, color="0.7", lw=0.8)
    ax.axhline(0.5, color="0.7", lw=0.8)
    chance = r"$P(\pi_{\mathrm{new}} \mid m \in \mathcal{A}_e)$"
    ax.set(xlabel=f"{chance}, Bayes' rule", ylabel=f"{chance}, counted")
    _plain(ax)
    return figure


def learning(curves: Mapping[str, Learning]) -> Figure:
    """P(m ∈ A_e | π) and episode length by PPO update, means over the problems."""
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    axes = figure.subplots(1, 2)
    for (name, learned), colour in zip(curves.items(), (RED, BLUE, GREEN, "#e69f00", "#999999"), strict=False):
        for ax, values in zip(axes, (learned.probability, learned.length), strict=True):
            ax.plot(np.arange(len(values)), values.mean(axis=1), color=colour, label=name)
    axes[0].set(xlabel="PPO updates", ylabel=f"{P}, mean")
    axes[1].set(xlabel="PPO updates", ylabel="length of an episode (steps), mean")
    for ax in axes:
        _plain(ax)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(curves), frameon=False)
    return figure


def robots(trials: Mapping[str, Sequence[Trial]]) -> Figure:
    """P(m ∈ A_e | π) of robots before (hollow) and after (full), with 95 % intervals; a panel per robot."""
    figure = Figure(figsize=(1.5 + 3.8 * len(trials), 3.5), layout="constrained")
    axes = figure.subplots(1, len(trials), sharey=True, squeeze=False)[0]
    for ax, (name, several) in zip(axes, trials.items(), strict=True):
        for x, trial in enumerate(several):
            for shift, found, face in ((-0.12, trial.found_old, "white"), (0.12, trial.found_new, BLUE)):
                low, high = interval(found, trial.episodes)
                ax.plot([x + shift] * 2, [low, high], color=BLUE, lw=1)
                ax.plot(x + shift, found / trial.episodes, "o", color=BLUE, mfc=face)
        names = [f"{trial.seed}\n{100 * trial.known:.0f} %" for trial in several]
        ax.set_xticks(range(len(several)), names, fontsize=8)
        ax.set_title(name, fontsize=10)
        ax.set_xlabel("seed, and share of episodes\nthat the archive knew")
        _plain(ax)
    axes[0].set(ylabel=f"{P}\n(hollow: before, full: after)", ylim=(0, 1.04))
    return figure


def lengths(lengths: Mapping[str, np.ndarray], limit: int) -> Figure:
    """Episode lengths (steps) of the elites of runs, a box per experiment: middle half, median, nine tenths.

    ``lengths`` (n,) by experiment, all seeds together; ``limit`` is the time limit.
    """
    figure = Figure(figsize=(7.5, 0.8 + 0.45 * len(lengths)), layout="constrained")
    ax = figure.subplots()
    drawn = ax.boxplot(
        [np.asarray(values) for values in lengths.values()],
        orientation="horizontal", whis=(5, 95), showfliers=False, patch_artist=True, widths=0.6,
        medianprops={"color": "black"},
    )  # fmt: skip
    for box, name in zip(drawn["boxes"], lengths, strict=True):
        box.set_facecolor(method_colour(name))
        box.set_alpha(0.6)
    ax.set_yticks(range(1, len(lengths) + 1), [label(name) for name in lengths])
    ax.invert_yaxis()
    ax.axvline(limit, color="0.5", ls=":")
    ax.set(xlabel="episode length of the archive's elites (steps; dotted: the time limit)", xlim=(0, 1.02 * limit))
    _plain(ax)
    return figure


def coefficients(metrics: Mapping[str, Sequence[pd.DataFrame]]) -> Figure:
    """|c_0|, its share of all coefficients, and newly filled cells in percent of the archive, by iteration.

    ``metrics`` are tables of ``metrics.csv``, one per seed, by experiment. Lines are running means over a twentieth of
    the run, averaged over seeds.
    """
    figure = Figure(figsize=(12, 3.4), layout="constrained")
    axes = figure.subplots(1, 3)
    titles = ("$|c_0|$ of the walk", r"$|c_0|\,/\,\sum_j |c_j|$", "cells newly filled (% of the archive)")
    looks = styles(metrics)
    for name, tables in metrics.items():
        look = looks[name] | {"marker": "None"}
        shown = [_coefficients(table) for table in tables]
        shortest = min(map(len, shown))
        mean = pd.DataFrame(np.mean([table.iloc[:shortest] for table in shown], axis=0), columns=shown[0].columns)
        smooth = mean.rolling(max(1, shortest // 20), min_periods=1, center=True).mean()
        for ax, column in zip(axes, smooth, strict=True):
            ax.plot(np.arange(1, shortest + 1), smooth[column], label=label(name), **look)
    for ax, title in zip(axes, titles, strict=True):
        ax.set(xlabel="QD iteration", ylabel=title)
        _plain(ax)
    axes[2].set_yscale("symlog", linthresh=0.1)
    axes[2].set_ylim(bottom=0)
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=min(4, len(metrics)), frameon=False
    )
    return figure


def _coefficients(table: pd.DataFrame) -> pd.DataFrame:
    """The three columns that ``coefficients`` draws, a row per iteration."""
    all_c = table[[name for name in table if name[0] == "c" and name[1:].isdigit()]].abs()
    size = all_c["c0"].to_numpy()
    new = table["coverage"].diff().fillna(table["coverage"].iloc[0])
    return pd.DataFrame({"size": size, "share": size / np.maximum(all_c.sum(axis=1), 1e-12), "new": 100 * new})


def _plain(ax: Axes) -> None:
    ax.grid(color="0.92")
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
