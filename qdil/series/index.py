"""The series of notebooks as ``notebooks/index.toml`` lists it, and its table of contents."""

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from qdil.config import BUDGETS, ConfigError
from qdil.evidence.markdown import markdown_table
from qdil.runs.studies import experiments_of

ROOT = Path(__file__).parent.parent.parent
NOTEBOOKS = ROOT / "notebooks"
# The paper's numbered items. Each notebook lists those that it shows.
CLAIMABLE = (
    *(f"Algorithm {n}" for n in (1, 2, 3)),
    *(f"Fig. {n}" for n in range(1, 17)),
    "Lemma 1",
    *(f"Table {n}" for n in range(1, 10)),
)


class Entry(NamedTuple):
    """A notebook of the series."""

    name: str  # of the file, without its suffix
    title: str
    about: str  # one line
    studies: tuple[str, ...]  # the studies whose runs it shows
    claims: tuple[str, ...]  # the items of CLAIMABLE that it shows
    part: str  # of the series: what it teaches, or which results it shows
    minutes: dict[str, float]  # by budget, on two CPU cores, without training; only measured budgets


def read(path: Path = NOTEBOOKS / "index.toml") -> tuple[Entry, ...]:
    """All entries in reading order."""
    rows = tomllib.loads(path.read_text())["notebook"]
    return tuple(
        Entry(
            row["name"],
            row["title"],
            row["about"],
            tuple(row["studies"]),
            tuple(row["claims"]),
            row["part"],
            row.get("minutes", {}),
        )
        for row in rows
    )


def experiments_for(names: Iterable[str], budget: str) -> tuple[str, ...]:
    """The experiments whose runs some notebooks show at a budget, each once. A notebook not in the index has none."""
    wanted = set(names)
    return experiments_of(studies_for(wanted), budget)


def studies_for(names: Iterable[str]) -> tuple[str, ...]:
    """The studies whose runs some notebooks show, each once, in the series' order."""
    wanted = set(names)
    return tuple(dict.fromkeys(study for entry in read() if entry.name in wanted for study in entry.studies))


def names_in(folder: Path = NOTEBOOKS) -> list[str]:
    """The numbered notebooks of a folder in reading order, without their suffix."""
    return sorted(path.stem for path in folder.glob("[0-9][0-9]_*.ipynb"))


def chosen(names: Iterable[str], folder: Path = NOTEBOOKS) -> list[str]:
    """``names``, each once; without names, all notebooks of the folder. Raises ConfigError for an unknown name."""
    known = names_in(folder)
    for name in (names := list(dict.fromkeys(names))):
        if name not in known:
            raise ConfigError(
                f"there is no notebook '{name}'; choose from {', '.join(known) or 'none: the folder is empty'}."
            )
    return names or known


def table(entries: Iterable[Entry] | None = None, folder: str = "notebooks/") -> str:
    """The series as a Markdown table with a link to each notebook in ``folder``.

    Columns of minutes appear for the budgets that any notebook was measured at.
    """
    entries = read() if entries is None else tuple(entries)
    budgets = [budget for budget in BUDGETS if any(budget in e.minutes for e in entries)]
    rows = [
        {
            "": entry.name[:2],
            "notebook": f"[{entry.title}]({folder}{entry.name}.ipynb)",
            "what it shows": entry.about,
            "of the paper": claims_text(entry.claims),
        }
        | {
            f"minutes, {budget}": f"{entry.minutes[budget]:.1f}" if budget in entry.minutes else ""
            for budget in budgets
        }
        for entry in entries
    ]
    return markdown_table(pd.DataFrame(rows), right=["", *(f"minutes, {budget}" for budget in budgets)])


def contents(entries: Iterable[Entry] | None = None) -> str:
    """The series as a Markdown list: an item per part, with a link to each of its notebooks."""
    parts: dict[str, list[str]] = {}
    for entry in read() if entries is None else entries:
        parts.setdefault(entry.part, []).append(f"{entry.name[:2]} [{entry.title}](notebooks/{entry.name}.ipynb)")
    return "\n".join(f"* **{part}**: {', '.join(links)}" for part, links in parts.items())


def claims_text(claims: Iterable[str]) -> str:
    """Claims as a short list in words: "Figs. 5, 6, Table 1"."""
    numbers: dict[str, list[str]] = {}
    for claim in claims:
        kind, number = claim.rsplit(" ", 1)
        numbers.setdefault(kind, []).append(number)
    plural = {"Fig.": "Figs.", "Table": "Tables", "Algorithm": "Algorithms"}
    return ", ".join(f"{plural[kind] if len(of) > 1 else kind} {', '.join(of)}" for kind, of in numbers.items())
