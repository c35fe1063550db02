"""The series as web pages: links lead somewhere, nothing comes from the network, formulas and pictures are there."""

import base64
import re
from pathlib import Path

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output

from qdil.config import ConfigError
from qdil.series import index, site

DOT = base64.b64encode(b"\x89PNG\r\n\x1a\n").decode()
FIRST, SECOND = index.read()[0], index.read()[1]


def write(folder: Path, name: str, text: str, html: str = "<b>a table</b>") -> None:
    output = new_output("display_data", {"image/png": DOT, "text/html": html}, metadata={"image/png": {}})
    picture = new_output("display_data", {"image/png": DOT, "text/plain": "a figure"})
    cells = [new_markdown_cell(text), new_code_cell("1 + 1", outputs=[output, picture])]
    path = folder / f"{name}.ipynb"
    path.parent.mkdir(parents=True, exist_ok=True)
    nbformat.write(new_notebook(cells=cells), path)


@pytest.fixture
def built(tmp_path):
    text = f"# Title\n\n$x_\\theta$ and $$y = 1 \\tag{{1}}$$ [next]({SECOND.name}.ipynb#Part), [code](../qdil/ppga.py)."
    write(tmp_path / "smoke", FIRST.name, text, '<iframe srcdoc="&lt;script&gt;1&lt;/script&gt;"></iframe>')
    write(tmp_path / "smoke", SECOND.name, f"# Other\n\n[back]({FIRST.name}.ipynb), [away](https://example.org)")
    out = tmp_path / "site"
    assert site.build("smoke", out, tmp_path) == out / "index.html"
    return out


def test_every_link_leads_to_a_file_and_nothing_comes_from_the_network(built):
    pages = list(built.glob("*.html"))
    assert len(pages) == 3
    for page in pages:
        text = page.read_text()
        assert site.from_network(text) == []
        for link in re.findall(r'(?:href|src)="([^"#?]+)', text):
            assert link.startswith(("https://example.org", "data:")) or (built / link).is_file(), link


def test_a_page_has_its_formulas_picture_code_and_neighbours(built):
    text = (built / f"{FIRST.name}.html").read_text()
    assert "$x_\\theta$" in text and "y = 1 \\tag{1}" in text
    assert f'src="data:image/png;base64,{DOT}"' in text
    assert '<iframe srcdoc="' in text
    assert f'href="{SECOND.name}.html#Part"' in text and 'href="files/qdil/ppga.py.txt"' in text
    assert (built / "files/qdil/ppga.py.txt").read_text() == (index.ROOT / "qdil/ppga.py").read_text()
    assert f'class="next" href="{SECOND.name}.html"' in text


def test_the_contents_list_pages_and_say_what_is_missing(built):
    text = (built / "index.html").read_text()
    assert f'href="{FIRST.name}.html"' in text and "smoke" in text
    if len(index.read()) > 2:
        assert f"Not executed at this budget: {index.read()[2].title}" in text


@pytest.mark.parametrize(
    "html",
    [
        '<script src="https://example.org/a.js"></script>',
        '<img alt="x" src=//example.org/a.png>',
        "<style>@import 'https://example.org/a.css';</style>",
        '<iframe srcdoc="&lt;script src=&quot;https://example.org/a.js&quot;&gt;&lt;/script&gt;"></iframe>',
        "<script type='module'>import m from 'https://example.org/m.js';</script>",
    ],
)
def test_a_page_that_would_need_the_network_is_refused(tmp_path, html):
    write(tmp_path / "smoke", FIRST.name, "# Title", html)
    with pytest.raises(ConfigError, match="//example.org/"):
        site.build("smoke", tmp_path / "site", tmp_path)


def test_the_largest_budget_is_shown_and_nothing_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="run 'qdil notebooks' first"):
        site.build(None, tmp_path / "site", tmp_path)
    write(tmp_path / "smoke", FIRST.name, "# Title")
    write(tmp_path / "laptop", FIRST.name, "# Title")
    assert site.largest(tmp_path) == "laptop"
