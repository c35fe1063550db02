"""Diagnoses of made-up runs whose numbers are known, of runs with parts missing, and the page that shows them."""

import json
import math
import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import spearmanr

from qdil import plotting
from qdil.cli import main
from qdil.config import GROUP_OF
from qdil.errors import ConfigError
from qdil.evidence import diagnosis, symptoms
from qdil.evidence.diagnosis import BY_NAME, CHECKS, LOOK, NOT_APPLICABLE, NOT_RECORDED, OK
from qdil.files import write_json, write_npz
from qdil.plotting.findings import position

ROWS, ELITES, CELLS = 40, 25, 5
SETTINGS = {
    "env": "walker2d", "method": "mconbo-gail", "budget": "laptop", "seed": 1, "iterations": ROWS,
    "episode_length": 100, "bonus_p": 0.1, "bonus_q": 0.5, "bonus_in_fitness": False, "selection": "learned",
    "warmup_updates": 4, "walk_updates": 2,
}  # fmt: skip
RESTARTS = (20, 26, 32)  # rows that end in a restart, all of them late
RISING = 4.0 * np.arange(1, ELITES + 1)  # a fitness from 4 to 100, per step from 0.04 to about 1


def healthy_metrics():
    """A run's metrics without a fault. Every fifth elite's rank is another in each of the archive's fields."""
    restarts = np.cumsum([row in RESTARTS for row in range(ROWS)])
    age, ages = 0, []
    for row in range(ROWS):
        ages.append(age)
        age = 0 if row in RESTARTS else age + 1
    constant = {
        "coverage": 0.5, "walk_reward": 1.25, "walk_learned": 1.0, "walk_q_share": 0.3, "gradient_q_share": 0.4,
        "expert_accuracy": 0.8, "policy_accuracy": 0.75, "expert_reward": 1.5, "heldout_reward": 1.3,
        "policy_reward": 0.5, "rolled_back": 0.0, "reward_rolled_back": 0.0, "c0": 0.5, "c1": 0.1, "c2": 0.0,
    }  # fmt: skip
    return pd.DataFrame({"iteration": np.arange(1, ROWS + 1), "restarts": restarts, "age": ages} | constant)


def healthy_archive():
    index = np.arange(ELITES)
    measures = (np.stack(np.unravel_index(index, (CELLS, CELLS)), axis=1) + 0.5) / CELLS
    shuffled = np.random.default_rng(0).permutation(ELITES)
    return {
        "index": index, "cells": np.array([CELLS, CELLS]), "measures": measures, "rescored_measures": measures.copy(),
        "fitness": RISING, "rescored_fitness": RISING / 1.02, "true_return": RISING**2, "rescored_return": RISING**3,
        "length": 90.0 + 0.4 * shuffled,
    }  # fmt: skip


def write(folder, settings=None, metrics=None, archive=None, drop=()):
    """A run with some columns or fields replaced, and those in ``drop`` left out."""
    write_json(folder / "config.json", SETTINGS | (settings or {}))
    columns = healthy_metrics().assign(**(metrics or {}))
    columns.drop(columns=[name for name in drop if name in columns]).to_csv(folder / "metrics.csv", index=False)
    fields = healthy_archive() | (archive or {})
    write_npz(folder / "archive.npz", **{name: value for name, value in fields.items() if name not in drop})
    (folder / "manifest.json").write_text("{}")
    return folder


def findings(folder):
    return {finding.check.name: finding for finding in diagnosis.diagnose(folder).findings}


def statuses(folder):
    return {name: finding.status for name, finding in findings(folder).items()}


def test_a_healthy_run_is_ok_everywhere(tmp_path):
    found = findings(write(tmp_path))
    assert {finding.status for finding in found.values()} == {OK} and list(found) == list(BY_NAME)
    known = {
        "expert_accuracy": 0.8, "policy_accuracy": 0.75, "heldout_reward": 0.8, "order_stored": 1.0,
        "order_fresh": 1.0, "stale_ratio": 1.02, "stale_order": 1.0, "relanded": 1.0, "relanded_near": 1.0,
        "restart_jump": 1.0, "restart_share": 0.15, "idle_share": 0.0, "gradient_q_share": 0.4, "walk_q_share": 0.3,
        "discarded": 0.0,
    }  # fmt: skip
    assert {name: found[name].value for name in known} == pytest.approx(known)
    assert found["episode_share"].value == pytest.approx((90 + 0.4 * 12) / 100)


