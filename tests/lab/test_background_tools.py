"""The background's tools: soft thresholds against pyribs, noise and true values, strategies, tables over seeds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from ribs.archives import GridArchive

from qdil.lab.background import compare, noise, problems, soft, strategies
from qdil.lab.background.algorithms import metrics, run_algorithm
from qdil.lab.background.compare import Case, ExperimentSize
from qdil.plotting import background as plotting

TINY = ExperimentSize(dim=4, cells=5, iterations=6, learning_rate=0.1, seeds=(3, 4))


@given(
    objectives=st.lists(st.floats(-50, 100), min_size=1, max_size=12),
    alpha=st.floats(0, 1),
    floor=st.floats(-40, 40),
)
def test_one_cell_does_as_pyribs_does(objectives, alpha, floor):
    archive = GridArchive(solution_dim=1, dims=[1], ranges=[(0, 1)], learning_rate=alpha, threshold_min=floor)
    added = [archive.add_single(np.zeros(1), f, np.zeros(1)) for f in objectives]
    visits = soft.visit(objectives, alpha, floor)
    accepted = np.array([row["status"] > 0 for row in added])
    np.testing.assert_allclose(visits.improvement, np.where(accepted, [row["value"] for row in added], 0), atol=1e-9)
    if accepted.any():
        assert visits.after[-1] == pytest.approx(archive.data("threshold")[0], abs=1e-9)
    np.testing.assert_array_equal(visits.before[1:], visits.after[:-1])


def test_thresholds_by_hand():
    visits = soft.visit([8, 8, 2, 12], 0.5)
    np.testing.assert_array_equal(visits.before, [0, 4, 6, 6])
    np.testing.assert_array_equal(visits.after, [4, 6, 6, 9])
    np.testing.assert_array_equal(visits.improvement, [8, 4, 0, 6])
    with pytest.raises(ValueError, match="between 0 and 1"):
        soft.visit([1], 1.1)


def test_noise_has_the_deviations_asked_for_and_leaves_gradients_alone():
    problem = problems.sphere(6)
    noisy = noise.noisy(problem, objective_sd=3.0, measure_sd=0.02, seed=0)
    x = np.zeros((4000, 6))
    objective, measures = noisy.evaluate(x)
    exact, where = problem.evaluate(x)
    width = 6 * problems.LIMIT  # of a measure's range: three coordinates, from -LIMIT to LIMIT each
    assert (objective - exact).std() == pytest.approx(3.0, rel=0.05)
    assert (measures - where).std(axis=0) == pytest.approx(0.02 * width, rel=0.05)
    assert abs((objective - exact).mean()) < 0.2
    for given_, true in zip(noisy.gradients(x[:2] + 1), problem.gradients(x[:2] + 1), strict=True):
        np.testing.assert_array_equal(given_, true)
    edge = noise.noisy(problem, 0.0, 5.0, seed=0).evaluate(x)[1]
    assert np.abs(edge).max() <= width / 2


def test_a_rescored_archive_holds_elites_in_their_true_cells():
    problem = problems.sphere(2)  # with two coordinates the measures are the coordinates
    archive = GridArchive(solution_dim=2, dims=[2, 2], ranges=problem.measure_ranges)
    solutions = np.array([[1.0, 1.0], [2.0, 2.0], [-1.0, 1.0]])
    archive.add(solutions, [500.0, 90.0, 80.0], [[1, 1], [-1, -1], [-1, 1]])  # the second in a wrong cell
    home = noise.rescored(problem, archive)
    exact = problem.evaluate(solutions)[0]
    assert len(archive) == 3 and len(home) == 2
    assert sorted(home.data("objective")) == pytest.approx(sorted([exact[1], exact[2]]))
    assert len(noise.rescored(problem, GridArchive(solution_dim=2, dims=[2, 2], ranges=problem.measure_ranges))) == 0


def test_rescoring_an_exact_archive_changes_nothing():
    problem = problems.rastrigin(6)
    archive = run_algorithm(problem, "cma-mega", 10, seed=0, cells=6, batch=10).archive
    assert metrics(noise.rescored(problem, archive)) == pytest.approx(metrics(archive))


@pytest.mark.parametrize("name", strategies.STRATEGIES)
def test_every_strategy_finds_an_optimum_without_noise(name):
    chase = strategies.chase(name, noise=0.0, iterations=60, seed=1)
    assert chase.distance[0] < strategies.START and chase.distance[-1] < 0.01
    assert chase.width[-1] < 0.01


def test_without_information_xnes_stays_wider_than_cma_es():
    # Noise a thousand times what there is to see: every ranking is chance.
    def widths(name):
        return np.array([strategies.chase(name, 1e5, 100, seed).width[-1] for seed in range(5)])

    assert np.all(widths("xNES") > widths("CMA-ES (pyribs)"))
    assert np.all(widths("xNES") > widths("CMA-ES (whole rank-one term)"))


def test_the_whole_rank_one_term_is_hansens():
    rng = np.random.default_rng(0)
    cov, rank_mu, path = np.eye(3), np.diag([3.0, 2.0, 1.0]), rng.normal(size=3)
    weights = np.full(4, 0.25)
    updated = strategies.WholeRankOne._calc_cov_update(cov, 0.1, 0.3, 0.1, path, 0.5, rank_mu, weights)
    # Eq. 47 of Hansen's tutorial with the path and the parents' steps in units of the step size 0.5.
    steps = path / 0.5
    np.testing.assert_allclose(updated, 0.6 * np.eye(3) + 0.1 * np.outer(steps, steps) + 0.3 * rank_mu / 0.25)


def test_an_unknown_strategy_is_refused():
    with pytest.raises(ValueError, match="choose one of"):
        strategies.chase("adam", 0.0, 1, 0)


def test_runs_differ_by_seed_alone_and_the_table_tells_their_range():
    problem = problems.sphere(TINY.dim)
    results = {name: compare.repeat(problem, name, TINY) for name in ("map-elites", "cma-maega")}
    again = run_algorithm(problem, "cma-maega", TINY.iterations, seed=4, cells=TINY.cells, learning_rate=0.1)
    np.testing.assert_array_equal(results["cma-maega"][1].history["qd_score"], again.history["qd_score"])
    final = compare.ends(results)
    assert list(final["label"]) == ["map-elites"] * 2 + ["cma-maega"] * 2
    scores = [result.history["qd_score"][-1] for result in results["map-elites"]]
    shown = f"{np.median(scores):.1f} ({min(scores):.1f} to {max(scores):.1f})"
    assert max(scores) < 1000  # from there on it is shown in whole numbers
    assert compare.table(results).loc["map-elites", "QD-score"] == shown


def test_sizes_count_their_seeds_from_the_first():
    assert compare.size_of("laptop", 7).seeds == (7, 8, 9, 10, 11)
    assert compare.size_of("smoke", 1)._replace(seeds=()) == compare.SIZES["smoke"]._replace(seeds=())


def test_under_noise_claims_and_truth_part_and_without_it_they_agree():
    cases = {"exact": Case(batch=8), "noise": Case(20.0, 0.1, 8)}
    rows = compare.under_noise(problems.sphere(TINY.dim), ("cma-mega", "cma-maega"), TINY, cases)
    assert len(rows) == 2 * 2 * len(TINY.seeds)
    exact, loud = (rows[rows["case"] == case] for case in cases)
    np.testing.assert_allclose(exact["claimed_qd_score"], exact["true_qd_score"])
    # The best of several noisy scores flatters; single cells may hold elites that are worth less than nothing.
    assert np.all(loud["claimed_best"] > 100) and np.all(loud["true_best"] <= 100)
    assert np.all(loud["claimed_coverage"] >= loud["true_coverage"])


def test_pictures_show_what_they_are_given():
    problem = problems.sphere(TINY.dim)
    results = {name: compare.repeat(problem, name, TINY) for name in ("map-elites", "cma-mega")}
    maps = plotting.archive_maps({name: several[0].archive for name, several in results.items()})
    filled = len(results["map-elites"][0].archive)
    assert maps.axes[0].get_title() == f"map-elites\n{filled} of 25 cells"
    grid = maps.axes[0].collections[0].get_array()
    assert grid.count() == filled and float(grid.sum()) == pytest.approx(
        results["map-elites"][0].history["qd_score"][-1]
    )
    curves = plotting.curves(results)
    np.testing.assert_allclose(
        curves.axes[1].lines[1].get_ydata(),
        100 * np.median([result.history["coverage"] for result in results["cma-mega"]], axis=0),
    )
    swept = plotting.swept({0.1: results["cma-mega"], 1.0: results["map-elites"]}, "α")
    assert [label.get_text() for label in swept.axes[0].get_xticklabels()] == ["0.1", "1"]
    chased = {0.0: {"xNES": [strategies.chase("xNES", 0.0, 5, seed) for seed in (0, 1)]}}
    rows = compare.under_noise(problem, ["cma-mega"], TINY, {"noise": Case(5.0, 0.02, 8)})
    drawn = plotting.under_noise(rows).axes[0].lines
    np.testing.assert_array_equal(drawn[1].get_ydata(), rows["true_qd_score"])
    for figure in (plotting.chases(chased), plotting.thresholds({0.5: soft.visit([8, 8, 2, 12], 0.5)})):
        assert isinstance(figure, Figure)
        figure.canvas.draw()
