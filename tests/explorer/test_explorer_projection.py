"""The map of k measures: the projection in Python and in the front end, against loops over all cells."""

import itertools
import re

import numpy as np
import pytest
from explorer_browser import SOURCES, needs_browser, script
from hypothesis import given
from hypothesis import strategies as st

from qdil.explorer import drawing, projection
from qdil.explorer.shown import Shown, content

pytest_plugins = ["explorer_browser"]
DIMS = {1: [7], 2: [4, 3], 3: [3, 4, 2], 4: [3, 2, 4, 2]}


def some_archive(k, seed, share=0.5):
    """Elites in about ``share`` of the cells; returns are whole numbers, so that several are equal."""
    draw = np.random.default_rng(seed)
    dims = DIMS[k]
    index = np.flatnonzero(draw.random(np.prod(dims)) < share)
    returns = draw.integers(0, 4, len(index)).astype(float)
    return {
        "index": index,
        "measures": draw.random((len(index), k)),
        "true_return": returns,
        "fitness": draw.random(len(index)),
        "length": draw.integers(1, 9, len(index)).astype(float),
        "cells": np.array(dims),
    }


def by_hand(archive, axes):
    """Square -> row of its best elite, from a grid of all cells and a loop over each square's stack."""
    dims = [int(n) for n in archive["cells"]]
    grid = np.full(dims, -1)
    grid.flat[archive["index"]] = np.arange(len(archive["index"]))
    best = {}
    sides = [range(dims[axis]) for axis in axes]
    for number, shown in enumerate(itertools.product(*sides)):
        place: list = [slice(None)] * len(dims)
        for axis, at in zip(axes, shown, strict=True):
            place[axis] = at
        rows = [row for row in np.ravel(grid[tuple(place)]) if row >= 0]
        if rows:
            best[number] = max(rows, key=lambda row: (archive["true_return"][row], -archive["index"][row]))
    return best


def all_axes(k):
    return list(itertools.permutations(range(k), min(k, 2)))


@given(st.integers(1, 4), st.integers(0, 10_000), st.sampled_from([0.0, 0.1, 0.5, 1.0]))
def test_a_square_shows_the_best_elite_over_the_other_axes(k, seed, share):
    archive = some_archive(k, seed, share)
    for axes in all_axes(k):
        expected = by_hand(archive, axes)
        seen = projection.project(archive, axes)
        assert dict(zip(seen["index"], projection.best_rows(archive, axes), strict=True)) == expected
        rows = list(expected.values())
        np.testing.assert_array_equal(seen["measures"], archive["measures"][rows].reshape(-1, k)[:, list(axes)])
        np.testing.assert_array_equal(seen["fitness"], archive["fitness"][rows])
        assert seen["cells"].tolist() == [DIMS[k][axis] for axis in axes]


def test_the_choices_of_axes():
    assert projection.axes_choices(1) == [(0,)]
    assert projection.axes_choices(2) == [(0, 1)]
    assert projection.axes_choices(4) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]


SQUARES = """cases => cases.map(({ dims, axes, elites, squares }) => {
  const map = q.emptyMap(dims, axes, elites);
  const taken = elites.index.map((_, row) => map.take(row));
  return {
    taken, best: squares.map(map.best),
    first: squares.map((square) => q.firstCell(dims, axes, square)),
    again: elites.index.map((cell) => q.cellNumber(dims, q.coordinates(dims, cell))),
  };
})"""


@pytest.mark.physics
@needs_browser
@pytest.mark.parametrize("k", [1, 2, 3, 4])
def test_the_front_end_projects_as_python_does(browser, k):
    cases, expected = [], []
    for seed, axes in itertools.product(range(5), all_axes(k)):
        archive = some_archive(k, seed)
        count = int(np.prod([DIMS[k][axis] for axis in axes]))
        elites = {name: archive[name].tolist() for name in ("index", "true_return")}
        cases.append({"dims": DIMS[k], "axes": axes, "elites": elites, "squares": list(range(count))})
        best = by_hand(archive, axes)
        grid = np.arange(np.prod(DIMS[k])).reshape(DIMS[k])
        first = np.moveaxis(grid, axes, range(len(axes))).reshape(count, -1).min(axis=1).tolist()
        expected.append({
            "taken": projection.squares(archive, axes).tolist(), "first": first, "again": elites["index"],
            "best": [int(best.get(square, -1)) for square in range(count)],
        })  # fmt: skip
    page = browser.new_page()
    script(page, "cellNumber, coordinates, emptyMap, firstCell", "projection.js")
    assert page.evaluate(SQUARES, cases) == expected
    page.close()


def some_history(k, seed, iterations=6):
    """Elites that take cells, and replace each other there with returns that may fall."""
    draw = np.random.default_rng(seed)
    iteration = np.sort(draw.integers(1, iterations + 1, 40))
    index = draw.integers(0, np.prod(DIMS[k]), 40)
    _, first = np.unique(np.stack([iteration, index]), axis=1, return_index=True)  # a cell changes once an iteration
    keep = np.sort(first)
    returns, fitness = draw.integers(0, 9, (2, len(keep))).astype(float)
    return {"iteration": iteration[keep], "index": index[keep], "true_return": returns, "fitness": fitness}


def archive_at(history, k, iteration):
    """The archive after ``iteration``: the last elite of every cell."""
    last = {int(cell): row for row, cell in enumerate(history["index"]) if history["iteration"][row] <= iteration}
    rows = [last[cell] for cell in sorted(last)]
    fields = {name: history[name][rows] for name in ("index", "true_return", "fitness")}
    return fields | {"cells": np.array(DIMS[k]), "measures": np.zeros((len(rows), k)), "length": np.zeros(len(rows))}


