"""The executed series as web pages that need no network and no server; see ``make site``."""

import argparse
import html
import re
import shutil
import sys
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from urllib.parse import unquote

import nbformat
from nbconvert import HTMLExporter
from nbconvert.filters import markdown2html
from pygments.formatters import HtmlFormatter

from qdil.config import BUDGETS, ConfigError
from qdil.series import index
from qdil.series.index import ROOT, Entry
from qdil.series.schedule import EXECUTED

SITE = ROOT / "build" / "site"
TITLE = "Quality Diversity Imitation Learning, step by step"
# The parts of MathJax that formulas of TeX need; the rest, speech and translations above all, is most of its size.
MATHJAX = (
    *("MathJax.js", "LICENSE", "config", "extensions/MathZoom.js", "extensions/MathEvents.js", "extensions/TeX"),
    *("jax/element", "jax/input", "jax/output/HTML-CSS", "fonts/HTML-CSS"),
)
AS_THEY_ARE = (".png", ".pdf", ".svg", ".html", ".gif", ".mp4")  # other linked files become .txt, which browsers show
ADDRESS = r"""["']?((?:https?:)?//[^"'()>\s]+)"""
LOADS = (
    rf"<(?:script|link|img|iframe|source|video|embed|object)\b[^>]*?(?:src|href|data)\s*=\s*{ADDRESS}",
    rf"(?:url\(|@import)\s*{ADDRESS}",
    rf"\bimport\b[^;\n]*?{ADDRESS}",
)

STYLE = """
:root { color-scheme: light; }
body { margin: 0 auto; max-width: 62rem; padding: 0 1.2rem 4rem; background: #fff; color: #1a1a1a;
  font: 1.02rem/1.55 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
nav { display: flex; flex-wrap: wrap; gap: .3rem 1.5rem; padding: .8rem 0; border-bottom: 1px solid #ccc; }
nav .next { margin-left: auto; }
a { color: #0b5394; }
h1, h2, h3 { line-height: 1.25; margin: 1.6em 0 .5em; }
h1 { font-size: 1.9rem; margin-top: 1rem; }
code, pre { font-family: ui-monospace, "DejaVu Sans Mono", monospace; font-size: .88rem; }
.input_area { background: #f5f6f8; border-left: 3px solid #b9c2cf; margin: .8rem 0 0; overflow-x: auto; }
.input_area pre { margin: 0; padding: .55rem .8rem; line-height: 1.4; }
.output_area pre { margin: .4rem 0; overflow-x: auto; white-space: pre-wrap; }
.output_stderr { background: #fdecea; }
.prompt { display: none; }
blockquote { margin: 1rem 0; padding: .1rem 1rem; border-left: 4px solid #d9a441; background: #fdf7ea; }
img { max-width: 100%; height: auto; }
iframe { max-width: 100%; }
.output_html, .rendered_html, main { overflow-x: auto; }
table { border-collapse: collapse; margin: 1rem 0; font-size: .9rem; }
th, td { padding: .28rem .7rem; border: 0; border-bottom: 1px solid #ddd; vertical-align: top; }
table { border: 0; }
thead th { border-bottom: 2px solid #999; }
th:not([align]):not([style]) { text-align: left; }
.anchor-link { display: none; }
"""

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="stylesheet" href="style.css">
<script type="text/x-mathjax-config">
MathJax.Hub.Config({{
  tex2jax: {{inlineMath: [["$", "$"], ["\\\\(", "\\\\)"]], displayMath: [["$$", "$$"]], processEscapes: true}},
  "HTML-CSS": {{availableFonts: [], imageFont: null, preferredFont: null, webFont: "STIX-Web"}},
  messageStyle: "none", showMathMenu: false
}});
</script>
<script src="mathjax/MathJax.js?config=TeX-AMS-MML_HTMLorMML-full" async></script>
</head>
<body>
<nav>{nav}</nav>
<main>
{body}
</main>
<nav>{nav}</nav>
</body>
</html>
"""


def build(budget: str | None = None, out: Path = SITE, executed: Path = EXECUTED) -> Path:
    """Write the pages of one budget's executed notebooks into ``out``, made anew; returns the page of contents.

    ``budget`` None: the largest with executed copies. Raises ConfigError where there are none, and for a page that
    would load something from the network.
    """
    budget = budget or largest(executed)
    there = [entry for entry in index.read() if (executed / budget / f"{entry.name}.ipynb").is_file()]
    if not there:
        raise ConfigError(
            f"no executed notebooks in {executed / budget}: run 'qdil notebooks --budget {budget}' first."
        )
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    (out / "style.css").write_text(STYLE + HtmlFormatter(style="default").get_style_defs(".highlight") + "\n")
    _copy_mathjax(out / "mathjax")
    contents = out / "index.html"
    _write(contents, TITLE, "", _contents(there, budget))
    for number, entry in enumerate(there):
        around = there[number - 1] if number else None, there[number + 1] if number + 1 < len(there) else None
        body = _linked(_body(executed / budget / f"{entry.name}.ipynb"), out)
        _write(out / f"{entry.name}.html", entry.title, _nav(*around), body)
    return contents


def largest(executed: Path = EXECUTED) -> str:
    """The largest budget with executed copies. Raises ConfigError if there are none at all."""
    for budget in reversed(BUDGETS):
        if any((executed / budget).glob("*.ipynb")):
            return budget
    raise ConfigError(f"no executed notebooks in {executed}: run 'qdil notebooks' first.")


def from_network(page: str) -> list[str]:
    """Addresses that a page, or a page embedded in it, would load by itself; links for a reader to follow are none."""
    embedded = [html.unescape(text) for text in re.findall(r'srcdoc="([^"]*)"', page)]
    return [found for text in (page, *embedded) for rule in LOADS for found in re.findall(rule, text, re.IGNORECASE)]


def _write(path: Path, title: str, nav: str, body: str) -> None:
    page = PAGE.format(title=html.escape(title), nav=nav, body=body)
    if addresses := from_network(page):
        raise ConfigError(
            f"{path.stem} would load {', '.join(sorted(set(addresses)))}; a page must not need the network."
        )
    path.write_text(page)


def _contents(there: Iterable[Entry], budget: str) -> str:
    """The page of contents: the table with links to the pages, and what was not executed at this budget."""
    there = list(there)
    missing = [entry.title for entry in index.read() if entry not in there]
    text = f"# {TITLE}\n\nThe notebooks of the series, executed at the budget *{budget}*.\n\n"
    text += index.table(there, folder="", suffix=".html")
    if missing:
        text += f"\n\nNot executed at this budget: {', '.join(missing)}."
    return markdown2html(text)


def _nav(before: Entry | None, after: Entry | None) -> str:
    links = ['<a href="index.html">All notebooks</a>']
    links += [f'<a href="{before.name}.html">← {html.escape(before.title)}</a>'] if before else []
    links += [f'<a class="next" href="{after.name}.html">{html.escape(after.title)} →</a>'] if after else []
    return " ".join(links)


def _body(notebook: Path) -> str:
    """What nbconvert makes of a notebook's cells, without a page around it."""
    exporter = HTMLExporter(
        template_name="basic", exclude_anchor_links=True, exclude_input_prompt=True, exclude_output_prompt=True
    )
    body, _ = exporter.from_notebook_node(nbformat.read(notebook, as_version=4))
    return body


