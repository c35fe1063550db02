"""A table of trials: settings where runs differ, and the numbers in their files."""

import io

import pandas as pd
import pytest
from fake_runs import write_run

from qdil.config import make_config, to_json
from qdil.evidence import trials
from qdil.files import write_json


@pytest.fixture
def folders(tmp_path):
    """Two runs that differ in seed, ``episodes`` and ``bonus_q``; as in ``write_run``, elites lose 1 scored again."""
    made = []
    for seed, changes in ((1, {}), (2, {"episodes": 7, "bonus_q": 2.0})):
        folder = write_run(tmp_path, "walker2d", "mbo-true", seed, qd_score=100.0 * seed)
        write_json(folder / "config.json", to_json(make_config("walker2d", "mbo-true", "laptop", seed, **changes)))
        made.append(folder)
    return made


def test_a_row_per_run_and_a_column_per_setting_that_differs(folders):
    table = trials.table(folders)
    assert table.columns[:5].tolist() == ["env", "method", "seed", "episodes", "bonus_q"]
    assert table["seed"].tolist() == [1, 2] and table["bonus_q"].tolist() == [0.5, 2.0]
    assert table["qd_score"].tolist() == [100.0, 200.0] == table["corrected_qd_score"].tolist()
    assert table["return_per_step"].tolist() == [38 / 40] * 2  # returns 9 and 29 over lengths 10 and 30
    assert table["stored_over_fresh"].tolist() == [40 / 38] * 2
    assert table["million_steps"].tolist() == [3.0] * 2 and table["seconds"].tolist() == [180.0] * 2


def test_it_prints_finished_runs_as_csv(folders, tmp_path, capsys):
    (folders[1] / "manifest.json").unlink()
    trials.main([str(tmp_path)])
    read = pd.read_csv(io.StringIO(capsys.readouterr().out))
    assert read["seed"].tolist() == [1] and read["qd_score"].tolist() == [100.0]


def test_a_note_shows_chosen_columns(folders, tmp_path):
    path = tmp_path / "trials.csv"
    trials.table(folders).to_csv(path, index=False, float_format="%.4g")
    table = trials.shown(path, {"bonus_q": "q"}, ["corrected_qd_score", "relanded"])
    assert [line.split("|")[1:4] for line in table.replace(" ", "").splitlines()[2:]] == [
        ["0.5", "100", "100%"],
        ["2", "200", "100%"],
    ]
