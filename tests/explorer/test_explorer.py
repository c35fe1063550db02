"""The explorer's rollouts, packing, drawing and pages, without a browser."""

import base64
import json
import re
from functools import partial

import explorer_runs
import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import qdil
from qdil.config import Evaluation, make_config, to_json
from qdil.errors import ConfigError
from qdil.explorer import compare, drawing, film, page, rollouts, showcase, shown
from qdil.explorer.pack import pack, unpack
from qdil.explorer.rollouts import Rollout
from qdil.rl import evaluate, networks
from qdil.rl.evaluate import Policies
from qdil.robots import brax_robots, register, shapes
from qdil.runs.folder import read_archive, read_config

CELLS = [0, 6, 7, 12, 18, 23]
pytestmark = pytest.mark.physics


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return explorer_runs.write(tmp_path_factory.mktemp("results") / "walker2d" / "true" / "seed-1", CELLS)


def random_rollout(seed, steps, links, seconds):
    draw = np.random.default_rng(seed)
    turns = draw.normal(size=(steps, links, 4))
    return Rollout(
        np.cumsum(draw.normal(0, 0.05, (steps, links, 3)), axis=0),
        turns / np.linalg.norm(turns, axis=-1, keepdims=True),
        draw.random((steps, 2)) < 0.5,
        draw.normal(size=steps).astype(np.float32),
        seconds,
        bool(seed % 2),
    )


@given(st.integers(0, 1000), st.integers(1, 40), st.integers(1, 11), st.sampled_from([0.008, 0.015, 0.05]))
def test_packing_keeps_everything_up_to_rounding(seed, steps, links, seconds):
    rollout = random_rollout(seed, steps, links, seconds)
    back = unpack(pack(rollout))
    kept = slice(None, None, back.stride)
    np.testing.assert_allclose(back.position, rollout.position[kept], atol=0.00051)
    cosine = np.abs((back.rotation * rollout.rotation[kept]).sum(-1)) / np.linalg.norm(back.rotation, axis=-1)
    assert cosine.min() > 1 - 1e-6  # a quaternion and its negative turn alike
    assert (np.sum(back.rotation[1:] * back.rotation[:-1], axis=-1) > -1e-3).all()  # and signs do not jump
    np.testing.assert_array_equal(back.contact, rollout.contact)
    np.testing.assert_allclose(back.reward, rollout.reward, atol=np.ptp(rollout.reward) / 1999 + 1e-6)
    assert (back.seconds, back.fell) == (seconds, rollout.fell)


def test_a_robot_that_leaps_too_far_is_refused():
    rollout = random_rollout(0, 4, 2, 0.05)
    with pytest.raises(ValueError, match="moves too far"):
        pack(rollout._replace(position=rollout.position * 1e6))


def test_rollouts_agree_with_the_evaluation_that_fills_archives(folder):
    """The same policies, start and steps as ``rl.evaluate`` takes give the same return, length and measures."""
    config, archive = read_config(folder), read_archive(folder, policies=True)
    policies = Policies(*(archive[name] for name in ("solution", "obs_mean", "obs_std")))
    played = rollouts.play(config, policies)
    env = register.make("walker2d")
    template = networks.template_of(env.obs_size, env.action_size, (8, 8))
    settings = Evaluation(episodes=1, sample_actions=False, eval_chunk_steps=60, eval_batch_size=len(CELLS))
    envs, tally = evaluate.begin(env, jax.random.split(jax.random.key(0), (len(CELLS), 1)), config["episode_length"])
    begin = jax.vmap(env.reset)(jax.numpy.broadcast_to(jax.random.key(0), (len(CELLS),)))
    _, tally, *_ = jax.jit(partial(evaluate.advance, env, template, settings))(
        policies, envs._replace(robot=begin), tally
    )
    np.testing.assert_array_equal([len(one.reward) for one in played], tally.length)
    np.testing.assert_allclose([one.reward.sum() for one in played], tally.true_return, rtol=2e-3)
    np.testing.assert_allclose([one.contact.sum(0) for one in played], tally.proxy_sum, atol=1)
    assert [one.fell for one in played] == [len(one.reward) < config["episode_length"] for one in played]


