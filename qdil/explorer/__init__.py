"""The archive explorer: click a cell, watch that robot move; in a notebook, on a web page, or in a film."""

import os
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from qdil.explorer import shown as showing
from qdil.explorer.film import render
from qdil.explorer.page import RECORDINGS, Page
from qdil.explorer.projection import axes_choices
from qdil.explorer.shown import Runs
from qdil.extras import needs

if TYPE_CHECKING:
    from qdil.explorer.widget import Explorer

__all__ = ["explore", "render"]

# Environment variables of kernels that Jupyter or VS Code started for a person. VSCODE_PID is missing under WSL,
# VSCODE_CWD in containers.
READER_VARIABLES = ("JPY_SESSION_NAME", "VSCODE_PID", "VSCODE_CWD")
VSCODE_NOTEBOOK = "__vsc_ipynb_file__"  # a variable that VS Code defines in every notebook, wherever its kernel runs
# ``QDIL_EXPLORER=page`` gives a page in spite of these variables. The program that executes the notebooks sets it: its
# kernels inherit the variables when it is itself started inside Jupyter, and their cells cannot take an argument.
PAGE_VARIABLE, PAGE_VALUE = "QDIL_EXPLORER", "page"


def explore(
    runs: Runs, config: Mapping[str, Any] | None = None, live: bool | None = None, recordings: int = RECORDINGS
) -> "Explorer | Page":
    """Explore archives: click a cell of the map, and that elite walks.

    ``runs``: a run's folder; an archive as ``read_archive`` returns it, with policies (then ``config``, the settings
    as ``read_config`` returns them, lets its robots walk); or several of either by name, to switch between them and to
    compare them on one colour scale.

    The map shows one measure as a strip and two as a square. Of more than two measures it shows two that the reader
    chooses, and in each square the best elite over the others.

    ``live`` True gives a widget: it rolls out every clicked elite. False gives a page: it plays about ``recordings``
    episodes, holds a picture for places where scripts may not run, and can be saved (``.save(path)``). None gives a
    widget where a person reads the notebook, and a page elsewhere (papermill, nbconvert, a script). Raises ConfigError
    for runs that do not exist or cannot be shown together.
    """
    archives = showing.read(runs, config)
    first = next((i for i, one in enumerate(archives) if one.plays and len(one.archive["index"])), 0)
    chosen = [[first, showing.best_cell(archives[first])]] if len(archives[first].archive["index"]) else []
    state = {"run": first, "axes": list(axes_choices(archives[first].k)[0]), "selected": chosen}
    if has_reader() if live is None else live:
        with needs("explorer", "the explorer in a live notebook"):
            from qdil.explorer.widget import Explorer
        return Explorer(archives, state)
    return Page(archives, state, recordings)


def has_reader() -> bool:
    """Whether a person reads this notebook while it runs."""
    if os.environ.get(PAGE_VARIABLE) == PAGE_VALUE:
        return False
    return any(name in os.environ for name in READER_VARIABLES) or VSCODE_NOTEBOOK in _notebook_variables()


def _notebook_variables() -> Mapping[str, Any]:
    """The variables of the notebook; none outside a notebook."""
    ipython = sys.modules.get("IPython")  # a notebook has imported it; importing it here would take half a second
    shell = ipython.get_ipython() if ipython else None
    return shell.user_ns if shell else {}