def some(share):
    """1 in the given share of late rows and in all early ones, which must not count, else 0."""
    late = ROWS - ROWS // 2
    return np.concatenate([np.ones(ROWS // 2), np.arange(late) < share * late])


def moved(cells):
    """The measures of fresh episodes that land so many ``cells`` away in the first measure."""
    archive = healthy_archive()
    row = archive["index"] // CELLS
    return archive["measures"] + np.stack([np.where(row < CELLS - cells, cells, -cells) / CELLS, 0.0 * row], axis=1)


AT_RESTARTS = np.where(np.isin(np.arange(ROWS), np.array(RESTARTS) + 1), 3.0, 1.0)
BACKWARDS = RISING[::-1]
# What is changed in a healthy run, the number that comes of it, and the side of the healthy range it is on.
FAULTS = [
    ("expert_accuracy", {"metrics": {"expert_accuracy": 0.97}}, 0.97, "above"),
    ("expert_accuracy", {"metrics": {"expert_accuracy": 0.5 * some(1)}}, 0.5, "below"),
    ("policy_accuracy", {"metrics": {"policy_accuracy": some(1)}}, 1.0, "above"),
    ("policy_accuracy", {"metrics": {"policy_accuracy": 0.5}}, 0.5, "below"),
    ("heldout_reward", {"metrics": {"heldout_reward": 0.75}}, 0.25, "below"),
    ("order_stored", {"archive": {"true_return": BACKWARDS}}, -1.0, "below"),
    ("order_fresh", {"archive": {"rescored_return": BACKWARDS}}, -1.0, "below"),
    ("survival_share", {"settings": {"bonus_p": 10.0}}, None, "above"),
    ("survival_share", {"archive": {"rescored_fitness": 50 + RISING / 1e3}}, None, "above"),
    ("survival_order", {"archive": {"length": 50.0 + 0.5 * RISING}}, 1.0, "above"),
    ("survival_order", {"archive": {"length": 50.0 + 0.5 * BACKWARDS}}, -1.0, "below"),
    ("stale_ratio", {"archive": {"rescored_fitness": RISING / 3}}, 3.0, "above"),
    ("stale_ratio", {"archive": {"rescored_fitness": 2 * RISING}}, 0.5, "below"),
    ("stale_order", {"archive": {"rescored_fitness": BACKWARDS}}, -1.0, "below"),
    ("relanded", {"archive": {"rescored_measures": moved(1)}}, 0.0, "below"),
    ("relanded_near", {"archive": {"rescored_measures": moved(2)}}, 0.0, "below"),
    ("episode_share", {"archive": {"length": np.full(ELITES, 40.0) + np.arange(ELITES)}}, 0.52, "below"),
    ("restart_jump", {"metrics": {"walk_learned": AT_RESTARTS}}, 3.0, "above"),
    ("restart_jump", {"metrics": {"walk_learned": 1 / AT_RESTARTS}}, 1 / 3, "below"),
    ("restart_share", {"metrics": {"restarts": np.cumsum(some(0.5))}}, 0.5, "above"),
    ("idle_share", {"metrics": {"c0": 1.0 - some(0.2), "c1": 1e-17}}, 0.2, "above"),
    ("gradient_q_share", {"metrics": {"gradient_q_share": 0.01}}, 0.01, "below"),
    ("gradient_q_share", {"metrics": {"gradient_q_share": 0.95}}, 0.95, "above"),
    ("walk_q_share", {"metrics": {"walk_q_share": 0.01}}, 0.01, "below"),
    ("walk_q_share", {"metrics": {"walk_q_share": 0.95}}, 0.95, "above"),
    # 40 iterations of 2 phases, 40 rollouts for the reward and 40 rounds of it; 2 of each in the warm-up.
    ("discarded", {"metrics": {"rolled_back": 0.25, "reward_rolled_back": 0.1}}, (10 + 4) / (160 + 4), "above"),
]


@pytest.mark.parametrize(("name", "changes", "value", "side"), FAULTS)
def test_a_fault_is_found_and_named(tmp_path, name, changes, value, side):
    finding = findings(write(tmp_path, **changes))[name]
    assert finding.status == LOOK
    if value is not None:
        assert finding.value == pytest.approx(value)
    assert finding.advice == getattr(BY_NAME[name], side) != ""


def test_every_check_has_a_fault_on_every_side_that_it_can_leave():
    sides = {(check.name, side) for check in CHECKS for side in ("below", "above") if getattr(check, side)}
    assert {(name, side) for name, _, _, side in FAULTS} == sides
    for check in CHECKS:
        lowest, highest = {"share": (0, 1), "correlation": (-1, 1), "ratio": (0, math.inf)}[check.form]
        assert bool(check.below) == (check.low > lowest) and bool(check.above) == (check.high < highest)


def test_the_reward_for_staying_is_p_and_what_the_poorest_elites_get(tmp_path):
    archive = {"rescored_fitness": np.arange(1.0, 102.0), "rescored_length": np.full(101, 10.0)}
    write_npz(write(tmp_path) / "archive.npz", **archive)
    # Per step 0.1 to 10.1: the 5th percentile is 0.6, the mean 5.1.
    assert findings(tmp_path)["survival_share"].value == pytest.approx((0.1 + 0.6) / (0.1 + 5.1))
    write_json(tmp_path / "config.json", SETTINGS | {"bonus_in_fitness": True})  # then p is part of the fitness
    assert findings(tmp_path)["survival_share"].value == pytest.approx(0.6 / 5.1)
    write_json(tmp_path / "config.json", SETTINGS | {"method": "mcond-gail"})
    assert findings(tmp_path)["survival_share"].value == pytest.approx(0.6 / 5.1)
    write_npz(tmp_path / "archive.npz", **(archive | {"rescored_fitness": np.arange(101.0) - 20}))
    assert findings(tmp_path)["survival_share"].value == 0.0  # a negative floor is no reward for staying


# What is missing


NEW = ("age", "walk_learned", "walk_q_share", "gradient_q_share", "expert_reward", "heldout_reward", "policy_reward")


def test_an_older_run_lacks_what_it_did_not_record_and_keeps_the_rest(tmp_path):
    reward = 1.25 * AT_RESTARTS
    found = findings(write(tmp_path, metrics={"walk_reward": reward}, drop=NEW))
    missing = {name for name, finding in found.items() if finding.status == NOT_RECORDED}
    assert missing == {"heldout_reward", "gradient_q_share", "walk_q_share"}
    assert found["restart_jump"].value == pytest.approx((3 * 1.25 - 0.1) / (1.25 - 0.1))  # p is taken off


def test_ages_follow_from_restarts_where_they_were_not_recorded(tmp_path):
    recorded = symptoms.ages(symptoms.read(write(tmp_path)))
    np.testing.assert_array_equal(symptoms.ages(symptoms.read(write(tmp_path, drop=("age",)))), recorded)


def test_a_run_that_has_begun_is_a_page_of_not_recorded(tmp_path, capsys):
    write_json(tmp_path / "config.json", SETTINGS)
    assert set(statuses(tmp_path).values()) == {NOT_RECORDED}
    assert main(["diagnose", str(tmp_path)]) == 0
    assert "not finished, no iterations recorded" in capsys.readouterr().out


def test_an_unfinished_run_is_judged_by_the_iterations_that_it_has(tmp_path):
    write(tmp_path, metrics={"expert_accuracy": np.where(np.arange(ROWS) < 30, 0.5, 0.9)})
    (tmp_path / "archive.npz").unlink(), (tmp_path / "manifest.json").unlink()
    found = findings(tmp_path)
    assert found["expert_accuracy"].value == pytest.approx(0.7)  # of rows 20 to 39
    assert found["stale_ratio"].status == NOT_RECORDED
    assert f"not finished, {ROWS} of {ROWS} iterations" in diagnosis.diagnose(tmp_path).title


def test_a_run_without_fresh_episodes_has_no_fresh_numbers(tmp_path):
    fresh = ("rescored_fitness", "rescored_return", "rescored_measures")
    missing = {name for name, status in statuses(write(tmp_path, drop=fresh)).items() if status == NOT_RECORDED}
    assert missing == {"order_fresh", "stale_ratio", "stale_order", "relanded", "relanded_near"}


def test_questions_about_imitation_do_not_apply_to_the_true_reward(tmp_path):
    true = healthy_archive()["true_return"]
    drop = ("expert_accuracy", "policy_accuracy", "reward_rolled_back", *NEW)
    archive = {"fitness": true, "rescored_fitness": true, "rescored_return": true}
    found = statuses(write(tmp_path, {"method": "true"}, archive=archive, drop=drop))
    assert {name for name, status in found.items() if status == NOT_APPLICABLE} == {
        "expert_accuracy", "policy_accuracy", "heldout_reward", "order_stored", "order_fresh", "survival_share",
        "gradient_q_share", "walk_q_share",
    }  # fmt: skip
    assert {name for name, status in found.items() if status == NOT_RECORDED} == set()


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"settings": {"method": "airl"}}, "stale_ratio"),
        ({"settings": {"method": "airl"}}, "restart_jump"),
        ({"archive": {"rescored_fitness": -RISING}}, "stale_ratio"),
        ({"archive": {"rescored_fitness": -RISING}}, "survival_share"),
        ({"archive": {"length": np.full(ELITES, 100.0)}}, "survival_order"),
        ({"archive": {"fitness": np.zeros(ELITES)}}, "order_stored"),
        ({"metrics": {"policy_reward": 1.5}}, "heldout_reward"),
        ({"metrics": {"restarts": 0, "age": np.arange(ROWS)}}, "restart_jump"),
        ({"metrics": {"coverage": 0.99}}, "walk_q_share"),
        ({"settings": {"bonus_q": 0.0}}, "gradient_q_share"),
        ({"settings": {"bonus_scope": "step"}}, "walk_q_share"),
    ],
)
def test_a_number_that_would_mean_nothing_is_not_given(tmp_path, changes, name):
    finding = findings(write(tmp_path, **changes))[name]
    assert finding.status == NOT_APPLICABLE and math.isnan(finding.value) and finding.why


