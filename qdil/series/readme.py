"""The tables that are made, in the README and the page on performance: nothing in them is typed.

The notebooks come from their index, verdicts from the kept runs, runs from the page that ``qdil figures`` wrote, and
speeds from what ``qdil bench`` wrote.
"""

import json
import math
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from qdil.evidence import claims, report
from qdil.evidence.markdown import markdown_table
from qdil.series import index

RESULTS = index.ROOT / "results"
EMPTY = ("", "no runs", "no runs †")


def verdicts(root: Path = RESULTS) -> str:
    """The verdicts of the laptop's runs as ``claims.md`` shows them, without the robots that have no run."""
    shown = report.overview(claims.judge(root, "laptop")).reset_index()
    return markdown_table(shown.loc[:, [name for name in shown if not set(shown[name]) <= set(EMPTY)]])


def runs(env: str) -> str:
    """The table of one robot's kept runs that ``qdil figures`` wrote."""
    return (RESULTS / "figures" / f"laptop-{env}-summary.md").read_text().strip()


def speeds(folder: Path = RESULTS / "bench") -> str:
    """What ``qdil bench --json`` measured of each robot at ``laptop``: a row per figure."""
    envs = ("walker2d", "halfcheetah", "humanoid")
    shown = pd.DataFrame({env: json.loads((folder / f"laptop-{env}.json").read_text())[env] for env in envs})
    shown = shown.map(_speed).rename(index=lambda name: name.replace("_", " ")).rename_axis("`laptop`").reset_index()
    return markdown_table(shown, right=envs)


def _speed(value: float) -> str:
    if math.isnan(value):
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
