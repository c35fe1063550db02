"""Pictures of archives and runs; every function takes arrays, tables or axes and returns what it drew.

Nothing here keeps state between calls or goes through pyplot's current figure, so a figure shows once, where it is
asked for.
"""

from qdil.plotting.archives import archives_side_by_side, behaviour_space, heatmap
from qdil.plotting.bars import bars, grid
from qdil.plotting.colours import method_colour, styles
from qdil.plotting.curves import learning_curves
from qdil.plotting.live import LiveArchive, live_figure
from qdil.plotting.style import METRICS, X_LABELS, label, label_measures, measure_labels, save, to_png

__all__ = [
    "METRICS",
    "X_LABELS",
    "LiveArchive",
    "archives_side_by_side",
    "bars",
    "behaviour_space",
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
