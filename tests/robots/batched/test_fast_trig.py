"""Angles against NumPy's, in double precision."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from qdil.robots.batched import fast_trig

coordinate = st.floats(-1e6, 1e6, width=32).filter(lambda x: x == 0.0 or abs(x) > 1e-30)


@given(coordinate, coordinate)
def test_the_angle_of_any_point(y, x):
    found = fast_trig.atan2(np.float32([y]), np.float32([x]))
    np.testing.assert_allclose(found, np.arctan2([abs(y) if y == 0.0 else y], [x + 0.0]), atol=4e-7)


@pytest.mark.parametrize("ours, numpys", [(fast_trig.acos, np.arccos), (fast_trig.asin, np.arcsin)])
def test_angles_of_cosines_and_sines(ours, numpys):
    x = np.linspace(-1.0, 1.0, 20001).astype(np.float32)
    np.testing.assert_allclose(jax.jit(ours)(x), numpys(x.astype(np.float64)), atol=4e-7)


def test_nan_and_infinity_have_no_angle():
    """So that a robot whose physics has become infinite is seen to be."""
    for y, x in ((np.nan, 1.0), (1.0, np.nan), (np.nan, np.nan), (np.inf, np.inf)):
        assert np.isnan(fast_trig.atan2(np.float32(y), np.float32(x)))
    assert np.isnan(fast_trig.acos(np.float32(1.5))) and np.isnan(fast_trig.asin(np.float32(np.nan)))
