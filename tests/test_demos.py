"""Demonstrations: who is chosen, what is recorded, and which files are refused."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from probes import counter

from qdil.imitation import demos
from qdil.search import networks

WALKER = counter(4.0)._replace(name="walker2d", backend="spring")


# Choosing


@given(st.integers(0, 2**32 - 1), st.integers(1, 15), st.integers(1, 15))
def test_farthest_points_agree_with_brute_force(seed, size, count):
    measures = np.random.default_rng(seed).random((size, 2))
    if count > size:
        with pytest.raises(ValueError, match=f"only {size} elites"):
            demos.farthest_points(measures, count)
        return
    chosen = demos.farthest_points(measures, count).tolist()
    assert chosen[0] == 0 and len(set(chosen)) == count
    for n in range(1, count):
        nearest = [min(np.hypot(*(measures[i] - measures[j])) for j in chosen[:n]) for i in range(size)]
        assert nearest[chosen[n]] == pytest.approx(max(nearest))


def test_farthest_points_by_hand():
    corners_and_middle = np.array([[0.1, 0.1], [0.5, 0.5], [0.9, 0.1], [0.1, 0.9], [1.0, 1.0]])
    assert demos.farthest_points(corners_and_middle, 4).tolist() == [0, 4, 2, 3]


def test_the_top_fifth_of_the_papers_grid_is_500():
    fitness = np.random.default_rng(0).permutation(1700).astype(float)
    top = demos.top_fifth(fitness, 2500)
    assert fitness[top].tolist() == [1699 - i for i in range(500)]


def test_selection_starts_from_the_best_and_stays_in_the_top_fifth():
    rng = np.random.default_rng(0)
    fitness, measures = rng.random(60), rng.random((60, 2))
    chosen = demos.select(fitness, measures, 50, 4)
    best = sorted(range(60), key=lambda i: -fitness[i])[:10]
    assert chosen[0] == best[0] and set(chosen) <= set(best) and len(set(chosen)) == 4
    distance = [np.hypot(*(measures[i] - measures[best[0]])) for i in best]
    assert chosen[1] == best[int(np.argmax(distance))]


# Recording


@pytest.fixture(scope="module")
def recorded():
    """Three episodes of the counter: one that runs and falls, one that creeps to the time limit, one that backs off."""
    like = networks.init_policy(jax.random.key(0), 1, 1, (2,), 1e-6)
    blank = jax.tree.map(jnp.zeros_like, like)

    def always(action):
        last = {**blank["mean"][-1], "b": jnp.array([action])}
        return networks.flatten({"mean": [blank["mean"][0], last], "log_std": like["log_std"]})

    elites = {
        "solution": np.stack([always(a) for a in (1.7, 0.25, -0.5)]),
        "obs_mean": np.zeros((3, 1), np.float32),
        "obs_std": np.ones((3, 1), np.float32),
    }
    return demos.record(WALKER, blank, elites, jax.random.key(3), 9, False)


def test_recorded_rows_belong_to_one_step_each(recorded):
    np.testing.assert_allclose(recorded["next_obs"], recorded["obs"] + recorded["action"], atol=1e-6)
    np.testing.assert_array_equal(recorded["proxy"], recorded["obs"] >= np.array([1.0, 2.0]))
    action_of = np.array([1.0, 0.25, -0.5])
    np.testing.assert_allclose(recorded["action"][:, 0], action_of[recorded["episode"]])


def test_recorded_episodes_are_whole_and_single(recorded):
    lengths = np.bincount(recorded["episode"])
    assert lengths.tolist() == [4, 9, 9]
    for i, last in enumerate(np.cumsum(lengths) - 1):
        mine = recorded["episode"] == i
        assert recorded["terminated"][last] == (i == 0)
        assert recorded["truncated"][last] == (i != 0)
        assert (recorded["terminated"] | recorded["truncated"])[mine].sum() == 1
        np.testing.assert_array_equal(recorded["obs"][mine][1:], recorded["next_obs"][mine][:-1])
        assert recorded["episode_return"][i] == pytest.approx(recorded["reward"][mine].sum(), rel=1e-5)
        np.testing.assert_allclose(recorded["episode_measures"][i], recorded["proxy"][mine].mean(axis=0))


# Keeping


@pytest.fixture
def rows():
    rng = np.random.default_rng(0)
    widths = {"obs": 3, "action": 2, "next_obs": 3, "proxy": 2}
    return {name: rng.normal(size=(7, width)).astype(np.float32) for name, width in widths.items()}


def refused(path, robot="walker2d", backend="spring") -> str:
    """The one sentence with which ``load`` refuses a file, without advice to trust it."""
    with pytest.raises(ValueError) as error:
        demos.load(path, robot, backend)
    sentence = str(error.value)
    assert "\n" not in sentence and sentence.endswith(".") and str(path) in sentence
    assert "pickle" not in sentence
    return sentence


def test_what_is_saved_is_loaded(tmp_path, rows):
    demos.save(tmp_path / "demos.npz", rows | {"episode_return": np.ones(1)}, WALKER)
    loaded = demos.load(tmp_path / "demos.npz", "walker2d", "spring")
    for name in demos.FIELDS:
        np.testing.assert_array_equal(getattr(loaded, name), rows[name])


def test_a_missing_file_is_refused(tmp_path):
    assert "qdil demos --env walker2d" in refused(tmp_path / "none.npz")


def test_another_robots_or_backends_demonstrations_are_refused(tmp_path, rows):
    path = tmp_path / "demos.npz"
    demos.save(path, rows, WALKER)
    assert "not of humanoid on spring" in refused(path, "humanoid")
    assert "not of walker2d on mjx" in refused(path, "walker2d", "mjx")


def test_truncated_files_are_refused(tmp_path, rows):
    path = tmp_path / "demos.npz"
    demos.save(path, rows, WALKER)
    whole = path.read_bytes()
    for kept in (0, 1, 4, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:kept])
        refused(path)


def test_flipped_bytes_are_refused_or_harmless(tmp_path, rows):
    path = tmp_path / "demos.npz"
    demos.save(path, rows, WALKER)
    whole = path.read_bytes()
    refusals = 0
    for at in range(0, len(whole), 37):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :])
        try:
            loaded = demos.load(path, "walker2d", "spring")
        except ValueError:
            refusals += 1
        else:
            for name in demos.FIELDS:
                np.testing.assert_array_equal(getattr(loaded, name), rows[name])
    assert refusals > 20


@pytest.mark.parametrize("content", [b"not an archive", b"\x80\x04N.", b"PK\x03\x04 only looks like one"])
def test_other_files_are_refused(tmp_path, content):
    (tmp_path / "demos.npz").write_bytes(content)
    refused(tmp_path / "demos.npz")


def test_a_single_array_is_refused(tmp_path, rows):
    with open(tmp_path / "demos.npz", "wb") as file:
        np.save(file, rows["obs"])
    refused(tmp_path / "demos.npz")


@pytest.mark.parametrize(("name", "bad"), list(itertools.product(demos.FIELDS, [np.nan, np.inf])))
def test_numbers_that_are_not_finite_are_refused(tmp_path, rows, name, bad):
    rows[name][3, 1] = bad
    demos.save(tmp_path / "demos.npz", rows, WALKER)
    assert "not finite" in refused(tmp_path / "demos.npz")


@pytest.mark.parametrize("name", demos.FIELDS)
def test_columns_that_do_not_fit_are_refused(tmp_path, rows, name):
    path = tmp_path / "demos.npz"
    demos.save(path, rows | {name: rows[name][:-1]}, WALKER)
    assert "[6, 7]" in refused(path)
    demos.save(path, {other: values for other, values in rows.items() if other != name}, WALKER)
    assert f"no {name}" in refused(path)
    demos.save(path, rows | {name: np.float32(1)}, WALKER)
    refused(path)
    demos.save(path, rows | {name: np.full(rows[name].shape, "text")}, WALKER)
    refused(path)


def test_no_rows_are_refused(tmp_path, rows):
    demos.save(tmp_path / "demos.npz", {name: values[:0] for name, values in rows.items()}, WALKER)
    refused(tmp_path / "demos.npz")
