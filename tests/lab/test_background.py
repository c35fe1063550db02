"""The benchmarks by hand and by finite differences; the algorithms against brute force, probes and the literature."""

import functools

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from ribs.archives import GridArchive

from qdil.lab.background import algorithms, competition, problems
from qdil.lab.background.algorithms import ALGORITHMS
from qdil.lab.background.problems import LIMIT, OFFSET, Problem

MAKERS = {"sphere": problems.sphere, "rastrigin": problems.rastrigin, "arm": problems.arm}
DQD = ("cma-mega", "cma-maega", "cma-mega-xnes", "cma-maega-xnes")
SOFT = ("cma-maega", "cma-maega-xnes")
DIM, CELLS, BATCH, ITERATIONS = 12, 10, 20, 40  # of the runs that claims are tested on
SEEDS = range(5)


# Problems


@pytest.mark.parametrize("name", MAKERS)
@given(x=st.lists(st.floats(-12, 12), min_size=7, max_size=7))
def test_gradients_are_the_slopes(name, x):
    problem, step = MAKERS[name](7), 1e-5
    x = np.array(x)
    assume(np.all(np.abs(np.abs(x) - LIMIT) > 2 * step))  # where the clip jumps there is no slope
    nudged = np.concatenate([x + step * np.eye(7), x - step * np.eye(7)])
    objective, measures = problem.evaluate(nudged)
    objective_grad, measure_grads = problem.gradients(x[None])
    slopes = (objective[:7] - objective[7:]) / (2 * step)
    np.testing.assert_allclose(objective_grad[0], slopes, rtol=1e-5, atol=1e-5)
    slopes = (measures[:7] - measures[7:]).T / (2 * step)
    np.testing.assert_allclose(measure_grads[0], slopes, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("name", MAKERS)
def test_a_batch_is_its_rows(name):
    problem = MAKERS[name](5)
    x = np.random.default_rng(0).normal(scale=4, size=(6, 5))
    together = [*problem.evaluate(x), *problem.gradients(x)]
    assert [part.shape for part in together] == [(6,), (6, 2), (6, 5), (6, 2, 5)]
    for i in range(6):
        alone = [*problem.evaluate(x[i : i + 1]), *problem.gradients(x[i : i + 1])]
        for whole, part in zip(together, alone, strict=True):
            np.testing.assert_allclose(whole[i], part[0], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", ["sphere", "rastrigin"])
def test_a_projection_is_best_at_its_offset_and_nothing_at_the_far_corner(name):
    problem = MAKERS[name](4)
    objective, measures = problem.evaluate(np.array([[OFFSET] * 4, [-LIMIT] * 4]))
    np.testing.assert_allclose(objective, [100, 0], atol=1e-12)
    np.testing.assert_allclose(measures, [[2 * 2.048] * 2, [-2 * 5.12] * 2])
    np.testing.assert_allclose(problem.gradients(np.full((1, 4), OFFSET))[0], 0, atol=1e-12)


def test_sphere_by_hand():
    # At 0 each coordinate is 2.048 from the optimum, of 7.168 at the worst: 1 - (2/7)^2 = 45/49.
    problem = problems.sphere(2)
    assert problem.evaluate(np.zeros((1, 2)))[0][0] == pytest.approx(100 * 45 / 49)
    # Towards the optimum: 2 * 2.048 / (2 * 7.168^2) a coordinate, times 100.
    np.testing.assert_allclose(problem.gradients(np.zeros((1, 2)))[0], 100 * 2.048 / 7.168**2)


def test_rastrigin_has_a_bowl_and_waves():
    # z = 1: bowl 1, wave 0; z = 1/2: bowl 1/4, wave 10 + 10.
    lost = 100 - problems.rastrigin(3).evaluate(OFFSET + np.array([[1.0] * 3, [0.5] * 3, [0.0, 0.0, 1.0]]))[0]
    np.testing.assert_allclose(lost[1] / lost[0], 20.25)
    np.testing.assert_allclose(lost[2] / lost[0], 1 / 3)


def test_clipping_by_hand():
    # 10.24 counts as 1/2, -8 as -0.64, and the limit itself in full; slopes -5.12/x².
    x = np.array([[10.24, -8.0, -5.12, 3.0, 0.0]])
    problem = problems.sphere(5)
    np.testing.assert_allclose(problem.evaluate(x)[1], [[0.5 - 0.64, -5.12 + 3.0]])
    inner, outer = problem.gradients(x)[1][0]
    np.testing.assert_allclose(inner, [-1 / 20.48, -0.08, 0, 0, 0])
    np.testing.assert_allclose(outer, [0, 0, 1, 1, 1])


def test_arm_by_hand():
    quarter, half = np.pi / 2, np.pi
    straight, up, folded, square = [0.0] * 4, [quarter, 0, 0, 0], [0, half, 0, half], [quarter] * 4
    objective, measures = problems.arm(4).evaluate(np.array([straight, up, folded, square]))
    np.testing.assert_allclose(measures, [[4, 0], [0, 4], [0, 0], [0, 0]], atol=1e-12)
    # Variances: 0; 3/16 of a quarter turn squared; a quarter of a half turn squared; 0, all angles being equal.
    np.testing.assert_allclose(objective, [100, 100 - 300 / 16 * quarter**2, 100 - 25 * half**2, 100])
    # A straight arm's joint moves the links from it on, upwards only.
    np.testing.assert_allclose(problems.arm(4).gradients(np.zeros((1, 4)))[1][0], [[0] * 4, [4, 3, 2, 1]])


@pytest.mark.parametrize("name", MAKERS)
@given(x=st.lists(st.floats(-30, 30), min_size=7, max_size=7))
def test_measures_stay_in_their_ranges(name, x):
    problem = MAKERS[name](7)
    low, high = np.array(problem.measure_ranges).T
    measures = problem.evaluate(np.array([x]))[1][0]
    assert np.all(low - 1e-9 <= measures) and np.all(measures <= high + 1e-9)


@pytest.mark.parametrize("name", MAKERS)
def test_ranges_are_no_wider_than_needed(name):
    problem = MAKERS[name](7)  # odd: the halves differ
    if name == "arm":
        first = np.array([0, np.pi / 2, np.pi, -np.pi / 2])[:, None]
        corners = np.concatenate([first, np.zeros((4, 6))], axis=1)
    else:
        corners = np.array([[LIMIT] * 7, [-LIMIT] * 7])
    measures = problem.evaluate(corners)[1]
    reached = np.stack([measures.min(axis=0), measures.max(axis=0)], axis=1)
    np.testing.assert_allclose(reached, problem.measure_ranges, rtol=1e-12)


@pytest.mark.parametrize(("name", "dim"), [("sphere", 1), ("rastrigin", 1), ("arm", 0)])
def test_too_few_dimensions_are_refused(name, dim):
    with pytest.raises(ValueError, match="at least"):
        MAKERS[name](dim)


# Algorithms


@functools.cache
def finished(name: str, seed: int, learning_rate: float = 0.01) -> algorithms.Result:
    """A run on the sphere, shared by the tests that only look."""
    problem = problems.sphere(DIM)
    return algorithms.run_algorithm(
        problem, name, ITERATIONS, seed, cells=CELLS, batch=BATCH, learning_rate=learning_rate
    )


def last(column: str, name: str, learning_rate: float = 0.01) -> np.ndarray:
    """A metric at the end of the run, (seeds,)."""
    return np.array([finished(name, seed, learning_rate).history[column][-1] for seed in SEEDS])


def recording(problem: Problem) -> tuple[Problem, list[np.ndarray]]:
    """The problem, and a list that will hold every batch it is asked to evaluate."""
    batches: list[np.ndarray] = []

    def evaluate(solutions):
        batches.append(np.array(solutions))
        return problem.evaluate(solutions)

    return problem._replace(evaluate=evaluate), batches


def probe(sigma: float = 0.01, sigma_g: float = 0.7) -> Problem:
    """f and both measures each depend on one coordinate of five, with gradients of very different length."""
    gradients = np.zeros((3, 5))
    gradients[[0, 1, 2], [0, 1, 2]] = [5.0, -3.0, 0.01]

    def values(x):
        return 1 + x @ gradients[0], x @ gradients[1:].T

    def slopes(x):
        return np.tile(gradients[0], (len(x), 1)), np.tile(gradients[1:], (len(x), 1, 1))

    return Problem("probe", 5, ((-9.0, 9.0), (-0.03, 0.03)), values, slopes, sigma, sigma_g)


def cell_of(measures: np.ndarray, problem: Problem, cells: int) -> tuple[int, ...]:
    low, high = np.array(problem.measure_ranges).T
    return tuple(np.clip(np.floor(cells * (measures - low) / (high - low)), 0, cells - 1).astype(int).tolist())


@pytest.mark.compiles
@pytest.mark.parametrize("name", ALGORITHMS)
def test_the_archive_holds_the_best_of_all_evaluations(name):
    problem, batches = recording(problems.rastrigin(6))
    result = algorithms.run_algorithm(problem, name, 10, seed=4, cells=6, batch=8, emitters=2)
    best: dict[tuple[int, ...], float] = {}
    if name in SOFT:
        batches = batches[1:]  # before the search: is the start above threshold_min?
    for batch in batches:
        for f, m in zip(*problems.rastrigin(6).evaluate(batch), strict=True):
            here = cell_of(m, problem, 6)
            best[here] = max(f, best.get(here, -np.inf))
    stored = result.archive.data(["index", "objective"], return_type="dict")
    held = {divmod(int(i), 6): f for i, f in zip(stored["index"], stored["objective"], strict=True)}
    assert held == pytest.approx(best)
    # Metrics by hand, and evaluations equal for all.
    history = result.history
    assert history["qd_score"][-1] == pytest.approx(sum(best.values()))
    assert history["coverage"][-1] == len(best) / 36
    assert history["best"][-1] == max(best.values())
    assert history["evaluations"].tolist() == [16 * i for i in range(1, 11)]
    assert sum(map(len, batches)) == 160
    assert (result.searched is result.archive) == (name not in (*SOFT, "nslc"))


def replay(problem: Problem, batches: list[np.ndarray], cells: int, alpha: float, floor: float):
    """The archive rules written out: (status, improvement) of every solution of every batch, and the final thresholds.

    ``floor`` -inf is the plain archive, whose threshold is the best objective and whose new cells improve upon 0.
    """
    thresholds: dict[tuple[int, ...], float] = {}
    expected = []
    for batch in batches:
        accepted: dict[tuple[int, ...], list[float]] = {}
        expected.append([])
        for f, m in zip(*problem.evaluate(batch), strict=True):
            here = cell_of(m, problem, cells)
            t = thresholds.get(here, floor)
            expected[-1].append((0 if f <= t else 1 if here in thresholds else 2, f - (t if np.isfinite(t) else 0)))
            if f > t:
                accepted.setdefault(here, []).append(f)
        for here, values in accepted.items():
            kept = (1 - alpha) ** len(values)
            plain = not np.isfinite(floor)
            thresholds[here] = (
                max(values) if plain else kept * thresholds.get(here, floor) + (1 - kept) * np.mean(values)
            )
    return expected, thresholds


@pytest.mark.parametrize("name", SOFT)
def test_the_searched_archive_follows_the_soft_threshold_rule(name):
    alpha, floor = 0.2, 10.0
    problem, batches = recording(problems.sphere(6))
    result = algorithms.run_algorithm(problem, name, 15, 1, cells=5, batch=12, learning_rate=alpha, threshold_min=floor)
    expected, thresholds = replay(problems.sphere(6), batches[1:], 5, alpha, floor)
    stored = result.searched.data(["index", "threshold"], return_type="dict")
    held = {divmod(int(i), 5): t for i, t in zip(stored["index"], stored["threshold"], strict=True)}
    assert held == pytest.approx(thresholds)
    assert {status for batch in expected for status, _ in batch} == {0, 1, 2}


@pytest.mark.parametrize("name", DQD)
def test_the_point_moves_to_the_better_halfs_weighted_mean(name):
    # Algorithm 1 of DQD with η = 1; CMA-MEGA ranks new cells first, CMA-MAEGA by the improvement alone.
    # Objectives below 0, so that a new cell's improvement is often the smaller one.
    lowered = problems.arm(9)._replace(evaluate=lambda x: (-100 * np.var(x, axis=1), problems.arm(9).evaluate(x)[1]))
    problem, batches = recording(lowered)
    algorithms.run_algorithm(problem, name, 30, 3, cells=CELLS, batch=13, learning_rate=0.1, threshold_min=-50)
    batches = batches[-60:]  # θ and its branches in turn
    expected, _ = replay(lowered, batches, CELLS, 0.1, -50 if name in SOFT else -np.inf)
    weights = np.log(6.5) - np.log(np.arange(1, 7))
    weights /= weights.sum()
    moves, by_status = 0, 0
    for i in range(1, 59, 2):
        status, value = np.array(expected[i]).T
        plain = np.argsort(-value)
        ranking = plain if name in SOFT else np.lexsort((-value, -status))
        restarts = name not in SOFT and not status.any()
        if not restarts:
            np.testing.assert_allclose(batches[i + 1][0], weights @ batches[i][ranking[:6]], atol=1e-9)
            moves += 1
            by_status += not np.array_equal(ranking[:6], plain[:6])
    assert moves > 10 and (name in SOFT or by_status > 0)


def test_cma_mes_mean_moves_to_what_entered_the_archive():
    # Improvement emitter of the CMA-ME paper: all that were added are parents, new cells before improved ones.
    lowered = problems.arm(9)._replace(evaluate=lambda x: (-100 * np.var(x, axis=1), problems.arm(9).evaluate(x)[1]))
    problem, batches = recording(lowered)
    algorithms.run_algorithm(problem, "cma-me", 5, 0, cells=40, batch=4000)
    expected, _ = replay(lowered, batches, 40, 1.0, -np.inf)
    for batch, after, ranked in zip(batches[1:], batches[2:], expected[1:], strict=False):
        status, value = np.array(ranked).T
        parents = batch[np.lexsort((-value, -status))[: np.count_nonzero(status)]]
        weights = np.log(len(parents) + 0.5) - np.log(np.arange(1, len(parents) + 1))
        assert 10 < len(parents) < 1900
        chance = 5 * after.std(axis=0) / np.sqrt(len(after))  # of the mean of so many samples
        assert np.all(np.abs(after.mean(axis=0) - weights @ parents / weights.sum()) < chance)


def test_cma_me_starts_over_from_an_elite_when_nothing_improves():
    # What comes later is worse: the second batch adds nothing, so the third surrounds the first one's best.
    rounds = iter(range(3))

    def declining(x):
        return -np.abs(x[:, 0]) - next(rounds), x[:, 1:3]

    problem, batches = recording(probe(sigma=0.01)._replace(evaluate=declining))
    elite = algorithms.run_algorithm(problem, "cma-me", 3, 0, cells=1, batch=400).archive.data("solution")[0]
    assert np.linalg.norm(elite - batches[1].mean(axis=0)) > 0.01
    np.testing.assert_allclose(batches[2].mean(axis=0), elite, atol=0.0025)
    assert batches[2].std(axis=0) == pytest.approx(0.01, rel=0.2)


@pytest.mark.parametrize("name", DQD)
def test_only_cma_mega_gives_up_a_point_that_improves_nothing(name):
    # One cell, and the start is the best there is: CMA-MEGA returns to it each time, CMA-MAEGA walks on.
    def hill(x):
        return 1 - np.square(x).sum(axis=1), x[:, 1:3]

    problem, batches = recording(probe()._replace(evaluate=hill))
    algorithms.run_algorithm(problem, name, 3, 0, cells=1, batch=9, learning_rate=1.0)
    points = np.concatenate(batches[-6::2])
    assert np.all(points[0] == 0)
    assert np.all(points[1:] == 0) == (name not in SOFT)


@pytest.mark.parametrize("name", ALGORITHMS)
def test_emitters_draw_apart(name):
    problem, batches = recording(probe())
    algorithms.run_algorithm(problem, name, 1, 0, batch=6, emitters=2)
    one, two = np.split(batches[-1], 2)
    assert not np.any(np.all(one == two, axis=1))


@pytest.mark.parametrize("name", ALGORITHMS)
def test_the_seed_decides_everything(name):
    first, again, other = (
        algorithms.run_algorithm(problems.rastrigin(6), name, 8, seed, cells=CELLS) for seed in (7, 7, 8)
    )
    for column, values in first.history.items():
        np.testing.assert_array_equal(values, again.history[column])
    for field in ("solution", "objective", "measures", "index"):
        np.testing.assert_array_equal(first.archive.data(field), again.archive.data(field))
    assert not np.array_equal(first.history["qd_score"], other.history["qd_score"])


@pytest.mark.parametrize("name", ALGORITHMS)
def test_the_archive_never_gets_worse(name):
    history = finished(name, 0).history
    for column in ("coverage", "best"):
        assert np.all(np.diff(history[column]) >= 0)
    assert history["coverage"][-1] > history["coverage"][0]
    assert history["best"][-1] > history["best"][0]


def found_by_hand(known, f, m, neighbours, width):
    """Novelty and local competition of one solution against ``known`` (objective, measures) ones."""
    if not known:
        return width, 0
    near = sorted(known, key=lambda other: np.linalg.norm(other[1] - m))[:neighbours]
    return np.mean([np.linalg.norm(other - m) for _, other in near]), sum(other < f for other, _ in near)


def fronts_by_hand(values):
    """Indices front by front: what no one else is at least as good as in both values, and better in one."""
    left, fronts = set(range(len(values))), []
    while left:
        beaten = {
            i
            for i in left
            for j in left
            if values[j][0] >= values[i][0] and values[j][1] >= values[i][1] and values[j] != values[i]
        }
        fronts.append(left - beaten)
        left = beaten
    return fronts


def test_novelty_search_keeps_what_is_novel_or_better_than_its_neighbour_and_breeds_the_first_fronts():
    problem = problems.arm(3)._replace(sigma=1e-4)
    start = np.random.default_rng(5).normal(size=(3, 12, 3))  # three generations that are far apart
    width, known, bred = 6 / 8, [], 0
    archive = competition.novelty_archive(problem, 8, seed=0)
    for first in start:
        emitter = competition.Generations(archive, problem.sigma, first, seed=1)
        objective, measures = problem.evaluate(emitter.ask())
        found = [
            found_by_hand(known, f, m, competition.NEIGHBOURS, width) for f, m in zip(objective, measures, strict=True)
        ]
        info = archive.add(first, objective, measures)
        np.testing.assert_allclose(info["novelty"], [novelty for novelty, _ in found])
        assert info["local_competition"].tolist() == [beaten for _, beaten in found]

        # What is not novel enough competes with its nearest neighbour; the best of a batch takes that place.
        before = list(known)
        for (novelty, _), f, m in zip(found, objective, measures, strict=True):
            if novelty >= width:
                known.append((f, m))
                continue
            nearest = min(range(len(before)), key=lambda i, m=m: np.linalg.norm(before[i][1] - m))
            if f > known[nearest][0]:
                known[nearest] = (f, m)
        np.testing.assert_allclose(sorted(archive.data("objective")), sorted(f for f, _ in known))

        emitter.tell(first, objective, measures, info)
        parents = {int(np.linalg.norm(first - child, axis=1).argmin()) for child in emitter.ask()}
        distances = [np.linalg.norm(first - child, axis=1).min() for child in emitter.ask()]
        assert len(parents) == 6 and max(distances) < 1e-3
        whole: set[int] = set()
        for front in fronts_by_hand(found):
            if len(whole | front) > 6:
                assert whole <= parents <= whole | front
                bred += bool(whole)
                break
            whole |= front
    assert bred > 0  # at least one generation had a first front that did not fill half of it


def test_novelty_search_spreads_further_than_chance():
    problem, rng = problems.sphere(DIM), np.random.default_rng(0)
    measures = problem.evaluate(rng.normal(size=(ITERATIONS * BATCH, DIM)))[1]
    cells = {cell_of(m, problem, CELLS) for m in measures}
    assert last("coverage", "nslc").mean() > 1.2 * len(cells) / CELLS**2


def test_map_elites_puts_noise_on_earlier_elites():
    problem, batches = recording(probe(sigma=0.01))
    algorithms.run_algorithm(problem, "map-elites", 4, 0, batch=400)
    assert batches[0].std(axis=0) == pytest.approx(1, rel=0.2)
    for i in (1, 2, 3):
        earlier = np.concatenate(batches[:i])
        gaps = batches[i][:, None, :] - earlier
        nearest = np.take_along_axis(gaps, np.square(gaps).sum(axis=2).argmin(axis=1)[:, None, None], axis=1)
        assert np.sqrt(np.square(nearest).mean()) == pytest.approx(0.01, rel=0.1)


def test_cma_me_starts_around_the_origin():
    problem, batches = recording(probe(sigma=0.01))
    algorithms.run_algorithm(problem, "cma-me", 1, 0, batch=400)
    assert batches[0].std(axis=0) == pytest.approx(0.01, rel=0.2)
    assert np.abs(batches[0].mean(axis=0)).max() < 0.002


@pytest.mark.parametrize("name", DQD)
def test_the_first_branches_weigh_unit_gradients(name):
    # Steps of sigma_g along each gradient, however long it is, and none elsewhere.
    problem, batches = recording(probe(sigma_g=0.7))
    algorithms.run_algorithm(problem, name, 1, 0, batch=401)
    theta, branches = batches[-2:]
    np.testing.assert_array_equal(theta, np.zeros((1, 5)))
    assert branches.shape == (400, 5)
    assert branches[:, :3].std(axis=0) == pytest.approx(0.7, rel=0.15)
    assert np.abs(branches[:, :3].mean(axis=0)).max() < 0.14
    np.testing.assert_array_equal(branches[:, 3:], 0)


@pytest.mark.parametrize("name", DQD)
def test_branches_span_the_gradients_at_their_point(name):
    problem, batches = recording(problems.arm(9))
    algorithms.run_algorithm(problem, name, 12, 2, cells=CELLS, batch=15)
    batches = batches[-24:]  # θ and its branches in turn
    for theta, branches in zip(batches[::2], batches[1::2], strict=True):
        objective_grad, measure_grads = problem.gradients(theta)
        rows = np.concatenate([objective_grad, measure_grads[0]])
        offsets = branches - theta
        weights = np.linalg.lstsq(rows.T, offsets.T, rcond=None)[0]
        np.testing.assert_allclose(rows.T @ weights, offsets.T, atol=1e-9 * np.abs(offsets).max())
    assert np.linalg.matrix_rank(offsets) == 3
    assert np.ptp([theta for theta in batches[::2]], axis=0).max() > 0.1  # θ walks


@pytest.mark.parametrize("name", SOFT)
def test_without_annealing_the_thresholds_stay_and_only_the_objective_counts(name):
    # α = 0 turns CMA-MAEGA into maximising f, α = 1 into search for new and better cells (MAP-Annealing paper).
    for seed in SEEDS:
        assert set(finished(name, seed, 0.0).searched.data("threshold")) == {0.0}
    assert last("best", name, 0.0).min() > 99.9
    assert last("coverage", name, 1.0).mean() > 0.1 + last("coverage", name, 0.0).mean()


@pytest.mark.parametrize("name", DQD)
@pytest.mark.parametrize("blind", ["map-elites", "cma-me"])
def test_gradients_beat_their_absence(name, blind):
    # DQD's result on linear projections, at the same number of evaluations.
    for column in ("coverage", "qd_score"):
        assert last(column, name).mean() > 1.5 * last(column, blind).mean()


def test_adapting_beats_fixed_noise():
    # The CMA-ME paper's result on linear projections.
    for column in ("coverage", "qd_score"):
        assert last(column, "cma-me").mean() > last(column, "map-elites").mean()


@pytest.mark.parametrize("name", DQD)
def test_search_beats_chance(name):
    problem, rng = problems.sphere(DIM), np.random.default_rng(0)
    for solutions in (
        rng.uniform(-LIMIT, LIMIT, (ITERATIONS * BATCH, DIM)),
        rng.normal(size=(ITERATIONS * BATCH, DIM)),
    ):
        best: dict[tuple[int, ...], float] = {}
        for f, m in zip(*problem.evaluate(solutions), strict=True):
            here = cell_of(m, problem, CELLS)
            best[here] = max(f, best.get(here, -np.inf))
        assert last("coverage", name).mean() > 1.2 * len(best) / CELLS**2
        assert last("qd_score", name).mean() > 1.2 * sum(best.values())


@pytest.mark.parametrize("pair", [("cma-mega", "cma-mega-xnes"), ("cma-maega", "cma-maega-xnes")])
def test_xnes_does_as_well_as_cma_es_and_not_the_same(pair):
    usual, ours = (last("qd_score", name) for name in pair)
    assert ours.mean() > 0.8 * usual.mean()
    assert np.all(ours != usual)


def test_an_unknown_algorithm_is_refused_by_name():
    untouched = probe()._replace(evaluate=None, gradients=None)  # nothing may be evaluated
    with pytest.raises(ValueError) as refusal:
        algorithms.run_algorithm(untouched, "cma-meg", 1, 0)
    assert "'cma-meg'" in str(refusal.value) and all(name in str(refusal.value) for name in ALGORITHMS)


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("cma-me", {"iterations": 0}, "iterations must be at least 1"),
        ("cma-me", {"cells": 0}, "cells must be at least 1"),
        ("cma-mega", {"batch": 2}, "batch must be at least 3"),
        ("map-elites", {"emitters": 0}, "emitters must be at least 1"),
        ("cma-maega", {"learning_rate": 1.5}, "between 0 and 1"),
        ("cma-maega-xnes", {"threshold_min": 1.0}, "below the start's objective, 1"),
        ("cma-maega", {"threshold_min": -np.inf}, "finite"),
        ("cma-maega", {"threshold_min": np.nan}, "finite"),
    ],
)
def test_settings_that_cannot_be_are_refused(name, settings, words):
    with pytest.raises(ValueError, match=words):
        algorithms.run_algorithm(probe(), name, seed=0, **{"iterations": 2, **settings})


@pytest.mark.parametrize("name", ALGORITHMS)
def test_the_smallest_settings_work(name):
    result = algorithms.run_algorithm(probe(), name, 3, 0, cells=1, batch=3)
    assert result.history["coverage"].tolist() == [1, 1, 1]
    assert result.history["best"][-1] == result.history["qd_score"][-1] >= 1


def test_metrics_of_an_empty_archive():
    empty = algorithms.metrics(GridArchive(solution_dim=1, dims=[2], ranges=[(0, 1)]))
    assert empty["qd_score"] == 0 and empty["coverage"] == 0 and np.isnan(empty["best"])
