"""The tables that are made, in the README and the page on performance: nothing in them is typed.

Of notebooks from their index, of verdicts and runs from the pages about them, of speeds from what ``qdil bench`` wrote.
"""

import json
import re
from collections.abc import Callable
from pathlib import Path

from qdil.series import index

RESULTS = index.ROOT / "results"
EMPTY = ("", "no runs", "no runs †")


def verdicts(page: Path = RESULTS / "claims.md") -> str:
    """The table of verdicts of ``qdil claims``' page, without the robots that there are no runs of."""
    section = page.read_text().split("## Verdicts")[1].split("\n## ")[0]
    lines = [line.strip("|") for line in section.splitlines() if line.startswith("|")]
    rows = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)] for line in lines]
    head, _, *body = rows
    told = [i for i in range(len(head)) if any(row[i] not in EMPTY for row in body)]
    rows = [head, ["---"] * len(head), *body]
    return "\n".join(index.table_row([row[i] for i in told]) for row in rows)


def runs(env: str) -> str:
    """The table of one robot's kept runs that ``qdil figures`` wrote."""
    return (RESULTS / "figures" / f"laptop-{env}-summary.md").read_text().strip()


def speeds(folder: Path = RESULTS / "bench") -> str:
    """What ``qdil bench --json`` measured of each robot at ``laptop``: a row per figure."""
    of = {
        env: json.loads((folder / f"laptop-{env}.json").read_text())[env]
        for env in ("walker2d", "halfcheetah", "humanoid")
    }
    names = dict.fromkeys(name for row in of.values() for name in row)
    head = [["`laptop`", *of], ["---", *("---:" for _ in of)]]
    rows = [[name.replace("_", " "), *(_speed(row.get(name)) for row in of.values())] for name in names]
    return "\n".join(index.table_row(row) for row in head + rows)


def _speed(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:,.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"


TABLES: dict[tuple[str, str], Callable[[], str]] = {  # by page and name
    ("README.md", "notebooks"): index.table,
    ("README.md", "verdicts"): verdicts,
    ("README.md", "walker2d's runs"): lambda: runs("walker2d"),
    ("README.md", "halfcheetah's runs"): lambda: runs("halfcheetah"),
    ("docs/performance.md", "speeds"): speeds,
}


def table_in(text: str, name: str) -> str:
    """The table between a page's markers. Raises ValueError where it has none."""
    begin, end = _markers(name)
    if begin not in text or end not in text:
        raise ValueError(f"the page has no '{begin}' … '{end}'.")
    return text.split(begin, 1)[1].split(end, 1)[0].strip()


def put_table(text: str, name: str, table: str) -> str:
    """A page with what stands between its markers replaced. Raises ValueError where it has none."""
    table_in(text, name)
    begin, end = _markers(name)
    before, rest = text.split(begin, 1)
    return f"{before}{begin}\n\n{table}\n\n{end}{rest.split(end, 1)[1]}"


def _markers(name: str) -> tuple[str, str]:
    return f"<!-- the table of {name} -->", f"<!-- end of the table of {name} -->"


def main() -> None:
    """Write all tables into their pages."""
    for (page, name), table in TABLES.items():
        path = index.ROOT / page
        path.write_text(put_table(path.read_text(), name, table()))


if __name__ == "__main__":
    main()
