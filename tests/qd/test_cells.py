"""The cell that a measure falls into: counted in whole numbers, the same in NumPy, in JAX and in pyribs."""

import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from ribs.archives import GridArchive

from qdil.qd.cells import EDGE, cell_index


@given(cells=st.integers(1, 60), counts=st.lists(st.integers(0, 1000), min_size=1, max_size=20), k=st.integers(1, 3))
def test_shares_of_an_episode_fall_into_the_cell_of_their_whole_numbers(cells, counts, k):
    length = 1000
    exact = np.minimum(np.array(counts) * cells // length, cells - 1)
    measures = np.repeat(np.float32(np.array(counts) / length)[:, None], k, axis=1)
    shape = (cells,) * k
    expected = np.repeat(exact[:, None], k, axis=1)
    np.testing.assert_array_equal(cell_index(measures, shape, np), expected)
    np.testing.assert_array_equal(cell_index(jnp.asarray(measures), shape, jnp), expected)
    grid = GridArchive(solution_dim=1, dims=shape, ranges=[(0, 1)] * k, dtype=np.float32, epsilon=EDGE)
    np.testing.assert_array_equal(grid.index_of(measures), np.ravel_multi_index(tuple(expected.T), shape))


def test_grids_may_have_different_numbers_of_cells():
    assert cell_index(np.float32([0.5, 1.0, 0.0]), (2, 10, 3), np).tolist() == [1, 9, 0]
