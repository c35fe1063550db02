"""The series as web pages: links lead somewhere, formulas and pages in frames work, and nothing needs the network."""

import base64
import contextlib
import io
import threading
from html import escape
from html.parser import HTMLParser
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote

import nbformat
import pytest
from explorer_browser import Watched, needs_browser
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output
from PIL import Image

from qdil.config import ConfigError
from qdil.series import index, site

pytest_plugins = ["explorer_browser"]
pytestmark = pytest.mark.physics  # a browser
FIRST, SECOND, THIRD = index.read()[:3]
INNER = "<p></p><script>document.querySelector('p').textContent = 6 * 7</script>"
FRAME = f'<iframe srcdoc="{escape(INNER)}"></iframe>'
PARAMETERS = [
    new_code_cell("budget = 'unused'", metadata={"tags": ["parameters"]}),
    new_code_cell("budget = 'replaced'", metadata={"tags": ["injected-parameters"]}),
]
TEXT = f"""# The first page

Inline $x_\\theta$, and an equation:

$$y = \\sum_i x_i, \\qquad \\mathbb{{E}}[y] = 1 \\tag{{17}}$$

$$\\begin{{aligned}} a &= b \\\\ c &= d \\end{{aligned}}$$

[next]({SECOND.name}.ipynb#Part-two), [code](../qdil/ppga.py), [how claims are judged](../docs/claims.md),
[lost]({THIRD.name}.ipynb), [folder](../qdil).
"""


def write(folder: Path, name: str, text: str, html: str = "<b>a table</b>") -> None:
    picture = io.BytesIO()
    Image.new("RGB", (900, 30), "red").save(picture, "PNG")
    outputs = [
        new_output("display_data", {"text/html": html, "text/plain": "an object"}),
        new_output(
            "display_data", {"image/png": base64.b64encode(picture.getvalue()).decode(), "text/plain": "a figure"}
        ),
        new_output("display_data", {"text/markdown": f"[first]({FIRST.name}.ipynb) and $z$", "text/plain": ""}),
    ]
    cells = [*PARAMETERS, new_markdown_cell(text), new_code_cell("1 + 1", outputs=outputs, execution_count=1)]
    path = folder / f"{name}.ipynb"
    path.parent.mkdir(parents=True, exist_ok=True)
    language = {"name": "python", "pygments_lexer": "ipython3"}
    nbformat.write(new_notebook(cells=cells, metadata={"language_info": language}), path)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A site of two notebooks, and what Sphinx complained about."""
    folder = tmp_path_factory.mktemp("site")
    write(folder / "smoke", FIRST.name, TEXT, FRAME)
    write(
        folder / "smoke", SECOND.name, "# The second page\n\n## Part two\n\nA zebrafinch. [away](https://example.org)"
    )
    complaints = io.StringIO()
    with contextlib.redirect_stderr(complaints):
        assert site.build("smoke", folder / "site", folder) == folder / "site" / "index.html"
    return folder / "site", complaints.getvalue()


class Read(HTMLParser):
    """The links and images of a page, and the places in it that a link can lead to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.places: set[str] = set()
        self.images: list[dict[str, str | None]] = []
        self.feed(path.read_text())

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.links += [given[name] for name in ("href", "src") if given.get(name)]
        self.places |= {given["id"]} if "id" in given else set()
        self.images += [given] if tag == "img" else []


def test_sphinx_has_nothing_to_complain_about(built):
    assert built[1] == ""


def test_every_link_leads_to_a_file_and_a_place_in_it(built):
    out, _ = built
    pages = {path: Read(path) for path in out.rglob("*.html")}
    assert {f"notebooks/{FIRST.name}.html", "docs/claims.html", "results/claims.html", "qdil/ppga.py.html"} <= {
        path.relative_to(out).as_posix() for path in pages
    }
    for path, page in pages.items():
        for link in page.links:
            if link.startswith(("https:", "data:")):
                continue
            address, _, place = unquote(link).partition("#")
            target = (path.parent / address.partition("?")[0]).resolve() if address else path
            assert target.is_file(), (path, link)
            assert not place or target not in pages or place in pages[target].places, (path, link)
    links = pages[out / "notebooks" / f"{FIRST.name}.html"].links
    assert f"{SECOND.name}.html#part-two" in links and "../qdil/ppga.py.html" in links


