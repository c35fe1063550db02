"""The experiments of studies are configurations that differ, and finished runs are found in their folders."""

import pytest

from qdil.config import BUDGETS, make_config
from qdil.errors import ConfigError
from qdil.runs import experiments, studies
from qdil.runs.folder import folder_of


@pytest.mark.parametrize("budget", BUDGETS)
def test_every_experiment_is_a_configuration_of_its_own(budget):
    names = studies.experiments_of(studies.STUDIES, budget)
    configs = [studies.config_of(name, "walker2d", budget) for name in names]
    assert len(set(configs)) == len(configs)


def test_a_name_leaves_out_what_changes_nothing_and_reads_back():
    assert studies.name_of("mconbo-gail", bonus_p=0.5, bonus_q=0.5) == "mconbo-gail"
    name = studies.name_of("mconbo-gail", bonus_q=1.0, reward_hidden=(8, 8))
    assert name == "mconbo-gail+bonus_q=1.0+reward_hidden=8,8"
    expected = make_config("walker2d", "mconbo-gail", "laptop", 2, bonus_q=1.0, reward_hidden=(8, 8))
    assert studies.config_of(name, "walker2d", "laptop", 2) == expected


def test_a_folder_names_budget_robot_experiment_and_seed(tmp_path):
    folder = folder_of("gail+bonus_q=1.0", "walker2d", "smoke", 3, tmp_path)
    assert folder == tmp_path / "smoke" / "walker2d" / "gail+bonus_q=1.0" / "seed-3"


def test_only_finished_runs_are_found_in_the_order_of_seeds(tmp_path):
    for seed in (1, 3):
        folder = folder_of("gail", "walker2d", "laptop", seed, tmp_path)
        folder.mkdir(parents=True)
        (folder / "manifest.json").write_text("{}")
    folder_of("gail", "walker2d", "laptop", 2, tmp_path).mkdir()
    found = experiments.finished(["gail", "vail"], "walker2d", "laptop", None, tmp_path)
    assert [path.name for path in found["gail"]] == ["seed-1", "seed-3"] and "vail" not in found


@pytest.mark.parametrize("name, message", [("gail+speed=1", "unknown setting 'speed'"), ("nail", "nail")])
def test_what_does_not_exist_is_refused(name, message):
    with pytest.raises(ConfigError, match=message):
        studies.config_of(name, "walker2d", "smoke")
    with pytest.raises(ConfigError, match="unknown study"):
        studies.experiments_of(["nothing"], "smoke")
