"""Steps of known kinds, and the rewards that models give to them."""

import jax
import numpy as np
import pytest
from probes import ACTIONS, OBS, ROBOT, demos_of, expert_steps, forward, in_numpy, random_steps

from qdil.config import make_config
from qdil.errors import ConfigError
from qdil.imitation import demos as demonstrations
from qdil.imitation.reward_model import Demonstrations
from qdil.lab import steps
from qdil.types import Transitions


def recorded(lengths, rng=None):
    """What ``demos.record`` writes, for episodes of these lengths, all numbers different."""
    rng, rows = rng or np.random.default_rng(0), sum(lengths)
    draw = {name: rng.normal(size=(rows, width)) for name, width in (("obs", OBS), ("action", ACTIONS))}
    proxy = (rng.random((rows, 2)) < 0.5).astype(np.float32)
    ends = np.isin(np.arange(rows), np.cumsum(lengths) - 1)
    more = {"reward": rng.normal(size=rows), "terminated": ends, "truncated": np.zeros(rows, bool)}
    episode = np.repeat(np.arange(len(lengths)), lengths)
    return {**draw, "next_obs": draw["obs"] + 1, "proxy": proxy, **more, "episode": episode}


@pytest.fixture
def file(tmp_path):
    def write(lengths):
        data = recorded(lengths)
        demonstrations.save(tmp_path / "demos.npz", data, ROBOT)
        return tmp_path / "demos.npz", data

    return write


@pytest.mark.parametrize("out", [0, 1, -1])
def test_the_episode_held_back_is_not_learned_from(file, out):
    path, data = file([3, 5, 4])
    split, number = steps.split(path, out), out % 3
    back, seen = data["episode"] == number, data["episode"] == (1 if number == 0 else 0)
    for name in Demonstrations._fields:
        np.testing.assert_allclose(getattr(split.learned, name), data[name][~back], rtol=1e-6)
        np.testing.assert_allclose(getattr(split.held_out, name)[:, 0], data[name][back], rtol=1e-6)
        np.testing.assert_allclose(getattr(split.seen, name)[:, 0], data[name][seen], rtol=1e-6)
    assert np.flatnonzero(split.held_out.ended[:, 0]).tolist() == [back.sum() - 1]
    for t in range(int(back.sum())):
        by_hand = data["proxy"][back][: t + 1].mean(axis=0)
        np.testing.assert_allclose(split.held_out.measures_so_far[t, 0], by_hand, rtol=1e-6)


def test_of_one_episode_the_second_half_is_held_back(file):
    path, data = file([7])
    split = steps.split(path)
    np.testing.assert_allclose(split.learned.obs, data["obs"][:3], rtol=1e-6)
    np.testing.assert_allclose(split.held_out.obs[:, 0], data["obs"][3:], rtol=1e-6)


def test_only_as_many_as_asked_for_are_learned_from(file):
    path, data = file([3, 5, 4])
    split = steps.split(path, 0, keep=1)
    np.testing.assert_allclose(split.learned.obs, data["obs"][data["episode"] == 1], rtol=1e-6)
    with pytest.raises(ConfigError, match="leaves 2 episodes"):
        steps.split(path, 0, keep=3)


def test_what_cannot_be_split_is_refused(file, tmp_path):
    path, _ = file([3, 3])
    with pytest.raises(ConfigError, match="no episode 2"):
        steps.split(path, 2)
    with pytest.raises(ConfigError, match="no demonstrations"):
        steps.split(tmp_path / "none.npz")


def test_other_actions_are_the_same_ones_elsewhere():
    some = expert_steps(np.random.default_rng(0), time=30, envs=1)
    other = steps.with_other_actions(some, 3)
    before, after = np.asarray(some.action[:, 0]), np.asarray(other.action[:, 0])
    assert not np.array_equal(before, after) and sorted(before.tolist()) == sorted(after.tolist())
    for name in set(Transitions._fields) - {"action"}:
        np.testing.assert_array_equal(getattr(some, name), getattr(other, name))


