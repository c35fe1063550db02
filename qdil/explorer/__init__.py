"""The archive explorer: click a cell, watch that robot move; in a notebook, in a page of its own, or in a film."""

import os
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from qdil.explorer import shown as showing
from qdil.explorer.film import render
from qdil.explorer.page import RECORDINGS, Page
from qdil.explorer.shown import Runs
from qdil.extras import needs

if TYPE_CHECKING:
    from qdil.explorer.widget import Explorer

__all__ = ["explore", "render"]

FORM = "QDIL_EXPLORER"  # an environment variable: "live" or "page" overrules what is found out
# Set for kernels that Jupyter or VS Code started for a reader, the second not under WSL, nor the third in containers.
SIGNS_OF_LIFE = ("JPY_SESSION_NAME", "VSCODE_PID", "VSCODE_CWD")
VSCODES_VARIABLE = "__vsc_ipynb_file__"  # what VS Code tells a notebook of itself, wherever its kernel runs


def explore(
    runs: Runs, config: Mapping[str, Any] | None = None, live: bool | None = None, recordings: int = RECORDINGS
) -> "Explorer | Page":
    """Explore archives: click a cell of the heatmap, and that elite walks.

    ``runs``: a run's folder; an archive as ``run.read_archive`` gives it, with policies (then ``config``, the settings
    as ``run.read_config`` gives them, lets its robots walk); or several of either by name, to switch between and
    compare on one colour scale.

    In a live notebook this is a widget that rolls out whatever is clicked. Where nobody is there to click (papermill,
    nbconvert), or with ``live`` False, it is a page that plays about ``recordings`` episodes, has a picture for where
    scripts may not run, and can be saved (``.save(path)``). Raises ConfigError for runs that are not there or don't go
    together.
    """
    read = showing.read(runs, config)
    first = next((i for i, one in enumerate(read) if one.plays and len(one.archive["index"])), 0)
    chosen = [[first, showing.best_cell(read[first])]] if len(read[first].archive["index"]) else []
    state = {"run": first, "selected": chosen}
    if _is_live() if live is None else live:
        with needs("explorer", "the explorer in a live notebook"):
            from qdil.explorer.widget import Explorer
        return Explorer(read, state)
    return Page(read, state, recordings)


def _is_live() -> bool:
    form = os.environ.get(FORM)
    if form:
        return form == "live"
    return any(sign in os.environ for sign in SIGNS_OF_LIFE) or VSCODES_VARIABLE in _users_variables()


def _users_variables() -> Mapping[str, Any]:
    """The variables of the notebook, if this is one."""
    ipython = sys.modules.get("IPython")  # there, if this is one; importing it otherwise takes half a second
    shell = ipython.get_ipython() if ipython else None
    return shell.user_ns if shell else {}
