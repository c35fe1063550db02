"""Tables against numbers worked out by hand from fake runs."""

import csv
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from fake_runs import write_arms, write_run

from qdil.evidence import paper, tables


def runs_of(root, names, env="walker2d"):
    return tables.finished_seeds(names, env, "laptop", root)


def test_final_metrics_are_the_runs_last_row_and_their_archive(tmp_path):
    folder = write_run(tmp_path, "walker2d", "gail", 3, qd_score=40.0, coverage=0.5, best=30.0, average=20.0)
    (folder / "summary.json").unlink()
    final = tables.final(runs_of(tmp_path, ["gail"]))
    assert final.index.to_list() == [("gail", 3)]
    assert final.loc[("gail", 3)].to_dict() == {
        "qd_score": 40.0, "coverage": 0.5, "best": 30.0, "average": 20.0, "corrected_qd_score": 38.0,
        "corrected_coverage": 0.5, "corrected_best": 29.0, "corrected_average": 19.0, "relanded": 1.0,
        "relanded_near": 1.0, "million_steps": 3.0, "minutes": 3.0,
    }  # fmt: skip


def test_every_finished_seed_counts_and_no_unfinished_one(tmp_path):
    for seed in (1, 2, 7):
        write_run(tmp_path, "walker2d", "gail", seed)
    (tmp_path / "laptop" / "walker2d" / "gail" / "seed-2" / "manifest.json").unlink()
    (tmp_path / "laptop" / "walker2d" / "gail" / "seed-old").mkdir()
    assert [path.name for path in runs_of(tmp_path, ["gail", "vail"])["gail"]] == ["seed-1", "seed-7"]
    assert set(tables.read_metrics(runs_of(tmp_path, ["gail"]))) == {"gail"}


def test_summaries_give_mean_and_standard_deviation(tmp_path):
    write_arms(tmp_path, "walker2d", "qd_score", {"gail": [1000.0, 2000.0, 6000.0], "true": [1234.4]})
    summary = tables.summary(runs_of(tmp_path, ["true", "gail"]))
    spread = np.sqrt((2000.0**2 + 1000.0**2 + 3000.0**2) / 2)
    assert summary.loc["gail", "QD-score"] == f"3,000 ± {spread:,.0f}"
    assert summary.loc["true", "QD-score"] == "1,234" and list(summary["seeds"]) == ["1", "3"]
    assert summary.loc["gail", "coverage"] == "100.0 ± 0.0%"


def test_ends_are_over_the_last_iterations_of_all_seeds(tmp_path):
    write_arms(tmp_path, "walker2d", "best", {"gail": [10.0, 30.0]})
    for seed, first in ((1, 99.0), (2, 0.0)):  # the first of three iterations: left out
        path = tmp_path / "laptop" / "walker2d" / "gail" / f"seed-{seed}" / "metrics.csv"
        table = pd.read_csv(path)
        table.loc[0, "best"] = first
        table.to_csv(path, index=False)
    ends = tables.ends(runs_of(tmp_path, ["gail"]), iterations=2)
    assert ends.loc["gail", "best"] == f"20 ± {np.std([10, 10, 30, 30], ddof=1):.0f}" and len(ends.columns) == 4
    assert tables.ends({}).empty


def test_the_papers_numbers_stand_beside_ours(tmp_path):
    write_arms(tmp_path, "walker2d", "coverage", {"gail": [0.5], "airl": [0.25], "mconbo-gail+demo_episodes=2": [0.75],
                                                  "mconbo-gail+bonus_q=1.0": [0.8]})  # fmt: skip
    names = ["gail", "airl", "mconbo-gail+demo_episodes=2", "mconbo-gail+bonus_q=1.0"]
    beside = tables.beside_paper(runs_of(tmp_path, names), "walker2d")["coverage"]
    assert beside.loc["gail"].to_dict() == {"ours": "50.0%", "corrected": "50.0%", "paper": "69.3 ± 2.6% (s.e.)"}
    assert beside.loc["mconbo-gail+demo_episodes=2", "paper"] == "91.1 ± 0.1% (s.e.)"
    for lost in ("airl", "mconbo-gail+bonus_q=1.0"):
        assert beside.loc[lost, "paper"] == "not recoverable"