def test_actions_that_follow_a_linear_law_are_explained_by_what_the_law_reads():
    rng = np.random.default_rng(0)

    def rows(count):
        obs, proxy = rng.normal(5, 3, (count, OBS)), rng.normal(size=(count, 2))
        return Demonstrations(obs, obs[:, :2] - 2 * proxy + 1, rng.normal(size=(count, OBS)), proxy)

    held_out = steps.Split(rows(300), None, jax.tree.map(lambda x: x[:, None], rows(200)))
    everything = steps.actions_explained(held_out, ["obs", "proxy"])
    assert everything == pytest.approx({"learned from": 1.0, "held out": 1.0}, abs=1e-3)
    # Of a variance of 3² + 2² the observation makes up 3², and the proxy 2².
    assert steps.actions_explained(held_out, ["obs"])["held out"] == pytest.approx(9 / 13, abs=0.1)
    assert steps.actions_explained(held_out, ["proxy"])["held out"] == pytest.approx(4 / 13, abs=0.1)
    assert steps.actions_explained(held_out, ["next_obs"])["held out"] < 0.05


def test_chances_are_counted_by_hand():
    some, others = np.array([[1.0, 2.0], [2.0, 5.0]]), np.array([2.0, 3.0, 0.0])
    by_hand = np.mean([[a > b, a == b] for a in some.ravel() for b in others], axis=0) @ [1, 0.5]
    assert steps.chance_above(some, others) == pytest.approx(by_hand)


def test_rewards_are_compared_by_means_and_chances():
    rewards = {"gail": {"a": np.array([[1.0], [3.0]]), "none": np.array([[2.0], [0.0]])}}
    table = steps.compare_rewards(rewards, "none")
    assert table.loc["gail", ("mean reward", "a")] == 2 and table.loc["gail", ("mean reward", "none")] == 1
    assert table.loc["gail", ("higher than none", "a")] == 0.75
    assert ("higher than none", "none") not in table.columns


def test_a_model_learns_and_rewards_steps_of_every_kind(monkeypatch):
    monkeypatch.setattr(steps.register, "make", lambda env, backend: ROBOT)
    rng = np.random.default_rng(0)
    known, beginner = expert_steps(rng), random_steps(rng)
    shown = {"expert": expert_steps(rng), "random": random_steps(rng)}
    learning = {"reward_hidden": (32,), "reward_steps": 300, "reward_batch": 64, "reward_learning_rate": 3e-3}
    config = make_config("walker2d", "mcond-gail", "smoke", gradient_penalty=0.1, **learning)
    rewards = steps.rewards_for(config, demos_of(known), beginner, shown, 1)
    assert {kind: values.shape for kind, values in rewards.items()} == {kind: (8, 32) for kind in shown}
    assert steps.chance_above(rewards["expert"], rewards["random"]) > 0.9
    again = steps.rewards_for(config, demos_of(known), beginner, shown, 1)
    np.testing.assert_array_equal(rewards["expert"], again["expert"])


def test_rounds_teach_a_base_model_on_rows_as_they_are():
    rng = np.random.default_rng(0)
    expert, policy = (steps.rows_of(rng.normal(x, 0.3, (50, 2))) for x in (1.0, -1.0))
    config = make_config("walker2d", "gail", "smoke", reward_hidden=(8,), reward_steps=20, reward_batch=32)
    learned = steps.learn_in_rounds(config, expert, policy, 5, 0)
    assert learned.history.index.tolist() == [20, 40, 60, 80, 100]
    assert learned.history["discriminator_loss"].iloc[-1] < learned.history["discriminator_loss"].iloc[0]
    logits = forward(in_numpy(learned.state.params), np.asarray(expert.obs))[:, 0]
    np.testing.assert_allclose(learned.reward(expert), np.log1p(np.exp(logits)), rtol=1e-4)
    assert learned.reward(expert).min() > learned.reward(policy).mean()


def test_rows_carry_what_they_are_given():
    rows = steps.rows_of(np.ones((3, 2)), proxy=np.zeros((3, 1)))
    assert [part.shape for part in rows] == [(3, 2), (3, 0), (3, 0), (3, 1)]
    np.testing.assert_array_equal(rows.obs, np.ones((3, 2)))


@pytest.mark.physics
def test_the_untrained_are_robots_in_motion():
    one, two = steps.untrained("walker2d", 1, robots=2, steps=8), steps.untrained("walker2d", 2, robots=2, steps=8)
    assert one.obs.shape[:2] == (8, 2) and not np.array_equal(one.obs, two.obs)
    np.testing.assert_allclose(one.next_obs[:-1], one.obs[1:], rtol=1e-6)
    assert all(np.isfinite(np.asarray(leaf, float)).all() for leaf in jax.tree.leaves(one))
