"""The explorer in a real browser: in JupyterLab with its kernel, and as a page from a file."""

import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import explorer_runs
import nbformat
import pytest

import qdil

CHROMIUM = os.environ.get("CHROMIUM", "/usr/bin/chromium")
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  # WebGL without a graphics card
BEST = 23  # the last of the cells below has the highest return

pytestmark = pytest.mark.skipif(not shutil.which(CHROMIUM), reason=f"no browser: {CHROMIUM} is not there")


class Watched:
    """A browser page that keeps what must not happen: complaints, and requests to other machines."""

    def __init__(self, page):
        self.page, self.complaints, self.strangers = page, [], []
        page.on("console", lambda said: self.complaints.append(said.text) if said.type == "error" else None)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", self._request)

    def _request(self, request):
        here = ("http://127.0.0.1", "ws://127.0.0.1", "file:", "data:", "blob:", "about:")
        if not request.url.startswith(here):
            self.strangers.append(request.url)

    def is_clean(self):
        assert self.strangers == []
        assert self.complaints == []


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        running = started.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield running
        running.close()


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    root = tmp_path_factory.mktemp("results")
    return {
        "true": explorer_runs.write(root / "true", [0, 6, 7, 12, 18, BEST]),
        "gail": explorer_runs.write(root / "gail", [6, 7, 13, BEST], "gail", seed=1),
        "lone": explorer_runs.write(root / "lone", [12], "gail"),
        "bare": explorer_runs.write(root / "bare", [6, 7, 12], with_policies=False),
    }


def centre(frame, cell, cells=explorer_runs.CELLS):
    """Where a cell lies on the heatmap, in CSS pixels, from the drawing's own margins."""
    box = frame.evaluate(
        "(() => { const b = document.querySelector('.qdil-map'); return [b.clientWidth, b.clientHeight]; })()"
    )
    size = min(box[0] - 50 - 74, box[1] - 10 - 46)
    first, second = divmod(cell, cells)
    return {"x": 50 + (first + 0.5) * size / cells, "y": 10 + size - (second + 0.5) * size / cells}


def click(frame, cell, **how):
    frame.locator(".qdil-map").click(position=centre(frame, cell), **how)


def labels(frame):
    return frame.locator(".qdil-label").evaluate_all("all => all.map(one => ({...one.dataset}))")


def wait_for(frame, state, count=1, timeout=120_000):
    frame.wait_for_function(
        "([state, count]) => document.querySelectorAll(`.qdil-label[data-state=${state}]`).length === count",
        arg=[state, count],
        timeout=timeout,
    )


def two_pictures(frame):
    """The robots' canvas now, and as soon as it looks different; at the latest after ten seconds."""
    take = "document.querySelector('.qdil-robots').toDataURL()"
    first = second = frame.evaluate(take)
    for _ in range(25):
        frame.wait_for_timeout(400)
        second = frame.evaluate(take)
        if second != first:
            break
    return first, second


@pytest.fixture
def opened(browser, tmp_path):
    """Opens a saved page from its file."""
    context = browser.new_context(viewport={"width": 1200, "height": 800})

    def open_(explored, script=None):
        path = explored.save(tmp_path / "page.html")
        watched = Watched(context.new_page())
        if script:
            watched.page.add_init_script(script)
        watched.page.goto(path.as_uri())
        watched.page.wait_for_selector(".qdil-explorer")
        return watched

    yield open_
    context.close()


def test_a_page_plays_what_is_clicked(opened, runs):
    watched = opened(qdil.explore(runs["true"], live=False))
    page = watched.page
    wait_for(page, "plays")
    assert labels(page)[0]["cell"] == str(BEST)
    click(page, 6)
    wait_for(page, "plays")
    shown = labels(page)[0]
    assert (shown["cell"], float(shown["return"])) == ("6", 161.5)
    assert "161.5" in page.locator(".qdil-label").inner_text()
    first, second = two_pictures(page)
    assert first != second
    watched.is_clean()


def test_keys_move_through_cells_and_an_empty_one_says_so(opened, runs):
    watched = opened(qdil.explore(runs["true"], live=False))
    page = watched.page
    wait_for(page, "plays")
    click(page, 7)
    page.keyboard.press("ArrowUp")  # 8 is empty
    assert labels(page)[0]["state"] == "empty"
    assert "Empty cell" in page.locator(".qdil-status").inner_text()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowRight")
    assert labels(page)[0]["cell"] == "12"
    page.keyboard.press("b")
    assert labels(page)[0]["cell"] == str(BEST)
    page.keyboard.press(" ")
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")  # is drawn
    stopped = page.locator(".qdil-explorer").get_attribute("data-time")
    page.wait_for_timeout(300)
    assert page.locator(".qdil-explorer").get_attribute("data-time") == stopped
    page.keyboard.press(".")
    page.wait_for_timeout(100)
    assert page.locator(".qdil-explorer").get_attribute("data-time") != stopped
    watched.is_clean()


