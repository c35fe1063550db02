"""Which runs are paired by seed, and which are not."""

import json

import numpy as np
import pytest
from fake_runs import write_run

from qdil.evidence import arms, tables
from qdil.evidence.arms import ANOTHER, Arm
from qdil.evidence.readings import READINGS


def manifest(seed, archive="a"):
    """That of a run that learned from the expert of ``seed``, whose archive has the hash ``archive``."""
    return {
        "demonstrations_sha256": "d",
        "demonstrations_expert": {"run": "r", "seed": seed, "archive_sha256": archive},
    }


def test_manifests_say_whose_demonstrations_a_run_learned_from():
    assert arms.expert_of({"demonstrations_sha256": None}, 2) is None
    assert arms.expert_of(manifest(2), 2) == "a"
    assert arms.expert_of(manifest(1), 2) == ANOTHER
    assert arms.expert_of({"demonstrations_sha256": "d"}, 2) == ANOTHER  # made before experts were recorded
    assert arms.expert_of({"demonstrations_sha256": "d", "demonstrations_expert": None}, 2) == ANOTHER


def test_an_arm_has_a_number_and_an_expert_per_seed(tmp_path):
    for seed in (1, 2, 11):
        folder = write_run(tmp_path, "walker2d", "gail", seed, qd_score=10.0 * seed)
        (folder / "manifest.json").write_text(json.dumps(manifest(seed, f"of {seed}")))
    folders = tables.finished_seeds(["gail"], "walker2d", "laptop", tmp_path)["gail"]
    found = arms.read(folders, READINGS["qd_score"])
    assert found == Arm({1: 10.0, 2: 20.0, 11: 110.0}, {1: "of 1", 2: "of 2", 11: "of 11"})


def test_runs_of_own_experts_are_paired_over_shared_seeds():
    ours = Arm({1: 10.0, 2: 21.0, 3: 99.0}, {1: "a", 2: "b", 3: "c"})
    expert = Arm({1: 8.0, 2: 18.0, 4: -99.0}, {1: None, 2: None, 4: None})
    found = arms.difference(ours, expert)
    assert found.paired and found.difference.value == 2.5 and found.seeds() == ((1, 2), (1, 2))
    assert arms.seeds_text(found.seeds(), found.paired) == "1-2"


def test_runs_of_another_seeds_expert_are_not_paired():
    ours = Arm({1: 10.0, 2: 20.0, 3: 30.0}, {1: "a", 2: ANOTHER, 3: ANOTHER})
    reference = Arm({1: 1.0, 2: 2.0}, {1: "a", 2: "b"})
    found = arms.difference(ours, reference)
    assert not found.paired and found.difference.value == 20.0 - 1.5 and found.seeds() == ((1, 2, 3), (1, 2))
    assert arms.seeds_text(found.seeds(), found.paired) == "1-3 / 1-2 ‡"
    spread = np.sqrt(np.var([10, 20, 30], ddof=1) / 3 + np.var([1, 2], ddof=1) / 2)
    assert found.difference.error == pytest.approx(spread)


def test_an_expert_that_was_trained_anew_between_two_runs_is_another():
    ours, reference = Arm({1: 1.0, 2: 2.0}, {1: "a", 2: "b"}), Arm({1: 1.0, 2: 2.0}, {1: "a", 2: "c"})
    assert arms.pairable([ours, ours]) and not arms.pairable([ours, reference])
    assert arms.pairable([ours, Arm({1: 1.0, 3: 2.0}, {1: "a", 3: "c"})])  # seed 1 alone is shared


def test_without_a_shared_seed_nothing_is_compared():
    found = arms.difference(Arm({1: 1.0, 2: 2.0}), Arm({3: 1.0, 4: 2.0}))
    assert np.isnan(found.difference.value) and found.seeds() == ((1, 2), (3, 4))


@pytest.mark.parametrize("seeds, text", [([(1, 2, 3, 5)], "1-3, 5"), ([()], "none"), ([(4,), (1, 11)], "4 / 1, 11")])
def test_seeds_are_listed_in_ranges(seeds, text):
    assert arms.seeds_text(seeds) == text