def test_what_the_paper_never_ran_says_so_and_a_single_seed_has_no_spread():
    assert tables.of_paper("walker2d", "mbo-gail", "best") == "not in the paper"
    assert tables.of_paper("walker2d", "mconbo-gail+selection=true", "best") == "not in the paper"
    assert tables.of_paper("walker2d", "mconbo-gail+demo_episodes=10", "best") == "not recoverable"
    assert tables.of_paper("humanoid", "true", "best") == "9691"


def test_the_later_versions_table_agrees_with_the_file():
    with open(Path(paper.__file__).parent / "paper_numbers.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["source"].startswith("later version")]
    published = {(row["environment"], row["method"], row["metric"]): float(row["value"]) for row in rows}
    table = tables.later_paper()
    assert set(table.index) == {(env, method) for env, method, _ in published}
    for (env, method), row in table.iterrows():
        assert row["coverage"] == f"{published[env, method, 'coverage_pct']:.1f}%"
        assert row["QD-score"] == f"{published[env, method, 'qd_score']:,.0f}"
        assert row["best"] == f"{published[env, method, 'best']:.0f}"
    assert list(tables.later_paper(["walker2d"], ["gail"]).index) == [("walker2d", "gail")]


def test_both_readings_stand_side_by_side(tmp_path):
    both = [("gail", 1, 100.0, 60.0), ("gail", 2, 120.0, 40.0)]
    for name, seed, claimed, corrected in both:
        write_run(tmp_path, "walker2d", name, seed, qd_score=claimed, corrected_qd_score=corrected, relanded=seed / 10)
    runs = runs_of(tmp_path, ["gail"])
    row = tables.summary(runs).loc["gail"]
    assert (row["QD-score"], row["corrected QD-score"]) == ("110 ± 14", "50 ± 14")
    assert (row["lands in own cell"], row["own or next cell"]) == ("15.0 ± 7.1%", "100.0 ± 0.0%")
    assert list(row.index[1:3]) == ["QD-score", "corrected QD-score"]
    assert tables.beside_paper(runs, "walker2d").loc["gail", ("QD-score", "corrected")] == "50 ± 14"


def test_nothing_finished_gives_empty_tables(tmp_path):
    assert tables.final({}).empty and tables.summary({}).empty and tables.beside_paper({}, "walker2d").empty
    assert tables.share_of_expert({}).empty and tables.share_of_expert({"walker2d": {}}).empty


def test_shares_of_the_expert_are_taken_robot_by_robot(tmp_path):
    write_arms(tmp_path, "walker2d", "qd_score", {"true": [90.0, 110.0], "gail": [50.0, 70.0]})
    write_arms(tmp_path, "halfcheetah", "qd_score", {"true": [1000.0], "gail": [800.0, 900.0]})
    write_arms(tmp_path, "humanoid", "qd_score", {"gail": [1.0]})  # no expert there: left out
    runs = {env: runs_of(tmp_path, ["true", "gail"], env) for env in ("walker2d", "halfcheetah", "humanoid")}
    shares = tables.share_of_expert(runs)
    assert shares.loc["gail", "share"] == pytest.approx((0.7 + 0.8) / 2)  # of 0.5, 0.7, 0.8, 0.9 the middle half
    assert shares.loc["gail", ["robots", "seeds"]].to_list() == [2, 4]
    assert np.isnan(shares.loc["true", "low"])  # one seed on one of its robots
    assert shares.loc["gail", "low"] < shares.loc["gail", "share"] < shares.loc["gail", "high"]
