"""The series: its sources, index, links and executed copies; and what executes it, on notebooks of a few lines."""

import ast
import functools
import importlib
import json
import re
import tomllib
from collections import Counter
from pathlib import Path
from types import ModuleType

import nbformat
import pytest
import yaml
from IPython.core.inputtransformer2 import TransformerManager
from markdown_cells import cells
from nbformat.v4 import new_code_cell, new_notebook

from qdil.cli import main
from qdil.config import ConfigError
from qdil.runs.studies import experiments_of
from qdil.series import index, schedule
from qdil.series.execute import execute
from qdil.series.page import Page

ROOT = Path(__file__).parent.parent.parent
NAMES = index.names_in()
PAGES = [
    *(ROOT / "notebooks").glob("*.ipynb"),
    ROOT / "README.md",
    *(ROOT / "docs").glob("*.md"),
    *(ROOT / "docs" / "notes").glob("*.md"),
]


@functools.cache
def source(name: str) -> nbformat.NotebookNode:
    return nbformat.read(ROOT / "notebooks" / f"{name}.ipynb", as_version=nbformat.NO_CONVERT)


def code_of(name: str) -> list[str]:
    return [cell.source for cell in source(name).cells if cell.cell_type == "code"]


def prose_of(path: Path) -> str:
    if path.suffix != ".ipynb":
        return path.read_text()
    return "\n\n".join(cell.source for cell in source(path.stem).cells if cell.cell_type == "markdown")


def parsed(name: str) -> ast.Module:
    return ast.parse("\n".join(TransformerManager().transform_cell(text) for text in code_of(name)))


# The sources


@pytest.mark.parametrize("name", NAMES)
def test_a_source_is_clean(name):
    notebook = source(name)
    nbformat.validate(notebook)
    assert (notebook.nbformat, notebook.nbformat_minor) == (4, 5) and notebook.metadata.kernelspec.name == "python3"
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == [] and cell.execution_count is None
            assert set(cell.metadata) <= {"tags"}
    assert set(notebook.metadata) <= {"kernelspec", "language_info"}


@pytest.mark.parametrize("name", NAMES)
def test_its_only_cell_of_parameters_comes_first_and_the_page_opens_with_them(name):
    cells = [cell for cell in source(name).cells if cell.cell_type == "code"]
    assert [i for i, cell in enumerate(cells) if "parameters" in cell.metadata.get("tags", [])] == [0]
    parameters = [target.id for line in ast.parse(cells[0].source).body for target in line.targets]
    assert parameters[:3] == ["budget", "env", "seed"]
    opened = [cell.source for cell in cells if "open_page(" in cell.source]
    assert len(opened) == 1 and "page = open_page(budget, env, seed" in opened[0]


@pytest.mark.parametrize("name", NAMES)
def test_it_uses_only_what_exists_and_shows_the_source_of_a_function(name):
    """Every import, and every attribute of an imported module, such as ``xnes.utilities``."""
    tree, modules = parsed(name), {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            modules |= {alias.asname or alias.name: importlib.import_module(alias.name) for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            modules |= {alias.asname or alias.name: imported(node.module, alias.name) for alias in node.names}
    used = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)]
    missing = {
        f"{node.value.id}.{node.attr}"
        for node in used
        if isinstance(modules.get(node.value.id), ModuleType) and not hasattr(modules[node.value.id], node.attr)
    }
    of_page = {node.attr for node in used if node.value.id == "page"}
    assert not missing and of_page <= set(dir(Page)) and "source" in of_page


def imported(module: str, name: str) -> object:
    """``from module import name``; raises where there is no such name."""
    found = importlib.import_module(module)
    return getattr(found, name) if hasattr(found, name) else importlib.import_module(f"{module}.{name}")


@pytest.mark.parametrize("name", NAMES)
def test_its_exercises_have_an_answer(name):
    exercises = prose_of(ROOT / "notebooks" / f"{name}.ipynb").split("## Try it yourself")[1]
    assert exercises.count("<details><summary>Answer") == exercises.count("</details>") >= 1


@pytest.mark.parametrize("name", NAMES)
def test_its_index_entry_names_all_runs_that_it_asks_for(name):
    """Else they are trained in the notebook, perhaps by two at a time."""
    wanted = set(index.experiments_for([name], "laptop"))
    tree = parsed(name)
    assigned = [node for node in ast.walk(tree) if isinstance(node, ast.Assign)]
    values = {node.targets[0].id: node.value for node in assigned if isinstance(node.targets[0], ast.Name)}
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.args):
            continue
        first = node.args[0]
        try:
            first = ast.literal_eval(values.get(first.id, first) if isinstance(first, ast.Name) else first)
        except ValueError:
            continue
        if node.func.attr == "experiments_of":
            assert set(experiments_of(first, "laptop")) <= wanted
        if node.func.attr == "runs":
            assert set(experiments_of([first], "laptop") if isinstance(first, str) else first) <= wanted


