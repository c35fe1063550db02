"""What ``train`` reports while it runs: the protocol, and an adapter for plain functions."""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from qdil.ppga import Search


class Report(Protocol):
    """Receives the progress of a run, for example ``Progress`` or ``plotting.LiveArchive``."""

    def announce(self, folder: Path, reached: tuple[int, int] | None) -> None:
        """Called once, before training starts or resumes in ``folder``.

        ``reached``: warm-up updates and QD iterations that the newest checkpoint holds; None for a new run.
        """

    def __call__(self, search: Search, row: dict[str, float]) -> None:
        """Called after every QD iteration with the search and its row of ``metrics.csv``."""


class AfterIteration:
    """A ``Report`` from a plain function of the search and its row of metrics."""

    def __init__(self, function: Callable[[Search, dict[str, float]], object]) -> None:
        self.function = function

    def announce(self, folder: Path, reached: tuple[int, int] | None) -> None:
        """Nothing happens before the first iteration."""

    def __call__(self, search: Search, row: dict[str, float]) -> None:
        """Call the function."""
        self.function(search, row)
