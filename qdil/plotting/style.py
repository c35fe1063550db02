"""The look of every figure, the words on its axes, and how a figure is written to a file."""

import io
from pathlib import Path

from matplotlib import rc_context, rc_params_from_file
from matplotlib.figure import Figure

from qdil.files import replace_file
from qdil.names import label as label
from qdil.qd.landing import SHARES

# ``@styled`` around a function that makes a figure applies qdil.mplstyle while it runs and changes nothing afterwards.
styled = rc_context(rc_params_from_file(Path(__file__).with_name("qdil.mplstyle"), use_default_template=False))

METRICS = {
    "qd_score": "QD-score (sum of returns)",
    "coverage": "coverage (% of cells)",
    "best": "best return (reward units)",
    "average": "average return (reward units)",
}
MORE_METRICS = {
    **{f"corrected_{name}": f"corrected {text}" for name, text in METRICS.items()},
    "relanded": "elites that land in their own cell (%)",
    "relanded_near": "elites that land in their own or the next cell (%)",
    "million_steps": "environment steps (millions)",
    "minutes": "training time (minutes)",
}
X_LABELS = {
    "iteration": "QD iteration",
    "env_steps": "environment steps (millions)",
    "wall_seconds": "wall-clock time (minutes)",
}
X_UNITS = {"iteration": 1.0, "env_steps": 1e6, "wall_seconds": 60.0}  # one unit of the axis, in the table's unit
FIELD_LABELS = {
    "true_return": "true return per episode (reward units)",
    "fitness": "learned fitness per episode (reward units)",
    "length": "episode length (steps)",
    "rescored_return": "true return, scored again (reward units)",
    "rescored_fitness": "learned fitness, scored again (reward units)",
}
RESOLUTION = {"png": "figure", "pdf": 200}  # dots per inch; in a PDF only of rasterised parts


def short(x: float, _: float = 0.0) -> str:
    """A number on an axis: 120,000 or 0.25, never 1e+05. The second argument is a tick's position, unused."""
    return f"{x:,.0f}" if abs(x) >= 1000 else f"{x:g}"


def percent(metric: str) -> float:
    """The factor from a metric to the unit of its axis label: coverage and re-landing are shares, shown in percent."""
    return 100.0 if metric.endswith("coverage") or metric in SHARES else 1.0


def to_png(figure: Figure) -> bytes:
    """A figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def save(figure: Figure, path: Path) -> list[Path]:
    """Write ``figure`` as ``path`` with the suffixes ``.png`` and ``.pdf``; return both paths.

    Each file is written whole or not at all. Files carry no date, so that equal figures give equal bytes.
    """
    written = []
    for kind, metadata in (("png", {"Software": None}), ("pdf", {"CreationDate": None})):
        buffer = io.BytesIO()
        figure.savefig(buffer, format=kind, metadata=metadata, dpi=RESOLUTION[kind])
        target = path.with_name(f"{path.name}.{kind}")
        replace_file(target, lambda file, buffer=buffer: file.write(buffer.getvalue()))  # type: ignore[misc]
        written.append(target)
    return written
