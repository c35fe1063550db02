"""xNES: one step as the paper writes it, its invariances, ties, and life inside pyribs."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ribs.archives import GridArchive
from ribs.emitters import EvolutionStrategyEmitter
from scipy.linalg import expm
from scipy.stats import ortho_group

from qdil.qd.xnes import XNES, draw_center, utilities


def tell(xnes: XNES, values) -> None:
    values = np.asarray(values, float)
    xnes.tell(np.argsort(-values, kind="stable"), values)


def maximise(function, xnes: XNES, iterations: int) -> None:
    for _ in range(iterations):
        tell(xnes, function(xnes.ask()))


def state(xnes: XNES) -> np.ndarray:
    """Mean and covariance, all that future samples depend on."""
    root = xnes.sigma * xnes.shape
    return np.concatenate([xnes.mean, np.ravel(root @ root.T)])


def test_one_step_is_the_papers():
    # Glasmachers et al. (2010), with full matrix A, both rates of A equal, and a second step from a skewed A.
    xnes = XNES(0.7, 3, 10, seed=0)
    mean, a = np.zeros(3), 0.7 * np.eye(3)
    rate = (9 + 3 * np.log(3)) / (5 * 3 * np.sqrt(3))
    weights = np.maximum(0, np.log(10 / 2 + 1) - np.log(np.arange(1, 11)))
    weights = weights / weights.sum() - 1 / 10
    for _ in range(3):
        samples = xnes.ask()
        fitness = np.cos(samples).sum(axis=1) + samples[:, 0] * samples[:, 1]
        z = np.linalg.solve(a, (samples - mean).T).T
        g_delta, g_m = np.zeros(3), np.zeros((3, 3))
        for utility, i in zip(weights, sorted(range(10), key=lambda i: -fitness[i]), strict=True):
            g_delta += utility * z[i]
            g_m += utility * (np.outer(z[i], z[i]) - np.eye(3))
        mean, a = mean + a @ g_delta, a @ expm(rate / 2 * g_m)
        tell(xnes, fitness)
        np.testing.assert_allclose(xnes.mean, mean, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(xnes.sigma * xnes.shape, a, rtol=1e-9, atol=1e-12)
        assert np.linalg.det(xnes.shape) == pytest.approx(1)


def test_a_step_leaves_no_thread_at_work():
    """A process that sleeps after a step uses no core: BLAS' threads may spin on for a tenth of a second."""
    code = """
import time
import numpy as np
from qdil.qd.xnes import XNES
xnes = XNES(1.0, 3, 96, seed=0)
xnes.ask()
xnes.tell(np.arange(96), np.arange(96.0))
xnes.check_stop(np.arange(96.0))
before = time.process_time()
time.sleep(0.5)
print(time.process_time() - before)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 0.03


def test_a_folded_coordinate_can_be_learned_from_zero():
    """One step from mean 0, larger c_0 and c_1 equally useful, c_2 useless: both means rise alike, c_2's does not."""
    means = []
    for seed in range(100):
        xnes = XNES(2.0, 3, 96, seed=seed, fold_first=True)
        samples = xnes.ask()
        assert (samples[:, 0] >= 0).all() and (samples[:, 1:] < 0).any()
        tell(xnes, samples[:, 0] + samples[:, 1])
        means.append(xnes.mean)
    useful, other, useless = np.median(means, axis=0)
    assert useful > 0.8 and other > 1.0 and abs(useless) < 0.3


def test_a_folded_coordinate_finds_its_optimum_and_stays_on_its_side():
    for optimum in (3.0, 0.0):
        xnes = XNES(1.0, 3, 40, seed=3, fold_first=True)
        for _ in range(60):
            tell(xnes, -np.square(xnes.ask() - [optimum, -1.0, 2.0]).sum(axis=1))
            assert xnes.mean[0] >= 0 and np.isfinite(state(xnes)).all()
        np.testing.assert_allclose(xnes.mean, [optimum, -1.0, 2.0], atol=0.1)


def test_without_improvement_folding_moves_nothing_on_average():
    moved = []
    for seed in range(400):
        xnes = XNES(1.0, 2, 20, seed=seed, fold_first=True)
        xnes.reset(np.array([1.0, 0.0]))
        count = len(xnes.ask())
        tell(xnes, np.random.default_rng(seed).normal(size=count))
        moved.append(xnes.mean - [1.0, 0.0])
    assert (np.abs(np.mean(moved, axis=0)) < 4 * np.std(moved, axis=0) / 20).all()


def test_a_restart_may_repeat_its_samples():
    xnes = XNES(1.0, 3, 5, seed=np.random.SeedSequence(4))
    first, second = xnes.ask(), xnes.ask()
    xnes.reset(np.zeros(3))
    assert not np.isin(xnes.ask(), [first, second]).any()
    xnes.reset(np.zeros(3), same_samples=True)
    np.testing.assert_array_equal(xnes.ask(), first)


def test_the_center_is_zero_or_anywhere_in_its_box():
    rng = np.random.default_rng(0)
    np.testing.assert_array_equal(draw_center("zero", 3, rng), np.zeros(3))
    drawn = np.array([draw_center("random", 3, rng) for _ in range(2000)])
    np.testing.assert_allclose(drawn.min(axis=0), [0, -2, -2], atol=0.02)
    np.testing.assert_allclose(drawn.max(axis=0), 2, atol=0.02)
    np.testing.assert_allclose(drawn.mean(axis=0), [1, 0, 0], atol=0.1)


