"""Speeds that ``qdil bench`` measured, as bars relative to Brax's own simulator."""

from collections.abc import Mapping

from matplotlib.figure import Figure

from qdil.plotting.colours import method_colour

# Figure of the bench, its legend, its colour.
BARS = (
    ("iteration_over_simulator", "whole iterations, true reward", method_colour("true")),
    ("mconbo_gail_iteration_over_simulator", "whole iterations, MConbo-GAIL", method_colour("mconbo-gail")),
    ("tuned_simulator_over_simulator", "tuned Brax: random actions, no learning", "0.72"),
)


def speeds(measured: Mapping[str, Mapping[str, float]]) -> Figure:
    """A group of bars per robot: environment steps per second, as multiples of Brax's own simulator.

    ``measured`` holds the bench's figures by robot: those of ``BARS`` (ratios), and ``simulator_steps_per_second``, the
    speed that they are relative to. Raises KeyError where a figure is missing.
    """
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    ax = figure.subplots()
    width = 0.8 / len(BARS)
    for i, (name, legend, colour) in enumerate(BARS):
        places = [robot + (i - 1) * width for robot in range(len(measured))]
        bars = ax.bar(places, [row[name] for row in measured.values()], 0.94 * width, color=colour, label=legend)
        ax.bar_label(bars, fmt="%.1f", padding=2, size=9)
    ax.axhline(1.0, color="0.5", lw=1, ls="--", label="Brax's own simulator: random actions, no learning")
    names = [f"{env}\n(1 = {row['simulator_steps_per_second']:,.0f} steps/s)" for env, row in measured.items()]
    ax.set_xticks(range(len(measured)), names)
    ax.set_ylabel("speed ÷ Brax's own speed")
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(axis="x", length=0)
    figure.legend(loc="outside upper left", ncols=2, frameon=False, fontsize=9)
    return figure
