"""Verdicts on runs whose numbers are known: every kind of comparison, each way it can go."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from fake_runs import write_archive, write_arms, write_run

from qdil import cli
from qdil.errors import ConfigError
from qdil.evidence import catalogue, claims, readings, report, verdicts
from qdil.evidence.arms import Arm
from qdil.evidence.verdicts import INCONCLUSIVE, NO_RUNS, NOT_REPRODUCED, REPRODUCED
from qdil.methods import BUILT_IN
from qdil.robots.register import PAPER_ROBOTS
from qdil.runs.folder import folder_of
from qdil.runs.studies import STUDIES, budget_of, config_of

ROOT = Path(claims.__file__).parent.parent.parent
HIGH, LOW, MIXED = [110.0, 120.0, 130.0], [10.0, 20.0, 30.0], [5.0, 115.0, 200.0]


def verdict_of(root, claim, env="walker2d"):
    judged = [v for v in claims.judge(root, "laptop", [env]) if v.claim.id == claim and v.env == env]
    [found] = [v for v in judged if v.protocol == v.claim.protocols[0]]
    return found


def test_every_claim_and_question_of_the_design_is_there_once():
    ids = [claim.id for claim in claims.CLAIMS]
    later = ["E1", "E2", "E3", "E4a", "E4b", "E4c", "E5"]
    ours = ["Q1a", "Q1b", "Q1c", "Q1d", "Q1e", "Q2", "Q3", "Q4", "Q5a", "Q5b", "Q6a", "Q6b"]
    assert ids == [f"C{i}" for i in range(1, 17)] + later + ours


def test_claims_compare_experiments_that_the_studies_train():
    trained = {name for names in STUDIES.values() for name in names}
    of_paper = claims.experiments_needed(protocol="paper")
    needed = {budget_of(name)[1] for name in of_paper}
    assert needed <= trained
    assert len({config_of(name, "walker2d", "laptop") for name in needed}) == len(needed)
    later = claims.experiments_needed([claim for claim in claims.CLAIMS if claim.source == verdicts.LATER])
    built_in = {name for name in later if "diffail" not in name or any(base.name == "diffail" for base in BUILT_IN)}
    assert built_in <= trained and {"mbo-gail+protocol=released", "true", "mbo-true+protocol=released"} <= set(later)


def test_nothing_was_run(tmp_path):
    judged = claims.judge(tmp_path)
    assert {v.verdict for v in judged} == {NO_RUNS}
    expected = [(c.id, env) for c in claims.CLAIMS for env in PAPER_ROBOTS] + [("C14", "mdp")]
    assert sorted((v.claim.id, v.env) for v in judged) == sorted(expected)  # each under its first protocol alone
    page = claims.markdown(judged, "laptop", tmp_path)
    assert "There are no runs." in page and page.count("No runs yet: C1, C2, C3,") == 3 and "No runs yet: C14." in page


@pytest.mark.parametrize(
    "ours, reference, expected",
    [
        (HIGH, LOW, REPRODUCED),
        (LOW, HIGH, NOT_REPRODUCED),
        (MIXED, HIGH, INCONCLUSIVE),
        ([30.0, 20.0, 10.0], [29.0, 19.0, 8.9], REPRODUCED),  # pairs differ far less than runs do
        ([30.0, 20.0, 10.0], [9.0, 29.0, 19.0], INCONCLUSIVE),  # the same runs, paired differently
        (HIGH, [], NO_RUNS),
        ([], HIGH, NO_RUNS),
        ([1000.0], LOW, INCONCLUSIVE),  # one seed, however far ahead
        (HIGH, [0.0], INCONCLUSIVE),
        ([7.0] * 3, [7.0] * 3, NOT_REPRODUCED),  # identical seeds are surely not above each other
        ([8.0] * 2, [7.0] * 2, REPRODUCED),
    ],
)
def test_beating_another_method(tmp_path, ours, reference, expected):
    write_arms(tmp_path, "walker2d", "qd_score", {"mconbo-gail": ours, "gail": reference})
    found = verdict_of(tmp_path, "C1")
    assert found.verdict == expected
    all_seeds = [tuple(range(1, len(arm) + 1)) for arm in (ours, reference)]
    shared = min(all_seeds, key=len)
    assert found.findings[0].seeds == ((shared, shared) if shared else tuple(all_seeds))


def test_robots_are_judged_apart_and_those_without_a_claim_are_marked(tmp_path):
    write_arms(tmp_path, "halfcheetah", "average", {"mconbo-gail": HIGH, "gail": LOW})
    assert verdict_of(tmp_path, "C6").verdict == NO_RUNS
    found = verdict_of(tmp_path, "C6", "halfcheetah")
    assert found.verdict == REPRODUCED and found.unclaimed
    [row] = report.overview([found], "halfcheetah").to_dict("records")
    assert (row["id"], row["as claimed"], row["protocol"]) == ("C6 †", "reproduced", "paper")
    assert report.overview([found], "walker2d").empty


@pytest.mark.parametrize(
    "coverage, expert, expected",
    [
        ([0.94, 0.95, 0.96], [0.5, 0.51, 0.52], REPRODUCED),
        ([0.90, 0.90], [0.5, 0.51], REPRODUCED),  # exactly near all
        ([0.79, 0.80, 0.81], [0.5, 0.51, 0.52], NOT_REPRODUCED),  # above the expert's, and still not near all
        ([0.94, 0.95, 0.96], [0.98, 0.99, 1.0], NOT_REPRODUCED),
        ([0.85, 0.95, 0.97], [0.5, 0.51, 0.52], INCONCLUSIVE),
    ],
)
def test_coverage_near_all_and_above_the_experts(tmp_path, coverage, expert, expected):
    write_arms(tmp_path, "walker2d", "coverage", {"mconbo-gail": coverage, "true": expert})
    assert verdict_of(tmp_path, "C3").verdict == expected


def test_reaching_the_expert_is_enough(tmp_path):
    write_arms(tmp_path, "walker2d", "qd_score", {"mconbo-gail": [5.0, 5.0], "true": [5.0, 5.0]})
    assert verdict_of(tmp_path, "C4").verdict == REPRODUCED


def test_all_comparisons_of_a_claim_must_hold(tmp_path):
    for seed in (1, 2):
        write_run(tmp_path, "walker2d", "mconbo-gail", seed, qd_score=9.0 + seed, coverage=0.5, best=5.0, average=3.0)
        write_run(tmp_path, "walker2d", "mcond-gail", seed, qd_score=1.0 + seed, coverage=0.1, best=1.0, average=4.0)
    found = verdict_of(tmp_path, "C7")
    status = {finding.part.reading: finding.verdict for finding in found.findings}
    assert status == {"qd_score": REPRODUCED, "coverage": REPRODUCED, "best": REPRODUCED, "average": NOT_REPRODUCED}
    assert found.verdict == NOT_REPRODUCED


def test_a_claim_with_runs_for_a_part_alone_is_open(tmp_path):
    write_arms(tmp_path, "walker2d", "qd_score", {"mconbo-gail": HIGH, "airl": LOW, "giril": LOW})
    assert verdict_of(tmp_path, "C5").verdict == INCONCLUSIVE
    write_arms(tmp_path, "walker2d", "qd_score", {"pwil": LOW, "maxent": [500.0, 501.0]})
    assert verdict_of(tmp_path, "C5").verdict == NOT_REPRODUCED


def test_conditioning_may_cost_a_tenth_where_the_bonus_must_gain(tmp_path):
    for name, level in {"gail": 100.0, "mcond-gail": 95.0, "mconbo-gail": 120.0}.items():
        for seed in (1, 2):
            write_run(tmp_path, "walker2d", name, seed, qd_score=level + seed, coverage=(level + seed) / 200)
    assert verdict_of(tmp_path, "C8").verdict == REPRODUCED
    write_arms(tmp_path, "walker2d", "qd_score", {"mcond-gail": [80.0, 81.0]})
    assert verdict_of(tmp_path, "C8").verdict == NOT_REPRODUCED


def test_the_best_of_the_grid_beats_every_other_point(tmp_path):
    grid = STUDIES["p-and-q"]
    write_arms(tmp_path, "walker2d", "qd_score", {name: LOW for name in grid} | {catalogue.BEST: HIGH})
    found = verdict_of(tmp_path, "C9")
    assert found.verdict == REPRODUCED and len(found.findings) == 8
    write_arms(tmp_path, "walker2d", "qd_score", {"mconbo-gail+bonus_p=1.0": [1000.0, 1001.0, 1002.0]})
    assert verdict_of(tmp_path, "C9").verdict == NOT_REPRODUCED
    shutil.rmtree(tmp_path / "laptop" / "walker2d" / "mconbo-gail+bonus_p=1.0")
    assert verdict_of(tmp_path, "C9").verdict == INCONCLUSIVE  # a point is missing


@pytest.mark.parametrize("level, expected", [(0.97, REPRODUCED), (0.5, NOT_REPRODUCED), (0.9, INCONCLUSIVE)])
def test_a_marginal_loss_is_at_most_a_tenth(tmp_path, level, expected):
    for seed in (1, 2):
        exact = dict.fromkeys(("qd_score", "coverage", "best", "average"), 100.0)
        write_run(tmp_path, "walker2d", "mconbo-gail", seed, **exact)
        write_run(
            tmp_path, "walker2d", "mconbo-gail-obs", seed, **{k: v * level + (seed - 1.5) / 5 for k, v in exact.items()}
        )
    assert verdict_of(tmp_path, "C10").verdict == expected


def test_margins_of_negative_references_are_still_losses(tmp_path):
    part = verdicts.Part("not below", "a", ("b",), "average", 0.1)
    reference = Arm({1: -100.0, 2: -100.0})
    assert verdicts.find(part, {"a": Arm({1: -105.0, 2: -105.0}), "b": reference}).verdict == REPRODUCED
    assert verdicts.find(part, {"a": Arm({1: -120.0, 2: -120.0}), "b": reference}).verdict == NOT_REPRODUCED


def test_fewer_demonstrations_cost_score_and_not_coverage(tmp_path):
    for n, score in ((4, 100.0), (2, 70.0), (1, 50.0)):
        suffix = "" if n == 4 else f"+demo_episodes={n}"
        for seed in (1, 2):
            write_run(tmp_path, "walker2d", f"mconbo-gail{suffix}", seed, qd_score=score + seed, coverage=0.9)
            write_run(tmp_path, "walker2d", f"gail{suffix}", seed, qd_score=score / 2 + seed, coverage=0.5)
    assert verdict_of(tmp_path, "C11").verdict == REPRODUCED
    write_arms(tmp_path, "walker2d", "qd_score", {"mconbo-gail+demo_episodes=1": [150.0, 151.0]})
    assert verdict_of(tmp_path, "C11").verdict == NOT_REPRODUCED  # its coverage holds, its score does not fall


def test_the_lemma_is_judged_from_its_results_file(tmp_path):
    path = tmp_path / "laptop" / "lemma.json"
    path.parent.mkdir()
    problems = {"mdp": [0.1, 0.12, 0.08], "mdp-falls": [0.1, -0.1], "walker2d": [-0.2, -0.19], "humanoid": [0.3]}
    path.write_text(json.dumps({"environments": {env: {"change": change} for env, change in problems.items()}}))
    judged = {v.env: v for v in claims.judge(tmp_path) if v.claim.id == "C14"}
    assert {env: v.verdict for env, v in judged.items()} == {
        "mdp": REPRODUCED, "mdp-falls": INCONCLUSIVE, "halfcheetah": NO_RUNS, "walker2d": NOT_REPRODUCED,
        "humanoid": INCONCLUSIVE,
    }  # fmt: skip
    assert [env for env, v in judged.items() if v.unclaimed] == ["mdp-falls"]
    assert "* **Lemma 1**: `lemma.json`, made at unknown." in claims.markdown(list(judged.values()), "laptop", tmp_path)
    assert "mdp-falls" not in {v.env for v in claims.judge(tmp_path) if v.claim.id != "C14"}
    assert judged["mdp"].findings[0].means == pytest.approx((0.1,)) and judged["mdp"].findings[0].seeds == ((0, 1, 2),)
    shown = claims.table(list(judged.values())).set_index("robot")
    assert shown.loc["mdp-falls †", "ours"] == "0 (fell in 50% of 2 trials)"
    assert "one PPO update at least 0" in shown.loc["mdp", "comparison"]


def test_a_seeds_archives_are_one_number_of_the_lemma(tmp_path):
    (tmp_path / "laptop").mkdir()
    trials = {"seed": [1, 1, 2, 2], "change": [0.4, 0.2, -0.1, 0.3], "updates": 15}
    (tmp_path / "laptop" / "lemma.json").write_text(json.dumps({"environments": {"walker2d": trials}}))
    found = verdict_of(tmp_path, "C14")
    assert len(found.findings[0].seeds[0]) == 2
    # 0.3 and 0.1 have the error 0.1, and one degree of freedom.
    half = np.tan(0.475 * np.pi) * 0.1
    assert tuple(found.findings[0].difference) == pytest.approx((0.2, 0.2 - half, 0.2 + half))
    [row] = claims.table([found]).to_dict("records")
    assert row["ours"] == "0.2 (fell in 25% of 4 trials)" and "15 PPO updates at least 0" in row["comparison"]
    assert row["seeds"] == "2" and len(claims.table([found])) == 1  # there is no corrected reading of it


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", '{"environments": {"mdp": [1]}}', '{"environments": {"mdp": {"change": ["a"]}}}']
)
def test_a_broken_results_file_is_refused(tmp_path, content):
    (tmp_path / "laptop").mkdir()
    (tmp_path / "laptop" / "lemma.json").write_text(content)
    with pytest.raises(ConfigError, match="lemma.json is no results file"):
        claims.judge(tmp_path)


def test_the_rise_of_c0_counts_iterations_that_find_cells_and_no_restart():
    metrics = pd.DataFrame({
        "coverage": [0.1, 0.2, 0.2, 0.3, 0.4, 0.5],
        "c0": [0.5, 0.7, 3.0, -3.1, 0.9, 1.3],
        "restarts": [0, 0, 0, 1, 1, 1],
    })  # fmt: skip
    # 0.5 to 0.7 counts, to 3.0 finds nothing, 3.0 to 3.1 counts, then xNES starts from 0, 0.9 to 1.3 counts.
    assert readings.c0_rise(metrics) == pytest.approx((0.2 + 0.1 + 0.4) / 3)
    assert np.isnan(readings.c0_rise(metrics.iloc[:1]))


def test_roughness_compares_neighbours_alone(tmp_path):
    grid = np.array([[1.0, 3.0, np.nan], [2.0, np.nan, 8.0]])
    index = np.flatnonzero(np.isfinite(grid))
    archive = {"index": index, "true_return": grid.ravel()[index], "cells": np.array([2, 3])}
    # Neighbours: 1-3 and 1-2; 8 touches nobody's edge.
    assert readings.roughness(archive) == pytest.approx(((3 - 1) + (2 - 1)) / 2 / np.mean([1, 3, 2, 8]))
    alone = {"index": np.array([0]), "true_return": np.array([1.0]), "cells": np.array([2, 3])}
    assert np.isnan(readings.roughness(alone))


def test_smoother_archives_are_distinguished_from_rougher_ones(tmp_path):
    for seed in (1, 2):
        write_run(tmp_path, "humanoid", "mconbo-gail", seed)
        for name in ("gail", "true"):
            write_archive(write_run(tmp_path, "humanoid", name, seed), [0, 1], [0.0, 40.0])
    found = verdict_of(tmp_path, "C16", "humanoid")
    assert [f.means for f in found.findings] == [pytest.approx((1.0, 2.0))] * 2
    assert found.verdict == REPRODUCED


def test_questions_are_answered_with_yes_and_no(tmp_path):
    write_arms(tmp_path, "walker2d", "qd_score", {"mconbo-gail": LOW, "mconbo-gail+selection=true": HIGH,
                                                  "mconbo-gail+walk_weights=fitness": HIGH})  # fmt: skip
    shown = report.overview(claims.judge(tmp_path, "laptop", ["walker2d"]), "walker2d").set_index("id")["as claimed"]
    assert shown["Q2"] == "yes" and shown["Q3"] == "no" and shown["Q4"] == "no runs"


def test_tables_put_the_papers_number_beside_ours(tmp_path):
    write_arms(tmp_path, "walker2d", "qd_score", {"mconbo-gail": [250.0, 250.0], "gail": [100.0, 100.0]})
    write_arms(tmp_path, "walker2d", "qd_score", {"mconbo-vail": [3.0], "vail": [2.0]})
    rows = claims.table(claims.judge(tmp_path)).drop_duplicates("id").set_index("id")
    first = rows.loc["C1"]
    assert first["paper"] == "4,116,000 against 2,483,000" and first["ours"] == "250 against 100"
    assert first[report.DIFFERENCE] == "+150 (+150.0%) [+150, +150]" and first["seeds"] == "1-2"
    second = rows.loc["C2"]
    assert second["paper"] == "not recoverable" and second["seeds"] == "1"
    assert second[report.DIFFERENCE] == "+1 (+50.0%), fewer than 2 seeds to compare"
    assert "C5" not in rows.index and len(claims.table(claims.judge(tmp_path), all_rows=True)) > len(rows)


def test_the_later_versions_numbers_stand_beside_its_own_claims_alone(tmp_path):
    arms = {"mbo-vail+protocol=released": HIGH, "vail+protocol=released": LOW, "true": LOW}
    write_arms(tmp_path, "humanoid", "qd_score", arms)
    rows = claims.table(claims.judge(tmp_path, envs=["humanoid"])).drop_duplicates("id").set_index("id")
    assert rows.loc["E2", "paper"] == "7,260,000 against 5,090,000" and rows.loc["E2", "protocol"] == "released"
    assert rows.loc["E2", "comparison"] == "QD-score: Mbo-VAIL above VAIL"
    assert rows.loc["E4b", "paper"] == "7,260,000 against 5,708,191"
    assert rows.loc["E4b", "comparison"] == "QD-score: Mbo-VAIL above Expert (paper protocol)"


def test_a_smoke_result_never_overwrites_the_laptops(tmp_path):
    write_arms(tmp_path, "walker2d", "qd_score", {"mconbo-gail": HIGH, "gail": LOW}, budget="smoke")
    assert {v.verdict for v in claims.judge(tmp_path, "laptop")} == {NO_RUNS}
    paths = {
        budget: claims.write(claims.judge(tmp_path, budget), budget, tmp_path) for budget in ("smoke", "laptop", "full")
    }
    assert {budget: str(path.relative_to(tmp_path)) for budget, path in paths.items()} == {
        "smoke": "smoke/claims.md", "laptop": "claims.md", "full": "full/claims.md"
    }  # fmt: skip
    assert (
        re.search(r"reproduced +\|", paths["smoke"].read_text()) and "There are no runs." in paths["laptop"].read_text()
    )


def test_pages_list_differences_between_runs(tmp_path):
    folder = write_run(tmp_path, "walker2d", "gail", 1)
    (folder / "config.json").write_text(json.dumps({"gamma": 0.5, "eval_chunk_steps": 1}))
    (folder / "manifest.json").write_text(
        json.dumps({"commit": "0123456789 with local changes", "demonstrations_sha256": "a"})
    )
    other = write_run(tmp_path, "walker2d", "mconbo-gail", 1)
    (other / "manifest.json").write_text(json.dumps({"commit": "0123456789", "demonstrations_sha256": "b"}))
    page = claims.markdown(claims.judge(tmp_path), "laptop", tmp_path)
    assert "**gamma was not today's** in `gail` 1." in page and "eval_chunk_steps" not in page
    assert "0123456 with local changes (1)" in page and "0123456 (1)" in page
    assert "**Not known to have learned from the expert of their own seed**: 1 of `mconbo-gail`; 1 of `gail`." in page


def test_every_rule_is_explained_in_the_docs():
    text = (ROOT / "docs" / "claims.md").read_text()
    assert all(f"**{claim.id}**" in text for claim in claims.CLAIMS)


def test_the_command_prints_and_writes(tmp_path, capsys):
    write_arms(tmp_path, "walker2d", "qd_score", {"mconbo-gail": HIGH, "gail": LOW})
    assert cli.main(["claims", "--results", str(tmp_path), "--env", "walker2d"]) == 0
    assert not (tmp_path / "claims.md").exists()
    assert cli.main(["claims", "--results", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "C1 walker2d (paper): QD-score: MConbo-GAIL above GAIL: reproduced" in printed
    assert f"Wrote {tmp_path / 'claims.md'}." in printed and (tmp_path / "claims.md").is_file()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--env", "cat"], "unknown robot 'cat'; choose one of"),
        (["--env", "hopper"], "the claims are not about 'hopper', but about halfcheetah, walker2d, humanoid"),
        (["--budget", "huge"], "choose one of"),
    ],
)
def test_the_command_refuses_what_does_not_exist(tmp_path, arguments, named, capsys):
    assert cli.main(["claims", "--results", str(tmp_path), *arguments]) == 2
    assert named in capsys.readouterr().err
    assert cli.main(["claims", "--results", str(tmp_path / "reslts")]) == 2
    assert "there is no folder" in capsys.readouterr().err and not (tmp_path / "reslts").exists()


def listed_seeds(text: str) -> list[int]:
    """The seeds in a text such as "1-3, 5"."""
    ends = [(int(first), int(last or first)) for first, last in re.findall(r"(\d+)(?:-(\d+))?", text)]
    return [seed for first, last in ends for seed in range(first, last + 1)]


def test_the_kept_page_agrees_with_the_runs_that_it_names(tmp_path):
    page = (ROOT / "results" / "claims.md").read_text()
    listed = subprocess.run(["git", "-C", ROOT, "ls-files", "results/laptop"], capture_output=True, text=True).stdout
    kept = {Path(line).parent for line in listed.split() if line.endswith("manifest.json")}
    for env, experiments in re.findall(r"^\* \*\*(\w+)\*\*: Seeds (.*?)\. Made at", page, re.MULTILINE):
        for seeds, experiment in re.findall(r"([\d, -]+) of `(.+?)`", experiments):
            for seed in listed_seeds(seeds):
                folder = folder_of(experiment, env, "laptop", seed, Path("results"))
                assert folder in kept, f"results/claims.md names {folder}, which is not kept"
                shutil.copytree(ROOT / folder, tmp_path / folder.relative_to("results"))
    if "`lemma.json`" in page:
        assert "results/laptop/lemma.json" in listed, "results/claims.md names lemma.json, which is not kept"
        shutil.copy(ROOT / "results" / "laptop" / "lemma.json", tmp_path / "laptop")
    anew = claims.markdown(claims.judge(tmp_path), "laptop", tmp_path)
    assert page.split("## Runs")[0] == anew.split("## Runs")[0], "run 'qdil claims' to write results/claims.md anew"
