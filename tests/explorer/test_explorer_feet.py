"""The explorer of robots with one foot, with four, and with their own simulator."""

import io

import explorer_runs
import jax.numpy as jnp
import numpy as np
import pytest
import traitlets
from matplotlib.figure import Figure
from PIL import Image

import qdil
from qdil.errors import ConfigError
from qdil.explorer import drawing, film, picture, projection, shown
from qdil.explorer.pack import pack, unpack
from qdil.robots import register, shapes
from qdil.robots.environment import Environment, Outcome, RobotState
from qdil.runs.folder import read_archive

ROBOTS = {"hopper": 1, "ant": 4}
SIDE = 5


def some_cells(k, count=12, seed=0):
    return sorted(np.random.default_rng(seed).choice(SIDE**k, min(count, SIDE**k - 1), replace=False).tolist())


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    root = tmp_path_factory.mktemp("results")
    return {env: explorer_runs.write(root / env, some_cells(k), env=env, k=k) for env, k in ROBOTS.items()}


@pytest.mark.physics
@pytest.mark.parametrize("env", ROBOTS)
def test_every_foot_has_its_contacts_shapes_and_leg(runs, env):
    one = shown.read(runs[env])[0]
    assert one.feet == list(register.find(env).measure_names)
    rollout = shown.roll_out(one, [int(one.archive["index"][-1])])[0]
    assert rollout.contact.shape[1] == ROBOTS[env] and rollout.contact.any()
    np.testing.assert_array_equal(unpack(pack(rollout)).contact, rollout.contact)
    body = shapes.shapes(env)
    for foot in range(ROBOTS[env]):
        assert set(shown.legs(env)[body.link[body.foot == foot]]) == {foot}
    assert shown.legs(env)[0] == -1  # the torso
    content = shown.content([one])
    assert content["robot"]["feet"] == one.feet and content["runs"][0]["feet"] == one.feet


@pytest.mark.physics
@pytest.mark.parametrize("env", ROBOTS)
def test_films_and_pictures_show_every_foot(runs, env, tmp_path):
    cells = some_cells(ROBOTS[env])[:2]
    path = qdil.render(runs[env], cells, tmp_path / "gait.png", width=64)
    with Image.open(path) as strip:
        assert strip.height == 2 * (46 + 64 + 10 + 12 * ROBOTS[env])
    assert qdil.render(runs[env], cells, tmp_path / "gait.gif", speed=4, width=64).is_file()
    explored = qdil.explore(runs[env], live=False)
    with Image.open(io.BytesIO(picture.picture(explored.runs, explored.state))) as drawn:
        colours = set(map(tuple, np.asarray(drawn.convert("RGB")).reshape(-1, 3)))
    rollout = shown.roll_out(explored.runs[0], [explored.state["selected"][0][1]])[0]
    lit = {tuple(drawing.FEET[foot].astype(int)) for foot in np.flatnonzero(rollout.contact.any(axis=0))}
    assert lit and lit <= colours


def own_robot(name, k):
    """A point that stands still, with a state that no other module reads."""

    def state(t):
        return RobotState(t, jnp.zeros(3), jnp.ones(k))

    return Environment(
        name, "own", 3, 2, tuple(f"wheel {i}" for i in range(k)), 0.05, lambda key: state(jnp.zeros(())),
        lambda robot, action: (state(robot.physics + 1), Outcome(jnp.ones(()), robot.physics > 5, jnp.bool_(True))),
    )  # fmt: skip


