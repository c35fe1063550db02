"""Figures and tables come from run folders, and the README shows the numbers of the kept runs."""

import pytest
from fake_runs import write_arms, write_run
from markdown_cells import cells

from qdil import plotting
from qdil.errors import ConfigError
from qdil.evidence import figures


def test_tables_and_pictures_come_from_the_runs(tmp_path):
    claimed = {"qd_score": 40.0, "coverage": 0.5, "best": 30.0, "average": 20.0}
    write_run(tmp_path, "walker2d", "true", 1, **claimed, corrected_qd_score=38.0, relanded=0.25)
    written = figures.write_figures("walker2d", "laptop", root=tmp_path)
    assert {path.suffix for path in written} == {".png", ".pdf", ".md"}
    assert all(path.stat().st_size > 100 for path in written)
    table = tmp_path / "figures" / "laptop-walker2d-summary.md"
    assert cells(table.read_text())[-1] == [
        "`true`", "40", "38", "50.0%", "50.0%", "30", "30", "20", "20", "25.0%", "100.0%", "3.0", "3.0"
    ]  # fmt: skip


def test_every_finished_seed_counts_unless_seeds_are_named(tmp_path):
    write_arms(tmp_path, "walker2d", "best", {"true": [30.0, 40.0], "gail": [10.0]})
    both = figures.summary_table(figures.finished_runs("walker2d", "laptop", tmp_path))
    assert [[*row[:3], row[6]] for row in cells(both)[1:]] == [
        ["`true`", "2", "1 ± 0", "35 ± 7"],
        ["`gail`", "1", "1", "10"],
    ]
    second = figures.summary_table(figures.finished_runs("walker2d", "laptop", tmp_path, [2]))
    assert [[*row[:2], row[5]] for row in cells(second)[1:]] == [["`true`", "1", "40"]]


def test_studies_get_figures_of_their_own_where_they_have_more_runs_than_the_main_one(tmp_path):
    write_arms(tmp_path, "walker2d", "best", {"true": [30.0], "vail": [10.0, 12.0], "mconbo-gail+bonus_q=1.0": [3.0]})
    runs = figures.finished_runs("walker2d", "laptop", tmp_path)
    names = figures.draw(runs, "walker2d").keys()
    assert {"curves-iteration", "vail-curves", "vail-bars", "p-and-q-grid"} <= names
    assert not any("true-reward" in name for name in names)  # of that study only the expert was run
    assert list(runs) == ["true", "vail", "mconbo-gail+bonus_q=1.0"]


def test_equal_runs_give_equal_files(tmp_path):
    content = []
    for name in ("a", "b"):
        write_run(tmp_path / name, "walker2d", "true", 1)
        archives = figures.draw(figures.finished_runs("walker2d", "laptop", tmp_path / name), "walker2d")["archives"]
        content.append([path.read_bytes() for path in plotting.save(archives, tmp_path / name / "archives")])
    assert content[0] == content[1]


@pytest.mark.parametrize("seeds, message", [(None, "no finished runs of walker2d"), ([4], "with seed 4")])
def test_nothing_to_draw_is_refused(tmp_path, seeds, message):
    with pytest.raises(ConfigError, match=message):
        figures.write_figures("walker2d", "laptop", seeds, tmp_path)