def test_a_page_has_code_pictures_with_words_and_the_parameters_it_ran_with(built):
    text = (built[0] / "notebooks" / f"{FIRST.name}.html").read_text()
    assert "replaced" in text and "unused" not in text
    [picture] = [image for image in Read(built[0] / "notebooks" / f"{FIRST.name}.html").images if "png" in image["src"]]
    assert picture["alt"] == "Figure: The first page"
    shown = (built[0] / "qdil" / "ppga.py.html").read_text()
    assert (index.ROOT / "qdil" / "ppga.py").read_text().split('"""')[1].split("\n")[0] in shown


def test_the_front_page_has_a_picture_the_notebooks_in_order_and_what_is_missing(built):
    page, text = Read(built[0] / "index.html"), (built[0] / "index.html").read_text()
    assert any((built[0] / image["src"]).stat().st_size > 10_000 for image in page.images if image.get("src"))
    listed = [link for link in page.links if link.startswith("notebooks/")]
    assert [link for link in dict.fromkeys(listed) if "explore" not in link] == [
        f"notebooks/{entry.name}.html" for entry in (FIRST, SECOND)
    ]
    assert f"Not executed at this budget, so not shown: {THIRD.title}, " in text


@needs_browser
@pytest.mark.parametrize("width", [1700, 1280, 390])
def test_in_a_browser_formulas_are_typeset_and_frames_live(built, browser, width):
    page = browser.new_page(viewport={"width": width, "height": 800})
    watched = Watched(page)
    page.goto((built[0] / "notebooks" / f"{FIRST.name}.html").as_uri())
    page.locator("mjx-container").nth(3).wait_for()
    assert page.locator("mjx-container").count() == 4
    assert page.locator("[data-mml-node=merror]").count() == 0
    assert page.frame_locator("iframe").locator("p").inner_text() == "42"
    assert page.evaluate("document.documentElement.scrollWidth") == width
    assert page.locator("img[alt='Figure: The first page']").bounding_box()["width"] < width
    watched.is_clean()
    page.close()


@needs_browser
def test_search_finds_a_word_and_the_page_that_has_it(built, browser):
    page = browser.new_page()
    watched = Watched(page)
    page.goto((built[0] / "index.html").as_uri())
    page.locator("input[name=q]").fill("zebrafinch")
    page.keyboard.press("Enter")
    page.locator("#search-results a").first.click()
    page.wait_for_url(f"**/{SECOND.name}.html*")
    watched.is_clean()
    page.close()


@needs_browser
def test_the_browser_refuses_what_an_output_would_load_from_elsewhere(tmp_path, browser):
    """Asked of the other machine itself: this one, which is reached without any page in between."""
    asked = []

    class Elsewhere(BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            self.send_response(204)
            self.end_headers()

        def log_message(self, *args):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Elsewhere) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        there = f"http://127.0.0.1:{server.server_port}"
        html = (
            f'<img src="{there}/image"><script src="{there}/script"></script><style>@import "{there}/style";</style>'
            f"<script>fetch('{there}/fetch').catch(() => 0)</script>"
            f'<iframe srcdoc="&lt;img src={there}/inner&gt;"></iframe><iframe src="{there}/outer"></iframe>'
        )
        write(tmp_path / "smoke", FIRST.name, "# Title", html)
        site.build("smoke", tmp_path / "site", tmp_path)
        page = browser.new_page()
        (tmp_path / "open.html").write_text(html)
        page.goto((tmp_path / "open.html").as_uri())
        page.wait_for_timeout(1000)
        assert {"/image", "/script", "/style", "/fetch", "/inner", "/outer"} <= set(asked)
        asked.clear()
        page.goto((tmp_path / "site" / "notebooks" / f"{FIRST.name}.html").as_uri())
        page.wait_for_timeout(1000)
        page.close()
        server.shutdown()
    assert asked == []


def test_the_largest_budget_is_shown_and_nothing_is_refused(tmp_path, capsys):
    with pytest.raises(ConfigError, match="run 'qdil notebooks' first"):
        site.build(None, tmp_path / "site", tmp_path)
    with pytest.raises(ConfigError, match="run 'qdil notebooks --budget smoke' first"):
        site.build("smoke", tmp_path / "site", tmp_path)
    write(tmp_path / "smoke", FIRST.name, "# Title")
    write(tmp_path / "laptop", FIRST.name, "# Title")
    assert site.largest(tmp_path) == "laptop"
