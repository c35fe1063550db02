"""The two archives against the rules of Algorithm 2, written out cell by cell."""

import numpy as np
import pytest

from qdil.qd import archive
from qdil.qd.archive import Candidates

ALPHA, FLOOR, CELLS = 0.3, -2.0, 4


def empty(learning_rate: float = ALPHA) -> archive.Archives:
    return archive.make(CELLS, 2, 3, 2, learning_rate, FLOOR)


def some(fitness, measures, finite=True, seed: int = 0) -> Candidates:
    """Candidates whose other fields are random."""
    rng = np.random.default_rng(seed)
    n = len(fitness)
    random = {
        "theta": rng.normal(size=(n, 3)),
        "obs_mean": rng.normal(size=(n, 2)),
        "obs_std": rng.uniform(1, 2, size=(n, 2)),
        "true_return": rng.normal(size=n),
        "length": rng.uniform(1, 50, size=n),
    }
    fixed = {"fitness": fitness, "measures": measures}
    as_floats = {name: np.asarray(value, np.float32) for name, value in {**random, **fixed}.items()}
    return Candidates(**as_floats, finite=np.broadcast_to(finite, n))


def cell(measures) -> tuple[int, int]:
    i, j = np.minimum((CELLS * np.asarray(measures)).astype(int), CELLS - 1)
    return int(i), int(j)


def test_single_insertions_follow_the_soft_threshold_rule():
    archives, rng = empty(), np.random.default_rng(0)
    thresholds: dict[tuple[int, int], float] = {}
    accepted = 0
    for _ in range(120):
        f, m = rng.normal(scale=3), rng.random(2)
        t = thresholds.get(cell(m), FLOOR)
        archives, improvement, _ = archive.add(archives, some([f], [m]))
        if f > t:
            accepted += 1
            thresholds[cell(m)] = (1 - ALPHA) * t + ALPHA * f
            assert improvement[0] == pytest.approx(f - t, rel=1e-4, abs=1e-4)
        else:
            assert improvement[0] == 0
    assert 20 < accepted < 100
    stored = archives.soft.data(["index", "threshold"])
    found = {divmod(int(i), CELLS): t for i, t in zip(stored["index"], stored["threshold"], strict=True)}
    assert found == pytest.approx(thresholds, rel=1e-4, abs=1e-4)


def test_a_batch_follows_the_batch_rule():
    # n accepted in one cell: t <- (1-(1-α)^n)·mean + (1-α)^n·t, over the accepted ones, who all saw the old t.
    archives = empty()
    here, there = [0.1, 0.1], [0.9, 0.1]
    archives, _, _ = archive.add(archives, some([1.0], [here]))
    t = (1 - ALPHA) * FLOOR + ALPHA * 1.0
    batch = [2.0, t - 0.5, 4.0, 3.0, -5.0, 0.0]
    archives, improvement, _ = archive.add(archives, some(batch, [here, here, here, there, there, here]))
    np.testing.assert_allclose(improvement, [2 - t, 0, 4 - t, 3 - FLOOR, 0, 0 - t], rtol=1e-5)
    stored = archives.soft.data(["index", "threshold"])
    kept = (1 - ALPHA) ** 3
    expected = {0: (1 - kept) * 2.0 + kept * t, 12: ALPHA * 3.0 + (1 - ALPHA) * FLOOR}
    assert dict(zip(stored["index"].tolist(), stored["threshold"].tolist(), strict=True)) == pytest.approx(expected)


def test_the_result_archive_keeps_the_best_of_each_cell():
    archives, rng = empty(), np.random.default_rng(1)
    best: dict[tuple[int, int], tuple] = {}
    for batch in range(6):
        candidates = some(rng.normal(size=20), rng.random((20, 2)), seed=batch)
        archives, _, _ = archive.add(archives, candidates)
        for row in zip(*candidates, strict=True):
            one = Candidates(*row)
            if cell(one.measures) not in best or one.fitness > best[cell(one.measures)].fitness:
                best[cell(one.measures)] = one
    elites = archive.elite_arrays(archives)
    assert elites["index"].tolist() == sorted(CELLS * i + j for i, j in best)
    for row, index in enumerate(elites["index"]):
        expected = best[divmod(int(index), CELLS)]
        np.testing.assert_array_equal(elites["solution"][row], expected.theta)
        for name in ("fitness", "measures", *archive.EXTRA):
            np.testing.assert_array_equal(elites[name][row], getattr(expected, name))


def test_below_the_floor_a_candidate_is_a_result_but_no_improvement():
    archives = empty()
    archives, improvement, _ = archive.add(archives, some([FLOOR - 1], [[0.5, 0.5]]))
    assert improvement.tolist() == [0]
    assert archive.elite_arrays(archives)["fitness"].tolist() == [FLOOR - 1]
    assert archives.soft.empty


