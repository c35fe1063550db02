"""Claims by both readings, under every protocol, over the seeds that count, and after Holm's correction."""

import json
import shutil
import subprocess

import numpy as np
import pytest
from fake_runs import write_arms, write_run

from qdil.config import BUDGETS, LAPTOP
from qdil.evidence import claims, claims_page, provenance, report, verdicts
from qdil.evidence.arms import ANOTHER, Arm
from qdil.evidence.corrected import METRICS
from qdil.evidence.stats import Interval
from qdil.evidence.verdicts import INCONCLUSIVE, NO_RUNS, NOT_REPRODUCED, REPRODUCED, Part
from qdil.runs.experiments import COUNTED_SEEDS
from qdil.runs.folder import folder_of
from qdil.runs.studies import PROTOCOL_NAMES, budget_of, under, without_protocol

HIGH, LOW = [110.0, 120.0, 130.0], [10.0, 20.0, 30.0]


def judged(root, claim, env="walker2d", budget="laptop"):
    """The verdicts on one claim by protocol."""
    return {v.protocol: v for v in claims.judge(root, budget, [env]) if v.claim.id == claim and v.env == env}


def row_of(root, claim, protocol="paper"):
    """A claim's row in the table of verdicts."""
    table = report.overview(claims.judge(root, "laptop", ["walker2d"]), "walker2d")
    [row] = table[(table["id"] == claim) & (table["protocol"] == protocol)].to_dict("records")
    return row


def test_a_claim_may_hold_as_claimed_and_fail_corrected(tmp_path):
    for seed in (1, 2, 3):
        write_run(tmp_path, "walker2d", "mconbo-gail", seed, qd_score=100.0 + seed, corrected_qd_score=40.0 + seed)
        write_run(tmp_path, "walker2d", "gail", seed, qd_score=80.0 + seed / 2, corrected_qd_score=60.0 + seed / 2)
    found = judged(tmp_path, "C1")["paper"]
    assert [f.verdict for f in found.findings] == [REPRODUCED] and [f.verdict for f in found.corrected] == [
        NOT_REPRODUCED
    ]
    row = row_of(tmp_path, "C1")
    assert (row["as claimed"], row["corrected"], row["Holm"]) == (REPRODUCED, NOT_REPRODUCED, "unchanged")
    both = claims.table([found])
    assert both["ours"].to_list() == ["102 against 81", "42 against 61"]
    assert both["comparison"].to_list()[1] == "corrected QD-score: MConbo-GAIL above GAIL"
    assert both["paper"].to_list()[1] == "–"


def test_only_claims_about_the_four_metrics_have_a_corrected_reading(tmp_path):
    without = {v.claim.id for v in claims.judge(tmp_path) if not v.corrected}
    assert without == {"C14", "C15", "C16"}
    for v in claims.judge(tmp_path):
        for claimed, corrected in zip(v.findings, v.corrected, strict=False):
            assert corrected.part == claimed.part._replace(reading=f"corrected_{claimed.part.reading}")


def test_other_protocols_are_judged_where_they_have_runs(tmp_path):
    released = {"mconbo-gail+protocol=released": LOW, "gail+protocol=released": HIGH}
    write_arms(tmp_path, "walker2d", "qd_score", released | {"mconbo-gail": HIGH, "gail": LOW, "true": LOW})
    found = judged(tmp_path, "C1")
    assert {p: v.verdict for p, v in found.items()} == {"paper": REPRODUCED, "released": NOT_REPRODUCED}
    # The expert is the run that demonstrates, whatever the protocol of its imitators.
    against = judged(tmp_path, "C4")["released"].findings[0].part
    assert (against.ours, against.against) == ("mconbo-gail+protocol=released", ("true",))
    order = [v.protocol for v in claims.judge(tmp_path, "laptop", ["walker2d"])]
    assert order == sorted(order, key=PROTOCOL_NAMES.index) and set(order) == set(PROTOCOL_NAMES)


def test_every_protocol_is_compared_with_its_own_runs():
    of_released = claims.experiments_needed(protocol="released")
    fixed = {name for name in of_released if "protocol=released" not in name and "/" not in name}
    assert fixed == {"true", "mconbo-gail", "gail"}  # the expert, and what the gain is compared with
    assert "mbo-gail+protocol=released" in of_released and "mcond-gail+protocol=released" in of_released


