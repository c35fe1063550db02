"""Corrected archives and metrics against examples worked out by hand, and against pyribs filled with the same data."""

import numpy as np
import pytest
from ribs.archives import GridArchive

from qdil.errors import ConfigError
from qdil.qd import landing
from qdil.qd.cells import EDGE

# Five elites on a 2 × 3 grid; index = 3 · column + row. Elite 2 and 3 land in the same cell, elite 4 stays.
HAND = {
    "index": np.array([0, 1, 2, 4, 5]),
    "true_return": np.array([10.0, 20.0, 30.0, 40.0, 50.0], np.float32),
    "rescored_return": np.array([9.0, 18.0, 27.0, 36.0, 45.0], np.float32),
    "rescored_fitness": np.array([1.0, 2.0, 3.0, 4.0, 5.0], np.float32),
    "rescored_measures": np.array([[0.6, 0.1], [0.1, 0.2], [0.2, 0.4], [0.3, 0.5], [0.9, 0.99]], np.float32),
    "cells": np.array([2, 3]),
}


def made(k, count, seed, cells=6):
    """An archive of ``count`` random elites whose fresh measures are shares of 20 steps, so many are on grid lines."""
    draw = np.random.default_rng(seed)
    dims = [cells + axis for axis in range(k)]
    return {
        "index": np.sort(draw.choice(np.prod(dims), count, replace=False)),
        "true_return": draw.normal(100, 30, count).astype(np.float32),
        "rescored_return": draw.normal(90, 40, count).astype(np.float32),
        "rescored_measures": (draw.integers(0, 21, (count, k)) / 20).astype(np.float32),
        "cells": np.array(dims),
    }


def test_elites_land_by_hand():
    np.testing.assert_array_equal(landing.landing_cells(HAND), [3, 0, 1, 1, 5])
    landed = landing.corrected_archive(HAND)
    np.testing.assert_array_equal(landed["index"], [0, 1, 3, 5])
    np.testing.assert_array_equal(landed["row"], [1, 3, 0, 4])
    np.testing.assert_array_equal(landed["true_return"], [18, 36, 9, 45])
    np.testing.assert_array_equal(landed["fitness"], [2, 4, 1, 5])
    np.testing.assert_array_equal(landed["measures"], HAND["rescored_measures"][[1, 3, 0, 4]])
    assert "length" not in landed  # this archive kept no lengths of fresh episodes


def test_metrics_by_hand():
    assert landing.claimed_metrics(HAND) == {
        "qd_score": 150,
        "coverage": pytest.approx(5 / 6),
        "best": 50,
        "average": 30,
    }
    # Own cell: elite 4 alone. Neighbours: 0 → 3, 1 → 0, 2 → 1 along an edge, 3 (column 1, row 1) → (0, 1) as well.
    assert landing.corrected_metrics(HAND) == {
        "corrected_qd_score": 108, "corrected_coverage": pytest.approx(4 / 6), "corrected_best": 45,
        "corrected_average": 27, "relanded": pytest.approx(0.2), "relanded_near": 1.0,
    }  # fmt: skip


def test_a_diagonal_neighbour_is_near_and_two_cells_away_is_not():
    grid = {"index": np.array([0, 0, 0]), "rescored_return": np.ones(3), "cells": np.array([4, 4])}
    measures = np.array([[0.3, 0.3], [0.6, 0.1], [0.1, 0.1]])  # cells (1, 1), (2, 0) and (0, 0)
    shares = landing.corrected_metrics(grid | {"true_return": np.ones(3), "rescored_measures": measures})
    assert (shares["relanded"], shares["relanded_near"]) == (pytest.approx(1 / 3), pytest.approx(2 / 3))


@pytest.mark.parametrize("k", [1, 2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_pyribs_filled_with_the_fresh_scores_gives_the_same(k, seed):
    archive = made(k, count=5 if k == 1 else 30, seed=seed)
    dims = archive["cells"].tolist()
    grid = GridArchive(solution_dim=1, dims=dims, ranges=[(0, 1)] * k, epsilon=EDGE, dtype=np.float32)
    rows = np.arange(len(archive["index"]), dtype=np.float32)[:, None]
    grid.add(rows, archive["rescored_return"], archive["rescored_measures"])
    data = grid.data(return_type="dict")
    order = np.argsort(data["index"])
    landed = landing.corrected_archive(archive)
    np.testing.assert_array_equal(landed["index"], data["index"][order])
    np.testing.assert_array_equal(landed["true_return"], data["objective"][order])
    np.testing.assert_array_equal(landed["row"], data["solution"][order, 0])
    ours = landing.corrected_metrics(archive)
    assert ours["corrected_qd_score"] == pytest.approx(grid.stats.qd_score, rel=1e-5)
    assert ours["corrected_coverage"] == pytest.approx(grid.stats.coverage)
    assert ours["corrected_best"] == pytest.approx(grid.stats.obj_max)
    assert ours["corrected_average"] == pytest.approx(grid.stats.obj_mean, rel=1e-5)
    own, there = (grid.int_to_grid_index(i) for i in (archive["index"], grid.index_of(archive["rescored_measures"])))
    steps = np.abs(own - there).max(axis=1)
    assert ours["relanded"] == pytest.approx(np.mean(steps == 0))
    assert ours["relanded_near"] == pytest.approx(np.mean(steps < 2)) and np.any(steps > 1)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_scores_that_repeat_the_claim_correct_nothing(k):
    archive = made(k, count=5, seed=7)
    middles = (np.stack(np.unravel_index(archive["index"], archive["cells"]), axis=1) + 0.5) / archive["cells"]
    archive |= {"rescored_measures": middles.astype(np.float32), "rescored_return": archive["true_return"]}
    claimed, corrected = landing.claimed_metrics(archive), landing.corrected_metrics(archive)
    assert [corrected[name] for name in landing.CORRECTED] == list(claimed.values())
    assert corrected["relanded"] == corrected["relanded_near"] == 1.0


def test_of_equal_returns_in_a_cell_the_first_elite_stays():
    archive = made(2, count=3, seed=0) | {"rescored_return": np.full(3, 5.0), "rescored_measures": np.full((3, 2), 0.5)}
    assert landing.corrected_archive(archive)["row"].tolist() == [0]


@pytest.mark.parametrize("field", ["rescored_return", "rescored_measures"])
def test_an_elite_without_a_finite_score_lands_nowhere(field):
    archive = HAND | {field: HAND[field].copy()}
    archive[field][4] = np.nan  # the only elite that would land in its own cell
    metrics = landing.corrected_metrics(archive)
    assert landing.landing_cells(archive)[4] == landing.ELSEWHERE
    assert metrics["corrected_qd_score"] == 108 - 45 and metrics["corrected_coverage"] == pytest.approx(3 / 6)
    assert metrics["relanded"] == 0 and metrics["relanded_near"] == pytest.approx(4 / 5)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_an_empty_archive_has_scores_of_zero(k):
    archive = made(k, count=0, seed=0)
    for metrics in (landing.claimed_metrics(archive), landing.corrected_metrics(archive)):
        values = list(metrics.values())
        assert values[:2] == [0, 0] and np.isnan(values[2:]).all()
    assert landing.corrected_archive(archive)["measures"].shape == (0, k)


def test_an_archive_whose_elites_were_not_scored_again_is_refused():
    with pytest.raises(ConfigError, match="no rescored_measures: its elites were not scored again"):
        landing.corrected_metrics({name: values for name, values in HAND.items() if name != "rescored_measures"})