# The index, the README's table, the links


def test_the_index_lists_the_notebooks_that_exist():
    assert [entry.name for entry in index.read()] == NAMES
    assert [name[:2] for name in NAMES] == [f"{number:02}" for number in range(len(NAMES))]


def test_every_figure_and_table_of_the_paper_is_claimed_by_one_notebook():
    claims = Counter(claim for entry in index.read() for claim in entry.claims)
    assert claims == Counter(index.CLAIMABLE)


@pytest.mark.parametrize("entry", index.read(), ids=lambda entry: entry.name)
def test_a_notebook_mentions_what_it_claims(entry):
    in_text = mentioned(prose_of(ROOT / "notebooks" / f"{entry.name}.ipynb"))
    assert set(entry.claims) <= in_text, set(entry.claims) - in_text


def mentioned(text: str) -> set[str]:
    """Figures, tables and the like that a text speaks of: "Figs. 12–14 and Table 2" is four."""
    found = set()
    kinds = {"Fig.": r"Fig(?:s?\.|ures?)", "Table": "Tables?", "Algorithm": "Algorithms?", "Lemma": "Lemma"}
    for kind, word in kinds.items():
        for run in re.findall(rf"{word}\s+(\d+(?:\s*(?:[,–-]|and|to)+\s*\d+)*)", text):
            for first, last in re.findall(r"(\d+)(?:\s*[–-]\s*(\d+))?", run):
                found |= {f"{kind} {number}" for number in range(int(first), int(last or first) + 1)}
    return found


def test_what_is_mentioned():
    assert mentioned("Figs. 12–14 and Table 2; Tables 4, 5 and 9") == {
        *("Fig. 12", "Fig. 13", "Fig. 14", "Table 2", "Table 4", "Table 5", "Table 9"),
    }


def test_the_table_has_a_row_per_notebook_and_says_what_it_claims():
    entries = [
        index.Entry(
            "00_first", "First", "a start", ("main",), ("Fig. 1", "Fig. 2", "Table 3"), "learn", {"smoke": 0.25}
        ),
        index.Entry("01_second", "Second", "an end", (), (), "b", {}),
    ]
    assert cells(index.table(entries)) == [
        ["", "notebook", "what it shows", "of the paper", "minutes, smoke"],
        ["00", "[First](notebooks/00_first.ipynb)", "a start", "Figs. 1, 2, Table 3", "0.2"],
        ["01", "[Second](notebooks/01_second.ipynb)", "an end", "", ""],
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_links_lead_to_files(page):
    links = re.findall(r"\]\(<?([^)\s>#]+)(?:#[^)\s>]*)?>?\)", prose_of(page))
    for link in links:
        assert re.match(r"https?://|mailto:", link) or (page.parent / link).exists(), link


@pytest.mark.parametrize(("here", "following"), list(zip(NAMES, NAMES[1:], strict=False)))
def test_a_notebook_leads_to_the_next(here, following):
    assert f"]({following}.ipynb)" in prose_of(ROOT / "notebooks" / f"{here}.ipynb")


# Executing


PARAMETERS = 'budget = "smoke"\nenv = "walker2d"\nseed = 1'


def write(folder: Path, name: str, *cells: str, parameters: str = PARAMETERS, tag: str = "parameters") -> Path:
    first = new_code_cell(parameters, metadata={"tags": [tag]})
    notebook = new_notebook(cells=[first, *map(new_code_cell, cells)])
    notebook.metadata.kernelspec = {"name": "python3", "display_name": "Python 3", "language": "python"}
    path = folder / f"{name}.ipynb"
    nbformat.write(notebook, path)
    return path


def outputs_of(path: Path) -> list:
    return [output for cell in nbformat.read(path, as_version=4).cells for output in cell.get("outputs", [])]


@pytest.fixture
def series(tmp_path, monkeypatch):
    """A folder that ``qdil notebooks`` takes for the series; its copies go to ``executed`` in it."""
    order = functools.partial(schedule.Order, notebooks=tmp_path, executed=tmp_path / "executed")
    monkeypatch.setattr(schedule, "Order", order)
    return tmp_path


@pytest.mark.physics
def test_a_failing_notebook_is_named_with_cell_and_error_while_the_others_go_on(series, capfd):
    write(series, "00_bad", "x = 1", "x / 0", "print('never')")
    write(series, "01_good", "print(budget, env, seed)")
    assert main(["notebooks", "--env", "halfcheetah", "--seed", "7"]) == 1
    captured = capfd.readouterr()
    assert captured.err.strip() == "00_bad, cell 4: ZeroDivisionError: division by zero"  # 2 is papermill's own cell
    assert {line.split(" after")[0] for line in captured.out.splitlines()} == {"00_bad: failed", "01_good: done"}
    (printed,) = outputs_of(series / "executed" / "smoke" / "01_good.ipynb")
    assert printed.text == "smoke halfcheetah 7\n"
    assert [o.ename for o in outputs_of(series / "executed" / "smoke" / "00_bad.ipynb") if o.output_type == "error"]


@pytest.mark.parametrize(
    ("parameters", "tag", "missing"),
    [
        ('budgte = "smoke"\nenv = "walker2d"\nseed = 1', "parameters", "budget"),
        ('budget = "smoke"\nenv = "walker2d"', "parameters", "seed"),
        (PARAMETERS, "parameter", "budget, env, seed"),
    ],
)
def test_a_notebook_that_would_ignore_a_parameter_is_refused_before_anything_runs(
    series, capfd, parameters, tag, missing
):
    write(series, "00_good", "print(budget)")
    write(series, "01_deaf", parameters=parameters, tag=tag)
    assert main(["notebooks"]) == 2
    assert f"01_deaf: no cell tagged 'parameters' sets {missing} (" in capfd.readouterr().err
    assert not (series / "executed").exists()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["00_goood"], "'00_goood'"),
        (["--budget", "huge"], "'huge'"),
        (["--env", "octopus"], "'octopus'"),
        (["--seed", "-1"], "seed=-1"),
        (["-j", "0"], "-j"),
        (["--timeout", "0"], "--timeout"),
    ],
)
def test_a_bad_request_is_refused_in_a_line(series, capfd, arguments, named):
    write(series, "00_good", "print(budget)")
    assert main(["notebooks", *arguments]) == 2
    captured = capfd.readouterr()
    assert named in captured.err and captured.err.count("\n") == 1 and not (series / "executed").exists()