def test_up_to_four_robots_walk_in_step_and_any_size_will_do(opened, runs):
    watched = opened(qdil.explore([runs["true"], runs["gail"]], live=False))
    page = watched.page
    wait_for(page, "plays")
    for cell in (0, 6, 7, 12):
        click(page, cell, modifiers=["Shift"])
    wait_for(page, "plays", 4)
    assert [one["cell"] for one in labels(page)] == ["0", "6", "7", "12"]
    page.set_viewport_size({"width": 480, "height": 900})
    page.wait_for_timeout(300)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    click(page, 18)
    wait_for(page, "plays")
    assert labels(page)[0]["cell"] == "18"
    page.locator(".qdil-menus select").nth(0).select_option("1")
    click(page, 13)
    wait_for(page, "plays")
    assert labels(page)[0]["run"] == "1"
    page.locator(".qdil-menus select").nth(2).select_option("0")
    assert "minus" in page.locator(".qdil-title").inner_text()
    watched.is_clean()


def test_an_archive_of_one_cell(opened, runs):
    watched = opened(qdil.explore(runs["lone"], live=False))
    wait_for(watched.page, "plays")
    assert labels(watched.page)[0]["cell"] == "12"
    watched.is_clean()


def test_the_slider_replays_how_the_archive_filled(opened, runs, tmp_path):
    path = explorer_runs.write(tmp_path / "remembers", [6, 12])
    explorer_runs.write_history(path, [1, 4, 9], [6, 12, 12], last=10)
    watched = opened(qdil.explore([path, runs["gail"]], live=False))
    page = watched.page
    wait_for(page, "plays")
    end = page.evaluate("document.querySelector('.qdil-map').toDataURL()")
    said = {}
    for iteration in ("1", "4", "10"):
        page.locator(".qdil-menus input[type=range]").fill(iteration)
        page.locator(".qdil-map").hover(position=centre(page, 12))
        said[iteration] = page.locator(".qdil-tip").inner_text(), page.locator(".qdil-title").inner_text()
        if iteration != "10":
            assert page.evaluate("document.querySelector('.qdil-map').toDataURL()") != end
    assert said["1"][0].startswith("After iteration 1: none.") and said["4"][0].startswith("After iteration 4: 10.5.")
    assert said["10"][0].startswith("Cell at") and "after" not in said["10"][1]
    assert said["1"][1].endswith("after iteration 1")
    page.locator(".qdil-menus input[type=range]").fill("4")
    page.locator(".qdil-menus select").nth(1).select_option("fitness")
    page.locator(".qdil-map").hover(position=centre(page, 6))
    page.locator(".qdil-map").hover(position=centre(page, 12))
    assert page.locator(".qdil-tip").inner_text().startswith("After iteration 4: 2.0")
    page.locator(".qdil-menus select").nth(0).select_option("1")  # a run that kept no history shows its end
    assert "after" not in page.locator(".qdil-title").inner_text()
    watched.is_clean()


def test_without_webgl_and_in_a_dark_theme_robots_walk_too(opened, runs):
    refuse = "HTMLCanvasElement.prototype.getContext = new Proxy(HTMLCanvasElement.prototype.getContext, {"
    refuse += "apply: (f, canvas, [kind, ...rest]) => kind.startsWith('webgl') ? null : f.call(canvas, kind, ...rest)})"
    watched = opened(qdil.explore(runs["true"], live=False), script=refuse)
    wait_for(watched.page, "plays")
    light = watched.page.evaluate("document.querySelector('.qdil-map').toDataURL()")
    watched.page.add_style_tag(content=":root { --jp-layout-color1: #111; --jp-ui-font-color1: #eee }")  # JupyterLab's
    watched.page.evaluate("document.body.dataset.jpThemeName = 'JupyterLab Dark'")
    click(watched.page, 6)
    wait_for(watched.page, "plays")
    first, second = two_pictures(watched.page)
    assert first != second
    assert watched.page.evaluate("document.querySelector('.qdil-map').toDataURL()") != light
    if os.environ.get("QDIL_SCREENSHOT"):
        watched.page.screenshot(path=os.environ["QDIL_SCREENSHOT"])
    assert watched.strangers == []
    assert [line for line in watched.complaints if "webgl" not in line.lower()] == []


def test_without_policies_the_heatmap_still_works_and_says_why_no_robot_walks(opened, runs):
    watched = opened(qdil.explore(runs["bare"], live=False))
    click(watched.page, 7)
    shown = labels(watched.page)[0]
    assert (shown["state"], float(shown["return"])) == ("none", 171.75)
    assert "policies are not on this machine" in watched.page.locator(".qdil-label").inner_text()
    watched.is_clean()


