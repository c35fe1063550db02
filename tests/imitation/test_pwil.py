"""PWIL against eqs. 13-15 word for word, with exact fractions, and against the optimal transport that it bounds."""

from fractions import Fraction
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from probes import ACTIONS, CONTEXT, OBS, built, demos_of, steps_of
from scipy.optimize import linear_sum_assignment, linprog

from qdil.imitation.rewards.pwil import couple, distances

pytestmark = pytest.mark.compiles

ROWS, TIME = 6, 9  # expert rows N, time limit T
ROLLOUT, ROLLOUTS, ENVS = 7, 3, 3
ALPHA, BETA = 5.0, 5.0

jitted_couple = jax.jit(couple)


# One step's coupling


def couple_slowly(distance, mass, amount):
    """Take ``amount`` from rows in the order of their distance, the first of equals first."""
    left, cost = list(mass), 0
    for j in sorted(range(len(mass)), key=lambda j: distance[j]):
        taken = min(amount, left[j])
        left[j] -= taken
        amount -= taken
        cost += taken * distance[j]
    return left, cost


tables = st.lists(st.lists(st.integers(0, 9), min_size=5, max_size=5), min_size=2, max_size=2)


@given(tables, tables, st.integers(0, 30))
def test_couplings_are_the_greedy_ones(distance, mass, amount):
    left, cost = jitted_couple(jnp.array(distance, jnp.float32), jnp.array(mass, jnp.int32), amount)
    assert left.dtype == jnp.int32
    for e in range(2):
        expected_left, expected_cost = couple_slowly(distance[e], mass[e], amount)
        assert left[e].tolist() == expected_left and cost[e] == expected_cost
        assert sum(mass[e]) - left[e].sum() == min(amount, sum(mass[e]))
        assert all(0 <= now <= before for now, before in zip(left[e].tolist(), mass[e], strict=True))


@given(tables, tables)
def test_no_feasible_coupling_of_a_step_is_cheaper(distance, mass):
    # Eqs. 13 and 14 as the linear programme they are.
    amount = min(sum(row) for row in mass)
    _, cost = jitted_couple(jnp.array(distance, jnp.float32), jnp.array(mass, jnp.int32), amount)
    for e in range(2):
        best = linprog(distance[e], A_eq=np.ones((1, 5)), b_eq=[amount], bounds=[(0, m) for m in mass[e]])
        assert cost[e] == pytest.approx(best.fun, abs=1e-6)


def test_distances_are_euclidean():
    x, atoms = np.random.default_rng(0).normal(size=(2, 4, 5)).astype(np.float32)
    by_hand = [[np.sqrt(sum((a - b) ** 2 for a, b in zip(u, v, strict=True))) for v in atoms] for u in x]
    np.testing.assert_allclose(distances(x, atoms), by_hand, rtol=1e-5)
    np.testing.assert_allclose(np.diag(distances(x, x)), 0, atol=2e-3)  # as exact as a product of matrices allows


# Rewards


def features_of(steps, demos, method):
    """Rows of numbers (…, F) whose Euclidean distance counts: each in spreads of the demonstrations."""
    raw, actions = np.asarray(demos.obs, float), np.asarray(demos.action, float)
    parts = [(np.asarray(steps.obs, float) - raw.mean(0)) / raw.std(0)]
    parts += [] if method.endswith("-obs") else [np.asarray(steps.action, float) / actions.std(0)]
    if "mcond" in method:
        proxies = np.asarray(demos.proxy, float).std(0)
        parts += [np.asarray(steps.proxy, float) / np.where(proxies == 0, 1, proxies)]
    return np.concatenate(parts, axis=-1)


def rewards_slowly(x, atoms, ended, coupling):
    """Eqs. 13-15 for one robot's history x (H, F), in exact fractions of mass."""
    count, size = atoms.shape
    free, rewards = [Fraction(1, count)] * count, []
    for row, last in zip(x, ended, strict=True):
        need, cost = Fraction(1, TIME), 0.0
        distance = np.sqrt(np.square(row - atoms).sum(axis=1))
        while need > 0:
            j = min((j for j in range(count) if free[j] > 0), key=lambda j: distance[j])
            omega = min(need, free[j])
            free[j] -= omega
            need -= omega
            cost += float(omega) * distance[j]
        rewards.append(ALPHA * np.exp(-BETA * TIME / np.sqrt(size) * cost))
        if last or coupling == "step":
            free = [Fraction(1, count)] * count
    return rewards


