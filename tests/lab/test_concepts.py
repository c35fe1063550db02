"""The overview's miniatures against other ways of computing the same, and what their pictures show."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import norm, truncnorm

from qdil.lab.background import concepts
from qdil.plotting import overview

CELLS = 20


def smoothed(position):
    """E[f] over episodes around ``position``, by SciPy's quadrature instead of the grid's sum."""
    return norm.expect(
        lambda m: concepts.fitness(np.atleast_1d(np.clip(m, 0, 1)))[0], loc=position, scale=concepts.SPREAD
    )


def test_without_bonus_the_search_settles_on_the_hill_that_it_began_on(monkeypatch):
    monkeypatch.setattr(concepts, "PATIENCE", 1000)  # no restart
    top = minimize_scalar(lambda x: -smoothed(x), bounds=(0.3, 0.5), method="bounded").x
    assert concepts.explore(0.0, 200, CELLS, seed=0).position[-1] == pytest.approx(top, abs=1e-3)


def test_a_step_goes_along_the_gradient():
    slope = (smoothed(concepts.BEGIN + 1e-4) - smoothed(concepts.BEGIN - 1e-4)) / 2e-4
    first = concepts.explore(0.0, 1, CELLS, seed=0).position[0]
    assert first - concepts.BEGIN == pytest.approx(concepts.RATE * slope, rel=0.02)


def test_visits_and_filled_cells_agree():
    found = concepts.explore(1.0, 150, CELLS, seed=3)
    assert found.visits.sum() == 150
    assert found.filled[-1] == (found.visits > 0).sum()
    assert found.filled[0] == 1 and set(np.diff(found.filled)) <= {0, 1}


def test_the_bonus_finds_more_cells_and_stays_less_in_one():
    without, bonus = ([concepts.explore(q, 200, CELLS, seed) for seed in range(20)] for q in (0.0, 2.0))
    assert np.mean([s.filled[-1] for s in bonus]) > np.mean([s.filled[-1] for s in without]) + 2
    assert np.mean([s.visits.max() for s in bonus]) < np.mean([s.visits.max() for s in without])


def test_reward_is_log_of_one_plus_the_density_of_demonstrations():
    at, experts, width = np.linspace(0, 1, 7), np.array([0.2, 0.9]), 0.1
    density = np.mean([truncnorm.pdf(at, -e / width, (1 - e) / width, e, width) for e in experts], axis=0)
    reward = concepts.discriminator_reward(at, experts, np.array([0.5, 0.5]), width, sees_details=False)
    np.testing.assert_allclose(reward, np.log1p(density), rtol=1e-3)


def test_a_discriminator_blind_to_details_never_gives_a_lower_mean_reward():
    at, experts, details = np.linspace(0, 1, 50), np.array([0.2, 0.7]), np.array([0.9, 0.3])
    fine, coarse = (concepts.discriminator_reward(at, experts, details, 0.06, sees) for sees in (True, False))
    assert (coarse >= fine - 1e-9).all() and (coarse > fine + 0.1).any()


def test_bars_are_mean_visits():
    searches = {"one": [concepts.explore(0.0, 30, 5, s) for s in (0, 1)], "two": [concepts.explore(1.0, 30, 5, 0)]}
    figure = overview.exploration(searches)
    bars = [bar.get_height() for bar in figure.axes[0].patches]
    assert bars == list(np.mean([s.visits for s in searches["one"]], axis=0))
    assert figure.axes[2].lines[0].get_ydata()[-1] == np.mean([20 * s.filled[-1] for s in searches["one"]])


@pytest.mark.parametrize("cells", [2, 5])
def test_a_cell_shows_feet_down_for_its_share_of_the_time(cells):
    figure = overview.behaviours(cells)
    bars = [c for c in figure.axes[0].collections if len(c.get_paths())]
    assert len(bars) == 2 * cells**2
    for number, bar in enumerate(bars):
        foot, cell = number % 2, divmod(number // 2, cells)
        down = sum(path.get_extents().width for path in bar.get_paths()) * cells / 0.84
        assert down == pytest.approx((cell[foot] + 0.5) / cells, abs=0.02)


def test_every_arrow_of_the_framework_joins_boxes():
    ends = {box for arrow in overview.ARROWS for box in (arrow[0], arrow[2])}
    assert ends == set(overview.BOXES)
    figure = overview.framework()
    assert {text.get_text() for text in figure.axes[0].texts} >= {box[5] for box in overview.BOXES.values()}


def test_rewards_are_drawn_on_one_scale():
    one = overview.Demonstrators([0.4], [0.3], True)
    figure = overview.localised_reward({"a": one, "b": one._replace(sees_details=False)})
    assert figure.axes[0].get_ylim() == figure.axes[1].get_ylim()
