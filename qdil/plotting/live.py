"""An archive that redraws in a notebook while it fills."""

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from qdil.config import Config
from qdil.names import title
from qdil.plotting.archives import one_archive
from qdil.plotting.style import to_png

if TYPE_CHECKING:  # both are slow to import, and one brings JAX
    from ribs.archives import GridArchive

    from qdil.ppga import Search


class LiveArchive:
    """A heatmap in a notebook that is redrawn while an archive fills: pass it to ``train`` as ``report``.

    It is redrawn in place at most every ``seconds`` and once at the end, with the progress as its title. The picture
    is a plain PNG, so an executed notebook keeps the last one and nothing else. Without an iteration nothing is shown.
    """

    def __init__(self, config: Config, seconds: float = 5.0) -> None:
        self.config, self.seconds = config, seconds
        self.begin, self.drawn = time.monotonic(), float("-inf")
        self.first: tuple[int, float] | None = None  # the first iteration and its time; programs compile before it
        self.handle: Any = None  # of the picture, once there is one

    def __call__(self, search: "Search", row: Mapping[str, float]) -> None:
        """Redraw if the last picture is old enough or this is the last iteration. ``row``: metrics of the iteration."""
        last = row["iteration"] == self.config.ppga.iterations
        self.first = self.first or (int(row["iteration"]), time.monotonic())
        if not last and time.monotonic() - self.drawn < self.seconds:
            return
        from IPython.display import Image, display

        text = self._progress(row, last)
        figure = live_figure(search.archives.result, text, self.config.env)
        picture = Image(to_png(figure), format="png", alt=text)
        if self.handle is None:
            self.handle = display(picture, display_id=True)
        else:
            self.handle.update(picture)
        self.drawn = time.monotonic()

    def announce(self, folder: object, reached: tuple[int, int] | None) -> None:
        """Nothing is drawn before the first iteration (``qdil.runs.report.Report``)."""

    def _progress(self, row: Mapping[str, float], last: bool) -> str:
        done, total, time_now = int(row["iteration"]), self.config.ppga.iterations, time.monotonic()
        first, since = self.first or (done, time_now)
        if last:
            clock = f", finished in {time_now - self.begin:.0f} s"
        else:
            clock = f", about {(time_now - since) / (done - first) * (total - done):.0f} s left" if done > first else ""
        return (
            f"{title(self.config.method)} on {self.config.env}: iteration {done} of {total}{clock}\n"
            f"coverage {row['coverage']:.0%}, QD-score {row['qd_score']:,.0f}, best return {row['best']:,.0f}"
        )


def live_figure(archive: "GridArchive", heading: str, robot: str | None = None) -> Figure:
    """The result archive of a search in progress, read from pyribs' own arrays."""
    content: dict[str, Any] = {name: archive.data(name) for name in ("index", "true_return")}
    return one_archive({**content, "cells": archive.dims}, heading, robot=robot)[0]
