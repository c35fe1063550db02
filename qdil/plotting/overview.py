"""The paper's idea: a behaviour space, the two problems of imitating diversity, and the framework (Figs. 1-3).

These figures show the small model of ``concepts`` and a diagram. They do not show results of runs.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch, Rectangle

from qdil.lab.background.concepts import Explored, discriminator_reward, fitness
from qdil.plotting.colours import BLUE, GREEN, ORANGE, RED
from qdil.plotting.demonstrations import spans
from qdil.plotting.style import styled

MEASURE = "measure m"
STEPS = 12  # steps of a gait in a cell of ``behaviours``
CYCLE = 6  # steps of one cycle of that gait


@styled
def behaviours(cells: int = 5) -> Figure:
    """The behaviour space of two feet as a square of gaits: each cell shows when each foot is down (as in Fig. 2).

    A foot is down for its cell's share of every cycle, and foot 2 follows foot 1 by half a cycle.
    """
    figure = Figure(figsize=(5.4, 5.4))
    ax = figure.subplots()
    for i in range(cells):
        for j in range(cells):
            _gait(ax, (i, j), cells)
    edges = np.arange(cells + 1) / cells
    ax.set(xlim=(0, 1), ylim=(0, 1), aspect="equal", xticks=edges, yticks=edges)
    ax.set(xlabel="share of time foot 1 touches the ground", ylabel="share of time foot 2 touches the ground")
    ax.grid(color="0.6", lw=0.8)
    ax.spines[:].set_visible(True)
    ax.set_title("in each cell, over time: foot 1 (orange) and foot 2 (blue) down", fontsize=9)
    return figure


def _gait(ax: Axes, cell: tuple[int, int], cells: int) -> None:
    """A cell's gait over ``STEPS`` steps: a bar per foot, coloured while the foot is down."""
    time = (np.arange(10 * STEPS) + 0.5) / 10
    for foot, (colour, height) in enumerate(((RED, 0.3), (BLUE, 0.62))):
        share = (cell[foot] + 0.5) / cells
        down = ((time + foot * CYCLE / 2) % CYCLE) < share * CYCLE
        left, bottom = (cell[0] + 0.08) / cells, (cell[1] + height - 0.09) / cells
        stretches = [(left + begin, length) for begin, length in spans(down, 0.84 / (cells * len(time)))]
        ax.add_patch(Rectangle((left, bottom), 0.84 / cells, 0.18 / cells, color="0.92", lw=0))
        ax.broken_barh(stretches, (bottom, 0.18 / cells), color=colour, lw=0)


@styled
def exploration(searches: Mapping[str, Sequence[Explored]]) -> Figure:
    """Episodes per cell of each search, averaged over its seeds, and the share of visited cells (Fig. 1a).

    Bars are episodes per cell, the line is f(m). All searches have the same cells and iterations.
    """
    figure = Figure(figsize=(4.4 * (len(searches) + 1), 3.2))
    axes = figure.subplots(1, len(searches) + 1)
    means = {name: np.mean([s.visits for s in seeds], axis=0) for name, seeds in searches.items()}
    top = 1.15 * max(mean.max() for mean in means.values())
    colours = dict(zip(searches, (BLUE, RED, GREEN), strict=False))
    for ax, (name, visits) in zip(axes, means.items(), strict=False):
        edges = np.arange(len(visits) + 1) / len(visits)
        ax.vlines(edges, 0, top, color="0.8", ls=":", lw=0.8)
        ax.bar(edges[:-1], visits, width=1 / len(visits), align="edge", color=colours[name], alpha=0.6)
        ax.set(title=name, xlabel=MEASURE, ylabel="episodes per cell (bars)", xlim=(0, 1), ylim=(0, top))
        _beside(ax, np.linspace(0, 1, 200))
    for name, seeds in searches.items():
        filled = np.array([100 * s.filled / len(s.visits) for s in seeds])
        middle, spread = filled.mean(axis=0), filled.std(axis=0)
        iterations = np.arange(1, len(middle) + 1)
        axes[-1].plot(iterations, middle, color=colours[name], label=name)
        axes[-1].fill_between(iterations, middle - spread, middle + spread, color=colours[name], alpha=0.18, lw=0)
    axes[-1].set(title="cells found", xlabel="iteration", ylabel="cells visited so far (%)", ylim=(0, 105))
    axes[-1].legend(frameon=False, loc="lower right")
    return figure


def _beside(ax: Axes, measure: np.ndarray) -> None:
    """f(m) as a line with its own axis on the right."""
    other = ax.twinx()
    other.plot(measure, fitness(measure), color="black", lw=1.2)
    other.set(ylabel="fitness f(m) (line)", ylim=(0, 0.9))
    other.grid(False)
    other.spines.right.set_visible(True)


class Demonstrators(NamedTuple):
    """The demonstrations of one panel, arguments of ``concepts.discriminator_reward``."""

    experts: Sequence[float]  # measures of the demonstrations
    details: Sequence[float]  # the detail of each
    sees_details: bool  # whether the discriminator sees it


