"""The paper's numbers are those of the table, of the end of runs, and never another paper's."""

import csv
import tomllib
from importlib.resources import files
from pathlib import Path

import pytest

from qdil.evidence import paper

ROOT = Path(__file__).parents[2]


def test_every_number_of_the_table_is_there():
    with (ROOT / "qdil" / "evidence" / "paper_numbers.csv").open() as file:
        rows = list(csv.DictReader(file))
    numbers = paper.numbers()
    assert len(numbers) == len(rows) and len(rows) > 100
    assert numbers["value"].to_list() == [float(row["value"]) for row in rows]


def test_what_is_returned_can_be_changed_without_harm():
    changed = paper.numbers()
    changed["value"] = 0.0
    assert paper.value("walker2d", "gail", "best") == 4031


@pytest.mark.parametrize(
    "args, expected",
    [
        (("walker2d", "mconbo-gail", "qd_score"), 4116000),
        (("walker2d", "mconbo-gail", "qd_score", 2), 3927000),
        (("walker2d", "gail", "coverage"), 0.6929),
        (("walker2d", "true", "qd_score"), 3641854),  # at iteration 2000, not 100 to 1500
        (("humanoid", "true", "best", 1), 9691),  # the expert has no demonstrations
        (("humanoid", "mbo-true", "average"), (5473 + 5127) / 2),  # two seeds
    ],
)
def test_values_are_those_of_the_end_of_the_papers_runs(args, expected):
    assert paper.value(*args) == pytest.approx(expected)


def test_a_later_number_never_stands_in_for_the_papers():
    assert paper.value("humanoid", "gail", "qd_score") is None
    assert paper.value("humanoid", "gail", "qd_score", origin=paper.LATER) == 1860000
    assert paper.value("humanoid", "mbo-gail", "qd_score", origin=paper.LATER) == 5310000
    # The later version has the bonus without measure conditioning.
    assert paper.value("humanoid", "mconbo-gail", "qd_score", origin=paper.LATER) is None
    assert paper.value("walker2d", "true", "qd_score", origin=paper.LATER) is None


def test_every_method_of_the_later_version_has_a_name_here():
    later = paper.numbers()
    assert set(paper.LATER_NAMES.values()) == set(later[later["origin"] == paper.LATER]["method"])
    assert paper.value("walker2d", "mbo-diffail", "coverage", origin=paper.LATER) == pytest.approx(0.8863)


def test_spreads_say_what_they_are():
    assert paper.spread("walker2d", "gail", "coverage") == (pytest.approx(0.0259), "standard error", 3)
    assert paper.spread("walker2d", "gail", "best", 2) == (130, "standard error", 3)
    assert paper.spread("walker2d", "true", "coverage") is None


@pytest.mark.parametrize(
    "env, experiment, there",
    [
        ("halfcheetah", "airl", True),
        ("walker2d", "mbo-gail", False),
        ("humanoid", "mbo-true", True),
        ("walker2d", "mbo-true", False),
        ("walker2d", "gail+demo_episodes=2", True),
        ("humanoid", "gail+demo_episodes=2", False),
        ("walker2d", "gail+demo_episodes=10", False),
        ("humanoid", "mconbo-gail+bonus_p=0.0+bonus_q=1.0", True),
        ("humanoid", "mconbo-gail+selection=true", False),
    ],
)
def test_what_the_paper_never_ran_is_not_lost(env, experiment, there):
    assert paper.has(env, experiment) is there


def test_the_paper_has_runs_of_every_number_that_is_known():
    known = paper.numbers()
    known = known[known["origin"] == paper.PAPER]
    for row in known.itertuples():
        usual = row.n_demos in (4,) or row.n_demos != row.n_demos
        assert paper.has(row.environment, row.method if usual else f"{row.method}+demo_episodes={row.n_demos:.0f}")


def test_the_experts_progress_ends_where_its_run_does():
    progress = paper.expert_progress("halfcheetah")
    assert list(progress.index) == [100, 500, 1000, 1500, 2000]
    assert progress[2000] == paper.value("halfcheetah", "true", "qd_score")
    assert progress.is_monotonic_increasing


@pytest.mark.parametrize("metric, origin", [("speed", paper.PAPER), ("best", "rumour")])
def test_what_the_table_cannot_have_is_refused(metric, origin):
    with pytest.raises(ValueError, match=metric if metric == "speed" else origin):
        paper.value("walker2d", "gail", metric, origin=origin)


def test_the_table_is_installed_with_the_package():
    assert files("qdil.evidence").joinpath("paper_numbers.csv").is_file()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "*.csv" in project["tool"]["setuptools"]["package-data"]["qdil.evidence"]
