"""What notebooks show and keep: figures beside their run's budget and robot, and sentences where there is nothing."""

from pathlib import Path

import pytest
from fake_runs import write_run
from matplotlib.figure import Figure

from qdil.qd import branching
from qdil.series import page


@pytest.fixture
def opened(tmp_path, monkeypatch, capsys):
    """A function that opens a page in an empty root; returns the page and that root."""
    monkeypatch.setattr(page, "ROOT", tmp_path)
    monkeypatch.chdir(tmp_path)  # so that the old folder comes back

    def begin(budget, env="walker2d"):
        return page.open_page(budget, env, 1), tmp_path

    return begin


@pytest.fixture
def shown(monkeypatch):
    """What is displayed as Markdown, in order."""
    texts = []
    monkeypatch.setattr(page, "display", lambda text: texts.append(text.data))
    return texts


def test_a_figure_is_shown_and_written_twice_under_its_budget_and_robot(opened, capsys):
    opened_page, root = opened("laptop", "halfcheetah")
    opened_page.show(Figure(), "fig-5")
    opened_page.show(Figure(), "fig-5", "humanoid")
    names = {f"laptop-{env}-fig-5.{kind}" for env in ("halfcheetah", "humanoid") for kind in ("png", "pdf")}
    assert {path.name for path in (root / "results" / "figures").iterdir()} == names
    assert capsys.readouterr().out.count("Figure") == 2


def test_a_smoke_figure_is_kept_apart(opened):
    opened_page, root = opened("smoke")
    opened_page.show(Figure(), "fig-5")
    assert (root / "results" / "smoke" / "figures" / "smoke-walker2d-fig-5.png").is_file()
    assert not (root / "results" / "figures").exists()


def test_a_figure_without_a_name_is_not_written(opened, capsys):
    opened_page, root = opened("laptop")
    opened_page.show(Figure())
    assert "Figure" in capsys.readouterr().out and not (root / "results").exists()


@pytest.mark.parametrize(
    ("figure", "text"),
    [(None, "No run is finished yet."), ({}, "No run is finished yet."), ("Too few elites.", "Too few elites.")],
)
def test_without_a_figure_there_is_a_sentence(opened, shown, figure, text):
    opened_page, root = opened("laptop")
    opened_page.show(figure, "fig-5")
    assert shown[-1] == text and not (root / "results").exists()


def test_robots_without_runs_are_named_and_left_out(opened, shown):
    opened_page, root = opened("laptop")
    write_run(root / "results", "walker2d", "gail", 2)
    (walker,) = opened_page.robots(["gail", "vail"])
    assert walker == ("walker2d", {"gail": [Path("results/laptop/walker2d/gail/seed-2")]})
    heading, rest = shown[1:]
    assert heading.startswith("**walker2d**") and "`vail`" in heading
    assert rest.startswith("No finished runs") and "halfcheetah" in rest and "walker2d" not in rest


def test_missing_runs_are_named(opened, shown):
    opened_page, root = opened("laptop")
    folder = write_run(root / "results", "walker2d", "gail", 2)
    assert opened_page.runs(["gail", "vail"]) == {"gail": [folder.relative_to(root)]}
    assert "`gail` (seed 2)" in shown[-1] and "**Not trained yet**, so not shown: `vail`" in shown[-1]


def test_without_demonstrations_a_page_says_how_to_make_them(opened, shown):
    opened_page, root = opened("laptop")
    assert opened_page.demonstrations() is None
    assert "No demonstrations yet" in shown[-1] and "`qdil demos --env walker2d --budget laptop --seed 1`" in shown[-1]
    path = root / "results" / "laptop" / "walker2d" / "demos-4-seed-1.npz"
    path.parent.mkdir(parents=True)
    path.touch()
    assert opened_page.demonstrations().samefile(path)


def test_the_source_of_a_function_is_shown_under_its_name(opened, shown):
    opened_page, _ = opened("laptop")
    opened_page.source(branching.branch)
    assert "`qdil.qd.branching.branch`" in shown[-1]
    assert "theta_mu = networks.flatten(policy)" in shown[-1] and "SHORTEST = " not in shown[-1]


def test_the_banner_names_budget_robot_and_seed(opened, shown):
    opened("laptop", "hopper")
    (banner,) = shown
    assert "**budget** laptop" in banner and "**robot** hopper" in banner and "**seed** 1" in banner


def test_verdicts_are_of_the_claims_asked_for_and_of_the_papers_robots_alone(opened, monkeypatch):
    displayed = []
    monkeypatch.setattr(page, "display", displayed.append)
    opened("laptop")[0].verdicts("C1", "C3")
    assert set(displayed[-1]["id"]) == {"C1", "C3"} and set(displayed[-1]["robot"]) == {"walker2d"}
    opened("laptop", "hopper")[0].verdicts("C1")
    assert "no verdict on hopper" in displayed[-1].data


def test_diagnoses_are_a_table_and_a_figure_or_a_sentence(opened, monkeypatch):
    displayed = []
    monkeypatch.setattr(page, "display", displayed.append)
    opened_page, root = opened("laptop")
    opened_page.diagnoses({})
    assert displayed[-1].data == "No run is finished yet."
    run = write_run(root / "results", "walker2d", "gail", 1)
    (run / "config.json").write_text('{"method": "gail"}')
    opened_page.diagnoses({"gail": [run]})
    table, figure = displayed[-2:]
    assert list(table.columns) == ["healthy", "gail"] and isinstance(figure, Figure)
