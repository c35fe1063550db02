"""Recording: rows belong to one step each, and of several episodes of an elite the best is kept."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dial import LENGTH, SKILL, dial
from probes import counter

from qdil.imitation import recording
from qdil.rl import networks

WALKER = counter(4.0)._replace(name="walker2d", backend="spring")


def constant(obs_size: int, actions: list[list[float]], std: float = 1e-6):
    """A template, and elites that act with ``actions`` (n, A) on average, whatever they observe."""
    like = networks.init_policy(jax.random.key(0), obs_size, len(actions[0]), (2,), std)
    blank = jax.tree.map(jnp.zeros_like, like)

    def always(action):
        last = {**blank["mean"][-1], "b": jnp.array(action)}
        return networks.flatten({"mean": [blank["mean"][0], last], "log_std": like["log_std"]})

    shape = (len(actions), obs_size)
    elites = {
        "solution": np.stack([always(action) for action in actions]),
        "obs_mean": np.zeros(shape, np.float32),
        "obs_std": np.ones(shape, np.float32),
    }
    return blank, elites


def recorded_counter(actions: list[float], attempts: int, target=(0.5, 0.5)):
    """Nine steps of robots that move by a constant ``actions`` (n,) each step and fall at 4."""
    blank, elites = constant(1, [[action] for action in actions])
    elites["measures"] = np.tile(np.array(target), (len(actions), 1))
    return recording.record(WALKER, blank, elites, jax.random.key(3), 9, False, attempts)


@pytest.fixture(scope="module")
def recorded():
    """Three episodes of the counter: one that runs and falls, one that creeps to the time limit, one that backs off."""
    return recorded_counter([1.7, 0.25, -0.5], 1)


def test_recorded_rows_belong_to_one_step_each(recorded):
    np.testing.assert_allclose(recorded["next_obs"], recorded["obs"] + recorded["action"], atol=1e-6)
    np.testing.assert_array_equal(recorded["proxy"], recorded["obs"] >= np.array([1.0, 2.0]))
    action_of = np.array([1.0, 0.25, -0.5])
    np.testing.assert_allclose(recorded["action"][:, 0], action_of[recorded["episode"]])


def test_recorded_episodes_are_whole_and_single(recorded):
    lengths = np.bincount(recorded["episode"])
    assert lengths.tolist() == [4, 9, 9]
    for i, last in enumerate(np.cumsum(lengths) - 1):
        rows = recorded["episode"] == i
        assert recorded["terminated"][last] == (i == 0)
        assert recorded["truncated"][last] == (i != 0)
        assert (recorded["terminated"] | recorded["truncated"])[rows].sum() == 1
        np.testing.assert_array_equal(recorded["obs"][rows][1:], recorded["next_obs"][rows][:-1])
        assert recorded["episode_return"][i] == pytest.approx(recorded["reward"][rows].sum(), rel=1e-5)
        np.testing.assert_allclose(recorded["episode_measures"][i], recorded["proxy"][rows].mean(axis=0))
    assert recorded["falls"].tolist() == [1, 0, 0]
    assert not any(name.startswith("heldout_") for name in recorded)  # there is no further episode


def test_an_episode_that_stands_is_recorded_if_there_is_one():
    """Moving 0.4 a step, a robot that starts above 0.4 falls within nine steps, whatever the target is."""
    for target in ((0.0, 0.0), (1.0, 1.0)):
        found = recorded_counter([0.4, 1.0], 16, target)
        starts = {name: found[f"{name}obs"][found[f"{name}episode"] == 0][0, 0] for name in ("", "heldout_")}
        assert max(starts.values()) <= 0.4 and starts[""] != starts["heldout_"]
        assert not found["terminated"][found["episode"] == 0].any()
        assert 4 <= found["falls"][0] <= 14 and found["falls"][1] == 16  # 60 % on average; moving 1 a step, all
        assert found["terminated"][found["episode"] == 1].sum() == 1


def test_of_the_episodes_that_stand_the_nearest_is_recorded_and_the_second_held_out():
    """Moving 0.2 a step, none falls. A start x ≤ 1 is past one after ⌈5(1 − x)⌉ of nine steps, past two five later."""
    found = recorded_counter([0.2], 64, (1.0, 1.0))  # as early past both as possible: starts above 0.8
    assert found["falls"].tolist() == [0]
    for name in ("", "heldout_"):
        assert found[f"{name}obs"][0, 0] > 0.8 and len(found[f"{name}obs"]) == 9
        assert set(found[f"{name}episode"]) == {0}
    assert found["obs"][0, 0] != found["heldout_obs"][0, 0]
    late = recorded_counter([0.2], 64, (0.0, 0.0))
    assert late["obs"][0, 0] < 0.2 and late["heldout_obs"][0, 0] < 0.2


@pytest.mark.parametrize("attempts", [1, 4])
def test_each_elite_is_recorded_under_its_own_number(attempts):
    """Dials that point elsewhere each have other measures: δ is 1 while the clock is before the pointer."""
    pointers = np.array([[0.22, 0.82], [0.62, 0.12], [0.42, 0.52]])
    blank, elites = constant(2, [[*(2 * p - 1), SKILL] for p in pointers])
    elites["measures"] = np.zeros((3, 2))
    found = recording.record(dial(), blank, elites, jax.random.key(0), LENGTH, False, attempts)
    np.testing.assert_allclose(found["episode_measures"], np.floor(10 * pointers) / 10, atol=1e-6)
    np.testing.assert_allclose(found["episode_return"], LENGTH)
    for name in ("", "heldout_")[: 1 + (attempts > 1)]:
        np.testing.assert_allclose(
            found[f"{name}action"][:, :2], (2 * pointers - 1)[found[f"{name}episode"]], rtol=1e-5
        )
        np.testing.assert_array_equal(np.bincount(found[f"{name}episode"]), [LENGTH] * 3)


def test_more_attempts_come_nearer():
    """Dials that tremble: the nearest of 32 episodes is nearer than a single one, on average over elites."""
    blank, elites = constant(2, [[0.0, 0.0, SKILL]] * 8, std=0.5)
    elites["measures"] = np.full((8, 2), 0.5)
    distance = {}
    for attempts in (1, 32):
        found = recording.record(dial(), blank, elites, jax.random.key(1), LENGTH, True, attempts)
        distance[attempts] = np.linalg.norm(found["episode_measures"] - 0.5, axis=1)
    assert distance[32].max() < distance[1].mean() and distance[32].mean() < 0.5 * distance[1].mean()
