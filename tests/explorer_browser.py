"""What the explorer's tests in a browser share: the browser, runs to show, JupyterLab, and ways to click and wait."""

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
SOURCES = Path(qdil.__file__).parent / "explorer" / "frontend" / "src"
BEST = 23  # the last of the cells below has the highest return

# Where QDIL_REQUIRE_BROWSER is set, as where every change is checked, a browser that is missing is a failure.
needs_browser = pytest.mark.skipif(
    not shutil.which(CHROMIUM) and not os.environ.get("QDIL_REQUIRE_BROWSER"),
    reason=f"no browser: {CHROMIUM} is not there",
)


class Watched:
    """A browser page that keeps what must not happen: complaints, and requests to other machines."""

    def __init__(self, page):
        self.page, self.complaints, self.strangers = page, [], []
        page.on("console", lambda message: self.complaints.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", self._request)

    def _request(self, request):
        here = ("http://127.0.0.1", "ws://127.0.0.1", "file:", "data:", "blob:", "about:")
        if not request.url.startswith(here):
            self.strangers.append(request.url)

    def is_clean(self):
        assert self.strangers == []
        assert self.complaints == []


@pytest.fixture(scope="module")  # no longer: while Playwright runs, nothing else may start an event loop
def browser():
    from playwright.sync_api import sync_playwright

    assert shutil.which(CHROMIUM), f"QDIL_REQUIRE_BROWSER is set, and {CHROMIUM} is not there"
    with sync_playwright() as started:
        running = started.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield running
        running.close()


@pytest.fixture(scope="session")
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


def click(frame, cell, cells=explorer_runs.CELLS, **how):
    frame.locator(".qdil-map").click(position=centre(frame, cell, cells), **how)


def labels(frame):
    return frame.locator(".qdil-label").evaluate_all("all => all.map(one => ({...one.dataset}))")


def wait_for(frame, state, count=1, timeout=120_000):
    frame.wait_for_function(
        "([state, count]) => document.querySelectorAll(`.qdil-label[data-state=${state}]`).length === count",
        arg=[state, count],
        timeout=timeout,
    )


def script(page, exposed: str, *names: str) -> None:
    """Let a page call what the front end's own files define: ``exposed`` of ``names``, without their imports."""
    lines = [line for name in names for line in (SOURCES / name).read_text().splitlines() if line[:7] != "import "]
    page.add_script_tag(type="module", content="\n".join([*lines, f"globalThis.q = {{ {exposed} }};"]))
    page.wait_for_function("globalThis.q")


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


def drawn(frame) -> None:
    """Wait until what was just asked for is on the screen."""
    frame.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def time_shown(frame) -> float:
    """Seconds of the episode, as they were drawn last."""
    return float(frame.locator(".qdil-explorer").get_attribute("data-time"))


def notebook(source: str):
    """A notebook of one cell."""
    made = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source)])
    made.metadata.kernelspec = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return made


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


@pytest.fixture(scope="module")
def lab(tmp_path_factory, runs):
    """JupyterLab on a free port of this machine, and the folder that it serves, with ``explore.ipynb``."""
    folder = tmp_path_factory.mktemp("lab")
    source = (
        "import json, qdil\n"
        f"explored = qdil.explore([{str(runs['true'])!r}, {str(runs['gail'])!r}])\n"
        "def note(change): open('chosen.json', 'w').write(json.dumps(change['new']))\n"
        "explored.view.observe(note, 'selected')\n"
        "explored"
    )
    nbformat.write(notebook(source), folder / "explore.ipynb")
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
