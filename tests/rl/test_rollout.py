"""Training rollouts, replayed step by step in plain Python."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from probes import counter
from scipy import stats

from qdil.rl.rollout import action_noise, rollout, start

BOUND, LIMIT, LENGTH, ENVS = 3.0, 6, 12, 8


def push_randomly(noise, obs):
    """Actions around 0.5, some of them beyond what the robot takes; their "log probability" is the observation."""
    return 0.5 + 0.6 * noise, obs[:, 0]


@pytest.fixture(scope="module")
def two_rollouts():
    """Two consecutive rollouts of the counter, joined along time, as NumPy arrays; and each rollout's first action."""
    env = counter(BOUND)
    drive = jax.jit(lambda envs: rollout(env, push_randomly, envs, LENGTH, LIMIT))
    envs = start(env, jax.random.split(jax.random.key(0), ENVS), LIMIT)
    envs, *first = drive(envs)
    envs, *second = drive(envs)
    join = jax.tree.map(lambda a, b: np.concatenate([a, b]), first, second)
    return join[0], join[1]


def test_steps_follow_the_robots_own_rules_across_rollouts(two_rollouts):
    steps, sample = two_rollouts
    falls = limits = 0
    for e in range(ENVS):
        position, age, proxies = steps.obs[0, e, 0], 0, []
        for t in range(2 * LENGTH):
            assert steps.obs[t, e, 0] == position
            action = np.clip(sample.raw_action[t, e, 0], -1, 1)
            after, age = np.float32(position + action), age + 1
            proxies.append([position >= 1, position >= 2])
            fell = after >= BOUND
            timed_out = age == LIMIT and not fell
            assert steps.action[t, e, 0] == action
            assert steps.next_obs[t, e, 0] == after
            assert steps.reward[t, e] == pytest.approx(after + action / 4, abs=1e-6)
            assert steps.proxy[t, e].tolist() == proxies[-1]
            np.testing.assert_allclose(steps.measures_so_far[t, e], np.mean(proxies, axis=0), rtol=1e-6)
            assert (steps.terminated[t, e], steps.truncated[t, e]) == (fell, timed_out)
            falls, limits = falls + fell, limits + timed_out
            position = after
            if fell or timed_out:
                age, proxies = 0, []
                if t + 1 < 2 * LENGTH:
                    position = steps.obs[t + 1, e, 0]
                    assert 0 <= position < 1
    assert falls > ENVS and limits > 1


def test_each_sample_is_remembered_as_it_was_drawn(two_rollouts):
    steps, sample = two_rollouts
    assert np.abs(sample.raw_action).max() > 1
    np.testing.assert_array_equal(sample.log_prob, steps.obs[..., 0])


def test_each_robot_and_rollout_has_a_start_of_its_own(two_rollouts):
    steps, _ = two_rollouts
    starts = steps.obs[1:, :, 0]  # where episodes begin, by the rollout in which the one before ended
    rollouts = list(zip(halves(steps.ended[:-1]), halves(starts), strict=True))
    assert all(ended.sum() > 1.5 * ENVS for ended, _ in rollouts)
    distinct = [set(at[ended[:, e], e].tolist()) for ended, at in rollouts for e in range(ENVS)]
    assert all(len(own) <= 1 for own in distinct)
    assert len(set.union(*distinct)) == sum(map(len, distinct))


def halves(x):
    """The steps of two rollouts without the last: those of the first rollout, and those of the second."""
    return x[:LENGTH], x[LENGTH:]


def test_noise_is_standard_normal_and_every_steps_own():
    noise = np.asarray(action_noise(jax.random.split(jax.random.key(0), 200), 30, 4))
    assert noise.shape == (30, 200, 4)
    assert stats.kstest(noise.ravel(), "norm").pvalue > 1e-3
    assert len(np.unique(noise)) > 0.99 * noise.size


def test_a_robots_future_does_not_depend_on_its_neighbours():
    env = counter(BOUND)
    keys = jax.random.split(jax.random.key(1), 4)
    order = jnp.array([2, 0, 3, 1])
    run = jax.jit(lambda k: rollout(env, push_randomly, start(env, k, LIMIT), LENGTH, LIMIT))
    plain, permuted = run(keys)[1], run(keys[order])[1]
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[:, order], b), plain, permuted)


def test_out_of_step_only_the_first_episode_is_cut_short():
    def stay(noise, obs):
        return jnp.zeros((len(obs), 1)), obs[:, 0]

    env, count = counter(BOUND), 64
    envs = start(env, jax.random.split(jax.random.key(3), count), LIMIT, in_step=False)
    _, steps, _ = jax.jit(lambda a: rollout(env, stay, a, 3 * LIMIT, LIMIT))(envs)
    ends = [np.flatnonzero(steps.truncated[:, e]) for e in range(count)]
    assert {int(e[0]) + 1 for e in ends} == set(range(1, LIMIT + 1))
    assert all((np.diff(e) == LIMIT).all() for e in ends)
    assert not np.asarray(steps.terminated).any()
