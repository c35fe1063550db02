"""An archive that redraws in a notebook while it fills."""

import time
from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure
from ribs.archives import GridArchive

from qdil.config import Config
from qdil.plotting.archives import heatmap
from qdil.plotting.style import to_png
from qdil.ppga import Search


class LiveArchive:
    """Watch an archive fill: give it to ``run.train`` as ``report``, in a notebook.

    One picture, redrawn in place at most every ``seconds`` and once at the end, with the progress as its title. It is
    a plain PNG, so an executed copy keeps the last one and nothing else. Nothing shows if no iteration is run.
    """

    def __init__(self, config: Config, seconds: float = 5.0) -> None:
        self.config, self.seconds = config, seconds
        self.begin, self.drawn = time.monotonic(), float("-inf")
        self.first: tuple[int, float] | None = None  # the first iteration seen, and when: before it, all compiles
        self.handle: Any = None  # of the picture, once there is one

    def __call__(self, search: Search, row: Mapping[str, float]) -> None:
        """Show one iteration, if the last picture is old enough or this is the last iteration."""
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

    def _progress(self, row: Mapping[str, float], last: bool) -> str:
        done, total, now = int(row["iteration"]), self.config.ppga.iterations, time.monotonic()
        first, since = self.first or (done, now)
        if last:
            clock = f", finished in {now - self.begin:.0f} s"
        else:
            clock = f", about {(now - since) / (done - first) * (total - done):.0f} s left" if done > first else ""
        return (
            f"{self.config.method} on {self.config.env}: iteration {done} of {total}{clock}\n"
            f"coverage {row['coverage']:.0%}, QD-score {row['qd_score']:,.0f}, best return {row['best']:,.0f}"
        )


def live_figure(archive: GridArchive, title: str, robot: str | None = None) -> Figure:
    """The result archive of a search in progress, drawn from pyribs' own arrays."""
    content: dict[str, Any] = {name: archive.data(name) for name in ("index", "measures", "true_return")}
    figure = Figure(figsize=(5.6, 4.4), dpi=100, layout="constrained")
    ax = figure.subplots()
    heatmap({**content, "cells": archive.dims}, ax, robot=robot)
    figure.suptitle(title, fontsize=10)
    return figure