@pytest.mark.parametrize("k", [1, 3, 6])
def test_a_robot_without_shapes_shows_its_map_and_says_why_it_is_not_drawn(tmp_path, monkeypatch, k):
    monkeypatch.setattr(register, "_ROBOTS", dict(register._ROBOTS))
    register.register_robot("cart", environment=own_robot("cart", k))
    run = explorer_runs.write(tmp_path / "run", some_cells(k), env="cart", k=k)
    explored = qdil.explore(run, live=False)
    one = explored.runs[0]
    assert one.why == "the robot cart has no shapes to draw"
    content = shown.content([one])
    assert content["robot"] is None and content["runs"][0]["feet"] == [f"wheel {i}" for i in range(k)]
    assert one.why in explored.save(tmp_path / "page.html").read_text()
    live = qdil.explore(run, live=True)
    sent = []
    monkeypatch.setattr(live.view, "send", lambda message, buffers=None: sent.append(message))
    live.view._answer(live.view, {"type": "want", "run": 0, "cell": some_cells(k)[0]}, [])
    assert sent[0]["type"] == "refused" and one.why in sent[0]["why"]
    with pytest.raises(ConfigError, match="has no shapes to draw"):
        qdil.render(run, 1, tmp_path / "gait.png")


def in_memory(k, count=12, seed=0):
    return explorer_runs.archive(some_cells(k, count, seed), seed, SIDE, k)


def test_archives_of_other_or_of_too_many_measures_are_refused():
    with pytest.raises(ConfigError, match="different numbers of measures .'a' has 1, 'b' has 2."):
        qdil.explore({"a": in_memory(1, 3), "b": in_memory(2)})
    wide = in_memory(2) | {"cells": np.array([2] * 7), "measures": np.zeros((12, 7))}
    with pytest.raises(ConfigError, match="draws 1 to 6 measures; 'archive' has 7"):
        qdil.explore(wide)


def test_an_archive_that_is_not_its_robots_is_refused(runs):
    archive = read_archive(runs["hopper"])
    with pytest.raises(ConfigError, match="measures of 'archive': 1; of ant: 4"):
        qdil.explore(archive, {"env": "ant"})


def test_the_widgets_axes_are_different_measures_of_the_archive():
    view = qdil.explore(in_memory(4), live=True).view
    assert view.axes == [0, 1]
    view.axes = (3, 1)
    assert view.axes == [3, 1]
    for wrong in ([0], [1, 1], [0, 4], [0, 1, 2]):
        with pytest.raises(traitlets.TraitError, match="axes is one of"):
            view.axes = wrong
    assert qdil.explore(in_memory(1, 3), live=True).view.axes == [0]


def test_recordings_are_of_cells_that_a_click_can_choose():
    archive = in_memory(4, count=300)
    archive["true_return"] = np.random.default_rng(1).random(300).astype(np.float32)
    one = shown.read(archive)[0]
    rows = {row for axes in projection.axes_choices(4) for row in projection.best_rows(archive, axes)}
    clickable = set(archive["index"][sorted(rows)].tolist())
    assert len(clickable) < 150
    chosen = shown.spread_out(one, 1000)
    assert len(chosen) == len(set(chosen)) and set(chosen) == clickable
    assert chosen[0] == archive["index"][np.argmax(archive["true_return"])]


@pytest.mark.parametrize(("k", "axes"), [(1, [0]), (2, [0, 1]), (3, [2, 0]), (6, [4, 5])])
def test_the_still_map_shows_the_projection(k, axes):
    archive = explorer_runs.archive(list(range(0, 2**k, 2)), side=2, k=k)
    figure = Figure()
    ax = picture._map(shown.read(archive)[0], axes, figure)
    seen = projection.project(archive, axes)
    expected = np.full(2 ** len(axes), np.nan)
    expected[seen["index"]] = seen["true_return"]
    drawn = np.ma.filled(ax.collections[0].get_array().astype(float), np.nan).reshape(-1)
    across_first = expected.reshape([2] * len(axes)).T.reshape(-1)  # a picture's rows are the second axis
    np.testing.assert_allclose(drawn, across_first)
    assert f"foot {axes[0] + 1}" in ax.get_xlabel()
    label = figure.axes[1].get_xlabel()
    others = {3: "over the other foot", 6: "over the other 4 feet"}
    assert label.endswith(others[k]) if k in others else "best elite" not in label


def test_a_films_text_names_every_share():
    assert film._shares_text([12]) == "foot on the ground 12 %"
    assert film._shares_text([12, 3]) == "feet on the ground 12 %, 3 %"
    assert film._shares_text([12, 3, 100, 0]) == "on the ground 12, 3, 100, 0 %"