@pytest.mark.parametrize(
    "name, protocol, expected",
    [
        ("gail", "paper", "gail"),
        ("gail", "released", "gail+protocol=released"),
        ("true+protocol=paper", "released", "true"),
        ("gail+protocol=improved", "released", "gail+protocol=improved"),
        ("gail+demo_episodes=2", "released", "gail+protocol=released+demo_episodes=2"),
        ("gail+selection=true", "improved", "gail+protocol=improved+selection=true"),
        ("desk/gail", "released", "desk/gail+protocol=released"),
    ],
)
def test_names_under_a_protocol(name, protocol, expected):
    assert under(name, protocol) == expected
    assert without_protocol(expected) == without_protocol(name)


def test_names_with_a_budget():
    assert budget_of("desk/gail+bonus_p=0.0") == ("desk", "gail+bonus_p=0.0") and budget_of("gail") == (None, "gail")


def test_seeds_of_trials_do_not_count(tmp_path):
    for seed in (1, 2, 3):
        write_run(tmp_path, "walker2d", "mconbo-gail", seed, qd_score=100.0 + seed)
        write_run(tmp_path, "walker2d", "gail", seed, qd_score=50.0)
    for seed in (0, 6, 101):
        write_run(tmp_path, "walker2d", "mconbo-gail", seed, qd_score=-1e6)
        write_run(tmp_path, "walker2d", "gail", seed, qd_score=0.0)
    write_run(tmp_path, "walker2d", "gail", 11, qd_score=50.0)
    write_run(tmp_path, "walker2d", "mconbo-gail", 11, qd_score=104.0)
    found = judged(tmp_path, "C1")["paper"]
    assert found.verdict == REPRODUCED and found.findings[0].seeds == ((1, 2, 3, 11),) * 2
    assert not {0, 6, 101} & set(COUNTED_SEEDS)
    page = claims.markdown(claims.judge(tmp_path), "laptop", tmp_path)
    assert "1-3, 11 of `mconbo-gail`" in page and "101" not in page.split("## Runs")[1].split("##")[0]


def test_runs_that_learned_from_one_expert_are_not_paired_and_marked(tmp_path):
    write_arms(tmp_path, "walker2d", "qd_score", {"mconbo-gail": [3.0, 2.0, 1.0], "gail": [2.9, 1.9, 0.85]})
    assert judged(tmp_path, "C1")["paper"].verdict == REPRODUCED  # paired: fake runs learned from nobody
    for name in ("mconbo-gail", "gail"):
        for seed in (1, 2, 3):
            path = folder_of(name, "walker2d", "laptop", seed, tmp_path) / "manifest.json"
            path.write_text(json.dumps({"demonstrations_sha256": "the same for all"}))
    found = judged(tmp_path, "C1")["paper"]
    assert found.verdict == INCONCLUSIVE and not found.findings[0].paired
    page = claims.markdown([found], "laptop", tmp_path)
    assert "| 1-3 ‡ " in page and claims_page.UNPAIRED_NOTE in page


def test_holm_corrects_for_a_claims_comparisons():
    part = Part("above", "a", ("b",), "qd_score")
    surely = {"a": Arm({1: 10.0, 2: 10.1, 3: 9.9}), "b": Arm({1: 1.0, 2: 1.0, 3: 1.0})}
    hardly = {"a": Arm({1: 9.2, 2: 7.0, 3: 5.0}), "b": Arm({1: 1.0, 2: 1.0, 3: 1.0})}
    one, other = verdicts.find(part, surely), verdicts.find(part, hardly)
    assert one.verdict == other.verdict == REPRODUCED and one.p_value < 0.01 < 0.025 < other.p_value < 0.05
    assert [f.after_holm for f in verdicts.with_holm([other])] == [REPRODUCED]
    assert [f.after_holm for f in verdicts.with_holm([one, other])] == [REPRODUCED, REPRODUCED]  # 0.05 for the last
    assert [f.after_holm for f in verdicts.with_holm([other, other])] == [INCONCLUSIVE] * 2
    missing = verdicts.find(part, {"a": surely["a"]})
    assert [f.after_holm for f in verdicts.with_holm([other, missing])] == [INCONCLUSIVE, NO_RUNS]


def test_holm_is_shown_where_it_changes_a_verdict(tmp_path):
    # The p-values of the four metrics are 4 %: each holds by itself, none after the correction.
    for seed, value in enumerate([9.2, 7.0, 5.0], start=1):
        write_run(tmp_path, "walker2d", "mconbo-gail", seed, **dict.fromkeys(METRICS, value))
        write_run(tmp_path, "walker2d", "mcond-gail", seed, **dict.fromkeys(METRICS, 1.0))
    row = row_of(tmp_path, "C7")
    assert row["as claimed"] == row["corrected"] == REPRODUCED and row["Holm"] == "inconclusive / inconclusive"