@pytest.mark.physics
def test_noise_and_bulk_are_failures_and_the_copy_is_kept(tmp_path):
    parameters = {"budget": "smoke", "env": "walker2d", "seed": 1}
    (drafts := tmp_path / "drafts").mkdir()
    for name, code, failure in (
        ("00_noisy", "import warnings\nwarnings.warn('old')", "00_noisy, cell 3: on standard error: "),
        ("01_bulky", "print('x' * 2_000_000)", "01_bulky: 2.0 MB of output; 2 MB is the limit"),
    ):
        target = tmp_path / "kept" / f"{name}.ipynb"
        found = execute(write(tmp_path, name, code), target, drafts / f"{name}.ipynb", parameters, 120.0)
        assert found.startswith(failure) and outputs_of(target)


@pytest.mark.physics
def test_a_notebook_has_a_limit_in_all_and_its_copy_is_kept(tmp_path):
    slow = write(tmp_path, "00_slow", "import time", "time.sleep(600)", "print('never')")
    parameters = {"budget": "smoke", "env": "walker2d", "seed": 1}
    failure = execute(slow, tmp_path / "kept" / "00_slow.ipynb", tmp_path / "draft.ipynb", parameters, limit=20.0)
    assert failure == f"00_slow, cell 4: TimeoutError: more than {1 / 3:g} minutes for the whole notebook"
    cells = nbformat.read(tmp_path / "kept" / "00_slow.ipynb", as_version=4).cells
    assert cells[-1].execution_count is None


@pytest.mark.physics
def test_a_kernel_that_dies_is_a_failure_with_its_cell(tmp_path):
    dying = write(tmp_path, "00_dying", "import os", "os._exit(3)", "print('never')")
    parameters = {"budget": "smoke", "env": "walker2d", "seed": 1}
    failure = execute(dying, tmp_path / "kept.ipynb", tmp_path / "draft.ipynb", parameters, limit=120.0)
    assert re.match(r"00_dying, cell 4: DeadKernelError: ", failure)


def test_unknown_names_are_refused_and_doubled_ones_executed_once(series):
    write(series, "00_good", "print(budget)")
    assert index.chosen(["00_good", "00_good"], series) == ["00_good"]
    with pytest.raises(ConfigError, match="there is no notebook 'good'; choose from 00_good"):
        index.chosen(["good"], series)


# What goes with the repository


def test_every_direct_dependency_has_its_notice():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [line for extra in project["optional-dependencies"].values() for line in extra]
    asked = [line for line in (*project["dependencies"], *extras) if not line.startswith("qdil[")]
    table = (ROOT / "THIRD_PARTY.md").read_text()
    named = {name for row in re.findall(r"^\| ([^|]+) \|", table, re.MULTILINE) for name in row.split(", ")}
    assert {re.match(r"[\w-]+", line)[0] for line in asked} <= named
    bundled = json.loads((ROOT / "qdil" / "explorer" / "frontend" / "package.json").read_text())["dependencies"]
    passed_on = (ROOT / "THIRD_PARTY.md").read_text().split("## What is passed on")[1]
    assert all(f"{name}.js" in passed_on for name in bundled)


def test_the_citation_file_reads_as_yaml_with_what_its_format_requires():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])
