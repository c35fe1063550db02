"""The explorer in JupyterLab: with its kernel, by a newcomer's path, and in a saved notebook without one."""

import functools
import json
import os
import shutil

import nbformat
import numpy as np
import pytest
from explorer_browser import (
    BEST,
    Watched,
    click,
    drawn,
    labels,
    needs_browser,
    notebook,
    run_first_cell,
    two_pictures,
    wait_for,
)

import qdil
from qdil.explorer import showcase
from qdil.series.index import NOTEBOOKS, ROOT

pytest_plugins = ["explorer_browser"]
pytestmark = [needs_browser, pytest.mark.physics]


# Resolves to the seconds from the next click to when its robot is there. The clock is the page's: the test's own would
# count Playwright's looking for the place to click.
STOPWATCH = """cell => {
  globalThis.took = new Promise((done) => document.addEventListener("click", () => {
    const begin = performance.now();
    new MutationObserver((_, observer) => {
      if (document.querySelector(".qdil-label[data-state=plays]")?.dataset.cell !== `${cell}`) return;
      observer.disconnect();
      done((performance.now() - begin) / 1000);
    }).observe(document.querySelector(".qdil-labels"), { childList: true });
  }, { capture: true, once: true }));
}"""


def seconds_until_it_plays(page, cell: int, cells: int) -> float:
    page.evaluate(STOPWATCH, cell)
    click(page, cell, cells=cells)
    return page.evaluate("() => globalThis.took")


