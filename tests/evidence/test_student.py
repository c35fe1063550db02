"""Student's intervals against closed forms, SciPy and NumPy; Holm's correction against a calculation by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats as scipy_stats

from qdil.evidence import student
from qdil.evidence.student import Estimate

NUMBERS = st.integers(-1000, 1000).map(float)
ARM = st.lists(NUMBERS, min_size=2, max_size=6)
BY_SEED = st.dictionaries(st.integers(1, 6), NUMBERS, max_size=6)


def test_two_seeds_have_cauchys_interval():
    # With one degree of freedom t is Cauchy's: its 97.5 % quantile is tan(0.475 π). The error of 4 and 8 is 2.
    half = np.tan(0.475 * np.pi) * 2.0
    assert student.mean([4.0, 8.0]).interval() == pytest.approx((6.0, 6.0 - half, 6.0 + half))


def test_three_seeds_have_the_closed_form_of_two_degrees_of_freedom():
    # The quantile of t with two degrees of freedom is (2p - 1) sqrt(2 / (4 p (1 - p))).
    p, values = 0.975, [1.0, 2.0, 6.0]
    half = (2 * p - 1) * np.sqrt(2 / (4 * p * (1 - p))) * np.sqrt(7.0) / np.sqrt(3)  # the variance is 7
    assert student.mean(values).interval() == pytest.approx((3.0, 3.0 - half, 3.0 + half))
    t = 3.0 / np.sqrt(7.0 / 3)
    assert student.mean(values).p_value() == pytest.approx(1 - t / np.sqrt(2 + t**2))


@pytest.mark.filterwarnings("ignore:Precision loss")  # SciPy's, for an arm without spread
@given(ARM, ARM)
def test_welchs_interval_and_p_value_are_scipys(ours, reference):
    if np.var(ours) + np.var(reference) == 0:
        return
    found = student.unpaired(ours, reference)
    of_scipy = scipy_stats.ttest_ind(ours, reference, equal_var=False)
    limits = of_scipy.confidence_interval(0.95)
    assert found.interval() == pytest.approx((np.mean(ours) - np.mean(reference), limits.low, limits.high))
    assert found.p_value() == pytest.approx(of_scipy.pvalue, abs=1e-9)


@given(BY_SEED, BY_SEED)
def test_paired_differences_are_scipys_over_the_shared_seeds(ours, reference):
    shared = [seed for seed in range(1, 7) if seed in ours and seed in reference]
    found = student.paired(ours, reference)
    if not shared:
        assert np.isnan(found.value)
        return
    first, second = ([arm[seed] for seed in shared] for arm in (ours, reference))
    assert found.value == pytest.approx(np.mean(first) - np.mean(second))
    if len(shared) < 2:
        assert not found.interval().known() and found.p_value() == 1.0
    elif np.ptp(np.subtract(first, second)) > 0:
        of_scipy = scipy_stats.ttest_rel(first, second)
        limits = of_scipy.confidence_interval(0.95)
        assert found.interval()[1:] == pytest.approx((limits.low, limits.high))
        assert found.p_value() == pytest.approx(of_scipy.pvalue, abs=1e-9)
    back = student.paired(reference, ours).interval()
    assert found.interval() == pytest.approx((-back.estimate, -back.high, -back.low), nan_ok=True)


def test_what_moves_both_runs_of_a_seed_alike_does_not_widen_the_interval():
    expert = {1: 0.0, 2: 500.0, 3: -900.0}
    ours = {seed: level + extra for (seed, level), extra in zip(expert.items(), (9.0, 10.0, 11.0), strict=True)}
    assert student.paired(ours, expert).interval() == pytest.approx(student.mean([9.0, 10.0, 11.0]).interval())
    assert student.unpaired([*ours.values()], [*expert.values()]).interval().low < 0


@given(ARM, st.floats(-1000, 1000))
def test_a_p_value_is_below_5_percent_where_the_interval_excludes_the_value(values, bar):
    found = student.mean(values)
    _, low, high = found.interval()
    if found.error == 0 or min(abs(bar - low), abs(bar - high)) < 1e-6:
        return
    assert (found.p_value(bar) < 0.05) == (not low <= bar <= high)


def test_runs_that_agree_exactly_leave_no_doubt():
    assert student.mean([2.0] * 3).interval() == (2.0, 2.0, 2.0)
    assert student.unpaired([2.0] * 3, [5.0] * 2).interval() == (-3.0, -3.0, -3.0)
    assert student.mean([2.0] * 3).p_value(2.0) == 1.0
    assert student.mean([2.0] * 3).p_value(1.0) == 0.0


@pytest.mark.parametrize("values", [[], [1.0, np.nan], [1.0, np.inf, 2.0]])
def test_unknown_numbers_are_not_left_out(values):
    for found in (student.mean(values), student.unpaired(values, [1.0, 2.0]), student.unpaired([1.0, 2.0], values)):
        assert np.isnan(found.value) and not found.interval().known() and found.p_value() == 1.0


def test_one_seed_has_a_mean_and_no_interval():
    assert student.mean([3.0])[0] == 3.0 and not student.mean([3.0]).interval().known()
    assert student.unpaired([3.0], [1.0, 2.0]).value == 1.5


def test_holm_by_hand():
    # Ascending: 0.004 x 4 = 0.016, 0.011 x 3 = 0.033, 0.02 x 2 = 0.04, 0.04 x 1 = 0.04.
    assert student.holm([0.02, 0.004, 0.04, 0.011]) == pytest.approx([0.04, 0.016, 0.04, 0.033])
    # 0.03 x 3 = 0.09 holds back 0.04 (x 2 = 0.08), although 0.08 is smaller.
    assert student.holm([0.03, 0.04, 0.9]) == pytest.approx([0.09, 0.09, 0.9])
    assert student.holm([0.7, 0.8]) == [1.0, 1.0] and student.holm([0.01]) == [0.01] and student.holm([]) == []


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8))
def test_holm_rejects_as_the_step_down_procedure_does(p_values):
    rejected, level = set(), 0.05
    for rank, index in enumerate(sorted(range(len(p_values)), key=lambda i: p_values[i])):
        if p_values[index] * (len(p_values) - rank) > level:
            break
        rejected.add(index)
    adjusted = student.holm(p_values)
    assert {index for index, p in enumerate(adjusted) if p <= level} == rejected
    assert all(one >= p for one, p in zip(adjusted, p_values, strict=True))


def test_intervals_of_another_confidence():
    found = Estimate(0.0, 1.0, 1e9)
    assert found.interval(0.6827).high == pytest.approx(1.0, abs=1e-3)
