"""Demonstrations: which elites and episodes are chosen, and which files are refused."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from probes import counter

from qdil.imitation import demos, selection

WALKER = counter(4.0)._replace(name="walker2d", backend="spring")


# Choosing


@given(st.integers(0, 2**32 - 1), st.integers(1, 15), st.integers(1, 15))
def test_farthest_points_agree_with_brute_force(seed, size, count):
    measures = np.random.default_rng(seed).random((size, 2))
    if count > size:
        with pytest.raises(ValueError, match=f"there are only {size} elites"):
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


def test_fresh_values_replace_those_that_won_the_cells():
    archive = {
        "true_return": np.array([9.0, 8.0]),
        "measures": np.array([[0.1, 0.1], [0.9, 0.9]]),
        "rescored_return": np.array([3.0, 7.0]),
        "rescored_measures": np.array([[0.2, 0.3], [0.8, 0.7]]),
        "index": np.array([0, 24]),
    }
    before = {name: values.copy() for name, values in archive.items()}
    fresh = selection.fresh(archive)
    assert fresh["true_return"].tolist() == [3, 7] and fresh["measures"].tolist() == [[0.2, 0.3], [0.8, 0.7]]
    assert fresh["index"].tolist() == [0, 24]
    for name, values in before.items():
        np.testing.assert_array_equal(archive[name], values)
    del archive["rescored_measures"]
    with pytest.raises(ValueError, match="no rescored_measures"):
        selection.fresh(archive)


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.sampled_from([0.0, 0.5, 1.0]))
def test_the_first_episode_stands_if_any_does_and_is_the_nearest_of_its_kind(seed, count, share):
    rng = np.random.default_rng(seed)
    measures, target, length = rng.random((count, 2)), rng.random(2), rng.integers(1, 9, count)
    fell = rng.random(count) < share
    order = selection.best_first(measures, fell, length, target).tolist()
    assert sorted(order) == list(range(count))
    distance = [np.hypot(*(m - target)) for m in measures]
    in_order = sorted(length)
    median = (in_order[(count - 1) // 2] + in_order[count // 2]) / 2
    kind = [0 if (length[i] >= median if all(fell) else not fell[i]) else 1 for i in range(count)]
    assert order == sorted(range(count), key=lambda i: (kind[i], distance[i]))


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


RECORDED = {"demo_attempts": np.array(16), "expert_seed": np.array(2), "episode": np.repeat([0, 1], [3, 4])}
AGREE = {"demo_episodes": 2, "demo_attempts": 16, "expert_seed": 2}


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("demo_episodes", "holds 2 demonstrations, not 7: add --set demo_episodes=2."),
        ("demo_attempts", "holds episodes chosen from 16 of each demonstrator, not 7: add --set demo_attempts=16."),
        ("expert_seed", "holds demonstrations of the expert of seed 2, not 7: add --set expert_seed=2."),
    ],
)
def test_a_file_that_was_recorded_with_other_settings_is_refused(tmp_path, rows, name, sentence):
    path = tmp_path / "demos.npz"
    demos.save(path, rows | RECORDED, WALKER)
    demos.load(path, "walker2d", "spring", expected=AGREE)
    found = refused_by(lambda: demos.load(path, "walker2d", "spring", expected=AGREE | {name: 7}))
    assert found == f"{path} {sentence}"


def test_settings_that_a_file_does_not_name_are_not_checked(tmp_path, rows):
    """As in files of earlier versions, and of other sources."""
    path = tmp_path / "demos.npz"
    demos.save(path, rows | {"episode": RECORDED["episode"]}, WALKER)
    demos.load(path, "walker2d", "spring", expected=AGREE | {"demo_attempts": 7, "expert_seed": 7})
    demos.save(path, rows, WALKER)
    demos.load(path, "walker2d", "spring", expected=dict.fromkeys(AGREE, 7))
    assert demos.expert_of(path) is None


def test_further_columns_leave_what_is_learned_from_as_it_is(tmp_path, rows):
    """Held-out episodes have as many rows as they have, whatever the number of demonstrated rows."""
    path = tmp_path / "demos.npz"
    held_out = {f"heldout_{name}": values[:2] + 1 for name, values in rows.items()}
    demos.save(path, rows | held_out, WALKER)
    loaded = demos.load(path, "walker2d", "spring")
    for name in demos.FIELDS:
        np.testing.assert_array_equal(getattr(loaded, name), rows[name])


KEPT = sorted(Path(__file__).parents[2].glob("results/*/*/demos-*-seed-*.npz"))


@pytest.mark.skipif(not KEPT, reason="no kept demonstrations here")
def test_kept_demonstrations_are_read():
    for path in KEPT:
        with np.load(path) as file:
            if "obs" not in file:  # in the showcase, which keeps only the demonstrators' places
                continue
            robot, backend, expected = str(file["robot"]), str(file["backend"]), file["obs"]
        np.testing.assert_array_equal(demos.load(path, robot, backend).obs, expected)


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


@pytest.mark.parametrize(("name", "bad"), list(itertools.product(demos.FIELDS, [np.nan, np.inf, 1e300])))
def test_numbers_that_are_not_finite_are_refused(tmp_path, rows, name, bad):
    rows[name] = rows[name].astype(np.float64)
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


def refused_by(call, *args) -> str:
    """The one sentence with which ``call`` refuses its arguments."""
    with pytest.raises(ValueError) as error:
        call(*args)
    sentence = str(error.value)
    assert "\n" not in sentence and sentence.endswith(".")
    return sentence


@pytest.mark.parametrize("alignment", ["aligned", "shifted"])
@pytest.mark.parametrize("how", ["left out", "of width 0"])
def test_actions_may_be_missing_where_nobody_needs_them(tmp_path, rows, how, alignment):
    path = tmp_path / "demos.npz"
    rows = rows | {"action": np.zeros((7, 0), np.float32), "episode": np.zeros(7, int)}
    demos.save(path, {name: values for name, values in rows.items() if how != "left out" or name != "action"}, WALKER)
    loaded = demos.load(path, "walker2d", "spring", False, alignment)
    assert loaded.action.shape == (len(loaded.obs), 0)
    if alignment == "aligned":
        np.testing.assert_array_equal(loaded.obs, rows["obs"])
    sentence = refused_by(demos.load, path, "walker2d", "spring", True, alignment)
    assert str(path) in sentence and "no actions" in sentence and "-obs" in sentence


def test_only_actions_may_be_missing(tmp_path, rows):
    path = tmp_path / "demos.npz"
    for name in ("obs", "next_obs", "proxy"):
        demos.save(path, {other: values for other, values in rows.items() if other not in (name, "action")}, WALKER)
        assert f"no {name}" in refused_by(demos.load, path, "walker2d", "spring", False).replace("action, ", "")
    only_a_number = {name: values for name, values in rows.items() if name != "action"} | {"obs": np.float32(1)}
    demos.save(path, only_a_number, WALKER)
    refused_by(demos.load, path, "walker2d", "spring", False)


# The released program's pairs


class Drawn:
    """In place of a random generator: the numbers that a test chose."""

    def __init__(self, *numbers: int):
        self.numbers = list(numbers)

    def integers(self, below: int) -> int:
        assert below == 20
        return self.numbers.pop(0)


def episodes_of(*lengths):
    """Episodes whose numbers tell where they belong: s_t = 100 e + t, a_t = s_t + ½, δ(s_t) = −s_t."""
    parts = []
    for e, length in enumerate(lengths):
        s = (100 * e + np.arange(length + 1, dtype=np.float32))[:, None]
        proxy = np.repeat(-s[:-1], 2, axis=1)
        parts.append({"obs": s[:-1], "action": s[:-1] + 0.5, "next_obs": s[1:], "proxy": proxy})
        parts[-1]["episode"] = np.full(length, e)
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def test_shifted_pairs_by_hand():
    # Four steps, one step late; and two steps, as late as two steps can be.
    data = demos.shifted(episodes_of(4, 2), Drawn(1, 19))
    assert data["obs"][:, 0].tolist() == [2, 3, 4, 102]
    assert data["action"][:, 0].tolist() == [0.5, 1.5, 2.5, 100.5]
    assert data["next_obs"][:, 0].tolist() == [3, 4, 4, 102]  # nothing is known after the last state
    assert data["proxy"].tolist() == [[-2, -2], [-3, -3], [-3, -3], [-101, -101]]  # nor is its own proxy
    in_time = demos.shifted(episodes_of(3), Drawn(0))
    assert in_time["obs"][:, 0].tolist() == [1, 2, 3] and in_time["action"][:, 0].tolist() == [0.5, 1.5, 2.5]


def test_shifted_pairs_are_a_lag_of_each_episodes_own():
    lengths, lags = [30] * 40 + [1, 5], []
    data = demos.shifted(episodes_of(*lengths), np.random.default_rng(0))
    for e, length in enumerate(lengths):
        rows = np.floor(data["action"][:, 0] / 100) == e
        lag = length - rows.sum()
        lags.append(lag)
        t = np.arange(length - lag)
        assert data["action"][rows, 0].tolist() == (100 * e + t + 0.5).tolist()
        assert data["obs"][rows, 0].tolist() == (100 * e + t + 1 + lag).tolist()
        assert data["next_obs"][rows, 0].tolist() == (100 * e + np.minimum(t + 2 + lag, length)).tolist()
        assert data["proxy"][rows, 1].tolist() == (-100 * e - np.minimum(t + 1 + lag, length - 1)).tolist()
    assert min(lags[:40]) == 0 and max(lags) <= 19 and len(set(lags[:40])) > 10 and lags[40] == 0


def test_a_file_is_shifted_by_its_seed(tmp_path):
    path, recorded = tmp_path / "demos.npz", episodes_of(30, 40, 25)
    demos.save(path, recorded, WALKER)
    first, again, other = (demos.load(path, "walker2d", "spring", True, "shifted", seed) for seed in (1, 1, 2))
    expected = demos.shifted(recorded, np.random.default_rng(1))
    for name in demos.FIELDS:
        np.testing.assert_array_equal(getattr(first, name), expected[name])
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.obs, other.obs)
    np.testing.assert_array_equal(demos.load(path, "walker2d", "spring").obs, recorded["obs"])


def test_a_file_cannot_be_shifted_without_its_episodes(tmp_path, rows):
    path = tmp_path / "demos.npz"
    demos.save(path, rows, WALKER)
    assert "no episode" in refused_by(demos.load, path, "walker2d", "spring", True, "shifted")
    demos.save(path, rows | {"episode": np.zeros(6, int)}, WALKER)
    refused_by(demos.load, path, "walker2d", "spring", True, "shifted")


# Fitting a robot


@pytest.mark.parametrize("actions", [2, 0])
def test_what_is_as_wide_as_the_robot_fits(actions):
    robot = WALKER._replace(obs_size=3, action_size=2)
    demos.check_fits(demos.Demonstrations(*(np.zeros((4, width)) for width in (3, actions, 3, 2))), robot)


@pytest.mark.parametrize("name", demos.FIELDS)
@pytest.mark.parametrize("more", [-1, 1])
def test_what_is_not_as_wide_as_the_robot_is_refused(name, more):
    widths = {"obs": 3, "action": 2, "next_obs": 3, "proxy": 2}
    robot = WALKER._replace(obs_size=3, action_size=2)
    columns = {n: np.zeros((4, width + more * (n == name))) for n, width in widths.items()}
    sentence = refused_by(demos.check_fits, demos.Demonstrations(**columns), robot)
    assert f"{name} of width {widths[name] + more}" in sentence and f"walker2d has {widths[name]}" in sentence


def test_an_elite_that_always_diverged_demonstrates_nothing():
    returns, measures = np.array([4.0, np.nan, 3.0, 2.0]), np.array([[0.1, 0.1], [0.9, 0.9], [0.2, 0.2], [0.5, np.nan]])
    assert demos.select(returns, measures, 100, 2).tolist() == [0, 2]
    with pytest.raises(ValueError, match="only 2 elites"):
        demos.select(returns, measures, 100, 3)