@styled
def localised_reward(panels: Mapping[str, Demonstrators], width: float = 0.06) -> Figure:
    """The reward of each behaviour under the best discriminator (Fig. 1b); orange lines are demonstrations.

    ``width`` is the width of a demonstration's bump, in units of the measure.
    """
    measure = np.linspace(0, 1, 300)
    rewards = {
        name: discriminator_reward(measure, np.array(d.experts), np.array(d.details), width, d.sees_details)
        for name, d in panels.items()
    }
    figure = Figure(figsize=(4.0 * len(panels), 3.0))
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for ax, (name, reward) in zip(axes, rewards.items(), strict=True):
        ax.fill_between(measure, reward, color=BLUE, alpha=0.25, lw=0)
        ax.plot(measure, reward, color=BLUE)
        for expert in panels[name].experts:
            ax.axvline(expert, color=ORANGE, lw=3, alpha=0.8, zorder=0)
        ax.set(title=name, xlabel=MEASURE, xlim=(0, 1), ylim=(0, 1.1 * max(r.max() for r in rewards.values())))
    axes[0].set_ylabel("mean reward −log(1−D) per step")
    return figure


WARM, BONUS, COOL, FRESH = "#fbe3c6", "#f7cfc0", "#d6e6f4", "#d5efe3"
# Boxes of ``framework``: left edge, bottom, width and height as shares of the figure; colour and text.
BOXES = {
    "demos": (0.02, 0.72, 0.19, 0.20, WARM, "demonstrations\n$(s_t, a_t, s_{t+1}, \\delta(s_t))$\nof a few elites"),
    "reward": (0.28, 0.72, 0.22, 0.20, WARM, "reward model $\\mathcal{R}$\nsees $s$, $a$ and $\\delta(s)$ (eq. 3)"),
    "bonus": (0.57, 0.72, 0.22, 0.20, BONUS, "measure bonus (eq. 2)\n$p + q\\,1[m \\in \\mathcal{A}_e]$"),
    "vppo": (
        0.40,
        0.40,
        0.26,
        0.17,
        COOL,
        "VPPO: copies of $\\theta_\\mu$\n$\\nabla f, \\nabla m_1, \\ldots, \\nabla m_k$",
    ),
    "policy": (0.02, 0.40, 0.25, 0.17, COOL, "search policy $\\theta_\\mu$\nplays episodes"),
    "branch": (0.40, 0.07, 0.26, 0.17, COOL, "candidates\n$\\theta_\\mu + |c_0|\\nabla f + \\Sigma_j c_j\\nabla m_j$"),
    "xnes": (0.02, 0.07, 0.25, 0.17, COOL, "xNES\n$c \\sim \\mathcal{N}(\\mu, \\Sigma)$"),
    "archive": (0.79, 0.07, 0.19, 0.50, FRESH, "archive $\\mathcal{A}$\nthe best policy\nof every cell"),
}
# Arrows of ``framework``: from a side of a box to a side of another, the text beside it, and the text's middle.
ARROWS = (
    ("demos", "E", "reward", "W", "learns", (0.245, 0.85)),
    ("policy", "N", "reward", "S", "episodes: $s, a, \\delta$", (0.165, 0.645)),
    ("reward", "S", "vppo", "N", "reward", (0.41, 0.645)),
    ("bonus", "S", "vppo", "N", "+ bonus", (0.67, 0.645)),
    ("policy", "E", "vppo", "W", "copies", (0.335, 0.51)),
    ("vppo", "S", "branch", "N", "gradients", (0.595, 0.32)),
    ("xnes", "E", "branch", "W", "coefficients", (0.335, 0.18)),
    ("branch", "E", "archive", "W", "whole\nepisodes", (0.725, 0.21)),
    ("archive", "N", "bonus", "E", "empty cells $\\mathcal{A}_e$", (0.90, 0.66)),
    ("xnes", "N", "policy", "S", "walk along $c_\\mu$", (0.07, 0.32)),
)


@styled
def framework() -> Figure:
    """A diagram of MConbo-IRL after Fig. 3; boxes that MConbo-IRL adds to PPGA have warm colours."""
    figure = Figure(figsize=(11, 5.0))
    ax = figure.subplots()
    ax.set(xlim=(0, 1), ylim=(-0.02, 1))
    ax.axis("off")
    for left, bottom, width, height, colour, text in BOXES.values():
        style = "round,pad=0,rounding_size=0.015"
        ax.add_patch(FancyBboxPatch((left, bottom), width, height, boxstyle=style, fc=colour, ec="0.35"))
        ax.text(left + width / 2, bottom + height / 2, text, ha="center", va="center", fontsize=10.5)
    for begin, out, end, into, text, middle in ARROWS:
        _arrow(ax, _side(begin, out), _side(end, into))
        ax.text(*middle, text, ha="center", va="center", fontsize=9, color="0.25")
    _ranking(ax)
    return figure


def _side(box: str, side: str) -> tuple[float, float]:
    """The middle of a box's side, which is N, E, S or W."""
    left, bottom, width, height = BOXES[box][:4]
    x = {"W": left, "E": left + width}.get(side, left + width / 2)
    y = {"S": bottom, "N": bottom + height}.get(side, bottom + height / 2)
    if (box, side) == ("archive", "W"):
        y = _side("branch", "E")[1]
    return x, y


def _arrow(ax: Axes, begin: tuple[float, float], end: tuple[float, float]) -> None:
    arrow = FancyArrowPatch(begin, end, arrowstyle="-|>", mutation_scale=14, shrinkA=0, shrinkB=1, color="0.25", lw=1.3)
    ax.add_patch(arrow)


def _ranking(ax: Axes) -> None:
    """The arrow from the archive back to xNES, below the candidates."""
    (x1, y1), (x2, y2) = _side("archive", "S"), _side("xnes", "S")
    ax.plot([x1, x1, x2], [y1, 0.0, 0.0], color="0.25", lw=1.3)
    _arrow(ax, (x2, 0.0), (x2, y2))
    ax.text(0.53, 0.025, "ranked by how much each improved the archive", ha="center", fontsize=9, color="0.25")