def test_a_second_click_compiles_nothing_and_an_episode_does_not_depend_on_its_neighbours(folder):
    one = shown.read(folder)[0]
    together = shown.roll_out(one, CELLS)
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, duration, **_: compiled.append(event) if "backend_compile" in event else None
    )
    alone = shown.roll_out(one, [CELLS[4]])[0]
    assert compiled == []
    np.testing.assert_allclose(alone.position, together[4].position, atol=1e-5)


def test_policies_of_another_size_are_refused(folder):
    config = read_config(folder)
    with pytest.raises(ValueError, match="these policies have 7 parameters"):
        rollouts.play(config, Policies(np.zeros((1, 7)), np.zeros((1, 17)), np.ones((1, 17))))


def test_runs_that_do_not_go_together_or_are_not_there_are_refused(folder, tmp_path):
    archive = read_archive(folder)
    with pytest.raises(ConfigError, match="no finished run"):
        qdil.explore(tmp_path)
    with pytest.raises(ConfigError, match="no run to explore"):
        qdil.explore({})
    with pytest.raises(ConfigError, match="cannot be explored"):
        qdil.explore(7)
    with pytest.raises(ConfigError, match="has no measures"):
        qdil.explore({name: values for name, values in archive.items() if name != "measures"})
    other = explorer_runs.write(tmp_path / "other", [3])
    settings = json.loads((other / "config.json").read_text()) | {"env": "halfcheetah"}
    (other / "config.json").write_text(json.dumps(settings))
    with pytest.raises(ConfigError, match="different robots"):
        qdil.explore([folder, other])


def test_an_archive_in_memory_plays_with_its_settings_and_shows_without(folder):
    archive = read_archive(folder, policies=True)
    assert not shown.read(archive)[0].plays
    config = to_json(make_config("walker2d", "true", "smoke", 1)) | {"actor_hidden": [8, 8], "episode_length": 20}
    known = shown.read(archive, config)[0]
    assert len(shown.roll_out(known, [12])[0].reward) <= 20
    with pytest.raises(ConfigError, match="cell 1 of 'archive' is empty"):
        shown.roll_out(known, [1])


def test_marks_are_those_of_the_expert_and_the_demonstrations(tmp_path):
    expert = explorer_runs.write(tmp_path / "true" / "seed-1", CELLS)
    imitator = explorer_runs.write(tmp_path / "gail" / "seed-1", CELLS, "gail")
    config = read_config(expert)
    places = np.array([[0.3, 0.5], [0.7, 0.1]], np.float32)
    np.savez(tmp_path / f"demos-{config['demo_episodes']}-seed-1.npz", elite_measures=places)
    runs = shown.content(shown.read([expert, imitator]))["runs"]
    assert runs[0]["top"] == sorted(CELLS, reverse=True)[:5]  # a fifth of 25 cells, and returns grow with the number
    assert runs[1]["top"] == []
    np.testing.assert_allclose([one["demonstrators"] for one in runs], [places, places], atol=1e-4)


def test_fresh_scores_reach_the_page_as_plain_numbers(tmp_path):
    again = explorer_runs.write(tmp_path / "again", [0, 6, 12], landing=[7, 7, 12])
    [run] = shown.content(shown.read(again))["runs"]
    assert run["fresh"] == {"true_return": [300, 290, 280], "cell": [7, 7, 12]}
    archive = dict(np.load(again / "archive.npz"))
    archive["rescored_return"][1] = np.nan  # its physics diverged in every episode
    [run] = shown.content(shown.read(archive))["runs"]
    assert run["fresh"] == {"true_return": [300, None, 280], "cell": [7, -1, 12]}
    [run] = shown.content(shown.read(explorer_runs.archive([0, 6, 12])))["runs"]
    assert run["fresh"] is None


def test_spread_out_cells_begin_with_the_best_and_are_all_different(folder):
    one = shown.read(folder)[0]
    assert shown.spread_out(one, 3)[:2] == [23, 0]  # the best, then the farthest corner
    assert sorted(shown.spread_out(one, 100)) == CELLS


def test_legs_are_what_only_one_foot_hangs_on():
    model = brax_robots.model(register.find("humanoid"))
    names = np.array([model.body(i + 1).name for i in range(model.nbody - 1)])
    leg = shown.legs("humanoid")
    assert set(names[leg == 0]) == {"right_thigh", "right_shin"}
    assert set(names[leg == 1]) == {"left_thigh", "left_shin"}


