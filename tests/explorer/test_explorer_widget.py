"""The widget's side of the explorer, without a browser: what it accepts, answers and leaves behind."""

import base64
import json
import sys
from types import SimpleNamespace

import explorer_runs
import numpy as np
import pytest
import traitlets

import qdil
from qdil.explorer import page, showcase, shown
from qdil.explorer.pack import pack
from qdil.series.index import ROOT

CELLS = [0, 6, 7, 12, 18, 23]
pytestmark = pytest.mark.physics


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return explorer_runs.write(tmp_path_factory.mktemp("results") / "seed-1", CELLS)


@pytest.mark.parametrize(
    ("selected", "why"),
    [
        ([[0, 9999]], "'Expert' has no cell 9999: they go from 0 to 24"),
        ([[0, -1]], "no cell -1"),
        ([[1, 6]], "there is no run 1: they are numbered from 0 to 0"),
        ([6], "'6' is no pair of whole numbers"),
        ([[0, 6.5]], "no pair of whole numbers"),
        ([[0, cell] for cell in CELLS], "4 robots at most walk side by side, not 6"),
    ],
)
def test_cells_that_are_not_there_are_refused_in_a_sentence(folder, selected, why):
    view = qdil.explore(folder, live=True).view
    with pytest.raises(traitlets.TraitError, match=why):
        view.selected = selected
    assert view.selected == [[0, 23]]


def test_cells_may_come_as_tuples_and_as_numpys_numbers(folder):
    view = qdil.explore(folder, live=True).view
    view.selected = [(0, np.int64(6)), (np.int32(0), 1)]
    assert json.dumps(view.selected) == "[[0, 6], [0, 1]]"


def test_runs_and_fields_that_are_not_there_are_refused(folder):
    view = qdil.explore(folder, live=True).view
    with pytest.raises(traitlets.TraitError, match="run is the number of a run, 0 to 0"):
        view.run = -1
    with pytest.raises(traitlets.TraitError, match="against is the number of a run, -1 to 0"):
        view.against = 1
    with pytest.raises(traitlets.TraitError, match="length"):
        view.field = "length"


def test_every_error_of_the_kernel_is_sent_to_the_page(folder, monkeypatch):
    view = qdil.explore(folder, live=True).view
    sent = []
    monkeypatch.setattr(view, "send", lambda content, buffers=None: sent.append(content))
    monkeypatch.setattr(shown, "roll_out", lambda *_: (_ for _ in ()).throw(RuntimeError("out of memory")))
    view._answer(view, {"type": "want", "run": 0, "cell": 12}, [])
    why = "The rollout failed in the kernel (RuntimeError: out of memory)"
    assert sent == [{"type": "refused", "why": why, "run": 0, "cell": 12}]
    view._answer(view, {"type": "want"}, [])
    assert sent[1]["type"] == "refused"


def test_a_saved_widget_leaves_a_small_picture(folder):
    bundle = qdil.explore(folder, live=True)._repr_mimebundle_()
    assert "application/vnd.jupyter.widget-view+json" in bundle
    assert base64.b64decode(bundle["text/html"].split("base64,")[1].split('"')[0]).startswith(b"\x89PNG")
    assert len(bundle["text/html"]) < 40_000


def test_vs_code_is_known_by_its_variables(folder, monkeypatch):
    for name in ("JPY_SESSION_NAME", "VSCODE_PID", "VSCODE_CWD", "QDIL_EXPLORER"):
        monkeypatch.delenv(name, raising=False)
    shell = SimpleNamespace(user_ns={})
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    assert isinstance(qdil.explore(folder), page.Page)
    shell.user_ns["__vsc_ipynb_file__"] = "explore.ipynb"
    assert not isinstance(qdil.explore(folder), page.Page)
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: None))
    monkeypatch.setenv("VSCODE_CWD", "/")
    assert not isinstance(qdil.explore(folder), page.Page)


def test_runs_are_named_by_their_methods_unless_the_reader_names_them(folder):
    assert [one.name for one in shown.read({"true": folder, "my own": folder})] == ["Expert", "my own"]


def test_an_episode_of_the_showcase_takes_four_kilobytes():
    """A recording is 300 steps of 8 ms at most: 2.4 s, 150 poses, and every step's contacts and reward."""
    kept = showcase.kept("walker2d", ROOT / showcase.FOLDER)
    assert kept
    for folder in kept.values():
        run = shown.read(folder)[0]
        sizes = [len(pack(rollout)) for rollout in shown.roll_out(run, shown.spread_out(run, 12))]
        assert 3_000 < np.median(sizes) < 4_300
        assert max(sizes) < 5_000