def test_a_folder_without_a_run_is_refused(tmp_path, capsys):
    with pytest.raises(ConfigError, match="there is no run in"):
        diagnosis.diagnose(tmp_path)
    assert main(["diagnose", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"qdil: there is no run in {tmp_path}.\n"
    for arguments in ([], [str(tmp_path), "--env", "walker2d", "--method", "gail"], ["--env", "walker2d"]):
        assert main(["diagnose", *arguments]) == 2
        assert "either the run's folder, or both --env and --method" in capsys.readouterr().err


@given(st.lists(st.tuples(st.integers(-3, 3), st.integers(-3, 3)), min_size=3, max_size=30))
def test_rank_correlation_is_spearmans_with_ties(pairs):
    one, other = np.array(pairs, float).T
    if np.ptp(one) == 0 or np.ptp(other) == 0:
        assert math.isnan(symptoms.rank_correlation(one, other))
    else:
        assert symptoms.rank_correlation(one, other) == pytest.approx(spearmanr(one, other)[0], abs=1e-12)


def test_a_correlation_of_one_half_orders_two_of_three_pairs():
    """The source of the healthy range of orders."""
    rng = np.random.default_rng(0)
    pearson = 2 * np.sin(0.5 * np.pi / 6)
    x = rng.normal(size=(2, 200_000))
    y = pearson * x + np.sqrt(1 - pearson**2) * rng.normal(size=x.shape)
    assert np.mean((x[0] > x[1]) == (y[0] > y[1])) == pytest.approx(2 / 3, abs=0.01)
    assert symptoms.rank_correlation(x[0], y[0]) == pytest.approx(0.5, abs=0.01)


# The page, the object, the table, the figure


def test_the_page_fits_a_screen_and_groups_advice(tmp_path, capsys):
    write(tmp_path, archive={"rescored_fitness": RISING[::-1] / 3})
    assert main(["diagnose", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 40 and max(map(len, lines)) <= diagnosis.PAGE
    (row,) = [line for line in lines if line.startswith("  stored fitness / fresh fitness")]
    assert re.search(r"3\.00 +0\.80 to 1\.25 +look here$", row)
    assert "3 of 18 numbers need a look." in lines
    text = " ".join(line.strip() for line in lines)
    together = "stored fitness / fresh fitness; order of stored and fresh fitness: Elites keep scores"
    assert text.count("Elites keep scores") == 1 and together in text


def test_a_run_that_learned_nothing_for_discarded_phases_says_so_first(tmp_path):
    write(tmp_path, metrics={"rolled_back": 2.0, "reward_rolled_back": 1.0})
    found = diagnosis.diagnose(tmp_path)
    assert diagnosis.report(found).splitlines()[1] == diagnosis.MOSTLY_DISCARDED
    assert diagnosis.MOSTLY_DISCARDED not in diagnosis.report(diagnosis.diagnose(write(tmp_path)))


def test_the_object_holds_every_finding(tmp_path, capsys):
    write(tmp_path, metrics={"expert_accuracy": 0.99}, drop=("walk_q_share",))
    assert main(["diagnose", str(tmp_path), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert (content["run"], content["finished"], content["iterations"]) == (tmp_path.as_posix(), True, ROWS)
    assert list(content["findings"]) == list(BY_NAME)
    accuracy, share = (content["findings"][name] for name in ("expert_accuracy", "walk_q_share"))
    assert accuracy == {"value": 0.99, "low": 0.55, "high": 0.95, "status": LOOK, "note": diagnosis.TOO_STRONG}
    assert share["value"] is None and share["status"] == NOT_RECORDED


def test_a_run_is_found_by_its_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "results" / "laptop" / "walker2d" / "mconbo-gail+bonus_q=1.0" / "seed-2"
    write(folder)
    by_name = ["--env", "walker2d", "--method", "mconbo-gail", "--seed", "2", "--set", "bonus_q=1.0"]
    assert main(["diagnose", *by_name]) == 0
    assert "mconbo-gail+bonus_q=1.0/seed-2: finished" in capsys.readouterr().out


def test_the_table_shows_means_over_seeds_and_marks_what_is_outside(tmp_path):
    factors = {"a": (1.0, 1.2), "b": (2.0, 4.0)}
    runs = {
        name: [write(tmp_path / name / str(f), archive={"rescored_fitness": RISING / f}) for f in of]
        for name, of in factors.items()
    }
    table = diagnosis.table(diagnosis.of_runs(runs))
    row = table.loc[("archive", "stored fitness / fresh fitness")]
    assert (row["healthy"], row["a"], row["b"]) == ("0.80 to 1.25", "1.10", "3.00 (look here)")
    assert len(table) == len(CHECKS)


def test_healthy_ranges_in_words():
    words = {check.name: diagnosis.healthy(check) for check in CHECKS}
    assert words["expert_accuracy"] == "55 to 95 %" and words["heldout_reward"] == "at least 50 %"
    assert words["restart_share"] == "at most 20 %" and words["survival_order"] == "-0.50 to 0.50"


def test_advice_names_settings_that_exist():
    texts = " ".join(check.below + check.above for check in CHECKS)
    assert set(re.findall(r"\b\w+_\w+\b", texts)) <= set(GROUP_OF)


def test_the_figure_has_a_mark_for_every_known_number_where_it_belongs(tmp_path):
    runs = {
        "gail": [write(tmp_path / "1", {"method": "gail"})],
        "mconbo-gail": [write(tmp_path / str(seed), metrics={"expert_accuracy": 0.6}) for seed in (2, 3)],
    }
    tidy = diagnosis.tidy(diagnosis.of_runs(runs))
    figure = plotting.findings(tidy)
    (ax,) = figure.axes
    marks = {line.get_label(): line.get_xydata() for line in ax.get_lines() if line.get_linestyle() == "None"}
    assert {name: len(data) for name, data in marks.items()} == {"GAIL": 16, "MConbo-GAIL": 36}
    titles = [text.get_text() for text in ax.get_yticklabels()]
    assert titles == [check.title for check in CHECKS]
    of_row = marks["MConbo-GAIL"][np.round(marks["MConbo-GAIL"][:, 1]) == 0]
    np.testing.assert_allclose(of_row[:, 0], 0.6)
    with pytest.raises(ValueError, match="no numbers"):
        plotting.findings(tidy.iloc[:0])


def test_positions_in_a_row_of_the_figure():
    np.testing.assert_allclose(position([0.0, 0.3, 1.0, np.inf], "share"), [0, 0.3, 1, 1])
    np.testing.assert_allclose(position([-1, 0, 1], "correlation"), [0, 0.5, 1])
    np.testing.assert_allclose(position([0.25, 0.5, 1, 2, 8, 100, -1], "ratio"), [0, 0.2, 0.4, 0.6, 1, 1, 0])
