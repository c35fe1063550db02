"""One visual language: what experiments are called in pictures, axes with units, and how figures are written."""

import io
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdil.files import replace_file
from qdil.robots import register

GREEN, BLUE, RED = "#009e73", "#0072b2", "#d55e00"
EMPTY = "0.87"  # grey of an empty cell

METRICS = {
    "qd_score": "QD-score (sum of returns)",
    "coverage": "coverage (% of cells)",
    "best": "best return (reward units)",
    "average": "average return (reward units)",
}
MORE_METRICS = {
    "rescored_average": "average return, scored again (reward units)",
    "million_steps": "environment steps (millions)",
    "minutes": "training time (minutes)",
}
X_LABELS = {
    "iteration": "QD iteration",
    "env_steps": "environment steps (millions)",
    "wall_seconds": "wall-clock time (minutes)",
}
X_UNITS = {"iteration": 1.0, "env_steps": 1e6, "wall_seconds": 60.0}  # of a table's column, in one of its label
FIELD_LABELS = {
    "true_return": "true return per episode (reward units)",
    "fitness": "learned fitness per episode (reward units)",
    "length": "episode length (steps)",
    "rescored_return": "true return, scored again (reward units)",
    "rescored_fitness": "learned fitness, scored again (reward units)",
}
RESOLUTION = {"png": "figure", "pdf": 200}  # dots per inch; in a PDF of what is no line or letter
SETTING_LABELS = {"bonus_p": "p", "bonus_q": "q"}


def label(experiment: str) -> str:
    """What an experiment is called in a legend: ``mconbo-gail+bonus_q=1.0`` is "mconbo-gail, q = 1"."""
    method, *settings = experiment.split("+")
    return ", ".join([method, *map(_setting, settings)])


def _setting(text: str) -> str:
    name, _, value = text.partition("=")
    try:
        value = f"{float(value):g}"
    except ValueError:
        pass  # not a number: shown as it is
    if name == "demo_episodes":
        return f"{value} demonstration{'' if value == '1' else 's'}"
    if name == "protocol":
        return f"all {value} choices"
    return f"{SETTING_LABELS.get(name, name.replace('_', ' '))} = {value}"


def short(x: float, _: float = 0.0) -> str:
    """A number on an axis: 120,000 or 0.25, never 1e+05."""
    return f"{x:,.0f}" if abs(x) >= 1000 else f"{x:g}"


def percent(metric: str) -> float:
    """What to multiply a metric by for its axis label: shares are drawn in percent."""
    return 100.0 if metric == "coverage" else 1.0


def measure_labels(robot: str | None = None) -> tuple[str, str]:
    """Axis labels of the measure space, naming the feet of ``robot`` where one is given."""
    names = [f" ({foot})" for foot in register.find(robot).measure_names] if robot else ["", ""]
    first, second = (f"share of time foot {i + 1}{name}\ntouches the ground" for i, name in enumerate(names))
    return first, second


def label_measures(ax: Axes, robot: str | None = None) -> None:
    """Label the unit square of the two feet's ground contact and fix its limits."""
    first, second = measure_labels(robot)
    ax.set(xlabel=first, ylabel=second, xlim=(0, 1), ylim=(0, 1), aspect="equal")


def to_png(figure: Figure) -> bytes:
    """A figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def save(figure: Figure, path: Path) -> list[Path]:
    """Write ``figure`` as ``path`` with the suffixes ``.png`` and ``.pdf``, each whole or not at all."""
    written = []
    for kind, metadata in (("png", {"Software": None}), ("pdf", {"CreationDate": None})):
        buffer = io.BytesIO()
        figure.savefig(
            buffer, format=kind, metadata=metadata, dpi=RESOLUTION[kind]
        )  # no dates: equal runs give equal files
        target = path.with_name(f"{path.name}.{kind}")
        replace_file(target, lambda file, buffer=buffer: file.write(buffer.getvalue()))  # type: ignore[misc]
        written.append(target)
    return written