@pytest.mark.parametrize(
    "low, high, expected",
    [
        (0.2, 0.5, REPRODUCED),
        (-0.5, -0.2, REPRODUCED),
        (0.01, 0.02, REPRODUCED),  # small, and still a difference
        (-0.05, 0.09, NOT_REPRODUCED),
        (-0.05, 0.11, INCONCLUSIVE),
        (-0.5, 0.01, INCONCLUSIVE),
        (np.nan, np.nan, INCONCLUSIVE),
    ],
)
def test_whether_two_gains_differ(low, high, expected):
    assert verdicts.decide_two_sided(Interval(0.0, low, high), 0.1) == expected


def test_gains_are_paired_by_seed_within_a_budget():
    part = Part("gain differs", "a+protocol=released", ("b+protocol=released", "a", "b"), "qd_score", 0.1)
    values = {"a+protocol=released": {1: 30.0, 2: 50.0, 3: 1.0}, "b+protocol=released": {1: 20.0, 2: 20.0},
              "a": {1: 110.0, 2: 130.0}, "b": {1: 100.0, 2: 100.0, 3: 5.0}}  # fmt: skip
    found = verdicts.find(part, {name: Arm(arm) for name, arm in values.items()})
    # Gains of seeds 1 and 2: 10/20 and 30/20, against 10/100 and 30/100.
    assert found.difference.estimate == pytest.approx(np.mean([0.5 - 0.1, 1.5 - 0.3]))
    assert found.seeds == ((1, 2),) * 4 and found.verdict == INCONCLUSIVE
    foreign = {name: Arm(arm, dict.fromkeys(arm, ANOTHER)) for name, arm in values.items()}
    assert verdicts.find(part, foreign).verdict == INCONCLUSIVE
    assert np.isnan(verdicts.find(part, foreign).difference.estimate)


def test_gains_of_two_budgets_are_compared_over_all_seeds_of_each(tmp_path, monkeypatch):
    monkeypatch.setitem(BUDGETS, "desk", LAPTOP)
    for budget, scale, seeds in (("laptop", 100.0, (1, 2, 3, 4)), ("desk", 1000.0, (1, 2, 3))):
        for seed in seeds:
            gain = 0.3 if budget == "laptop" else 1.3
            noise = 0.01 * (seed % 2)
            write_run(tmp_path, "walker2d", "gail", seed, budget, qd_score=scale)
            write_run(tmp_path, "walker2d", "mconbo-gail", seed, budget, qd_score=scale * (1 + gain + noise))
    found = judged(tmp_path, "Q6b")["paper"]
    assert found.verdict == REPRODUCED and found.findings[0].seeds == ((1, 2, 3), (1, 2, 3), (1, 2, 3, 4), (1, 2, 3, 4))
    assert found.findings[0].difference.estimate == pytest.approx(1.0, abs=0.01)
    [row] = claims.table([found])[:1].to_dict("records")
    assert row["comparison"] == (
        "QD-score: gain of MConbo-GAIL (desk) over GAIL (desk), minus that of MConbo-GAIL (laptop) over GAIL (laptop)"
    )
    assert row[report.DIFFERENCE].startswith("+100.2% [") and row["verdict"] == "yes"
    assert "Q6b" not in {v.claim.id for v in claims.judge(tmp_path, "full")}
    page = claims.markdown(claims.judge(tmp_path), "laptop", tmp_path)
    assert "At `desk`:" in page and "1-3 of `mconbo-gail`" in page.split("At `desk`:")[1]


def test_the_page_names_the_commit_of_the_protocol(tmp_path):
    assert provenance.protocol_commit(tmp_path) == "unknown"
    if shutil.which("git") is None:
        pytest.skip("git is not installed")

    def git(*arguments):
        author = ["-c", "user.name=a", "-c", "user.email=a@b"]
        command = ["git", "-C", str(tmp_path), *author, *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    page = tmp_path / "docs" / "protocol.md"
    page.parent.mkdir()
    page.write_text("rules")
    git("init", "-q")
    git("add", ".")
    git("commit", "-q", "-m", "rules")
    commit = git("rev-parse", "HEAD")
    (tmp_path / "other").write_text("x")
    git("add", ".")
    git("commit", "-q", "-m", "something else")
    assert provenance.protocol_commit(tmp_path) == commit[:7]
    page.write_text("other rules")
    assert provenance.protocol_commit(tmp_path) == f"{commit[:7]} with local changes"
