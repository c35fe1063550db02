"""Metrics by the number of demonstrations, against a table written by hand and the file of the paper's numbers."""

import csv
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from qdil.evidence import scalability


def test_ours_are_means_over_seeds_by_method_and_number(monkeypatch):
    keys = [("gail", 1), ("gail", 2), ("gail+demo_episodes=2", 1)]
    values = {"qd_score": [10.0, 30.0, 7.0], "coverage": [0.2, 0.4, 0.5], "best": [1.0, 1.0, 1.0], "average": [0.0] * 3}
    final = pd.DataFrame(values, index=pd.MultiIndex.from_tuples(keys, names=["experiment", "seed"]))
    both = final.join((final / 2).add_prefix("corrected_"))
    monkeypatch.setattr(scalability.tables, "final", lambda runs: both)
    table = scalability.ours({}, "walker2d", "laptop").set_index(["method", "n_demos", "metric"])
    assert table.loc[("gail", 4, "qd_score")].tolist() == [20, pytest.approx(np.sqrt(200))]
    assert table.loc[("gail", 2, "coverage"), "value"] == 0.5 and np.isnan(table.loc[("gail", 2, "best"), "spread"])
    assert len(table) == 8
    corrected = scalability.ours({}, "walker2d", "laptop", corrected=True).set_index(["method", "n_demos", "metric"])
    np.testing.assert_allclose(corrected.astype(float), table.astype(float) / 2)


def test_the_papers_are_its_files_rows():
    table = scalability.published("walker2d").set_index(["method", "n_demos", "metric"])
    with (Path(scalability.__file__).parent / "paper_numbers.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["source"].startswith("walker2d demo-count figure")]
    assert len(table) == len(rows) > 0
    for row in rows:
        percent = row["metric"] == "coverage_pct"
        key = (row["method"], int(row["n_demos"]), "coverage" if percent else row["metric"])
        scale = 100 if percent else 1
        expected = [float(row["value"]) / scale, float(row["spread"]) / scale]
        np.testing.assert_allclose(table.loc[key].astype(float), expected)


def test_of_other_robots_nothing_is_known():
    assert scalability.published("humanoid").empty


def test_remarks_on_the_papers_numbers_are_shown_once():
    assert scalability.notes("walker2d") == "the 1-demo bands look like incomplete seeds"
    assert scalability.notes("humanoid") == ""
