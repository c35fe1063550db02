"""Lemma 1's small world against enumeration, finite differences and sampling; PPO on it; robots' and files' parts."""

import itertools
import json
from collections import defaultdict

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qdil.errors import ConfigError
from qdil.lab.lemma import mdp, missing, ppo, results, robot, trials
from qdil.lab.lemma.mdp import Mdp
from qdil.lab.lemma.ppo import TabularPPO
from qdil.lab.lemma.results import RobotTrial
from qdil.lab.lemma.trials import Improvements
from qdil.plotting import lemma as pictures

STATES, ACTIONS, HORIZON, CELLS, GAMMA = 3, 2, 4, 3, 0.9
# Every program of many trials takes seconds to compile, so the tests share one number of problems and two of episodes.
PROBLEMS, FEW, MANY = 60, TabularPPO(episodes=8), TabularPPO(episodes=64)
WEIGHT = (1 - GAMMA**HORIZON) / (1 - GAMMA)
SMALL = TabularPPO(horizon=HORIZON, episodes=16, minibatches=2, epochs=2)


def drawn(seed: int, falls: float, k: int = 2) -> tuple[Mdp, np.ndarray, np.ndarray]:
    """A random problem of k measures in double precision: MDP with random proxies, logits, occupied cells."""
    rng = np.random.default_rng(seed)
    world = Mdp(
        jnp.asarray(rng.dirichlet(np.ones(STATES))),
        jnp.asarray(rng.dirichlet(np.ones(STATES), (STATES, ACTIONS))),
        jnp.asarray(falls * rng.random((STATES, ACTIONS))),
        jnp.asarray(rng.integers(0, 2, (STATES, k)), jnp.int32),
    )
    return world, jnp.asarray(rng.normal(size=(STATES, ACTIONS))), rng.random((CELLS,) * k) < 0.5


def enumerated(world: Mdp, theta: np.ndarray, horizon: int = HORIZON) -> dict[tuple[int, ...], float]:
    """Probability of every (length, count of foot 1, count of foot 2, …), trajectory by trajectory."""
    start, step, fall, proxy = (np.asarray(x, float) for x in world)
    policy = np.exp(theta) / np.exp(theta).sum(axis=1, keepdims=True)
    total: dict[tuple[int, ...], float] = defaultdict(float)
    for length in range(1, horizon + 1):
        for states in itertools.product(range(len(start)), repeat=length):
            for actions in itertools.product(range(policy.shape[1]), repeat=length):
                chance = start[states[0]]
                for t in range(length):
                    chance *= policy[states[t], actions[t]]
                    if t < length - 1:
                        chance *= (1 - fall[states[t], actions[t]]) * step[states[t], actions[t], states[t + 1]]
                if length < horizon:
                    chance *= fall[states[-1], actions[-1]]
                counts = proxy[list(states)].sum(axis=0).astype(int)
                total[length, *counts.tolist()] += chance
    return total