def is_quick(took: list[float]) -> bool:
    """Half a second on idle cores; longer by as much as others use them."""
    crowd = max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))
    print(f"seconds from click to robot: {[round(one, 2) for one in took]}, {crowd:.1f} processes for each core")
    return sorted(took)[len(took) // 2] < 0.5 * crowd


def is_chosen(page, path, cells) -> bool:
    """Does the kernel write, within ten seconds, that these are the chosen cells?"""
    for _ in range(50):
        if path.exists() and path.read_text() == json.dumps(cells):
            return True
        page.wait_for_timeout(200)
    return False


def test_in_jupyterlab_a_click_reaches_the_kernel_and_its_robot_walks(browser, lab):
    url, folder = lab
    context = browser.new_context(viewport={"width": 1400, "height": 1000})
    watched = Watched(context.new_page())
    page = watched.page
    page.goto(f"{url}/lab/tree/explore.ipynb")
    run_first_cell(page)
    page.wait_for_selector(".qdil-explorer", timeout=120_000)
    wait_for(page, "plays", timeout=240_000)
    assert labels(page)[0]["cell"] == str(BEST)
    pause(page)
    took = [seconds_until_it_plays(page, cell, 5) for cell in (7, 18, 0, 6)]  # none was seen before
    page.get_by_role("button", name="Play", exact=False).last.click()
    chosen = folder / "chosen.json"
    assert is_chosen(page, chosen, [[0, 6]])
    assert float(labels(page)[0]["return"]) == 161.5
    first, second = two_pictures(page)
    assert first != second
    page.locator(".qdil-map").focus()
    there = page.locator(".jp-Notebook-cell").count()
    page.keyboard.press("ArrowRight")  # not JupyterLab's own key while the heatmap has the focus
    page.wait_for_timeout(500)
    assert labels(page)[0]["state"] == "empty"
    page.keyboard.press("b")  # nor this one, which would add a notebook's cell
    page.keyboard.press("Enter")
    assert labels(page)[0]["cell"] == str(BEST)
    assert page.locator(".jp-Notebook-cell").count() == there
    page.locator(".widget-dropdown select").first.select_option("GAIL")
    page.wait_for_function("document.querySelector('.qdil-title').innerText.includes('GAIL')")
    click(page, 13)
    wait_for(page, "plays")
    assert is_chosen(page, chosen, [[1, 13]])
    if os.environ.get("QDIL_SCREENSHOT"):
        page.screenshot(path=f"{os.environ['QDIL_SCREENSHOT']}.newcomer.png")
    resized(page)
    watched.is_clean()
    context.close()
    assert is_quick(took)


def pause(page) -> None:
    """Without a graphics card the moving picture alone keeps both cores busy; what is timed is the kernel's answer."""
    page.get_by_role("button", name="Pause", exact=False).click()


def resized(page) -> None:
    """The widget keeps to its place in a narrower window, and clicks go where they point."""
    wide = page.locator(".qdil-map").bounding_box()["width"]
    page.set_viewport_size({"width": 800, "height": 1000})
    page.wait_for_function(f"Math.abs(document.querySelector('.qdil-map').clientWidth - {wide}) > 5")
    drawn(page)
    root = page.locator(".qdil-explorer")
    assert root.evaluate("root => root.scrollWidth <= root.clientWidth")
    click(page, 7)
    wait_for(page, "plays")
    assert labels(page)[0]["cell"] == "7"


def test_a_newcomer_runs_the_notebook_clicks_and_a_robot_walks(browser, lab):
    """The repository's own notebook, opened in JupyterLab, all cells run by the menu."""
    url, folder = lab
    shutil.copyfile(NOTEBOOKS / "12_explore.ipynb", folder / "12_explore.ipynb")
    context = browser.new_context(viewport={"width": 1500, "height": 1050})
    page = context.new_page()
    # A workspace of its own: the usual one would open again, in a hidden panel, what another test had opened.
    page.goto(f"{url}/lab/workspaces/newcomer/tree/12_explore.ipynb")
    page.wait_for_selector(".jp-Toolbar-kernelName:has-text('Python 3')", timeout=120_000)
    page.wait_for_selector(".jp-NotebookPanel-toolbar [data-status=idle]", timeout=120_000)
    page.get_by_role("menuitem", name="Run", exact=True).click()
    page.get_by_role("menuitem", name="Run All Cells", exact=True).click()
    page.wait_for_selector(".qdil-explorer", timeout=240_000)
    wait_for(page, "plays", timeout=240_000)
    page.locator(".qdil-explorer").scroll_into_view_if_needed()
    filled = []
    for folder in showcase.kept("walker2d", ROOT / showcase.FOLDER).values():
        with np.load(folder / "archive.npz") as archive:
            filled, side = [*filled, archive["index"]], int(archive["cells"][0])
    common = functools.reduce(np.intersect1d, filled)  # whichever run the notebook shows first
    pause(page)
    took = [seconds_until_it_plays(page, int(cell), side) for cell in common[[20, len(common) // 2, -20]]]
    page.get_by_role("button", name="Play", exact=False).last.click()
    first, second = two_pictures(page)
    assert first != second
    assert page.locator("[data-mime-type*=error], [data-mime-type*=stderr]").count() == 0
    if os.environ.get("QDIL_SCREENSHOT"):
        page.screenshot(path=f"{os.environ['QDIL_SCREENSHOT']}.newcomer.png")
    context.close()
    assert is_quick(took)


def test_a_saved_copy_that_is_not_trusted_shows_its_picture(browser, lab, runs):
    """JupyterLab takes frames out of a notebook that came from elsewhere; the picture under them remains."""
    url, folder = lab
    saved = notebook("qdil.explore(run)")
    html = qdil.explore(runs["true"], live=False)._repr_html_()
    saved.cells[0].outputs = [nbformat.v4.new_output("execute_result", {"text/html": html}, execution_count=1)]
    nbformat.write(saved, folder / "saved.ipynb")
    page = browser.new_page()
    page.goto(f"{url}/lab/workspaces/saved/tree/saved.ipynb")
    picture = page.locator(".jp-RenderedHTML img")
    picture.wait_for(timeout=60_000)
    assert picture.evaluate("image => image.decode().then(() => image.naturalWidth)") > 500
    assert page.locator(".jp-RenderedHTML iframe").count() == 0
    page.close()
