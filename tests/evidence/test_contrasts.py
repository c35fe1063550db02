"""Effects of changes, against arithmetic done by hand on runs written by hand."""

import json

import numpy as np
import pytest
from fake_runs import write_run

from qdil.evidence import contrasts, tables

SCORES = {"base": [100.0, 200.0, 300.0], "better": [300.0, 310.0, 290.0], "alone": [150.0], "below zero": [-50.0],
          "zero": [0.0]}  # fmt: skip


@pytest.fixture
def runs(tmp_path):
    for name, scores in SCORES.items():
        for seed, score in enumerate(scores, start=1):
            write_run(tmp_path, "walker2d", name, seed, qd_score=score, coverage=0.5, best=score * 2, average=7.0)
    return tables.finished_seeds(SCORES, "walker2d", "laptop", tmp_path)


def scores_of(found):
    return found[found["metric"] == "QD-score"]


def test_effects_are_percent_of_the_unchanged_mean_over_shared_seeds(runs):
    found = contrasts.effects(
        runs, {"more": ("better", "base"), "missing": ("nobody", "base"), "one": ("alone", "base")}
    )
    assert list(dict.fromkeys(found.index)) == ["more", "one"]
    assert set(found["metric"]) == set(contrasts.TITLES.values())
    scores = scores_of(found)
    assert scores.loc["more", "difference"] == pytest.approx(100 * (300 - 200) / 200)
    assert scores.loc["more", "seeds"] == "1-3" and scores.loc["one", "seeds"] == "1"
    assert scores.loc["one", "difference"] == pytest.approx(100 * (150 - 100) / 100)
    assert np.isnan(scores.loc["one", "low"])
    # The paired differences 200, 110, -10 have the variance 11100; t's 97.5 % quantile is 4.3027.
    half = 4.3027 * np.sqrt(11100 / 3) / 2
    assert scores.loc["more", ["low", "high"]].astype(float).to_list() == pytest.approx(
        [50 - half, 50 + half], rel=1e-4
    )
    coverage = found[found["metric"] == "coverage"].loc["more"]
    assert coverage["difference"] == coverage["low"] == coverage["high"] == 0


def test_runs_of_another_seeds_expert_are_marked_as_in_verdicts(runs):
    for folder in runs["better"]:
        (folder / "manifest.json").write_text(json.dumps({"demonstrations_sha256": "one file for all"}))
    scores = scores_of(contrasts.effects(runs, {"more": ("better", "base")}))
    assert scores.loc["more", "seeds"] == "1-3 ‡" and scores.loc["more", "difference"] == pytest.approx(50)


def test_above_a_negative_reference_is_positive_and_nothing_is_a_share_of_zero(runs):
    found = contrasts.effects(runs, {"x": ("base", "below zero"), "y": ("base", "zero")})
    assert scores_of(found)["difference"].to_list() == [
        pytest.approx(100 * (100 + 50) / 50),
        pytest.approx(np.nan, nan_ok=True),
    ]


def test_tables_have_a_row_per_change(runs):
    shown = contrasts.table(contrasts.effects(runs, {"more": ("better", "base"), "one": ("alone", "base")}))
    assert shown.index.tolist() == ["more", "one"] and shown.columns.tolist() == ["seeds", *contrasts.TITLES.values()]
    assert shown.loc["one", "QD-score"] == "+50.0 %" and shown.loc["more", "QD-score"].startswith("+50.0 % [")
    assert contrasts.table(contrasts.effects({}, {"x": ("a", "b")})).empty
