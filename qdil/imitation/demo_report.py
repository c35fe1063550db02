"""What a demonstrations file holds, as text: a table, how far apart its episodes are, a warning. Imports no JAX.

Files of earlier versions lack ``falls`` and ``demo_attempts``, and those from other sources may lack more. What a file
does not tell is left out.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from qdil.errors import ConfigError
from qdil.files import read_npz

Demos = Mapping[str, np.ndarray]  # a file's columns: some have a row per step, some a row per episode


def report(demos: Demos) -> str:
    """A row per demonstration, a sentence on their spread, and a warning if all of them fall.

    Columns marked "selected" are the values by which the demonstrator was selected: its means over fresh episodes (in
    files of earlier versions, those that won its cell). "Distance" is that of the recorded episode's measures from
    these; "falls" counts the simulated episodes that end in a fall.
    """
    rows = [_row(demos, number) for number in range(len(demos["episode_return"]))]
    widths = {name: max(len(name), *(len(row[name]) for row in rows)) for name in rows[0]}
    lines = ["  ".join(name.rjust(width) for name, width in widths.items())]
    lines += ["  ".join(row[name].rjust(width) for name, width in widths.items()) for row in rows]
    return "\n".join([*lines, *filter(None, (spread(demos), fall_warning(demos)))])


def _row(demos: Demos, number: int) -> dict[str, str]:
    """The cells of one demonstration by the name of their column."""
    steps = np.flatnonzero(demos["episode"] == number)
    recorded, selected = demos["episode_measures"][number], demos["elite_measures"][number]
    row = {
        "demonstration": str(number + 1),
        "steps": str(len(steps)),
        "end": "fall" if demos["terminated"][steps[-1]] else "time limit",
        "return": f"{demos['episode_return'][number]:,.0f}",
        "return, selected": f"{demos['elite_return'][number]:,.0f}",
        "measures": _place(recorded),
        "measures, selected": _place(selected),
        "distance": f"{np.linalg.norm(recorded - selected):.3f}",
    }
    if "falls" in demos:
        row["falls"] = f"{demos['falls'][number]} of {demos['demo_attempts']}"
    return row


def _place(measures: np.ndarray) -> str:
    return ", ".join(f"{value:.2f}" for value in measures)


def spread(demos: Demos) -> str | None:
    """A sentence on the smallest distance between two demonstrations, as selected and as recorded; None for one."""
    if len(demos["episode_return"]) < 2:
        return None
    selected, recorded = (smallest_distance(demos[name]) for name in ("elite_measures", "episode_measures"))
    return f"Smallest distance between two demonstrations: {selected:.3f} as selected, {recorded:.3f} as recorded."


def smallest_distance(measures: np.ndarray) -> float:
    """The distance between the two nearest of ``measures`` (n, k), n ≥ 2."""
    distances = np.linalg.norm(measures[:, None] - measures[None], axis=-1)
    return float(distances[np.triu_indices(len(measures), 1)].min())


def fall_warning_of(path: Path) -> str | None:
    """``fall_warning`` of a file. None also if it cannot be read: training refuses such a file in its own words."""
    try:
        return fall_warning(read_npz(path))
    except (ConfigError, OSError):
        return None


def fall_warning(demos: Demos) -> str | None:
    """A warning, with figures, if every demonstration ends in a fall; None otherwise, and if the file does not tell."""
    if "terminated" not in demos or "episode" not in demos:
        return None
    numbers, lengths = np.unique(demos["episode"], return_counts=True)
    if not all(demos["terminated"][demos["episode"] == number][-1] for number in numbers):
        return None
    what = f"all {len(numbers)} demonstrations end in a fall, after {lengths.min()} to {lengths.max()} steps"
    if len(numbers) == 1:
        what = f"the demonstration ends in a fall, after {lengths[0]} steps"
    if "falls" in demos:
        what += f"; of {len(numbers) * int(demos['demo_attempts'])} simulated episodes, {demos['falls'].sum()} fell"
    return f"Warning: {what}. Imitators may learn to fall."
