"""The explorer where no kernel is: in an executed copy as nbconvert makes web pages of it."""

import io
import os
import subprocess
import sys

import nbformat
import pytest
from explorer_browser import BEST, Watched, labels, needs_browser, notebook
from nbconvert import HTMLExporter
from PIL import Image

import qdil
from qdil.explorer import READER_VARIABLES

pytest_plugins = ["explorer_browser"]
pytestmark = [needs_browser, pytest.mark.physics]
LOCAL = {"mathjax_url": "", "require_js_url": ""}  # what a page of nbconvert's would otherwise load from elsewhere


@pytest.fixture(scope="module")
def executed(tmp_path_factory, runs):
    """A notebook that a batch run executed: no person is there to click."""
    folder = tmp_path_factory.mktemp("executed")
    nbformat.write(notebook(f"import qdil\nqdil.explore({str(runs['true'])!r})"), folder / "explore.ipynb")
    alone = {name: value for name, value in os.environ.items() if name not in READER_VARIABLES}
    command = [sys.executable, "-m", "nbconvert", "--execute", "--to", "notebook", "--inplace", "explore.ipynb"]
    subprocess.run(command, cwd=folder, env=alone, check=True, capture_output=True)
    return nbformat.read(folder / "explore.ipynb", as_version=4)


def opened_html(page, tmp_path, node):
    body, _ = HTMLExporter(**LOCAL).from_notebook_node(node)
    (tmp_path / "exported.html").write_text(body)
    watched = Watched(page)
    page.goto((tmp_path / "exported.html").as_uri())
    return watched


def test_an_executed_copy_as_a_web_page_is_live_over_its_picture(browser, executed, tmp_path):
    watched = opened_html(browser.new_page(), tmp_path, executed)
    frame = watched.page.frame_locator("iframe")
    frame.locator(".qdil-label[data-state=plays]").wait_for()
    assert frame.locator(".qdil-label").get_attribute("data-cell") == str(BEST)
    inside = watched.page.frames[-1]
    assert labels(inside)[0]["state"] == "plays"
    assert watched.page.locator("img").evaluate("image => image.naturalWidth") > 500
    watched.is_clean()
    watched.page.close()


def test_an_executed_copy_shows_its_picture_where_no_script_may_run(browser, executed, tmp_path):
    context = browser.new_context(java_script_enabled=False)
    page = opened_html(context.new_page(), tmp_path, executed).page
    seen = Image.open(io.BytesIO(page.locator("img").screenshot()))  # with what lies over it
    assert seen.width > 500
    assert len(seen.convert("RGB").getcolors(1 << 20)) > 200  # a robot in its light, not an empty frame
    context.close()


def test_a_live_notebook_that_was_saved_shows_its_map_as_a_web_page(browser, runs, tmp_path):
    bundle = qdil.explore(runs["true"], live=True)._repr_mimebundle_()
    saved = notebook("qdil.explore(run)")
    saved.cells[0].outputs = [nbformat.v4.new_output("execute_result", bundle, execution_count=1)]
    watched = opened_html(browser.new_page(), tmp_path, saved)
    assert watched.page.locator("img").evaluate("image => image.naturalWidth") > 400
    watched.is_clean()
    watched.page.close()
