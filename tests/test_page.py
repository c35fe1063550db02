"""What notebooks show and keep: figures beside their run's budget and robot, and sentences where there is nothing."""

import pytest
from matplotlib.figure import Figure

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


def test_a_sentence_is_shown_and_writes_nothing(opened, capsys):
    root = opened("laptop")
    page.show("No run is finished yet.", "fig-5")
    page.show(None, "fig-5")
    assert capsys.readouterr().out.count("Markdown") == 1 and not (root / "results").exists()
