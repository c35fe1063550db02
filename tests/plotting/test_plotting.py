"""Pictures draw the numbers they are given, look the same everywhere, and can be told apart without colour vision."""

import itertools

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from qdil import plotting
from qdil.methods import method_names
from qdil.plotting import style
from qdil.plotting.curves import over_seeds
from qdil.runs.studies import STUDIES

# Machado, Oliveira and Fernandes (2009), severity 1: what is seen of linear RGB without one kind of cone.
VISION = {
    "full": np.eye(3),
    "protanopia": np.array([[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]]),
    "deuteranopia": np.array([[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]]),
    "tritanopia": np.array([[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]]),
}
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def lab(colour, seen):
    """CIELAB of a colour as it is seen."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = XYZ @ np.clip(seen @ linear, 0, 1) / np.array([0.9505, 1.0, 1.089])
    x, y, z = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def table(values, steps=None, n=30):
    iteration = np.arange(1, n + 1)
    columns = {"iteration": iteration, "env_steps": iteration * 1.0 if steps is None else steps}
    level = {"qd_score": 400.0, "coverage": 0.01, "best": 2.0, "average": 1.0}
    return pd.DataFrame(columns | {name: scale * np.asarray(values) * np.ones(n) for name, scale in level.items()})


def final(rows):
    index = pd.MultiIndex.from_tuples(rows, names=["experiment", "seed"])
    return pd.DataFrame({"qd_score": list(rows.values()), "coverage": [v / 1000 for v in rows.values()]}, index)


@pytest.mark.parametrize("study", STUDIES)
@pytest.mark.parametrize("vision", VISION)
def test_methods_drawn_together_have_colours_that_anyone_can_tell_apart(study, vision):
    methods = dict.fromkeys(name.split("+")[0] for name in STUDIES[study])
    for first, second in itertools.combinations(methods, 2):
        colours = [lab(plotting.method_colour(name), VISION[vision]) for name in (first, second)]
        assert np.linalg.norm(np.subtract(*colours)) > 14, (first, second)


@pytest.mark.parametrize("names", [*STUDIES.values(), tuple(method_names())], ids=[*STUDIES, "all methods"])
def test_no_two_lines_of_a_picture_look_the_same(names):
    line_styles = plotting.styles(names)
    assert list(line_styles) == list(names)
    assert len({tuple(map(str, one.values())) for one in line_styles.values()}) == len(names)


def test_a_method_has_the_same_colour_everywhere():
    for name in method_names():
        colour = plotting.method_colour(name)
        assert plotting.styles([name, "true", "gail"])[name]["color"] == colour
        assert plotting.method_colour(f"{name}+gamma=0.5") == colour


def test_every_method_has_a_colour_of_its_own():
    """Also those that no study draws together: a reader meets them in one notebook after the other."""
    assert len({plotting.method_colour(name) for name in method_names()}) == len(method_names())


def test_names_that_are_no_methods_get_their_own_styles():
    line_styles = plotting.styles(["first try", "second try", "gail"])
    assert len({one["color"] for one in line_styles.values()}) == 3


@pytest.mark.parametrize(
    "experiment, text",
    [
        ("mconbo-gail", "MConbo-GAIL"),
        ("mconbo-gail+bonus_p=0.0+bonus_q=1.0", "MConbo-GAIL, p = 0, q = 1"),
        ("gail+demo_episodes=1", "GAIL, 1 demonstration"),
        ("gail+demo_episodes=10", "GAIL, 10 demonstrations"),
        ("mconbo-gail+protocol=released", "MConbo-GAIL, released protocol"),
        ("mconbo-vail+vail_beta=fixed", "MConbo-VAIL, vail beta = fixed"),
        ("gail+reward_hidden=8,8", "GAIL, reward hidden = 8,8"),
    ],
)
def test_legends_call_experiments_by_what_differs(experiment, text):
    assert plotting.label(experiment) == text


def test_axes_have_the_units_of_their_labels():
    steps = table(1.0, steps=np.linspace(0.5e6, 3e6, 30))
    for x, unit, columns in (("env_steps", 1e6, {}), ("wall_seconds", 60.0, {"wall_seconds": np.arange(30) * 12.0})):
        tables = steps.assign(**columns)
        ax = plotting.learning_curves({"gail": tables}, x=x).axes[0]
        np.testing.assert_allclose(ax.lines[0].get_xdata(), tables[x] / unit)
    assert [style.short(x) for x in (0.0, 0.25, 100.0, 1000.0, 120000.0)] == ["0", "0.25", "100", "1,000", "120,000"]


def test_curves_are_the_mean_over_seeds_in_a_band_of_one_standard_deviation():
    figure = plotting.learning_curves({"gail": [table(v) for v in (1.0, 2.0, 6.0)], "true": table(5.0)})
    axes = figure.axes
    gail, true = axes[0].lines
    assert (gail.get_ydata() == 1200.0).all() and (true.get_ydata() == 2000.0).all()
    [band] = axes[0].collections
    heights = band.get_paths()[0].vertices[:, 1]
    deviation = 400 * np.sqrt((4 + 1 + 9) / 2)
    assert (heights.min(), heights.max()) == pytest.approx((1200 - deviation, 1200 + deviation))
    assert (axes[1].lines[0].get_ydata() == 3.0).all()  # coverage in percent
    assert true.get_linestyle() == "--" and [ax.get_title() for ax in axes] == list(plotting.METRICS.values())


def test_seeds_measured_at_other_steps_are_compared_where_all_were_measured():
    tables = [table([1.0, 2.0, 3.0], [0.0, 10.0, 20.0], 3), table([0.0, 5.0, 10.0], [5.0, 15.0, 25.0], 3)]
    where, values = over_seeds(tables, "env_steps", "average")
    assert (where[0], where[-1]) == (5.0, 20.0) and values.shape == (2, 3)
    assert values[:, 0] == pytest.approx([1.5, 0.0]) and values[:, -1] == pytest.approx([3.0, 7.5])


def test_legends_say_over_how_many_seeds_and_leave_the_curves_alone():
    metrics = {name: [table(1.0), table(2.0)] for name in STUDIES["released"]}
    figure = plotting.learning_curves(metrics)
    figure.draw_without_rendering()
    [legend] = figure.legends
    box = legend.get_window_extent()
    assert "over 2 seeds" in legend.get_title().get_text() and len(legend.get_texts()) == len(metrics)
    assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 and box.y0 >= 0
    assert all(not ax.get_tightbbox().overlaps(box) for ax in figure.axes)
    uneven = plotting.learning_curves({"gail": [table(1.0)], "true": [table(1.0), table(2.0)]})
    assert "GAIL 1, Expert 2" in uneven.legends[0].get_title().get_text()


@pytest.mark.parametrize(
    "metrics, x", [({}, "iteration"), ({"gail": []}, "iteration"), ({"gail": [table(1.0)]}, "weeks")]
)
def test_curves_of_nothing_or_against_nothing_are_refused(metrics, x):
    with pytest.raises(ValueError):
        plotting.learning_curves(metrics, x)


def test_bars_show_means_deviations_and_every_seed():
    figure = plotting.bars(
        final({("true", 1): 700.0, ("gail", 1): 100.0, ("gail", 2): 300.0}), ["qd_score", "coverage"]
    )
    score, coverage = figure.axes
    assert [bar.get_width() for bar in score.patches] == [700.0, 200.0]
    assert [bar.get_width() for bar in coverage.patches] == pytest.approx([70.0, 20.0])
    dots = [line.get_xdata() for line in score.lines if line.get_marker() == "o"]
    assert [list(dot) for dot in dots] == [[700.0], [100.0, 300.0]]
    [whisker] = [c for c in score.collections if len(c.get_segments()) == 1]
    assert np.ptp(whisker.get_segments()[0][:, 0]) == pytest.approx(2 * 100 * np.sqrt(2))
    assert [tick.get_text() for tick in score.get_yticklabels()] == ["Expert", "GAIL"]


def test_bars_show_the_corrected_reading_below_the_claimed_one():
    claimed = final({("true", 1): 700.0, ("gail", 1): 100.0, ("gail", 2): 300.0})
    score, coverage = plotting.bars(
        claimed.assign(corrected_qd_score=[500.0, 10.0, 30.0]), ["qd_score", "coverage"]
    ).axes
    bars = [
        (round(bar.get_y() + bar.get_height() / 2, 3), bar.get_width(), bool(bar.get_hatch())) for bar in score.patches
    ]
    assert bars == [(-0.2, 700, False), (0.8, 200, False), (0.2, 500, True), (1.2, 20, True)]
    assert [bar.get_y() + bar.get_height() / 2 for bar in coverage.patches] == [0, 1]  # it has one reading
    assert [text.get_text() for text in score.figure.legends[0].get_texts()] == [
        "as claimed",
        "corrected (fresh episodes)",
    ]


def test_grids_put_every_experiment_where_its_settings_are():
    rows = {("mconbo-gail", 1): 10.0, ("mconbo-gail", 2): 30.0, ("mconbo-gail+bonus_q=1.0", 1): 50.0,
            ("mconbo-gail+bonus_p=0.0+bonus_q=1.0", 1): 70.0}  # fmt: skip
    ax = plotting.grid(final(rows)).axes[0]
    shown = np.ma.filled(ax.images[0].get_array(), np.nan)
    np.testing.assert_array_equal(shown, [[np.nan, 70.0], [20.0, 50.0]])  # p = 0, 0.5 up; q = 0.5, 1 across
    assert {text.get_text() for text in ax.texts} == {"no run", "70", "20", "50"}
    assert ax.get_xlabel() == "q" and ax.get_ylabel() == "p" and ax.get_title() == "mean over 1 to 2 seeds"


def test_a_grid_refuses_what_differs_in_more_than_its_two_settings():
    with pytest.raises(ValueError, match="differ in more"):
        plotting.grid(final({("mconbo-gail", 1): 1.0, ("mconbo-vail", 1): 1.0}))


@pytest.mark.parametrize("draw", [plotting.bars, lambda rows: plotting.grid(rows, metric="speed")])
def test_metrics_that_are_not_there_are_refused(draw):
    with pytest.raises(ValueError, match="cannot be drawn"):
        draw(final({("gail", 1): 1.0})[["coverage"]])


def test_many_archives_stand_in_rows_on_one_scale():
    def archive(value):
        return {"index": np.array([0, 1]), "measures": np.array([[0.2, 0.2], [0.2, 0.7]]), "cells": np.array([2, 2]),
                "true_return": np.array([0.0, value])}  # fmt: skip

    figure = plotting.archives_side_by_side(
        {name: archive(v) for v, name in enumerate(STUDIES["parts"] + ("true",), 1)}
    )
    meshes = [ax.collections[0] for ax in figure.axes if ax.collections and ax.get_title()]
    assert len(meshes) == 5 and {mesh.get_clim() for mesh in meshes} == {(0.0, 5.0)}
    assert len({ax.get_subplotspec().rowspan.start for ax in figure.axes if ax.get_title()}) == 2


def test_large_archives_stay_small_as_pdf(tmp_path):
    rng = np.random.default_rng(0)
    cells = {"index": np.arange(2500), "measures": (np.indices((50, 50)).reshape(2, -1).T + 0.5) / 50,
             "cells": np.array([50, 50]), "true_return": rng.normal(size=2500)}  # fmt: skip
    paths = plotting.save(plotting.archives_side_by_side(dict.fromkeys(["true", "gail"], cells)), tmp_path / "archives")
    assert [path.name for path in paths] == ["archives.png", "archives.pdf"]
    assert all(path.stat().st_size < 150_000 for path in paths)


def test_figures_leave_no_trace_in_pyplot():
    import matplotlib.pyplot as plt

    assert isinstance(plotting.learning_curves({"gail": table(1.0)}), Figure) and not plt.get_fignums()
