"""docs/paper-map.md: what it names exists and cites what it implements; every equation of the paper is there."""

import inspect
import re
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name

import pytest

from qdil.series import index

ROOT = Path(__file__).parent.parent
ROW = re.compile(
    r"\| (?P<item>[^|]+) \| .+ \| \[`(?P<name>[\w.]+)`\]\(\.\./(?P<file>[\w/.]+)\) \| (?P<notebooks>[\d, ]+) \|"
)
ROWS = [ROW.fullmatch(line) for line in (ROOT / "docs" / "paper-map.md").read_text().splitlines()]
FOUND = [row.groupdict() for row in ROWS if row]
NOT_IMPLEMENTED = {12, 18, 19}  # a marginal constraint of PWIL's coupling, and two steps of proofs


def numbers(text):
    """The numbers of equations in words such as "eqs. 3, 7" or "eqs. 11-15"."""
    found = set()
    for listed in re.findall(r"eqs?\. ([\d, -]+)", text):
        for part in re.findall(r"\d+(?:-\d+)?", listed):
            first, _, last = part.partition("-")
            found |= set(range(int(first), int(last or first) + 1))
    return found


def cited(name):
    """The docstrings that may cite: the function's and its module's."""
    thing = resolve_name(name)
    module = thing if inspect.ismodule(thing) else import_module(thing.__module__)
    return f"{inspect.getdoc(thing)}\n{inspect.getdoc(module)}", module


@pytest.mark.parametrize("row", FOUND, ids=lambda row: f"{row['item']}: {row['name']}")
def test_each_function_exists_and_cites_its_item(row):
    text, module = cited(row["name"])
    assert Path(inspect.getfile(module)).resolve() == (ROOT / row["file"]).resolve()
    if row["item"].startswith("eq"):
        assert numbers(row["item"]) <= numbers(text)
    else:
        wanted, _, line = row["item"].partition(", ")
        assert wanted.lower() in text.lower()
        assert line.split(" ")[-1].split("-")[0] in text
    for notebook in re.findall(r"\d+", row["notebooks"]):
        assert any(name.startswith(f"{notebook}_") for name in index.names_in())


def test_every_equation_has_its_row():
    there = set().union(*(numbers(row["item"]) for row in FOUND))
    assert there | NOT_IMPLEMENTED == set(range(1, 21))
    assert len(FOUND) > 20