def test_samples_have_the_mean_and_covariance_of_the_state():
    xnes = XNES(0.5, 3, 20, seed=1)
    maximise(lambda c: -np.square(c - [1, 2, 3]) @ [1, 5, 25], xnes, 10)
    samples = xnes.ask(200_000)
    moments = np.concatenate([samples.mean(axis=0), np.cov(samples.T).ravel()])
    np.testing.assert_allclose(moments, state(xnes), atol=0.02 * np.abs(state(xnes)).max())


def test_finds_the_top_of_an_ill_conditioned_hill():
    xnes = XNES(1.0, 4, 40, seed=0)
    top, turn = np.array([3.0, -2, 1, 5]), ortho_group.rvs(4, random_state=0)
    maximise(lambda c: -np.square((c - top) @ turn) @ [1, 10, 100, 1000], xnes, 150)
    np.testing.assert_allclose(xnes.mean, top, atol=1e-3)
    assert xnes.sigma < 0.01


def test_turning_the_problem_turns_the_search():
    turn = ortho_group.rvs(4, random_state=3)
    plain, turned = XNES(1.0, 4, 12, seed=5), XNES(1.0, 4, 12)

    def hill(c):
        return -np.square(c - [1, 2, 0, -1]) @ [1, 3, 9, 27] + c[:, 0] * c[:, 2]

    for _ in range(6):
        samples = plain.ask()
        turned._z = plain._z @ turn.T
        seen = turned.mean + turned.sigma * turned._z @ turned.shape.T
        np.testing.assert_allclose(seen, samples @ turn.T, atol=1e-9)
        tell(plain, hill(samples))
        tell(turned, hill(seen @ turn))
        np.testing.assert_allclose(turned.mean, turn @ plain.mean, atol=1e-9)
        np.testing.assert_allclose(turned.shape, turn @ plain.shape @ turn.T, atol=1e-9)
        assert turned.sigma == pytest.approx(plain.sigma)


@pytest.mark.parametrize("transform", [np.exp, lambda f: f**3, lambda f: 1e-6 * f - 40])
def test_only_the_order_of_fitness_matters(transform):
    plain, other = XNES(1.0, 3, 12, seed=2), XNES(1.0, 3, 12, seed=2)
    maximise(lambda c: -np.square(c - 1).sum(axis=1), plain, 5)
    maximise(lambda c: transform(-np.square(c - 1).sum(axis=1)), other, 5)
    np.testing.assert_array_equal(state(other), state(plain))


def test_utilities_by_hand():
    # n = 4: log 3, log 3/2, log 1, 0 for ranks 1 to 4, as shares of log 9/2, minus a quarter.
    shares = np.array([np.log(3), np.log(1.5), 0, 0]) / np.log(4.5) - 0.25
    np.testing.assert_allclose(utilities(np.array([5.0, 7.0, 6.0, 1.0])), shares[[2, 0, 1, 3]])
    tied = [shares[:2].mean(), shares[:2].mean(), shares[2:].mean(), shares[2:].mean()]
    np.testing.assert_allclose(utilities(np.array([9.0, 9.0, 0.0, 0.0])), tied)


@given(st.lists(st.integers(-3, 3), min_size=2, max_size=30))
def test_ties_share_and_utilities_sum_to_zero(values):
    u = utilities(np.array(values, float))
    assert u.sum() == pytest.approx(0, abs=1e-12)
    for i in range(len(values)):
        for j in range(len(values)):
            assert values[i] != values[j] or u[i] == pytest.approx(u[j])
            assert values[i] <= values[j] or u[i] >= u[j] - 1e-12


def test_several_criteria_rank_like_pyribs_two_stage_ranking():
    # Columns count in order: new cells (2) first, then improvements (1), and the value within each.
    u = utilities(np.array([[1, 9.0], [2, 0.5], [1, 3.0], [2, 0.1], [0, 50.0], [0, 60.0]]))
    assert np.argsort(-u)[:3].tolist() == [1, 3, 0]


def test_equal_values_change_nothing():
    xnes = XNES(0.3, 3, 8, seed=0)
    maximise(lambda c: c[:, 0], xnes, 2)
    before = state(xnes)
    xnes.ask()
    tell(xnes, np.zeros(8))
    np.testing.assert_allclose(state(xnes), before, atol=1e-12)


def test_reset_starts_over_with_new_samples():
    xnes = XNES(0.3, 3, 8, seed=0)
    first = xnes.ask()
    maximise(lambda c: c[:, 0], xnes, 3)
    xnes.reset(np.array([1.0, 2, 3]))
    np.testing.assert_array_equal(state(xnes), [1, 2, 3, *np.ravel(0.09 * np.eye(3))])
    again = xnes.ask()
    assert np.abs(again - [1, 2, 3] - first).min() > 1e-6


def test_stops_when_collapsed_or_blown_up():
    xnes = XNES(1.0, 2, 8)
    assert not xnes.check_stop(np.zeros(8))
    for useless in (1e-12, 1e12, np.inf):
        xnes.sigma = useless
        assert xnes.check_stop(np.zeros(8))


def test_bounds_are_refused():
    with pytest.raises(ValueError, match="unbounded"):
        XNES(1.0, 2, lower_bounds=np.array([0.0, -np.inf]))


def test_serves_pyribs_own_emitter():
    archive = GridArchive(solution_dim=4, dims=[10, 10], ranges=[(-2, 2)] * 2)
    emitter = EvolutionStrategyEmitter(archive, x0=[2.0] * 4, sigma0=0.5, es=XNES, ranker="obj", batch_size=20, seed=1)
    best = []
    for _ in range(25):
        solutions = emitter.ask()
        objective, measures = -np.square(solutions).sum(axis=1), solutions[:, :2]
        info = archive.add(solutions, objective, measures)
        emitter.tell(solutions, objective, measures, info)
        best.append(objective.max())
    assert best[0] < -5 and max(best) > -0.5
    assert archive.stats.num_elites > 10