def test_a_notebooks_output_is_live_over_its_picture(browser, runs, tmp_path):
    html = qdil.explore(runs["true"], live=False)._repr_html_()
    (tmp_path / "output.html").write_text(f"<!doctype html>{html}")
    page = browser.new_page()
    watched = Watched(page)
    page.goto((tmp_path / "output.html").as_uri())
    frame = page.frame_locator("iframe")
    frame.locator(".qdil-label[data-state=plays]").wait_for()
    assert page.locator("img").evaluate("image => image.naturalWidth") > 500
    watched.is_clean()
    page.close()


@pytest.fixture(scope="module")
def lab(tmp_path_factory, runs):
    """JupyterLab on a free port of this machine, and the folder that it serves."""
    folder = tmp_path_factory.mktemp("lab")
    cells = [
        "import json, qdil\n"
        f"explored = qdil.explore([{str(runs['true'])!r}, {str(runs['gail'])!r}])\n"
        "def note(change): open('chosen.json', 'w').write(json.dumps(change['new']))\n"
        "explored.view.observe(note, 'selected')\n"
        "explored"
    ]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source) for source in cells])
    notebook.metadata.kernelspec = {"name": "python3", "display_name": "Python 3", "language": "python"}
    nbformat.write(notebook, folder / "explore.ipynb")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root", "--ip=127.0.0.1", f"--port={port}"]
    command += ["--IdentityProvider.token=", "--ServerApp.port_retries=0", f"--ServerApp.root_dir={folder}"]
    command += ["--LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate", "--LabApp.news_url=None"]
    quiet = {**os.environ, "JUPYTER_CONFIG_DIR": str(folder / "config"), "JUPYTERLAB_SETTINGS_DIR": str(folder / "set")}
    quiet |= {"JUPYTERLAB_WORKSPACES_DIR": str(folder / "spaces")}
    with open(folder / "lab.log", "w") as log:
        server = subprocess.Popen(command, stdout=log, stderr=log, env=quiet, cwd=folder)
    try:
        yield _answering(f"http://127.0.0.1:{port}", server, folder), folder
    finally:
        server.terminate()
        server.wait(30)


def _answering(url: str, server: subprocess.Popen, folder: Path) -> str:
    for _ in range(120):
        try:
            urllib.request.urlopen(f"{url}/api/status", timeout=1).close()
            return url
        except OSError:
            assert server.poll() is None, (folder / "lab.log").read_text()
            time.sleep(0.5)
    raise TimeoutError((folder / "lab.log").read_text())


def run_first_cell(page) -> None:
    """Shift+Enter, as often as it takes: a cell run before JupyterLab has its kernel is forgotten, or a dialog asks."""
    prompt = page.locator(".jp-CodeCell .jp-InputPrompt").first
    prompt.wait_for(timeout=60_000)
    page.wait_for_selector(".jp-Toolbar-kernelName:has-text('Python 3')")
    for _ in range(20):
        select = page.locator("dialog .jp-mod-accept")
        if select.count():
            select.click()
        else:
            page.locator(".jp-CodeCell .cm-content").first.click()
            page.keyboard.press("Shift+Enter")
        page.wait_for_timeout(3000)
        if prompt.inner_text() != "[ ]:":
            return
    raise TimeoutError("no kernel took the cell")


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
    click(page, 12)
    wait_for(page, "plays")
    took = []
    for cell in (6, 12, 6):
        begin = time.monotonic()
        click(page, cell)
        page.wait_for_function(f"document.querySelector('.qdil-label[data-state=plays]')?.dataset.cell === '{cell}'")
        took.append(time.monotonic() - begin)
    chosen = folder / "chosen.json"
    page.wait_for_timeout(200)
    assert json.loads(chosen.read_text()) == [[0, 6]]
    assert float(labels(page)[0]["return"]) == 161.5
    first, second = two_pictures(page)
    assert first != second
    page.keyboard.press("ArrowRight")  # not JupyterLab's own key while the heatmap has the focus
    page.wait_for_timeout(500)
    assert labels(page)[0]["state"] == "empty"
    page.locator(".widget-dropdown select").first.select_option("GAIL")
    page.wait_for_function("document.querySelector('.qdil-title').innerText.includes('GAIL')")
    click(page, 13)
    wait_for(page, "plays")
    assert json.loads(chosen.read_text()) == [[1, 13]]
    if os.environ.get("QDIL_SCREENSHOT"):
        page.screenshot(path=os.environ["QDIL_SCREENSHOT"])
    watched.is_clean()
    context.close()
    assert min(took) < 1  # half a second on two idle cores; other work may be going on