def test_rejects_may_keep_their_distance_to_the_threshold():
    """The released program's Δ: f − t_e for everyone; a candidate that is not finite is the worst."""
    archives, here, there = empty(1.0), [0.1, 0.1], [0.9, 0.9]
    archives, *_ = archive.add(archives, some([5.0], [here]))
    fitness, measures = [7.0, 4.0, 5.0, -3.0, np.nan], [here, here, here, there, here]
    added = {how: archive.add(archives, some(fitness, measures), how) for how in ("zero", "difference")}
    assert added["difference"].improvement.tolist() == [2.0, -1.0, 0.0, -3.0 - FLOOR, -1.0]
    assert added["zero"].improvement.tolist() == [2.0, 0.0, 0.0, 0.0, 0.0]
    for one in added.values():
        assert one.accepted.tolist() == [True, False, False, False, False]
        assert archive.elite_arrays(one.archives)["fitness"].tolist() == [7.0, -3.0]


def test_what_is_not_finite_never_enters():
    archives = empty()
    fitness = [np.nan, np.inf, -np.inf, 5.0, 1.0]
    measures = [[0.1, 0.1], [0.3, 0.1], [0.6, 0.1], [0.9, 0.1], [0.9, 0.9]]
    finite = np.array([True, True, True, False, True])
    archives, improvement, _ = archive.add(archives, some(fitness, measures, finite))
    assert improvement.tolist() == [0, 0, 0, 0, 1 - FLOOR]
    for one in archives:
        assert one.data("index").tolist() == [15]
    _, nothing, _ = archive.add(archives, some([np.nan, 9.0], [[0.1, 0.1]] * 2, np.array([True, False])))
    assert nothing.tolist() == [0, 0]
    assert np.isfinite(archive.metrics(archive.elite_arrays(archives), 16)["qd_score"])


@pytest.mark.parametrize("field", [name for name in Candidates._fields if name != "finite"])
def test_a_single_bad_number_in_any_field_keeps_a_candidate_out(field):
    candidates = some([1.0, 2.0, 3.0], [[0.1, 0.1], [0.5, 0.5], [0.9, 0.9]])
    values = getattr(candidates, field).copy()
    values[1, ...] = np.where(np.arange(values[1].size).reshape(values[1].shape) == 0, np.nan, values[1])
    candidates = candidates._replace(**{field: values})
    assert archive.usable(candidates).tolist() == [True, False, True]
    archives = empty()
    archives, improvement, accepted = archive.add(archives, candidates)
    assert improvement.tolist() == [1 - FLOOR, 0, 3 - FLOOR]
    assert accepted.tolist() == [True, False, True]
    assert archive.elite_arrays(archives)["fitness"].tolist() == [1, 3]


def test_occupied_marks_exactly_the_filled_cells():
    archives = empty()
    measures = np.array([[0.0, 0.0], [0.3, 0.99], [1.0, 1.0], [0.6, 0.1], [0.31, 0.95]])
    assert not archive.occupied(archives).any()
    archives, _, _ = archive.add(archives, some(np.ones(5), measures))
    expected = np.zeros((CELLS, CELLS), bool)
    for m in measures:
        expected[cell(m)] = True
    np.testing.assert_array_equal(archive.occupied(archives), expected)
    assert expected.sum() == 4


def test_metrics_by_hand():
    archives = empty()
    candidates = some([1.0, 2.0, 10.0], [[0.1, 0.1], [0.1, 0.9], [0.9, 0.9]])
    candidates = candidates._replace(true_return=np.array([-4.0, 7.0, 3.0], np.float32))
    archives, _, _ = archive.add(archives, candidates)
    assert archive.metrics(archive.elite_arrays(archives), 16) == {
        "qd_score": 6.0,
        "coverage": 3 / 16,
        "best": 7.0,
        "average": 2.0,
        "learned_qd_score": 13.0,
    }


def test_metrics_of_an_empty_archive():
    metrics = archive.metrics(archive.elite_arrays(empty()), 16)
    assert (metrics["qd_score"], metrics["coverage"], metrics["learned_qd_score"]) == (0, 0, 0)
    assert np.isnan(metrics["best"]) and np.isnan(metrics["average"])


def test_random_elite_is_one_whole_elite_and_any_of_them():
    archives, rng = empty(), np.random.default_rng(0)
    assert archive.random_elite(archives, rng) is None
    candidates = some([1.0, 2.0, 3.0], [[0.1, 0.1], [0.5, 0.5], [0.9, 0.9]])
    archives, _, _ = archive.add(archives, candidates)
    drawn = []
    for _ in range(60):
        elite = archive.random_elite(archives, rng)
        i = int(elite["fitness"]) - 1
        np.testing.assert_array_equal(elite["solution"], candidates.theta[i])
        np.testing.assert_array_equal(elite["obs_mean"], candidates.obs_mean[i])
        np.testing.assert_array_equal(elite["obs_std"], candidates.obs_std[i])
        drawn.append(i)
    assert min(np.bincount(drawn, minlength=3)) > 8
