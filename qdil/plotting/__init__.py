"""Figures of archives, runs and experiments, in one style, for robots with any number of feet.

Every function takes arrays, tables or axes and returns what it drew. Nothing keeps state between calls or uses
pyplot's current figure, so a notebook shows a figure once, where a cell returns it. Importing this package does not
import JAX; the few figures that need it import it when they are drawn.
"""

from qdil.plotting.archives import archives_side_by_side, behaviour_space, both_readings, heatmap
from qdil.plotting.bars import bars, grid
from qdil.plotting.colours import method_colour, styles
from qdil.plotting.curves import learning_curves
from qdil.plotting.findings import findings
from qdil.plotting.live import LiveArchive, live_figure
from qdil.plotting.measures import label_measures, measure_labels
from qdil.plotting.style import METRICS, X_LABELS, label, save, to_png

__all__ = [
    "METRICS",
    "X_LABELS",
    "LiveArchive",
    "archives_side_by_side",
    "bars",
    "behaviour_space",
    "both_readings",
    "findings",
    "grid",
    "heatmap",
    "label",
    "label_measures",
    "learning_curves",
    "live_figure",
    "measure_labels",
    "method_colour",
    "save",
    "styles",
    "to_png",
]