def history(rng, chance):
    """Steps (ROLLOUTS · ROLLOUT, ENVS) of episodes that end by chance, with a fall or without, or at the time limit."""
    steps = steps_of(rng, ROLLOUTS * ROLLOUT, ENVS)
    ended = rng.random((ROLLOUTS * ROLLOUT, ENVS)) < chance
    begun = np.zeros(ENVS, int)
    for t in range(len(ended)):
        begun += 1
        ended[t] |= begun == TIME
        begun[ended[t]] = 0
    fell = ended & (rng.random(ended.shape) < 0.5)
    return steps._replace(terminated=jnp.asarray(fell), truncated=jnp.asarray(ended & ~fell))


DEMOS = demos_of(steps_of(np.random.default_rng(5), 1, ROWS, shift=0.5))
CASES = [("pwil", "episode"), ("pwil", "step"), ("mcond-pwil", "episode"), ("pwil-obs", "episode")]


@cache
def begun(method, coupling):
    """A model, its state after ``DEMOS``, and its reward compiled."""
    model = built(method, episode_length=TIME, pwil_coupling=coupling, pwil_alpha=ALPHA, pwil_beta=BETA)
    return model, model.init(jax.random.key(0), DEMOS), jax.jit(model.reward)


def rollouts_of(steps, size):
    return [jax.tree.map(lambda x, t=t: x[t : t + size], steps) for t in range(0, len(steps.obs), size)]


def rewarded(case, steps, size):
    """Rewards (H, E), computed in rollouts of ``size`` steps, and the mass left after each rollout."""
    model, state, compute = begun(*case)
    memory, rewards, masses = model.begin(state, steps.obs.shape[1]), [], []
    for part in rollouts_of(steps, size):
        memory, reward = compute(state, memory, CONTEXT, part)
        rewards.append(np.asarray(reward))
        masses.append(np.asarray(memory))
    return np.concatenate(rewards), np.stack(masses)


@pytest.mark.parametrize("case", CASES, ids="-".join)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.15, 0.5]))
def test_rewards_are_the_equations(case, seed, chance):
    steps = history(np.random.default_rng(seed), chance)
    rewards, _ = rewarded(case, steps, ROLLOUT)
    x, atoms = features_of(steps, DEMOS, case[0]), features_of(DEMOS, DEMOS, case[0])
    for e in range(ENVS):
        expected = rewards_slowly(x[:, e], atoms, np.asarray(steps.ended[:, e]), case[1])
        np.testing.assert_allclose(rewards[:, e], expected, rtol=2e-4)
    assert 0 < rewards.min() and rewards.max() <= ALPHA


def test_rewards_do_not_depend_on_how_steps_are_cut_into_rollouts():
    steps = history(np.random.default_rng(1), 0.15)
    case = ("pwil", "episode")
    np.testing.assert_array_equal(rewarded(case, steps, ROLLOUT)[0], rewarded(case, steps, ROLLOUT * ROLLOUTS)[0])


def test_no_mass_is_lost():
    steps = history(np.random.default_rng(2), 0.1)
    _, masses = rewarded(("pwil", "episode"), steps, 1)
    ages, ended = np.zeros(ENVS, int), np.asarray(steps.ended)
    for mass, last in zip(masses, ended, strict=True):
        ages = np.where(last, 0, ages + 1)
        assert masses.dtype == np.int32 and mass.min() >= 0 and mass.max() <= TIME
        np.testing.assert_array_equal(mass.sum(axis=1), ROWS * (TIME - ages))
    assert ended.any() and not ended.all()


def test_both_couplings_by_hand():
    # Nine times the same step: the reward falls if its mass stays taken, and stays if the mass is restored every step.
    one = jax.tree.map(lambda x: jnp.repeat(x[:1, :1], TIME, axis=0), history(np.random.default_rng(3), 0.0))
    carried, restored = (rewarded(("pwil", how), one, TIME)[0][:, 0] for how in ("episode", "step"))
    assert carried[0] == pytest.approx(restored[0], rel=1e-5) and carried[-1] < carried[0]
    assert np.all(np.diff(carried) <= 1e-6) and np.ptp(restored) == 0
    with_end = one._replace(truncated=one.truncated.at[4].set(True))
    again = rewarded(("pwil", "episode"), with_end, TIME)[0][:, 0]
    np.testing.assert_array_equal(again[5:], again[: TIME - 5])


# Optimal transport


def optimal_cost(x, atoms):
    """The least cost of moving T steps of mass 1/T onto N rows of mass 1/N: an assignment of N T equal crumbs."""
    distance = np.linalg.norm(x[:, None] - atoms[None], axis=-1)
    crumbs = np.repeat(np.repeat(distance, len(atoms), axis=0), len(x), axis=1)
    return crumbs[linear_sum_assignment(crumbs)].sum() / crumbs.shape[0]


