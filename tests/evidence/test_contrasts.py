"""Effects of changes, against arithmetic done by hand on runs written by hand."""

import numpy as np
import pandas as pd
import pytest

from qdil.evidence import contrasts


@pytest.fixture
def runs(monkeypatch):
    """Final metrics of four experiments as ``tables.final`` gives them, and folders that only have to be there."""
    scores = {"base": [100.0, 200.0, 300.0], "better": [300.0, 310.0, 290.0], "alone": [150.0], "below zero": [-50.0]}
    index = pd.MultiIndex.from_tuples([(e, i) for e, s in scores.items() for i in range(len(s))])
    index.names = ["experiment", "seed"]
    values = pd.DataFrame({"qd_score": np.concatenate(list(scores.values()))}, index=index)
    values = values.assign(coverage=0.5, best=values["qd_score"] * 2, average=7.0)
    monkeypatch.setattr(
        contrasts.tables, "final", lambda runs: values[values.index.get_level_values("experiment").isin(runs)]
    )
    return {name: [None] * len(s) for name, s in scores.items()}


def test_effects_are_percent_of_the_unchanged_mean(runs):
    found = contrasts.effects(
        runs, {"more": ("better", "base"), "missing": ("nobody", "base"), "one": ("alone", "base")}
    )
    assert list(dict.fromkeys(found.index)) == ["more", "one"] and set(found["metric"]) == set(
        contrasts.TITLES.values()
    )
    scores = found[found["metric"] == "QD-score"]
    assert scores.loc["more", "difference"] == pytest.approx(100 * (300 - 200) / 200)
    assert scores.loc["more", "seeds"] == "3 / 3" and scores.loc["one", "seeds"] == "1 / 3"
    assert scores.loc["one", "difference"] == pytest.approx(-25) and np.isnan(scores.loc["one", "low"])
    low, high = scores.loc["more", ["low", "high"]]
    assert -5 < low < 50 < high <= 210  # no resample can leave (290 − 300)/300 … (310 − 100)/100
    coverage = found[found["metric"] == "coverage"].loc["more"]
    assert coverage["difference"] == coverage["low"] == coverage["high"] == 0


def test_above_a_negative_reference_is_positive(runs):
    found = contrasts.effects(runs, {"x": ("base", "below zero")})
    assert found[found["metric"] == "QD-score"]["difference"].item() == pytest.approx(100 * (200 + 50) / 50)


def test_tables_have_a_row_per_change(runs):
    shown = contrasts.table(contrasts.effects(runs, {"more": ("better", "base"), "one": ("alone", "base")}))
    assert shown.index.tolist() == ["more", "one"] and shown.columns.tolist() == ["seeds", *contrasts.TITLES.values()]
    assert shown.loc["one", "QD-score"] == "-25.0 %" and shown.loc["more", "QD-score"].startswith("+50.0 % [")
    assert contrasts.table(contrasts.effects({}, {"x": ("a", "b")})).empty