def test_a_page_holds_its_recordings_and_loads_nothing(folder, tmp_path):
    explored = qdil.explore(folder, live=False)
    html = explored.save(tmp_path / "page.html", recordings=4).read_text()
    assert not re.search(r"""(src|href)=["']?https?:""", html)
    data = json.loads(re.search(r"globalThis\.qdilPage = (.*);\n", html)[1])
    assert len(data["rollouts"]) == 4
    assert data["show"]["playable"] == [[int(key.split(":")[1]) for key in data["rollouts"]]]
    cell = data["show"]["playable"][0][0]
    back = unpack(base64.b64decode(data["rollouts"][f"0:{cell}"]))
    expected = shown.roll_out(shown.read(folder)[0], [cell])[0]
    np.testing.assert_array_equal(back.contact, expected.contact)


def test_a_notebooks_output_shows_its_picture_before_its_frame(folder):
    html = qdil.explore(folder, live=False)._repr_html_()
    assert html.index("<img ") < html.index("<iframe ")
    picture = base64.b64decode(re.search('base64,([^"]*)', html)[1])
    assert picture.startswith(b"\x89PNG")
    assert len(html) < 1_500_000


def test_the_form_follows_where_it_runs(folder, monkeypatch):
    for name in ("JPY_SESSION_NAME", "VSCODE_PID", "QDIL_EXPLORER"):
        monkeypatch.delenv(name, raising=False)
    assert isinstance(qdil.explore(folder), page.Page)
    monkeypatch.setenv("JPY_SESSION_NAME", "explore.ipynb")
    live = qdil.explore(folder)
    assert live.selected == [("Expert", 23)]
    monkeypatch.setenv("QDIL_EXPLORER", "page")
    assert isinstance(qdil.explore(folder), page.Page)


def test_the_kernel_answers_a_request_with_the_rollout_or_a_reason(folder, monkeypatch):
    view = qdil.explore(folder, live=True).view
    sent = []
    monkeypatch.setattr(view, "send", lambda content, buffers=None: sent.append((content, buffers)))
    view._answer(view, {"type": "want", "run": 0, "cell": 12}, [])
    view._answer(view, {"type": "want", "run": 0, "cell": 1}, [])
    assert sent[0][0] == {"type": "rollout", "run": 0, "cell": 12}
    assert len(unpack(sent[0][1][0]).reward) <= 60
    assert sent[1][0]["type"] == "refused" and "empty" in sent[1][0]["why"]


def test_a_balls_picture_is_a_disc_of_the_right_size():
    """A ball of radius 0.3 at the target, seen from distance d, has angular radius asin(0.3 / d)."""
    ball = drawing.Scene(
        np.array([[[0, 0, 5.0], [0, 0, 5.0]]], np.float32), np.array([0.3], np.float32), np.array([[255, 0, 0.0]]),
        np.zeros((0, 5)),
    )  # fmt: skip
    picture = drawing.image(ball, np.array([0, 0, 5.0]), 1.0, 200, 200, drawing.View(distance=4.0))
    red = picture[..., 0].astype(int) - picture[..., 2] > 40
    expected = np.tan(np.arcsin(0.3 / 4)) / np.tan(drawing.OPENING / 2) * 100
    assert np.sqrt(red.sum() / np.pi) == pytest.approx(expected, rel=0.03)
    rows, columns = np.nonzero(red)
    assert (rows.mean(), columns.mean()) == pytest.approx((99.5, 99.5), abs=1)


def test_a_capsule_hides_what_is_behind_it_and_a_touching_foot_is_lit():
    robot, pose = shapes.shapes("walker2d"), shapes.first_pose("walker2d")
    leg = shown.legs("walker2d")
    pictures = [
        drawing.image(drawing.scene(robot, leg, pose, np.array(feet)), np.array([0, 0, 0.7]), 1.4, 120, 120)
        for feet in ([False, False], [True, False])
    ]
    changed = (pictures[0] != pictures[1]).any(axis=-1)
    assert 0 < changed.mean() < 0.1
    assert np.nonzero(changed)[0].min() > 60  # only near the ground