def map_at(history, k, iteration, axes, field):
    archive = archive_at(history, k, iteration)
    grid = np.full(int(np.prod([DIMS[k][axis] for axis in axes])), np.nan)
    for square, row in by_hand(archive, axes).items():
        grid[square] = archive[field][row]
    return grid


@pytest.mark.physics
@needs_browser
@pytest.mark.parametrize("k", [1, 2, 3, 4])
def test_maps_of_any_iteration_and_their_differences_are_those_of_a_loop(browser, k):
    histories = [some_history(k, seed) for seed in (1, 2)]
    runs = []
    for history in histories:
        end = archive_at(history, k, 6)
        plain = {name: values.tolist() for name, values in history.items()}
        fields = {name: end[name].tolist() for name in ("index", "true_return", "fitness")}
        runs.append({"cells": DIMS[k], **fields, "history": {**plain, "last": 6}})
    page = browser.new_page()
    script(page, "picture", "projection.js", "data.js")
    draw = """([runs, axes, against, iteration]) => {
      const drawn = q.picture(runs, { run: 0, against, field: "fitness", iteration, axes });
      return [[...drawn.values].map((value) => (isNaN(value) ? null : value)), drawn.high];
    }"""
    for axes in all_axes(k):
        maps = [[map_at(history, k, t, axes, "fitness") for t in range(7)] for history in histories]
        gaps = np.array(maps[0]) - np.array(maps[1])
        for iteration in range(7):
            values, _ = page.evaluate(draw, [runs, axes, -1, iteration])
            np.testing.assert_array_equal(np.array(values, float), maps[0][iteration])
            values, high = page.evaluate(draw, [runs, axes, 1, iteration])
            np.testing.assert_array_equal(np.array(values, float), gaps[iteration])
            assert high == np.nanmax(np.abs(gaps))
    page.close()


def scored_again(archive, k, seed):
    """The archive with fresh scores: whole-numbered returns, so that several are equal; one elite without any."""
    draw, count = np.random.default_rng(seed + 100), len(archive["index"])
    returns, measures = draw.integers(0, 4, count).astype(float), draw.random((count, k))
    returns[count // 2] = np.nan
    return {**archive, "rescored_return": returns, "rescored_measures": measures}


def landing_by_hand(archive, axes):
    """Square -> (mean return, cell that it won) of the best elite that lands there on fresh episodes."""
    best: dict[int, tuple[float, int]] = {}
    for row, (value, place) in enumerate(zip(archive["rescored_return"], archive["rescored_measures"], strict=True)):
        if np.isfinite(value):
            along = [int(archive["cells"][axis] * place[axis]) for axis in axes]
            square = int(np.ravel_multi_index(along, [archive["cells"][axis] for axis in axes]))
            landing = int(np.ravel_multi_index((archive["cells"] * place).astype(int), archive["cells"]))
            rank = (value, -landing, -row)
            if square not in best or rank > best[square][1]:
                best[square] = (int(archive["index"][row]), rank)
    return {square: (rank[0], cell) for square, (cell, rank) in best.items()}


@pytest.mark.physics
@needs_browser
@pytest.mark.parametrize("k", [1, 2, 3])
def test_the_front_end_puts_elites_where_they_land(browser, k):
    archives = [scored_again(some_archive(k, seed), k, seed) for seed in (3, 4)]
    runs = content([Shown("run", None, one, np.zeros((0, 0)), None, "no policies") for one in archives])["runs"]
    page = browser.new_page()
    script(page, "cellOf, picture, squareShown", "projection.js", "data.js")
    draw = """([runs, axes, against]) => {
      const drawn = q.picture(runs, { run: 0, against, field: "landed", iteration: 2, axes });
      return {
        values: [...drawn.values].map((value) => (isNaN(value) ? null : value)),
        cells: [...drawn.values].map((_, square) => q.cellOf(runs[0], axes, square, "landed")),
        places: runs[0].index.map((cell) => q.squareShown(runs[0], axes, cell, "landed")), high: drawn.high,
      };
    }"""
    for axes in all_axes(k):
        by_run = [landing_by_hand(archive, axes) for archive in archives]
        drawn = page.evaluate(draw, [runs, axes, -1])
        seen = list(zip(drawn["values"], drawn["cells"], strict=True))
        assert {square: one for square, one in enumerate(seen) if one[0] is not None} == by_run[0]
        assert {cell for value, cell in seen if value is None} <= {-1}
        for square, (_, cell) in by_run[0].items():
            assert drawn["places"][archives[0]["index"].tolist().index(cell)] == square
        gaps = {s: by_run[0][s][0] - by_run[1][s][0] for s in by_run[0].keys() & by_run[1].keys()}
        minus = page.evaluate(draw, [runs, axes, 1])
        assert {i: v for i, v in enumerate(minus["values"]) if v is not None} == gaps
        assert minus["high"] == (max(map(abs, gaps.values()), default=0) or 1)
    page.close()


def test_six_feet_have_one_colour_each_the_same_in_films_and_in_the_front_end():
    text = (SOURCES / "colours.js").read_text()
    for name, ours in (("FEET", drawing.FEET), ("LEGS", drawing.LEGS)):
        (line,) = re.findall(rf"export const {name} = \[(.*?)\]", text)
        in_front_end = [[int(code[i : i + 2], 16) for i in (0, 2, 4)] for code in re.findall("#([0-9a-f]{6})", line)]
        assert in_front_end == ours.astype(int).tolist()
        assert len({tuple(colour) for colour in in_front_end}) == 6
