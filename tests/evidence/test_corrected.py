"""Both readings of a run: from its ``summary.json``, or from ``archive.npz`` if the run has none."""

import json

import numpy as np
import pytest
from fake_runs import write_run

from qdil.errors import ConfigError
from qdil.evidence import corrected
from qdil.evidence.readings import NAMES, READINGS
from qdil.files import write_npz

BOTH = (*corrected.METRICS, *corrected.CORRECTED, *corrected.SHARES)


def test_a_run_without_a_summary_is_read_from_its_archive(tmp_path):
    folder = write_run(tmp_path, "walker2d", "gail", 1, qd_score=7.0)
    (folder / "summary.json").unlink()
    assert corrected.of_run(folder) == {
        "qd_score": 40.0, "coverage": 0.5, "best": 30.0, "average": 20.0,
        "corrected_qd_score": 38.0, "corrected_coverage": 0.5, "corrected_best": 29.0, "corrected_average": 19.0,
        "relanded": 1.0, "relanded_near": 1.0,
    }  # fmt: skip


def test_a_summary_is_read_and_its_missing_numbers_are_not_a_number(tmp_path):
    folder = write_run(tmp_path, "walker2d", "gail", 1, corrected_qd_score=12.5, relanded=0.25)
    found = corrected.of_run(folder)
    assert (found["corrected_qd_score"], found["relanded"], found["qd_score"]) == (12.5, 0.25, 1.0)
    kept = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps(kept | {"best": None}))
    assert np.isnan(corrected.of_run(folder)["best"])


def test_every_metric_of_both_readings_is_a_reading_with_a_name(tmp_path):
    values = {name: float(i) for i, name in enumerate(BOTH, start=2)}
    folder = write_run(tmp_path, "walker2d", "gail", 1, **values)
    assert {name: READINGS[name](folder) for name in BOTH} == values
    assert len({NAMES[name] for name in BOTH}) == len(BOTH)


def test_a_run_whose_elites_were_never_scored_again_is_refused(tmp_path):
    folder = write_run(tmp_path, "walker2d", "gail", 1)
    (folder / "summary.json").unlink()
    write_npz(folder / "archive.npz", index=np.zeros(0, int), true_return=np.zeros(0), cells=np.array([2, 2]))
    with pytest.raises(ConfigError, match="were not scored again"):
        corrected.of_run(folder)
