"""DiffAIL against NumPy: noise levels, loss and reward; what both of its losses learn; what its reward depends on."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from probes import ACTIONS, CONTEXT, OBS, STATS, area_under_curve, built, demos_of, forward, in_numpy, steps_of

from qdil.config import make_config
from qdil.imitation.rewards.diffail import (
    LEAST,
    TIME_INPUTS,
    Levels,
    cross_entropy,
    draw_noise,
    errors,
    loss,
    noise_levels,
    rewards_of,
    spread_levels,
)
from qdil.rl.networks import init_mlp

ROWS, FEATURES, STEPS = 5, 3, 4


def config(**settings):
    return make_config("walker2d", "diffail", "smoke", diffail_steps=STEPS, **settings)


def levels_in_numpy(steps):
    """√ᾱ_t, √(1−ᾱ_t) and the inputs for t, step by step."""
    signals, noises, times, kept = [], [], [], 1.0
    for t in range(steps):
        kept *= 1 - (1e-4 + (0.02 - 1e-4) * (t / (steps - 1) if steps > 1 else 0))
        rates = [10000 ** (-i / 7) for i in range(8)]
        signals.append(kept**0.5)
        noises.append((1 - kept) ** 0.5)
        times.append([np.sin(t * rate) for rate in rates] + [np.cos(t * rate) for rate in rates])
    return signals, noises, times


def error_in_numpy(params, x, noise, t, steps=STEPS):
    """(ε − ε_ψ(x_t, t))² (F,) of one row."""
    signals, noises, times = levels_in_numpy(steps)
    noisy = signals[t] * x + noises[t] * noise
    return (noise - forward(params, np.concatenate([noisy, times[t]]))) ** 2


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    params = in_numpy(init_mlp(jax.random.key(0), (FEATURES + TIME_INPUTS, 6, FEATURES)))
    return params, *rng.normal(size=(2, ROWS, FEATURES))


# Noise


@pytest.mark.parametrize("steps", [1, 2, 10, 100])
def test_noise_levels_are_those_of_ho_et_al(steps):
    for given_, by_hand in zip(noise_levels(steps), levels_in_numpy(steps), strict=True):
        np.testing.assert_allclose(given_, by_hand, rtol=1e-5, atol=1e-5)


def test_the_last_of_ten_levels_keeps_most_of_the_row():
    # The product of (1 − β) is about 1 − Σβ = 1 − 10 · 0.01: a tenth of the variance is noise.
    levels = noise_levels(10)
    assert float(levels.noise[-1]) ** 2 == pytest.approx(0.1, rel=0.1)
    np.testing.assert_allclose(np.square(levels.signal) + np.square(levels.noise), 1, rtol=1e-6)


def test_noisy_rows_have_the_spread_that_the_level_says():
    # A network of zeros answers 0, so the error is ε² alone; with ε_ψ = x_t it is (ε − √ᾱ x − √(1−ᾱ) ε)².
    rng, level = np.random.default_rng(0), Levels(*(x[7] for x in noise_levels(10)))
    x, noise = rng.normal(size=(2, 1000, 2))
    silent = [{"w": np.zeros((2 + TIME_INPUTS, 2)), "b": np.zeros(2)}]
    np.testing.assert_allclose(errors(silent, x, noise, level), noise**2, rtol=1e-4)
    echo = [{"w": np.eye(2 + TIME_INPUTS, 2), "b": np.zeros(2)}]
    signal, spread = float(level.signal), float(level.noise)
    np.testing.assert_allclose(errors(echo, x, noise, level), (noise - signal * x - spread * noise) ** 2, atol=1e-4)


# The loss


def loss_in_numpy(params, expert, policy, t, noise, mix, settings):
    """E_D[−log D] + E_π[−log(1−D)] + penalty, by loops over rows and, for the penalty, by finite differences."""

    def d(row, which, i):
        return np.exp(-np.mean(error_in_numpy(params, row, noise[which][i], t[which][i])))

    total = penalty = 0.0
    for i, (x, y) in enumerate(zip(expert, policy, strict=True)):
        if settings.reward.diffail_loss == "probability":
            total -= np.log(d(x, 0, i)) + np.log(1 - d(y, 1, i))
        else:
            total -= np.log(1 / (1 + np.exp(-d(x, 0, i)))) + np.log(1 - 1 / (1 + np.exp(-d(y, 1, i))))
        between = mix[i] * x + (1 - mix[i]) * y
        moves = 1e-5 * np.eye(FEATURES)
        slope = np.array([(d(between + move, 2, i) - d(between - move, 2, i)) / 2e-5 for move in moves])
        penalty += (np.linalg.norm(slope) - 1) ** 2
    return (total + settings.reward.diffail_penalty * penalty) / len(expert), total / len(expert)


@pytest.mark.parametrize("how", ["probability", "logit"])
@pytest.mark.parametrize("penalty", [0.0, 3.0])
def test_loss_agrees_with_a_slow_loop(problem, how, penalty):
    params, expert, policy = problem
    settings = config(diffail_loss=how, diffail_penalty=penalty)
    level_key, noise_key, mix_key = jax.random.split(jax.random.key(7), 3)
    t = np.asarray(jax.random.randint(level_key, (3, ROWS), 0, STEPS))
    noise = np.asarray(jax.random.normal(noise_key, (3, ROWS, FEATURES)), float)
    mix = np.asarray(jax.random.uniform(mix_key, (ROWS, 1)), float)
    total, plain = loss_in_numpy(params, expert, policy, t, noise, mix, settings)
    given_, info = loss(params, expert, policy, jax.random.key(7), settings)
    assert given_ == pytest.approx(total, rel=1e-4)
    assert info["discriminator_loss"] == pytest.approx(plain, rel=1e-4)


@pytest.mark.parametrize("how", ["probability", "logit"])
def test_gradient_agrees_with_finite_differences(problem, how):
    params, expert, policy = problem
    settings, key = config(diffail_loss=how), jax.random.key(3)
    with jax.enable_x64(True):
        params = jax.tree.map(jnp.asarray, params)
        expert, policy = jnp.asarray(expert), jnp.asarray(policy)
        slopes = jax.grad(loss, has_aux=True)(params, expert, policy, key, settings)[0]
        for layer, of_layer in zip(params, slopes, strict=True):
            for at in [(0, 0), (2, 1)]:
                values = []
                for move in (1e-6, -1e-6):
                    moved = [{**one, "w": one["w"].at[at].add(move)} if one is layer else one for one in params]
                    values.append(float(loss(moved, expert, policy, key, settings)[0]))
                assert of_layer["w"][at] == pytest.approx((values[0] - values[1]) / 2e-6, rel=1e-3, abs=1e-6)


def test_cross_entropy_and_accuracies_by_hand():
    # D = ½ at an error of log 2, so the first expert row and the last two policy rows are recognised.
    expert, policy = np.log([4 / 3, 4.0]), np.log([4 / 3, 2.0, 4.0])
    total, info = cross_entropy(expert, policy, "probability")
    assert total == pytest.approx(-np.log([3 / 4, 1 / 4]).mean() - np.log([1 / 4, 1 / 2, 3 / 4]).mean(), rel=1e-5)
    assert info["diffusion_loss"] == pytest.approx(expert.mean())
    assert (info["expert_accuracy"], info["policy_accuracy"]) == pytest.approx((1 / 2, 2 / 3))
    total, _ = cross_entropy(expert, policy, "logit")
    sigmoid = [1 / (1 + np.exp(-d)) for d in (3 / 4, 1 / 4)], [1 / (1 + np.exp(-d)) for d in (1 / 4, 1 / 2, 3 / 4)]
    assert total == pytest.approx(-np.log(sigmoid[0]).mean() - np.log(1 - np.array(sigmoid[1])).mean(), rel=1e-5)


@given(st.lists(st.floats(0, 50), min_size=1, max_size=6), st.sampled_from(["probability", "logit"]))
def test_cross_entropy_is_finite_for_any_error(values, how):
    total, _ = cross_entropy(jnp.float32(values), jnp.float32(values), how)
    slopes = jax.grad(lambda e: cross_entropy(e, e, how)[0])(jnp.float32(values))
    assert np.isfinite(total) and np.isfinite(slopes).all()


# The reward


@pytest.mark.parametrize("how", ["row", "element"])
@pytest.mark.parametrize("method", ["diffail", "mcond-diffail", "diffail-obs"])
@pytest.mark.parametrize("levels", [range(STEPS), [1, 3]])
def test_reward_agrees_with_a_slow_loop(method, how, levels):
    model = built(method, diffail_steps=STEPS, diffail_reward=how, diffail_levels=len(levels))
    steps = steps_of(np.random.default_rng(1), time=3, envs=2)
    state = model.init(jax.random.key(0), demos_of(steps))
    params, noise = in_numpy(state.inner.learner.params), np.asarray(state.inner.noise, float)
    _, reward = model.reward(state, (), CONTEXT, steps)
    for at in np.ndindex(*reward.shape):
        x = (steps.obs[at] - STATS.mean) / STATS.std
        x = x if method.endswith("-obs") else np.concatenate([x, steps.action[at]])
        x = np.concatenate([x, steps.proxy[at]]) if method.startswith("mcond-") else x
        error = [error_in_numpy(params, x, one, t) for one, t in zip(noise, levels, strict=True)]
        d = np.mean(np.exp(-np.mean(error, axis=1)) if how == "row" else np.exp(-np.array(error)))
        assert reward[at] == pytest.approx(-np.log(1 - d), rel=2e-3)


@pytest.mark.parametrize(
    ("steps", "count", "used"), [(4, 4, [0, 1, 2, 3]), (3, 9, [0, 1, 2]), (100, 10, range(5, 100, 10)), (7, 1, [3])]
)
def test_levels_of_the_reward_are_spread_evenly(steps, count, used):
    for some, whole in zip(spread_levels(steps, count), noise_levels(steps), strict=True):
        np.testing.assert_array_equal(some, np.asarray(whole)[list(used)])


@given(st.integers(1, 9), st.integers(1, 4), st.integers(0, 9))
def test_noise_of_the_reward_comes_in_opposite_pairs(levels, features, seed):
    noise = np.asarray(draw_noise(jax.random.key(seed), (levels, features)))
    assert noise.shape == (levels, features) and len(np.unique(np.abs(noise))) == -(-levels // 2) * features
    np.testing.assert_array_equal(noise[1::2], -noise[: levels - levels % 2 : 2])


def test_noise_of_the_reward_is_standard_normal():
    noise = np.asarray(draw_noise(jax.random.key(0), (2, 20000)))
    assert noise.std() == pytest.approx(1, rel=0.02) and np.mean(noise[0] ** 4) == pytest.approx(3, rel=0.1)


def test_reward_of_a_perfect_model_is_the_largest():
    # Rows of zeros and a network that divides x_t by the level's noise find every ε.
    levels, noise = noise_levels(1), jnp.ones((1, 2))
    perfect = [{"w": np.eye(2 + TIME_INPUTS, 2) / float(levels.noise[0]), "b": np.zeros(2)}]
    reward = rewards_of(perfect, noise, levels, jnp.zeros((3, 2)), "row")
    np.testing.assert_allclose(reward, -np.log(LEAST), rtol=1e-5)


def test_reward_of_a_step_depends_on_that_step_alone_until_the_model_learns():
    model = built("mcond-diffail")
    steps = steps_of(np.random.default_rng(2), time=6, envs=8)
    demos = demos_of(steps)
    state = model.init(jax.random.key(0), demos)
    _, whole = model.reward(state, (), CONTEXT, steps)
    _, part = model.reward(state, (), CONTEXT, jax.tree.map(lambda x: x[2:4, ::-1], steps))
    np.testing.assert_allclose(part, whole[2:4, ::-1], rtol=1e-5)
    after, _ = model.update(jax.random.key(1), state, CONTEXT, demos, steps)
    assert not np.array_equal(after.inner.noise, state.inner.noise)
    assert after.inner.noise.shape == (10, OBS + ACTIONS + 2)


# Learning


@pytest.mark.compiles
@pytest.mark.parametrize("how", ["probability", "logit"])
@pytest.mark.parametrize("reward", ["row", "element"])
def test_rewards_of_demonstration_like_steps_are_higher_after_learning(how, reward):
    rng = np.random.default_rng(0)
    model = built(
        "diffail", reward_hidden=(32,), reward_learning_rate=3e-3, reward_steps=300, reward_batch=64,
        diffail_loss=how, diffail_reward=reward,
    )  # fmt: skip
    there, here, like_there, like_here = (steps_of(rng, shift=s) for s in (1.5, -0.5, 1.5, -0.5))
    update = jax.jit(model.update)
    for expert, policy, like_expert, like_policy in (
        (there, here, like_there, like_here),
        (here, there, like_here, like_there),  # so that no model wins that has not learned
    ):
        begun = model.init(jax.random.key(1), demos_of(expert))
        state, _ = update(jax.random.key(0), begun, CONTEXT, demos_of(expert), policy)
        high, low = (model.reward(state, (), CONTEXT, steps)[1] for steps in (like_expert, like_policy))
        assert area_under_curve(high, low) > 0.9
