"""The history of an archive, against the archive itself after every iteration."""

import numpy as np
from test_archive import CELLS, empty, some

from qdil.qd import archive, history


def recorded(batches: int = 8) -> tuple[history.History, list[dict[str, np.ndarray]]]:
    """A history, and the archive's own content after each of its iterations."""
    archives, rng, past, seen = empty(), np.random.default_rng(3), history.empty(), []
    for iteration in range(1, batches + 1):
        if iteration != 4:  # in one of them nothing is added
            archive.add(archives, some(rng.normal(size=12), rng.random((12, 2)), seed=iteration))
        past = history.append(past, iteration, archive.returns(archives), CELLS**2)
        seen.append(archive.elite_arrays(archives))
    return past, seen


def test_a_history_replays_the_archive_at_every_iteration():
    past, seen = recorded()
    for iteration, elites in enumerate(seen, start=1):
        for name, grid in history.snapshot(past, iteration, CELLS**2).items():
            expected = np.full(CELLS**2, np.nan, np.float32)
            expected[elites["index"]] = elites[name]
            np.testing.assert_array_equal(grid, expected)
    assert np.isnan(history.snapshot(past, 0, CELLS**2)["fitness"]).all()


def test_a_history_holds_only_what_changed_in_order():
    past, seen = recorded()
    assert (np.diff(past.iteration) >= 0).all() and 4 not in past.iteration
    for cell in set(past.cell.tolist()):
        assert (np.diff(past.fitness[past.cell == cell]) > 0).all()  # an elite only gives way to a better one
    pairs = list(zip(past.iteration.tolist(), past.cell.tolist(), strict=True))
    assert len(set(pairs)) == len(pairs) and pairs == sorted(pairs)
    assert [values.dtype for values in past] == [values.dtype for values in history.empty()]


def test_returns_are_those_of_the_elites_without_their_policies():
    archives = empty()
    archive.add(archives, some(np.arange(5.0), np.random.default_rng(0).random((5, 2))))
    few, all_ = archive.returns(archives), archive.elite_arrays(archives)
    assert set(few) == {"index", "true_return", "fitness"}
    for name, values in few.items():
        np.testing.assert_array_equal(values, all_[name])