def greedy_costs(rewards, size):
    """Total coupling cost of each robot's whole episode, read off its rewards (T, E)."""
    return -np.log(rewards / ALPHA).sum(axis=0) * np.sqrt(size) / (BETA * TIME)


def test_an_episodes_cost_bounds_the_wasserstein_distance():
    steps = steps_of(np.random.default_rng(4), TIME, 20)
    rewards, masses = rewarded(("pwil", "episode"), steps, TIME)
    greedy = greedy_costs(rewards, OBS + ACTIONS)
    x, atoms = features_of(steps, DEMOS, "pwil"), features_of(DEMOS, DEMOS, "pwil")
    best = np.array([optimal_cost(x[:, e], atoms) for e in range(20)])
    assert np.all(greedy >= best * (1 - 1e-4)) and np.any(greedy > 1.02 * best)
    assert not masses.any()  # a whole episode takes everything


def test_a_greedy_coupling_that_is_not_optimal_by_hand():
    # Rows at 0 and 1. The step at 0.4 takes the row at 0, so that the step at 0 must go to 1: 1.4 in place of 0.6.
    mass, costs = jnp.array([[2, 2]], jnp.int32), []
    for x in (0.4, 0.0):
        mass, cost = jitted_couple(jnp.array([[x, 1 - x]]), mass, 2)
        costs.append(float(cost[0]) / 4)
    assert sum(costs) == pytest.approx(1.4 / 2)
    assert optimal_cost(np.array([[0.4], [0.0]]), np.array([[0.0], [1.0]])) == pytest.approx(0.6 / 2)


def test_repeating_the_demonstration_costs_nothing_and_has_the_largest_reward():
    rng = np.random.default_rng(6)
    expert = steps_of(rng, TIME, 1)
    model = built("pwil", episode_length=TIME)
    state = model.init(jax.random.key(0), demos_of(expert))
    for order in (np.arange(TIME), rng.permutation(TIME)):
        steps = jax.tree.map(lambda x, order=order: x[order], expert)
        mass, rewards = model.reward(state, model.begin(state, 1), CONTEXT, steps)
        x = features_of(steps, demos_of(expert), "pwil")[:, 0]
        assert optimal_cost(x, x) == 0 and not mass.any()
        np.testing.assert_allclose(rewards, ALPHA, rtol=5e-3)


def test_with_one_row_there_is_only_one_coupling():
    steps, one = steps_of(np.random.default_rng(7), TIME, 4), steps_of(np.random.default_rng(8), 1, 1)
    model = built("pwil", episode_length=TIME)
    state = model.init(jax.random.key(0), demos_of(one))
    _, rewards = model.reward(state, model.begin(state, 4), CONTEXT, steps)
    # One row has no spread, so observations and actions count as they are; only its mean is taken off.
    x = np.concatenate([steps.obs - one.obs, steps.action - one.action], axis=-1)
    best = [optimal_cost(x[:, e], np.zeros((1, OBS + ACTIONS))) for e in range(4)]
    np.testing.assert_allclose(greedy_costs(np.asarray(rewards), OBS + ACTIONS), best, rtol=1e-4)


def test_reward_is_the_exponential_of_the_cost():
    # A step at a distance d from the one row has c = d/T, whatever T.
    steps, one = steps_of(np.random.default_rng(7), 2, 4), steps_of(np.random.default_rng(8), 1, 1)
    d = np.linalg.norm(np.concatenate([steps.obs - one.obs, steps.action - one.action], axis=-1), axis=-1)
    for length in (2, 500):
        model = built("pwil", episode_length=length, pwil_alpha=3.0, pwil_beta=0.5)
        state = model.init(jax.random.key(0), demos_of(one))
        _, rewards = model.reward(state, model.begin(state, 4), CONTEXT, steps)
        np.testing.assert_allclose(rewards, 3 * np.exp(-0.5 * d / np.sqrt(OBS + ACTIONS)), rtol=1e-4)


def test_it_never_learns():
    model, state, _ = begun("pwil", "episode")
    steps = steps_of(np.random.default_rng(0))
    after, info = model.update(jax.random.key(0), state, CONTEXT, demos_of(steps), steps)
    assert not model.learns and info == {}
    for leaf, other_leaf in zip(jax.tree.leaves(state), jax.tree.leaves(after), strict=True):
        np.testing.assert_array_equal(leaf, other_leaf)