@pytest.mark.parametrize("suffix", [".png", ".gif", ".mp4"])
def test_films_are_written_whole(folder, tmp_path, suffix):
    path = qdil.render(folder, [6, 12], tmp_path / f"gait{suffix}", speed=4, width=64)
    assert [one.name for one in tmp_path.iterdir()] == [path.name]
    if suffix == ".mp4":
        assert path.read_bytes()[4:8] == b"ftyp" and path.stat().st_size > 2000
        return
    with Image.open(path) as picture:
        assert picture.width == (2 * 64 if suffix == ".gif" else film.MOMENTS * 64)
        if suffix == ".gif":
            first = np.asarray(picture.convert("RGB")).copy()
            picture.seek(1)
            assert picture.n_frames > 2 and (np.asarray(picture.convert("RGB")) != first).any()


def test_films_that_cannot_be_are_refused(folder, tmp_path):
    with pytest.raises(ConfigError, match="no known suffix"):
        qdil.render(folder, [6], tmp_path / "gait.avi")
    with pytest.raises(ConfigError, match="1 to 4 cells"):
        qdil.render(folder, [0, 6, 7, 12, 18], tmp_path / "gait.png")
    with pytest.raises(ConfigError, match="cell 5 of 'Expert' is empty"):
        qdil.render(folder, [5], tmp_path / "gait.png")
    with pytest.raises(ConfigError, match="too few elites"):
        qdil.render(folder, 9, tmp_path / "gait.png")


def test_the_showcase_keeps_a_run_that_still_walks(folder, tmp_path):
    target = showcase.keep(folder, tmp_path)
    assert showcase.kept("walker2d", tmp_path) == {"true": target}
    before, after = (shown.roll_out(shown.read(path)[0], [6])[0] for path in (folder, target))
    assert (target / "policies.npz").stat().st_size < 0.7 * (folder / "policies.npz").stat().st_size
    np.testing.assert_allclose(after.position[:10], before.position[:10], atol=0.01)


def test_the_showcase_keeps_fresh_scores(tmp_path):
    again = explorer_runs.write(tmp_path / "run", [0, 6, 12], landing=[7, 7, 12])
    kept = showcase.keep(again, tmp_path / "kept")
    assert [shown.content(shown.read(path))["runs"][0]["fresh"]["cell"] for path in (again, kept)] == [[7, 7, 12]] * 2


def test_comparison_counts_cells_and_gaps_by_hand():
    first = {
        "index": np.array([0, 1, 2]),
        "true_return": np.array([1.0, 2.0, 3.0]),
        "fitness": np.array([3.0, 2.0, 1.0]),
    }
    other = {
        "index": np.array([1, 2, 5]),
        "true_return": np.array([4.0, 2.0, 9.0]),
        "fitness": np.array([1.0, 0.0, 2.0]),
    }
    table = compare.with_first({"a": first, "b": other})
    assert table.loc["a"].tolist() == [3, 0, 0, 0]
    assert table.loc["b"].tolist() == [3, 1, 50, 0.5]
    again = {
        "rescored_return": np.ones(3),
        "rescored_measures": np.array([[0.5], [0.9], [0.9]]),
        "cells": np.array([6]),
    }
    table = compare.with_first({"a": first, "b": {**other, **again}})  # its elites land in cells 3, 5 and 5
    assert np.isnan(table.loc["a", "land in own cell (%)"]) and table.loc["b", "land in own cell (%)"] == 33
    assert compare.rank_correlation({"a": first, "b": other}).tolist() == [-1, 1]


def test_a_history_beside_the_archive_gives_the_widget_its_slider(tmp_path):
    path = explorer_runs.write(tmp_path / "run", [6, 12])
    assert len(qdil.explore(path, live=True).children[0].children) == 1  # the colour menu alone
    explorer_runs.write_history(path, [1, 4, 9], [6, 12, 12], last=10)
    explored = qdil.explore(path, live=True)
    history = explored.view.show["runs"][0]["history"]
    assert history == {"iteration": [1, 4, 9], "index": [6, 12, 12], "last": 10, **explorer_runs.growing(3)}
    slider = explored.children[0].children[1].children[1]
    slider.value = 4
    assert explored.view.iteration == 4
    slider.value = 10
    assert explored.view.iteration == -1
