"""The simulation of few seeds: what is known of it exactly, and what the docs conclude from it."""

import numpy as np
import pytest

from qdil.evidence import trust


@pytest.mark.parametrize("name", trust.NOISES)
def test_noise_is_centred_and_independent(name):
    drawn = trust.NOISES[name](np.random.default_rng(0), 100_000)
    assert drawn.shape == (100_000,) and abs(drawn.mean()) < 5 * drawn.std() / np.sqrt(len(drawn))
    assert abs(np.corrcoef(drawn[1:], drawn[:-1])[0, 1]) < 0.02


def test_a_seeds_expert_moves_both_of_its_runs():
    rng = np.random.default_rng(0)
    first, second = trust.paired_runs(rng, trust.NOISES["normal"], 20_000)
    assert np.corrcoef([*first.values()], [*second.values()])[0, 1] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("seeds, exact", [(2, 1 / 2), (3, 3 / 4)])
def test_a_bootstrap_of_two_or_three_pairs_covers_as_rarely_as_their_range(seeds, exact):
    # Its ends are the smallest and the largest difference: 0 is outside if all have the same sign, 2 / 2^n of cases.
    assert trust.coverage("bootstrap", trust.NOISES["normal"], seeds) == pytest.approx(exact, abs=0.04)


@pytest.mark.parametrize("name", trust.NOISES)
@pytest.mark.parametrize("seeds", [3, 4, 5])
def test_students_interval_is_the_better_choice_for_few_seeds(name, seeds):
    of_student, of_bootstrap = (trust.coverage(m, trust.NOISES[name], seeds, 600) for m in ("student", "bootstrap"))
    assert of_student > 0.92 and of_bootstrap < 0.88


def test_a_single_look_is_wrong_as_often_as_promised_and_more_looks_more_often():
    one, two, three = (trust.called_by_chance(looks) for looks in ((5,), (3, 5), (3, 5, 10)))
    assert one == pytest.approx(0.05, abs=0.006)
    assert one + 0.02 < two < 0.10 and two + 0.01 < three < 0.15