def _linked(body: str, out: Path) -> str:
    """Links between notebooks as links between pages; other files of the repository that a page links to are copied."""

    def renamed(found: re.Match) -> str:
        attribute, path, anchor = found[1], unquote(html.unescape(found[2])), found[3] or ""
        source = (index.NOTEBOOKS / path).resolve()
        if source.parent == index.NOTEBOOKS and source.suffix == ".ipynb":
            return f'{attribute}="{source.stem}.html{anchor}"'
        if not source.is_relative_to(ROOT) or not source.is_file():
            return found[0]
        copy = Path("files") / source.relative_to(ROOT)
        copy = copy if copy.suffix in AS_THEY_ARE else copy.with_name(f"{copy.name}.txt")
        (out / copy).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, out / copy)
        return f'{attribute}="{copy.as_posix()}{anchor}"'

    return re.sub(r'\b(href|src)="([^"#:?]+)(#[^"]*)?"', renamed, body)


def _copy_mathjax(target: Path) -> None:
    static = Path(str(files("jupyter_server_mathjax"))) / "static"
    for part in MATHJAX:
        source = static / part
        (target / part).parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if source.is_dir() else shutil.copyfile)(source, target / part)


def main(argv: list[str] | None = None) -> int:
    """Build the site."""
    parser = argparse.ArgumentParser(prog="python -m qdil.series.site", description=main.__doc__)
    parser.add_argument("--budget", choices=BUDGETS, help="default: the largest with executed notebooks")
    parser.add_argument("--out", type=Path, default=SITE)
    args = parser.parse_args(argv)
    try:
        print(f"Wrote {build(args.budget, args.out)}.")
    except ConfigError as error:
        print(f"qdil: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