def empty(occupied: np.ndarray, length: int, *counts: int) -> bool:
    """m ∈ A_e in whole numbers."""
    cells = len(occupied)
    return not occupied[tuple(min(cells * count // length, cells - 1) for count in counts)]


# Dynamic programming


@pytest.mark.parametrize("k, falls", [(1, 0.6), (2, 0.0), (2, 0.6), (3, 0.6)])
@given(seed=st.integers(0, 10_000))
@settings(max_examples=5)
def test_probabilities_are_those_of_all_trajectories(k, falls, seed):
    world, theta, occupied = drawn(seed, falls, k)
    expected = enumerated(world, np.asarray(theta))
    computed = np.asarray(mdp.outcomes(world, theta, HORIZON), float)
    assert computed.sum() == pytest.approx(1, abs=1e-5)
    for (length, *counts), chance in expected.items():
        assert computed[length - 1, *counts] == pytest.approx(chance, abs=1e-5)
    found = sum(chance for outcome, chance in expected.items() if empty(occupied, *outcome))
    grid = jnp.asarray(occupied)
    assert float(mdp.probability(world, theta, grid, HORIZON)) == pytest.approx(found, abs=1e-5)
    for p, q in ((0.0, 1.0), (0.5, 0.25)):
        discounted = sum(
            chance * (p + q * empty(occupied, *outcome)) * sum(GAMMA**t for t in range(outcome[0]))
            for outcome, chance in expected.items()
        )
        assert float(mdp.bonus_return(world, theta, grid, HORIZON, GAMMA, p, q)) == pytest.approx(discounted, abs=1e-4)
    steps = sum(chance * outcome[0] for outcome, chance in expected.items())
    assert float(mdp.mean_length(world, theta, HORIZON)) == pytest.approx(steps, abs=1e-4)


@given(seed=st.integers(0, 10_000), falls=st.sampled_from([0.0, 0.6]))
@settings(max_examples=10)
def test_the_gradient_is_the_slope(seed, falls):
    with jax.enable_x64(True):
        world, theta, occupied = drawn(seed, falls)
        grid, step = jnp.asarray(occupied), 1e-5
        gradient = (ppo.ascend(world, theta, grid, HORIZON, GAMMA, 1.0) - theta).ravel()
        for i, nudge in enumerate(np.eye(theta.size).reshape(-1, *theta.shape) * step):
            up, down = (mdp.bonus_return(world, theta + s * nudge, grid, HORIZON, GAMMA) for s in (1, -1))
            assert float(gradient[i]) == pytest.approx(float(up - down) / (2 * step), abs=1e-7)


@given(seed=st.integers(0, 100_000))
@settings(max_examples=40)
def test_a_small_exact_step_never_lowers_the_probability(seed):
    # The Hessian of P is at most E|score|² + E|its Jacobian| ≤ 2 T² + T = 36, and h = WEIGHT · P with WEIGHT < 3.5, so
    # that a step along ∇h is safe up to a size of 2 / (36 · 3.5) = 0.0158.
    with jax.enable_x64(True):
        world, theta, occupied = drawn(seed, falls=0.0)
        grid = jnp.asarray(occupied)
        moved = ppo.ascend(world, theta, grid, HORIZON, GAMMA, 0.0158)
        before, after = (float(mdp.probability(world, x, grid, HORIZON)) for x in (theta, moved))
        assert after >= before - 1e-12


@given(seed=st.integers(0, 10_000))
@settings(max_examples=10)
def test_objective_and_probability_are_one_where_lengths_are_equal(seed):
    # Eq. 17, with the T of our sum the number of steps.
    world, theta, occupied = drawn(seed, falls=0.0)
    grid = jnp.asarray(occupied)
    chance = float(mdp.probability(world, theta, grid, HORIZON))
    assert float(mdp.bonus_return(world, theta, grid, HORIZON, GAMMA)) == pytest.approx(WEIGHT * chance, abs=1e-5)


def test_by_hand_a_rising_objective_can_lower_the_probability_where_robots_fall():
    # State 0 touches with foot 1. Action 1 falls at once: measures (1, 0), an empty cell. Action 0 goes on, to state 1
    # (again foot 1, so (1, 0)) in 4 of 5 cases and else to state 2 (no foot, so (1/2, 0), a filled cell).
    step = np.zeros((3, 2, 3))
    step[:, :, 1], step[:, :, 2] = 0.8, 0.2
    fall = np.array([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]])
    world = Mdp(*(jnp.asarray(x, jnp.float32) for x in (np.eye(3)[0], step, fall)), jnp.array([[1, 0], [1, 0], [0, 0]]))
    occupied = jnp.array([[True, True], [True, True], [False, True]])  # 3 x 2 cells, (1, 0) in the only empty one
    values = []
    for staying in (0.1, 0.9):
        theta = jnp.log(jnp.array([[staying, 1 - staying]] * 3))
        chance = float(mdp.probability(world, theta, occupied, 2))
        objective = float(mdp.bonus_return(world, theta, occupied, 2, 1.0))
        assert chance == pytest.approx(1 - 0.2 * staying)
        assert objective == pytest.approx((1 - staying) * 1 + staying * 0.8 * 2)
        values.append((chance, objective))
    assert values[1][0] < values[0][0] and values[1][1] > values[0][1]


@pytest.mark.parametrize("falls", [0.0, 0.6])
def test_sampled_episodes_have_the_exact_distribution(falls):
    world, theta, _ = drawn(5, falls)
    seen = mdp.sample(jax.random.key(0), world, theta, HORIZON, 20_000)
    counts = np.rint(np.asarray(seen.measures) * np.asarray(seen.length)[:, None]).astype(int)
    for (length, first, second), chance in enumerated(world, np.asarray(theta)).items():
        hit = (np.asarray(seen.length) == length) & (counts == [first, second]).all(axis=1)
        assert abs(hit.mean() - chance) < 5 * np.sqrt(chance * (1 - chance) / 20_000) + 1e-4
    assert np.array_equal(np.asarray(seen.counts).sum(axis=0), seen.length)


def test_random_worlds_have_every_contact_pattern_and_fall_only_if_asked():
    world = mdp.random_mdp(jax.random.key(0))
    assert {tuple(row) for row in np.asarray(world.proxy).tolist()} == {(0, 0), (0, 1), (1, 0), (1, 1)}
    np.testing.assert_allclose(np.asarray(world.step).sum(axis=-1), 1, atol=1e-5)
    patterns = {tuple(row) for row in np.asarray(mdp.random_mdp(jax.random.key(0), k=3).proxy).tolist()}
    assert patterns == set(itertools.product((0, 1), repeat=3))
    assert not world.fall.any() and 0 < mdp.random_mdp(jax.random.key(0), falls=0.3).fall.max() <= 0.3


# PPO


def test_advantages_by_hand():
    world, theta, occupied = drawn(3, 0.6)
    seen = mdp.sample(jax.random.key(1), world, theta, HORIZON, 16)
    given_ = SMALL._replace(gamma=GAMMA, lam=0.7, p=0.25, q=1.0)
    advantages = np.asarray(ppo._advantages(seen, jnp.asarray(occupied), given_, STATES))
    state, length = np.asarray(seen.state), np.asarray(seen.length)
    counts = np.rint(np.asarray(seen.measures) * length[:, None]).astype(int)
    reward = np.array([0.25 + empty(occupied, int(n), *c) for n, c in zip(length, counts.tolist(), strict=True)])
    from_each = defaultdict(list)
    for n in range(16):
        for t in range(length[n]):
            from_each[state[t, n]].append(reward[n] * sum(GAMMA**i for i in range(length[n] - t)))
    critic = {s: np.mean(values) for s, values in from_each.items()}
    for n in range(16):
        advantage = 0.0
        for t in reversed(range(length[n])):
            after = critic[state[t + 1, n]] if t + 1 < length[n] else 0.0
            advantage = reward[n] + GAMMA * after - critic[state[t, n]] + GAMMA * 0.7 * advantage
            assert advantages[t, n] == pytest.approx(advantage, abs=1e-4)


def test_nothing_is_learned_where_nothing_can_be_found():
    world, theta, _ = drawn(0, 0.0)
    full = jnp.ones((CELLS, CELLS), bool)
    np.testing.assert_array_equal(ppo.improve(jax.random.key(0), world, theta, full, SMALL), theta)


def test_one_iteration_improves_most_problems_and_more_episodes_improve_more_of_them():
    few, many = (trials.by_ppo(0, PROBLEMS, settings_).change for settings_ in (FEW, MANY))
    assert np.mean(many < 0) < 0.3 < np.mean(few < 0)
    assert many.mean() > 3 * few.mean() > 0


def test_many_iterations_find_a_way_that_is_certain():
    # Foot 1 is down exactly after action 1, and the empty cells ask for it all the time.
    step = jnp.tile(jnp.eye(2)[None], (2, 1, 1))
    world = Mdp(jnp.array([0.0, 1.0]), step, jnp.zeros((2, 2)), jnp.array([[0, 0], [1, 0]], jnp.int32))
    occupied = jnp.zeros((5, 5), bool).at[:4].set(True)
    theta, chosen = jnp.zeros((2, 2)), TabularPPO(horizon=6, episodes=64, learning_rate=0.1)
    assert float(mdp.probability(world, theta, occupied, 6)) == pytest.approx((1 / 2) ** 5 * 6, abs=1e-5)
    improve = jax.jit(lambda key, theta: ppo.improve(key, world, theta, occupied, chosen))
    for update in range(60):
        theta = improve(jax.random.key(update), theta)
    assert float(mdp.probability(world, theta, occupied, 6)) > 0.95


def test_the_clip_bounds_how_far_one_iteration_goes():
    moves = {}
    for clip in (0.02, 1e9):
        world, theta, occupied = drawn(7, 0.0)
        chosen = SMALL._replace(clip=clip, learning_rate=0.1, epochs=4)
        after = ppo.improve(jax.random.key(0), world, theta, jnp.asarray(occupied), chosen)
        moves[clip] = float(jnp.abs(jax.nn.softmax(after) - jax.nn.softmax(theta)).max())
    assert 0 < moves[0.02] < 0.5 * moves[1e9]


def test_minibatches_that_do_not_divide_are_refused():
    world, theta, occupied = drawn(0, 0.0)
    with pytest.raises(ValueError, match="minibatches=3 must divide episodes=16"):
        ppo.improve(jax.random.key(0), world, theta, jnp.asarray(occupied), SMALL._replace(minibatches=3))


# Many trials


def test_where_lengths_are_equal_objective_and_probability_never_disagree_and_else_they_do():
    equal, early = (trials.by_ppo(1, PROBLEMS, FEW, falls) for falls in (0.0, 0.5))
    assert {0, 1} == set(trials.group(equal))
    assert {0, 1, 2} <= set(trials.group(early))
    exact = trials.by_gradient(1, PROBLEMS, 0.01, FEW, 0.5)
    assert exact.objective_change.min() > 0 > exact.change.min()
    weight = (1 - 0.99**12) / (1 - 0.99)
    np.testing.assert_allclose(equal.objective_change, weight * equal.change, atol=1e-6)


def test_fuller_archives_are_harder_to_find_empty_cells_of():
    half, full = (trials.problems(1, PROBLEMS, 0.0, filled) for filled in (0.5, 0.9))
    np.testing.assert_array_equal(trials.problems(1, PROBLEMS, 0.0).occupied, half.occupied)
    for drawn_, share in ((half, 0.5), (full, 0.9)):
        assert np.mean(drawn_.occupied) == pytest.approx(share, abs=0.05)
    few = trials.by_ppo(1, PROBLEMS, FEW, filled=0.9)
    np.testing.assert_array_equal(few.probability_old, trials.values(full, full.theta, FEW)[0])


def test_trials_are_named_by_what_rose():
    several = Improvements(
        *np.array([[0.5, 0.5, 0.5, 0.5, 0.5], [0.5, 0.4, 0.4, 0.6, 0.7], [1.0] * 5, [1, 0, 2, 0, 1.5]])
    )
    assert trials.group(several).tolist() == [0, 1, 2, 3, 0]
    tally = trials.tally(several)
    assert tally[list(trials.GROUPS)].tolist() == [40, 20, 20, 20]
    assert tally["median change of P"] == pytest.approx(0)
    np.testing.assert_allclose(several.posterior, [0.5, 4 / 9, 4 / 9, 6 / 11, 7 / 12])
    assert Improvements(*np.zeros((4, 1))).posterior.tolist() == [0.5]


def test_counting_episodes_agrees_with_the_exact_values():
    problems = trials.problems(2, PROBLEMS, 0.5)
    exact, _, length = trials.values(problems, problems.theta, FEW)
    counted = trials.by_counting(problems, problems.theta, FEW, seed=0, episodes=1000)
    z = (counted - exact) / np.sqrt(np.maximum(exact * (1 - exact), 1e-6) / 1000)
    assert np.abs(z).max() < 4.5 and 0.7 < np.std(z) < 1.4
    assert np.all((1 <= length) & (length < 12))


def test_bayes_rule_agrees_with_counted_coin_flips():
    table = trials.bayes_by_sampling(1, PROBLEMS, 2, 1000, MANY._replace(learning_rate=0.3))
    share = table["by_new"] / table["landed"]
    z = (share - table["exact"]) / np.sqrt(table["exact"] * (1 - table["exact"]) / table["landed"])
    assert np.abs(z).max() < 4.5 and np.std(z) < 1.4
    assert table["exact"].min() < 0.5 < table["exact"].max()


def test_learning_starts_at_the_old_policy_and_a_reward_for_survival_lengthens_episodes():
    survival = MANY._replace(p=1.0, q=0.0, learning_rate=0.1)
    learned = trials.learning(1, PROBLEMS, 3, survival, falls=0.5)
    problems = trials.problems(1, PROBLEMS, 0.5)
    chance, _, length = trials.values(problems, problems.theta, survival)
    np.testing.assert_array_equal(learned.probability[0], chance)
    np.testing.assert_array_equal(learned.length[0], length)
    np.testing.assert_array_equal(learned.length[-1], trials.values(problems, learned.theta, survival)[2])
    assert learned.probability.shape == (4, PROBLEMS)
    assert np.mean(learned.length[-1] > learned.length[0]) > 0.9


# Robots and the file


def test_an_archive_is_filled_where_a_policy_goes_most():
    # Four cells visited 5, 3, 1 and 1 times of 10.
    measures = np.repeat([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9], [0.9, 0.9]], [5, 3, 1, 1], axis=0)
    seen = robot.Sample(measures, np.full(10, 7.0))
    filled = {known: robot.make_archive(seen, 2, known).astype(int).tolist() for known in (0.0, 0.5, 0.6, 0.85, 1.0)}
    assert filled == {
        0.0: [[0, 0], [0, 0]],
        0.5: [[1, 0], [0, 0]],
        0.6: [[1, 0], [1, 0]],
        0.85: [[1, 1], [1, 0]],
        1.0: [[1, 1], [1, 1]],
    }
    assert robot.make_archive(seen, 4, 1.0).sum() == 4  # cells that nobody visited stay empty
    assert robot._found(robot.make_archive(seen, 2, 0.5), seen).sum() == 5


def test_intervals_of_extreme_counts():
    # Clopper-Pearson has a closed form where nothing, or everything, was found.
    assert robot.interval(0, 20) == pytest.approx((0, 1 - 0.025 ** (1 / 20)))
    assert robot.interval(20, 20) == pytest.approx((0.025 ** (1 / 20), 1))


TRIALS = [RobotTrial(1, 0.5, 10, 4, 7, 40.0, 80.0, 100.0, 110.0), RobotTrial(2, 0.9, 10, 1, 0, 9.0, 0.0, 90.0, 95.0)]


def test_the_file_keeps_what_it_has_and_adds_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(missing.PROBLEMS, "smoke", PROBLEMS)
    asked = []

    def run(env, budget, report, effort):
        asked.append(env)
        return TRIALS

    monkeypatch.setattr(robot, "run_trials", run)
    assert results.read("smoke", tmp_path) == {}
    written = missing.compute_missing("walker2d", "smoke", tmp_path, settings=MANY)
    assert list(written) == ["mdp", "mdp-falls", "walker2d"]
    direct = trials.by_ppo(missing.SEED, PROBLEMS, MANY)
    np.testing.assert_allclose(written["mdp"]["change"], direct.change, rtol=1e-5)
    assert written["walker2d"]["change"] == pytest.approx([0.3, -0.1])
    assert written["walker2d"]["updates"] == robot.EFFORTS["smoke"].updates
    assert results.trials_of(written["walker2d"]) == TRIALS
    stamp = (tmp_path / "smoke" / "lemma.json").read_bytes()
    assert (
        missing.compute_missing("walker2d", "smoke", tmp_path)
        == results.read("smoke", tmp_path)
        == json.loads(stamp)["environments"]
    )
    assert (tmp_path / "smoke" / "lemma.json").read_bytes() == stamp and asked == ["walker2d"]
    both = missing.compute_missing("halfcheetah", "smoke", tmp_path)
    assert list(both)[-1] == "halfcheetah" and both["mdp"] == written["mdp"] and asked == ["walker2d", "halfcheetah"]


def test_changes_are_means_by_seed_with_the_number_of_updates():
    several = {"seed": [1, 1, 3], "change": [0.4, 0.2, -0.1]}
    assert results.changes(several | {"updates": 15}) == (
        "15 PPO updates",
        [0.4, 0.2, -0.1],
        pytest.approx([0.3, -0.1]),
    )
    assert results.changes(several).improvement == "some PPO updates"
    assert results.changes({"change": [0.5]}) == ("one PPO update", [0.5], [0.5])


def test_a_file_that_is_none_is_refused(tmp_path):
    path = results.path_of("smoke", tmp_path)
    path.parent.mkdir()
    path.write_text("[]")
    with pytest.raises(ConfigError, match="lemma.json is no results file"):
        results.read("smoke", tmp_path)


@pytest.mark.slow
@pytest.mark.physics
def test_a_robot_is_tried_from_a_policy_that_stays_the_same():
    effort = robot.Effort(seeds=1, warmup=1, known=(0.5,), updates=1, rounds=1)
    lines: list[str] = []
    first, again = (robot.run_trials("walker2d", "smoke", lines.append, effort) for _ in range(2))
    assert first == again and len(first) == 1 and len(lines) == 2
    assert 0 <= first[0].found_old <= first[0].episodes == 24
    assert 1 <= first[0].length_old <= 50 and first[0].return_old <= first[0].length_old


# Pictures


def test_pictures_of_many_trials_show_shares_and_values():
    several = trials.by_ppo(1, PROBLEMS, FEW, 0.5)
    fallen = np.count_nonzero(several.change < -trials.ROUNDING)
    fell = 100 * fallen / PROBLEMS
    drawn = pictures.changes({"early ends": several})
    assert drawn.axes[0].get_title() == f"early ends\nfell in {fell:.1f} % of {PROBLEMS}"
    assert sum(bar.get_height() for bar in drawn.axes[0].patches[:60]) == fallen  # 60 bins, stacked: fallen first
    clouds = pictures.assumption({"early ends": several}).axes[0].collections
    assert [len(cloud.get_offsets()) for cloud in clouds] == np.bincount(trials.group(several), minlength=4).tolist()
    table = pd.DataFrame({8: trials.tally(several)}).T
    bars = pictures.fallen({"episodes": table}).axes[0].patches
    assert sum(bar.get_height() for bar in bars) == pytest.approx(fell)


def test_a_policys_episodes_are_drawn_where_they_fall():
    chances = np.zeros((3, 3))
    chances[2, 0], chances[1, 1] = 0.75, 0.25  # m = (1, 0) and (1/2, 1/2) of episodes of two steps
    ax = pictures.episodes_on_archive({"here": chances}, np.array([[True, True], [False, True]])).axes[0]
    new, known = ax.collections[1:]
    areas = {tuple(at): area for at, area in zip(new.get_offsets().tolist(), new.get_sizes(), strict=True)}
    assert {at: area for at, area in areas.items() if area > 0} == {(1.0, 0.0): 0.75 * 2500}
    areas = {tuple(at): area for at, area in zip(known.get_offsets().tolist(), known.get_sizes(), strict=True)}
    assert {at: area for at, area in areas.items() if area > 0} == {(0.5, 0.5): 0.25 * 2500}


def test_robots_are_drawn_with_their_intervals():
    lines = pictures.robots({"walker2d": TRIALS}).axes[0].lines
    np.testing.assert_allclose(lines[0].get_ydata(), robot.interval(4, 10))
    assert [line.get_ydata()[0] for line in lines[1::2]] == [0.4, 0.7, 0.1, 0.0]


def test_coefficients_are_shares_and_cells_are_counted_once():
    log = pd.DataFrame({"coverage": [0.1, 0.3, 0.3], "c0": [1.0, 0.5, 2.0], "c1": [-1.0, 1.5, 1.0], "c2": [2.0, 0, 1]})
    size, share, new = pictures.coefficients({"gail": [log, log]}).axes
    np.testing.assert_allclose(size.lines[0].get_ydata(), [1, 0.5, 2])
    np.testing.assert_allclose(share.lines[0].get_ydata(), [0.25, 0.25, 0.5])
    np.testing.assert_allclose(new.lines[0].get_ydata(), [10, 20, 0], atol=1e-12)


def test_the_other_pictures_can_be_drawn():
    who = trials.bayes_by_sampling(1, PROBLEMS, 2, 1000, MANY._replace(learning_rate=0.3))
    learned = trials.learning(1, PROBLEMS, 3, MANY._replace(p=1.0, q=0.0, learning_rate=0.1), falls=0.5)
    lengths = pictures.lengths({"zero": np.array([3.0, 5.0, 9.0]), "mbo-zero": np.array([9.0, 10.0])}, limit=10)
    assert [label.get_text() for label in lengths.axes[0].get_yticklabels()] == ["Zero reward", "Mbo-Zero reward"]
    drawn = pictures.learning({"p = 1": learned})
    np.testing.assert_allclose(drawn.axes[1].lines[0].get_ydata(), learned.length.mean(axis=1))
    for figure in (pictures.bayes(who), lengths, drawn):
        figure.canvas.draw()
