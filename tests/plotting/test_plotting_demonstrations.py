"""Pictures of demonstrations and robots show the values in the arrays."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from qdil.plotting import demonstrations, robots
from qdil.robots import shapes


def archive(n=30, cells=6, seed=0):
    rng = np.random.default_rng(seed)
    return {"true_return": rng.normal(size=n), "measures": rng.random((n, 2)), "cells": np.array([cells, cells])}


def test_each_step_rings_the_point_farthest_from_the_stars():
    expert = archive()
    figure = demonstrations.selection(expert, 3)
    best = expert["measures"][np.argsort(-expert["true_return"])[:7]]  # a fifth of 36 cells
    stars = [best[0]]
    for ax in figure.axes[1:3]:
        gaps = [min(np.hypot(*(point - star)) for star in stars) for point in best]
        ring = ax.collections[2].get_offsets()[0]
        np.testing.assert_allclose(ring, best[np.argmax(gaps)])
        assert f"{max(gaps):.2f}" in ax.get_title()
        stars.append(best[np.argmax(gaps)])


def test_one_demonstrator_is_the_best_elite():
    expert = archive()
    figure = demonstrations.selection(expert, 1)
    np.testing.assert_allclose(
        figure.axes[0].collections[2].get_offsets()[0], expert["measures"][expert["true_return"].argmax()]
    )


def test_more_demonstrators_than_elites_are_refused():
    with pytest.raises(ValueError, match="only 3 elites"):
        demonstrations.selection(archive(3), 4)


def test_spans_cover_exactly_the_steps_on_the_ground():
    down = np.random.default_rng(1).integers(0, 2, 200)
    found = np.zeros(200)
    for begin, length in demonstrations.spans(down, 0.5):
        found[round(begin / 0.5) : round((begin + length) / 0.5)] += 1
    np.testing.assert_array_equal(found, down)
    assert demonstrations.spans(np.zeros(5), 0.1) == []


def test_a_strip_per_demonstration_names_its_numbers():
    proxy = np.array([[1, 0], [0, 1], [1, 1], [0, 0], [1, 0]])
    demos = {"proxy": proxy, "episode": np.array([0, 0, 1, 1, 1]), "episode_return": np.array([7.0, 9.0]),
             "episode_measures": np.array([[0.5, 0.5], [2 / 3, 1 / 3]])}  # fmt: skip
    figure = demonstrations.contact_strips(demos, 0.1, "walker2d")
    assert [ax.get_title(loc="left").split("; ")[1] for ax in figure.axes] == ["m = (0.50, 0.50)", "m = (0.67, 0.33)"]
    assert "return 9 in 3 steps" in figure.axes[1].get_title(loc="left")
    assert [t.get_text() for t in figure.axes[0].get_yticklabels()] == ["foot", "foot_left"]


def test_capsules_of_a_robot_are_drawn_at_their_place_and_size():
    what = shapes.Shapes(
        np.array([0, 1]), np.array([[[0, 0, 0], [0, 0, 1.0]]] * 2), np.array([0.1, 0.2]), np.array([-1, 0])
    )
    quarter = np.array([[1.0, 0, 0, 0], [0.5**0.5, 0, 0.5**0.5, 0]])  # the second lies down: z turns to x about y
    ax = Figure().subplots()
    robots.robot(ax, what, shapes.Pose(np.array([[0, 0, 1.0], [1, -1.0, 1]]), quarter))
    upright, lying = (patch.get_path().get_extents().bounds for patch in ax.patches[:2])
    np.testing.assert_allclose(upright, (-0.1, 0.9, 0.2, 1.2), atol=2e-3)
    np.testing.assert_allclose(lying, (0.8, 0.8, 1.4, 0.4), atol=4e-3)
    assert [patch.get_facecolor()[:3] == (0.55, 0.55, 0.55) for patch in ax.patches[:2]] == [True, False]
