"""The executed notebooks and ``docs/`` as web pages that need no network and no server; see ``make site``.

Sphinx builds the pages, with the settings of ``docs/site/conf.py``. This file gathers them in one folder, laid out as
the repository, so that links between them stay as they are.
"""

import argparse
import re
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from urllib.parse import unquote

from qdil.config import BUDGETS, ConfigError
from qdil.extras import needs
from qdil.series import index
from qdil.series.index import ROOT, Entry
from qdil.series.schedule import EXECUTED

with needs("notebooks", "the site"):
    import nbformat
    from sphinx.cmd.build import build_main

SITE = ROOT / "build" / "site"
SETTINGS = ROOT / "docs" / "site"
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(<?([^)\s>#]+)(#[^)\s>]*)?>?\)")
COPIED = (".png", ".pdf", ".svg", ".html", ".gif", ".mp4")  # linked files that a browser shows
# Suffixes of linked files that get a page with their text, and the language of its highlighting.
SHOWN = {".py": "python", ".md": "markdown", ".toml": "toml", ".yaml": "yaml", ".csv": "text", "": "text"}


def build(budget: str | None = None, out: Path = SITE, executed: Path = EXECUTED) -> Path:
    """Build the pages of one budget's executed notebooks into ``out``, made anew; returns the front page.

    ``budget`` None: the largest with executed copies. Raises ConfigError where there are none, and where Sphinx fails.
    """
    budget = budget or largest(executed)
    found = [entry for entry in index.read() if (executed / budget / f"{entry.name}.ipynb").is_file()]
    if not found:
        raise ConfigError(
            f"no executed notebooks in {executed / budget}: run 'qdil notebooks --budget {budget}' first."
        )
    source = out.with_name(f"{out.name}-source")
    for folder in (out, source):
        shutil.rmtree(folder, ignore_errors=True)
    gather(budget, found, source, executed)
    # The options keep Sphinx's cache out of the site and print only errors and warnings.
    if build_main(["-q", "-c", str(SETTINGS), "-d", str(source / ".cache"), str(source), str(out)]):
        raise ConfigError(f"Sphinx could not build the pages in {source}; its messages are above.")
    return out / "index.html"


def largest(executed: Path = EXECUTED) -> str:
    """The largest budget with executed copies. Raises ConfigError if there are none at all."""
    for budget in reversed(BUDGETS):
        if any((executed / budget).glob("*.ipynb")):
            return budget
    raise ConfigError(f"no executed notebooks in {executed}: run 'qdil notebooks' first.")


def anchor(heading: str) -> str:
    """The name by which Jupyter links to a heading."""
    return heading.replace(" ", "-")


def gather(budget: str, entries: Iterable[Entry], source: Path, executed: Path = EXECUTED) -> None:
    """Write the pages of ``entries``, of ``docs/`` and the front page into ``source``, for Sphinx to read."""
    entries = list(entries)
    notebooks = {index.NOTEBOOKS / f"{entry.name}.ipynb": entry for entry in entries}
    docs = [path for path in sorted((ROOT / "docs").rglob("*.md")) if SETTINGS not in path.parents]
    docs = [ROOT / "README.md", *docs, ROOT / "results" / "claims.md", ROOT / "THIRD_PARTY.md"]
    pages = Pages(source, {*notebooks, *docs})
    for path in docs:
        pages.write(path, path.read_text())
    for path in notebooks:
        notebook = nbformat.read(executed / budget / path.name, as_version=4)
        _prepare(notebook, path, pages)
        pages.write(path, nbformat.writes(notebook), linked=False)
    pages.write(ROOT / "index.md", _front(budget, entries, docs))


class Pages:
    """The pages that Sphinx reads, in the folder ``source``, each at the place of its file in the repository.

    ``known``: the files that are pages themselves, so that links to them need no change.
    """

    def __init__(self, source: Path, known: Iterable[Path]) -> None:
        self.source, self.known = source, set(known)

    def write(self, path: Path, text: str, linked: bool = True) -> None:
        """Write a page for the file ``path`` of the repository."""
        target = self.source / path.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(self.links(text, path.parent) if linked else text)

    def links(self, text: str, folder: Path) -> str:
        """Markdown whose links, relative to ``folder``, point to a file of the site; others become plain text."""
        return LINK.sub(lambda found: self._link(folder, *found.groups(default="")), text)

    def _link(self, folder: Path, image: str, words: str, address: str, part: str) -> str:
        target = (folder / unquote(address)).resolve()
        if ":" in address or target in self.known:
            return f"{image}[{words}]({address}{part})"
        if not target.is_relative_to(ROOT) or not target.is_file():
            return words
        if target.suffix in COPIED:
            copy = self.source / target.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(target, copy)
            return f"{image}[{words}]({address})"
        if target.suffix in SHOWN:
            self._show(target)
            return f"[{words}]({address}.md)"
        return words

    def _show(self, target: Path) -> None:
        """A page with the text of a file."""
        name, fence = target.relative_to(ROOT).as_posix(), "`" * 10
        head = f"---\norphan: true\n---\n\n# `{name}`\n\n"
        code = f"{fence}{SHOWN[target.suffix]}\n{target.read_text()}\n{fence}\n"
        self.write(target.with_name(f"{target.name}.md"), head + code, linked=False)


def _prepare(notebook: nbformat.NotebookNode, path: Path, pages: Pages) -> None:
    """Adapt a notebook's links, describe its pictures by their section, and hide parameters that were replaced."""
    injected = any("injected-parameters" in cell.metadata.get("tags", []) for cell in notebook.cells)
    heading = ""
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            cell.source = pages.links(cell.source, path.parent)
            heading = ([heading] + re.findall(r"^#+ (.+)$", cell.source, re.MULTILINE))[-1]
            continue
        tags = cell.metadata.get("tags", [])
        if injected and "parameters" in tags:
            cell.metadata.tags = ["remove-cell"]
        cell.metadata.mystnb = {"image": {"alt": f"Figure: {heading}"}}
        for output in cell.get("outputs", []):
            if markdown := output.get("data", {}).get("text/markdown"):
                output.data["text/markdown"] = pages.links(markdown, path.parent)


def _front(budget: str, entries: list[Entry], docs: Iterable[Path]) -> str:
    """The front page: what this is, the notebooks, and which of them were not executed at this budget."""
    from qdil.series.page import BUDGET_NOTES  # imports JAX

    missing = [entry.title for entry in index.read() if entry not in entries]
    template = (SETTINGS / "index.md").read_text()
    return template.format(
        executed=f"They were executed at the *{budget}* budget: {BUDGET_NOTES[budget]}.",
        contents="\n".join(_line(entry) for entry in entries),
        missing=f"Not executed at this budget, so not shown: {', '.join(missing)}." if missing else "",
        notebooks="\n".join(f"notebooks/{entry.name}" for entry in entries),
        docs="\n".join(path.relative_to(ROOT).with_suffix("").as_posix() for path in docs),
    )


def _line(entry: Entry) -> str:
    claims = f" ({index.claims_text(entry.claims)} of the paper)" if entry.claims else ""
    return f"* [{entry.name[:2]} {entry.title}](notebooks/{entry.name}.ipynb): {entry.about}{claims}."


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
