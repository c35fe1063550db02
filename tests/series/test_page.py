"""What notebooks show and keep: figures beside their run's budget and robot, and sentences where there is nothing."""

from pathlib import Path

import pytest
from fake_runs import write_run
from matplotlib.figure import Figure

from qdil.config import ROBOTS
from qdil.series import page


@pytest.fixture
def opened(tmp_path, monkeypatch, capsys):
    """A function that opens a page in an empty root; returns that root."""
    monkeypatch.setattr(page, "ROOT", tmp_path)
    monkeypatch.chdir(tmp_path)  # so that the old folder comes back

    def begin(budget, env="walker2d"):
        page.begin(budget, env, 1)
        return tmp_path

    return begin


@pytest.fixture
def said(monkeypatch):
    """What is displayed as Markdown, in order."""
    texts = []
    monkeypatch.setattr(page, "display", lambda shown: texts.append(shown.data))
    return texts


def test_a_figure_is_shown_and_written_twice_under_its_budget_and_robot(opened, capsys):
    root = opened("laptop", "halfcheetah")
    page.show(Figure(), "fig-5")
    page.show(Figure(), "fig-5", "humanoid")
    names = {f"laptop-{env}-fig-5.{kind}" for env in ("halfcheetah", "humanoid") for kind in ("png", "pdf")}
    assert {path.name for path in (root / "results" / "figures").iterdir()} == names
    assert capsys.readouterr().out.count("Figure") == 2


def test_a_smoke_figure_is_kept_apart(opened):
    root = opened("smoke")
    page.show(Figure(), "fig-5")
    assert (root / "results" / "smoke" / "figures" / "smoke-walker2d-fig-5.png").is_file()
    assert not (root / "results" / "figures").exists()


def test_a_sentence_or_a_figure_without_a_name_is_shown_and_writes_nothing(opened, capsys):
    root = opened("laptop")
    page.show(Figure(), None)
    page.show("No run is finished yet.", "fig-5")
    page.show(None, "fig-5")
    assert capsys.readouterr().out.count("Markdown") == 1 and not (root / "results").exists()


def test_robots_without_runs_are_named_and_left_out(opened, said):
    root = opened("laptop")
    write_run(root / "results", "walker2d", "gail", 2)
    (walker,) = page.robots(["gail", "vail"], "laptop")
    assert walker == ("walker2d", {"gail": [Path("results/laptop/walker2d/gail/seed-2")]})
    of = {robot: text for text in said for robot in ROBOTS if robot in text}
    assert "`vail`" in of["walker2d"] and all("no finished runs" in of[name] for name in ("halfcheetah", "humanoid"))


def test_without_demonstrations_a_page_says_how_to_make_them(opened, said):
    root = opened("laptop")
    assert page.demonstrations("walker2d", "laptop") is None
    assert "No demonstrations yet" in said[-1] and "`qdil demos --env walker2d --budget laptop`" in said[-1]
    path = root / "results" / "laptop" / "walker2d" / "demos-4.npz"
    path.parent.mkdir(parents=True)
    path.touch()
    assert page.demonstrations("walker2d", "laptop").samefile(path)
