"""Pictures that compare, read back from what was drawn."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex

from qdil.plotting import comparisons
from qdil.plotting.colours import METHOD_COLOURS


def texts(legend):
    return [text.get_text() for text in legend.get_texts()]


def test_boxes_show_the_middle_half_of_each_kind():
    rng = np.random.default_rng(0)
    rewards = {m: {"a": rng.normal(size=(20, 3)), "b": rng.normal(5, 1, (7, 1))} for m in ("gail", "vail")}
    figure = comparisons.rewards_by_kind(rewards)
    for ax, (model, kinds) in zip(figure.axes, rewards.items(), strict=True):
        assert ax.get_title() == model.upper()
        for box, values in zip(ax.patches, kinds.values(), strict=True):
            drawn = box.get_path().vertices[:, 0]
            np.testing.assert_allclose([drawn.min(), drawn.max()], np.percentile(values, [25, 75]))
    assert [t.get_text() for t in figure.axes[0].get_yticklabels()] == ["a", "b"]


def test_curves_are_the_tables_columns_and_share_a_legend():
    tables = {
        "one": pd.DataFrame({"gail": [1.0, 2.0], "mine": [3.0, 1.0]}, index=[0, 5]),
        "two": pd.DataFrame({"mine": [4.0]}, index=[7]),
    }
    figure = comparisons.curves(tables, "x", "y")
    first, second = figure.axes
    assert [list(line.get_ydata()) for line in first.lines] == [[1, 2], [3, 1]]
    assert list(second.lines[0].get_xdata()) == [7] and texts(figure.legends[0]) == ["GAIL", "mine"]
    assert to_hex(first.lines[0].get_color()) == METHOD_COLOURS["gail"]
    assert first.lines[1].get_color() == second.lines[0].get_color() != first.lines[0].get_color()
    assert (first.get_ylabel(), second.get_ylabel(), second.get_xlabel()) == ("y", "", "x")


def test_panels_that_are_called_like_their_only_line_need_no_legend():
    one = {name: pd.DataFrame({name: [1.0, 2.0]}) for name in ("gail", "airl")}
    assert not comparisons.curves(one, "x", "y").legends


def test_shares_are_shown_from_zero():
    table = {"share": pd.DataFrame({"gail": [97.0, 99.0]})}
    assert comparisons.curves(table, "x", "y", from_zero=True).axes[0].get_ylim()[0] == 0
    assert comparisons.curves(table, "x", "y").axes[0].get_ylim()[0] > 90


def test_clouds_are_the_points():
    points = {"a": np.eye(2), "b": np.zeros((3, 2))}
    figure = comparisons.clouds({"left": points, "right": {"a": np.ones((1, 2))}}, "x", "y")
    assert [len(c.get_offsets()) for ax in figure.axes for c in ax.collections] == [2, 3, 1]
    np.testing.assert_array_equal(figure.axes[0].collections[0].get_offsets(), np.eye(2))


def test_coupling_draws_a_line_for_every_mass_as_wide_as_it_is_large():
    steps, atoms = np.array([[0.0, 0], [1, 1]]), np.array([[2.0, 0], [0, 3], [5, 5]])
    taken = np.array([[2, 0, 0], [1, 4, 0]])
    ax = comparisons.coupling(steps, atoms, taken).axes[0]
    drawn = {tuple(map(tuple, line.get_xydata())): line.get_linewidth() for line in ax.lines}
    ends = {(tuple(steps[t]), tuple(atoms[j])): taken[t, j] for t, j in np.argwhere(taken)}
    assert drawn.keys() == ends.keys()
    widths = np.array([drawn[key] / ends[key] for key in ends])
    np.testing.assert_allclose(widths, widths[0])


def test_demonstrators_stand_among_the_experts_elites():
    rng = np.random.default_rng(0)
    archive = {"measures": rng.random((9, 2)), "true_return": np.arange(9.0), "cells": [5, 2]}
    chosen = {1: archive["measures"][8:], 2: archive["measures"][[8, 7]]}
    one, two = comparisons.demonstrators(archive, chosen).axes
    assert [len(c.get_offsets()) for c in two.collections] == [9, 2, 2] and one.get_title() == "1 demonstrator"
    np.testing.assert_array_equal(two.collections[1].get_offsets(), archive["measures"][[8, 7]])
    np.testing.assert_array_equal(one.collections[2].get_offsets(), chosen[1])


def test_lines_over_demonstrations_have_points_in_order_and_coverage_in_percent():
    rows = [("gail", 4, "coverage", 0.5, 0.1), ("gail", 1, "coverage", 0.2, np.nan), ("gail", 1, "best", 7.0, np.nan)]
    table = pd.DataFrame(rows, columns=["method", "n_demos", "metric", "value", "spread"])
    figure = comparisons.by_demonstrations({"ours": table, "theirs": table}, ["coverage", "best"])
    assert len(figure.axes) == 4 and texts(figure.legends[0]) == ["GAIL"]
    coverage = figure.axes[0].lines[0]
    assert list(coverage.get_xdata()) == [1, 4] and list(coverage.get_ydata()) == [20, 50]
    bars = figure.axes[0].collections[0].get_segments()
    np.testing.assert_allclose([bar[:, 1] for bar in bars], [[20, 20], [40, 60]])
    assert list(figure.axes[1].lines[0].get_ydata()) == [7]
    assert [bool(ax.get_title()) for ax in figure.axes] == [True, True, False, False]
    assert (figure.axes[0].get_ylabel(), figure.axes[2].get_ylabel()) == ("ours", "theirs")


def test_effects_have_their_intervals_in_the_rows_of_their_names():
    table = pd.DataFrame(
        {"difference": [1.0, -2.0, 5.0], "low": [0.0, -3.0, np.nan], "high": [2.0, -1.0, np.nan], "base": list("xyx")},
        index=["a", "b", "b"],
    )
    left, right = comparisons.effects(table, "effect", "base").axes
    assert [t.get_text() for t in left.get_yticklabels()] == ["a", "b"]
    assert (list(left.lines[1].get_xdata()), list(left.lines[1].get_ydata())) == ([1, 5], [0, 1])
    assert (list(right.lines[1].get_xdata()), list(right.lines[1].get_ydata())) == ([-2], [1])
    np.testing.assert_array_equal(right.collections[0].get_segments()[0], [[-3, 1], [-1, 1]])
    assert len(comparisons.effects(table, "effect").axes) == 1


@pytest.mark.parametrize(
    "draw",
    [
        lambda: comparisons.rewards_by_kind({}),
        lambda: comparisons.curves({}, "x", "y"),
        lambda: comparisons.clouds({}, "x", "y"),
        lambda: comparisons.by_demonstrations({}),
        lambda: comparisons.effects(pd.DataFrame(columns=["difference", "low", "high"]), "effect"),
    ],
)
def test_nothing_to_draw_is_refused(draw):
    with pytest.raises(ValueError, match="draw"):
        draw()
