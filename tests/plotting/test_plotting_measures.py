"""Figures follow the number of measures k; what they draw is compared with loops over a made-up archive."""

import math

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from qdil import plotting
from qdil.errors import ConfigError
from qdil.plotting import archives, comparisons, demonstrations, live, measures, ppga
from qdil.robots import register

CELLS = {1: (11,), 2: (3, 5), 3: (4, 2, 3), 4: (2, 3, 4, 2)}  # unequal, so that no axis can stand for another
EVERY_K = pytest.mark.parametrize("k", CELLS)
TRIANGLES = {1: [(0,)], 2: [(0, 1)], 3: [(0, 1), (0, 2), (1, 2)],
             4: [(0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3)]}  # fmt: skip


def made_up(k, seed=0):
    """An archive of k measures with about half of its cells filled, and returns of both signs."""
    rng = np.random.default_rng(seed)
    cells, filled = CELLS[k], []
    while len(filled) < max(3, math.prod(cells) // 2):
        cell = tuple(int(rng.integers(n)) for n in cells)
        filled += [] if cell in filled else [cell]
    index = []
    for cell in filled:
        flat = 0
        for coordinate, n in zip(cell, cells, strict=True):
            flat = flat * n + coordinate
        index.append(flat)
    places = (np.array(filled) + rng.uniform(0.1, 0.9, (len(filled), k))) / cells
    returns = rng.normal(size=len(filled)) * 100
    return {"index": np.array(index), "measures": places, "cells": np.array(cells), "true_return": returns}


def best_by_loop(archive, plane):
    """{cell of the plane: best return of the elites whose measures fall into it}."""
    best = {}
    for place, value in zip(archive["measures"], archive["true_return"], strict=True):
        cell = tuple(int(place[measure] * archive["cells"][measure]) for measure in plane)
        best[cell] = max(value, best.get(cell, -np.inf))
    return best


def drawn_cells(ax, plane):
    """{cell of the plane: value} of the coloured cells on ``ax``; masked cells are grey."""
    values = ax.collections[0].get_array()
    shown = {}
    for row, column in np.argwhere(~np.ma.getmaskarray(values)):
        shown[(int(column), int(row))[: len(plane)]] = float(values[row, column])
    return shown


def maps(figure):
    return [ax for ax in figure.axes if ax.get_label() != "<colorbar>"]


@EVERY_K
def test_maps_show_the_best_value_over_all_other_measures(k):
    one, two = made_up(k, seed=1), made_up(k, seed=2)
    figure = plotting.archives_side_by_side({"true": one, "gail": two})
    axes = maps(figure)
    assert len(axes) == 2 * len(TRIANGLES[k])
    pairs = [(archive, plane) for archive in (one, two) for plane in TRIANGLES[k]]
    found = [drawn_cells(ax, plane) for ax, (_, plane) in zip(_in_reading_order(axes, k), pairs, strict=True)]
    assert found == [pytest.approx(best_by_loop(archive, plane)) for archive, plane in pairs]
    values = [value for archive, plane in pairs for value in best_by_loop(archive, plane).values()]
    for ax in axes:
        assert ax.collections[0].get_clim() == pytest.approx((min(values), max(values)))


def _in_reading_order(axes, k):
    """Axes by figure column of their triangle first, then row by row."""
    width = max(1, k - 1)
    places = {ax: ax.get_subplotspec() for ax in axes}
    triangle = {ax: (s.rowspan.start // width, s.colspan.start // width) for ax, s in places.items()}
    return sorted(axes, key=lambda ax: (triangle[ax], places[ax].rowspan.start, places[ax].colspan.start))


@EVERY_K
def test_every_plane_of_an_archive_can_be_chosen(k):
    archive = made_up(k)
    for plane in [*TRIANGLES[k], *(plane[::-1] for plane in TRIANGLES[k])]:
        ax = Figure().subplots()
        plotting.heatmap(archive, ax, plane=plane)
        assert drawn_cells(ax, plane) == pytest.approx(best_by_loop(archive, plane))
        assert f"foot {plane[0] + 1}" in ax.get_xlabel()
        assert (f"foot {plane[-1] + 1}" in ax.get_ylabel()) == (k > 1)
    for plane in ((0, 0), (0, k), (0, 1, 2), ()):
        with pytest.raises(ValueError, match="no plane"):
            plotting.heatmap(archive, Figure().subplots(), plane=plane)


CAPTIONS = {
    1: "grey: empty cell",
    2: "grey: empty cell",
    3: "over the other measure\n",
    4: "over the other 2 measures\n",
}


@pytest.mark.parametrize("k, caption", CAPTIONS.items())
def test_the_caption_says_what_a_projection_shows(k, caption):
    [bar] = [ax for ax in plotting.archives_side_by_side({"true": made_up(k)}).axes if ax.get_label() == "<colorbar>"]
    text = bar.get_xlabel() + bar.get_ylabel()
    assert caption in text and ("best" in text) == (k > 2)


def landed(archive, seed):
    """An archive with fresh scores, and by hand where its elites land: {cell per measure: best mean return}."""
    draw, cells = np.random.default_rng(seed), [int(count) for count in archive["cells"]]
    count = len(archive["index"])
    measures, returns = draw.uniform(size=(count, len(cells))), draw.normal(size=count)
    best: dict[tuple[int, ...], float] = {}
    for place, value in zip(measures, returns, strict=True):
        cell = tuple(int(number * share) for number, share in zip(cells, place, strict=True))
        best[cell] = max(value, best.get(cell, -np.inf))
    return {**archive, "rescored_measures": measures, "rescored_return": returns}, best


@pytest.mark.parametrize("count", [1, 2, 3, 5])
@EVERY_K
def test_archives_are_drawn_as_claimed_and_as_they_land(k, count):
    names = ["true", "gail", "vail", "airl", "pwil"][:count]
    made = {name: landed(made_up(k, seed=i), i) for i, name in enumerate(names)}
    figure = plotting.both_readings({name: archive for name, (archive, _) in made.items()})
    axes = _in_reading_order(maps(figure), k)
    width = len(TRIANGLES[k])
    spaces = [axes[i : i + width] for i in range(0, len(axes), width)]
    claimed_first = k == 2 and count == 3
    order = [(name, i) for i in (0, 1) for name in names] if claimed_first else [(n, i) for n in names for i in (0, 1)]
    assert len(spaces) == len(order) == 2 * count
    assert len({ax.collections[0].get_clim() for ax in axes}) == 1
    for space, (name, reading) in zip(spaces, order, strict=True):
        archive, best = made[name]
        filled = len(best) if reading else len(archive["index"])
        title = next(ax.get_title(loc="left") or ax.get_title() for ax in space)
        assert ("as claimed", "as it lands")[reading] in title and f"{filled} of" in title
        for ax, plane in zip(space, TRIANGLES[k], strict=True):
            expected = best_by_loop(archive, plane)
            if reading:
                expected = {}
                for cell, value in best.items():
                    seen = tuple(cell[axis] for axis in plane)
                    expected[seen] = max(value, expected.get(seen, -np.inf))
            assert drawn_cells(ax, plane) == pytest.approx(expected)


def test_an_archive_without_fresh_scores_has_no_second_reading():
    with pytest.raises(ConfigError, match="not scored again"):
        plotting.both_readings({"true": made_up(2)})


def test_archives_of_different_robots_are_not_drawn_side_by_side():
    with pytest.raises(ValueError, match="number of measures"):
        plotting.archives_side_by_side({"true": made_up(2), "gail": made_up(3)})


def test_an_empty_archive_is_all_grey():
    nothing = {"index": np.zeros(0, int), "cells": [3, 3], "true_return": np.zeros(0)}
    [ax] = maps(plotting.archives_side_by_side({"true": nothing}))
    assert drawn_cells(ax, (0, 1)) == {} and ax.get_title() == "Expert: 0 of 9 cells"


@pytest.mark.parametrize("robot", register.robot_names())
def test_axes_name_the_feet_of_every_robot(robot):
    feet = register.find(robot).measure_names
    labels = plotting.measure_labels(robot, len(feet))
    assert len(labels) == len(feet) and all(foot in label for foot, label in zip(feet, labels, strict=True))


def test_feet_are_numbered_where_their_names_are_not_known():
    assert measures.foot_names("someone-elses", 3) == measures.foot_names(None, 3) == ["foot 1", "foot 2", "foot 3"]
    assert measures.foot_names("walker2d", 3) == ["foot 1", "foot 2", "foot 3"]


def at(collection, plane):
    """The drawn points in the measures of a plane; a strip has one."""
    return collection.get_offsets()[:, : len(plane)]


@EVERY_K
def test_points_stand_on_every_plane(k):
    archive = made_up(k)
    demos = {"elite_measures": archive["measures"][:2]}
    space = maps(plotting.behaviour_space(archive, demos))
    many = _in_reading_order(maps(comparisons.demonstrators(archive, {1: archive["measures"][:1]})), k)
    for plane, one, other in zip(TRIANGLES[k], _in_reading_order(space, k), many, strict=True):
        np.testing.assert_allclose(at(one.collections[0], plane), archive["measures"][:, plane])
        np.testing.assert_allclose(at(one.collections[2], plane), archive["measures"][:2, plane])
        np.testing.assert_allclose(at(other.collections[2], plane), archive["measures"][:1, plane])


@EVERY_K
def test_the_second_demonstrator_is_the_farthest_of_the_pool_in_all_measures(k):
    archive = made_up(k, seed=3)
    axes = _in_reading_order(maps(demonstrations.selection(archive, 2)), k)
    order = sorted(range(len(archive["index"])), key=lambda i: -archive["true_return"][i])
    pool = [archive["measures"][i] for i in order[: max(1, math.prod(CELLS[k]) // 5)]]
    farthest = max(pool, key=lambda point: sum((point - pool[0]) ** 2))
    for plane, ax in zip(TRIANGLES[k], axes[len(TRIANGLES[k]) :], strict=True):
        np.testing.assert_allclose(at(ax.collections[-1], plane), [[farthest[measure] for measure in plane]])


@EVERY_K
def test_gait_diagrams_have_a_row_per_foot(k):
    proxy = np.random.default_rng(k).integers(0, 2, (40, k))
    demos = {
        "proxy": proxy,
        "episode": np.zeros(40, int),
        "episode_return": [5.0],
        "episode_measures": proxy[None].mean(1),
    }
    strips = demonstrations.contact_strips(demos, 0.1).axes[0]
    above, below = ppga.proxies(proxy, 0.1).axes
    for ax in (strips, above):
        time_down = [sum(path.get_extents().width for path in bars.get_paths()) for bars in ax.collections]
        np.testing.assert_allclose(time_down, 0.1 * proxy.sum(axis=0), atol=1e-9)
    assert [tick.get_text() for tick in strips.get_yticklabels()] == [f"foot {i + 1}" for i in range(k)]
    np.testing.assert_allclose([line.get_ydata()[-1] for line in below.lines[::2]], proxy.mean(axis=0))


@EVERY_K
def test_candidates_have_a_panel_for_every_coefficient(k):
    rng = np.random.default_rng(k)
    places, coefficients = rng.random((8, k)), rng.normal(size=(8, 1 + k))
    axes = maps(ppga.candidates(places, coefficients, np.full(k, 0.5)))
    assert len(axes) == 1 + k
    for j, ax in enumerate(axes):
        colours = ax.collections[0].get_array()
        np.testing.assert_allclose(colours, np.abs(coefficients[:, 0]) if j == 0 else coefficients[:, j])
        measure = max(j - 1, 0)
        assert any(np.allclose(column, places[:, measure]) for column in ax.collections[0].get_offsets().T)
        assert k == 2 or f"foot {measure + 1}" in ax.get_xlabel() + ax.get_ylabel()  # of two, only the first has both


@EVERY_K
def test_coefficients_and_distributions_have_k_plus_one_dimensions(k):
    metrics = pd.DataFrame({"iteration": [1, 2], "restarts": [0, 1], **{f"c{j}": [j, -j] for j in range(k + 1)}})
    lines = ppga.coefficients_over(metrics).axes[0].lines
    assert [list(line.get_ydata()) for line in lines[: k + 1]] == [[j, -j] for j in range(k + 1)]
    assert len({(line.get_color(), str(line.get_linestyle())) for line in lines[: k + 1]}) == k + 1
    samples = np.random.default_rng(k).normal(size=(6, 1 + k))
    gaussian = (np.arange(1.0 + k), np.eye(1 + k))
    axes = ppga.search_distribution(gaussian, gaussian, samples, np.ones(6)).axes
    assert [(ax.get_xlabel(), ax.get_ylabel()) for ax in axes] == [(f"$c_{i}$", f"$c_{i + 1}$") for i in range(k)]
    for i, ax in enumerate(axes):
        np.testing.assert_allclose(ax.collections[1].get_offsets(), samples[:, i : i + 2])
        np.testing.assert_allclose([line.get_xydata()[0] for line in ax.lines], [[i, i + 1]] * 2)


@EVERY_K
def test_each_copy_is_filled_in_its_own_panel(k):
    names = ["return", *(f"foot {i + 1} down" for i in range(k))]
    columns = pd.MultiIndex.from_tuples([(name, kind) for name in names for kind in ("mean", "error")])
    table = pd.DataFrame(np.zeros((2 + k, 2 * (1 + k))), index=["mu", "f", *map(str, range(k))], columns=columns)
    axes = ppga.objectives(table).axes
    filled = [[bars.lines[0].get_markerfacecolor() != "white" for bars in ax.containers] for ax in axes]
    np.testing.assert_array_equal(filled, np.eye(2 + k, dtype=bool)[1:])


@EVERY_K
def test_a_path_goes_from_iteration_to_iteration_on_every_plane(k):
    rng = np.random.default_rng(k)
    followed = pd.DataFrame({**{f"m{j + 1}": rng.random(3) for j in range(k)}, "restart": [False, True, False]})
    axes = _in_reading_order(maps(ppga.path(followed, made_up(k))), k)
    for plane, ax in zip(TRIANGLES[k], axes, strict=True):
        columns = followed[[f"m{measure + 1}" for measure in plane]].to_numpy()
        ends = [(np.array(text.xyann)[: len(plane)], np.array(text.xy)[: len(plane)]) for text in ax.texts]
        np.testing.assert_allclose(ends, [(columns[0], columns[1]), (columns[1], columns[2])])
        assert [text.arrow_patch.get_linestyle() for text in ax.texts] == ["--", "-"]


@EVERY_K
def test_a_live_archive_is_the_searchs(k):
    archive = made_up(k)

    class Grid:
        dims = CELLS[k]

        def data(self, name):
            return archive[name]

    axes = _in_reading_order(maps(live.live_figure(Grid(), "so far")), k)
    for plane, ax in zip(TRIANGLES[k], axes, strict=True):
        assert drawn_cells(ax, plane) == pytest.approx(best_by_loop(archive, plane))


def test_six_measures_fit():
    """The most that a robot may have: 15 maps, each with its two measures."""
    cells = np.full(6, 2)
    archive = {"index": np.arange(64), "cells": cells, "true_return": np.arange(64.0)}
    figure, space = archives.one_archive(archive, "six feet")
    figure.draw_without_rendering()
    assert len(space) == 15
    for (i, j), ax in space.items():  # a cell's best return has every other coordinate 1
        expected = {(a, b): 63 - (1 - a) * 2 ** (5 - i) - (1 - b) * 2 ** (5 - j) for a in (0, 1) for b in (0, 1)}
        assert drawn_cells(ax, (i, j)) == expected
