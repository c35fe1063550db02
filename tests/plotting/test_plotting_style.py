"""One style for all figures, applied only while they are made; and a package that is quick to import."""

import pkgutil
import subprocess
import sys

import matplotlib
import pandas as pd
import pytest
from matplotlib.figure import Figure

import qdil.plotting
from qdil import plotting
from qdil.plotting import comparisons
from qdil.plotting.style import styled

MODULES = [f"qdil.plotting.{module.name}" for module in pkgutil.iter_modules(qdil.plotting.__path__)]


@pytest.mark.physics  # a process, though without physics
def test_importing_all_figures_and_drawing_finished_runs_does_not_import_jax():
    code = f"""
import sys, numpy, pandas
import {", ".join(MODULES)}
from qdil import plotting
from qdil.plotting import demonstrations
assert "jax" not in sys.modules, "on import"
archive = {{"index": [0], "cells": [2, 2], "true_return": [1.0], "measures": numpy.zeros((1, 2))}}
table = pandas.DataFrame({{"iteration": [1], "qd_score": [1.0], "coverage": [0.1], "best": [1.0], "average": [1.0]}})
plotting.archives_side_by_side({{"mcond-airl": archive}}, robot="walker2d")
plotting.behaviour_space(archive, {{"elite_measures": numpy.zeros((1, 2))}})
demonstrations.selection(archive, 1)
plotting.learning_curves({{"mcond-airl": table, "my own": table}})
index = pandas.MultiIndex.from_tuples([("gail+bonus_p=0.0", 1)], names=["experiment", "seed"])
plotting.bars(table.set_index(index), ["qd_score"])
plotting.grid(table.set_index(index))
assert "jax" not in sys.modules, "on drawing"
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_figures_have_the_style_and_leave_matplotlibs_settings_alone():
    before = dict(matplotlib.rcParams)
    [ax] = comparisons.curves({"loss": pd.DataFrame({"a": [1.0, 2.0], "b": [2.0, 1.0]})}, "updates", "").axes
    assert dict(matplotlib.rcParams) == before
    assert not ax.spines.top.get_visible() and not ax.spines.right.get_visible() and ax.spines.left.get_visible()
    assert ax.xaxis.get_gridlines()[0].get_visible() and ax.get_axisbelow() is True
    assert not ax.figure.legends[0].get_frame_on() and ax.figure.get_layout_engine() is not None


def test_a_map_has_a_border_and_no_grid():
    archive = {"index": [0], "cells": [2, 2], "true_return": [1.0]}
    ax = plotting.archives_side_by_side({"true": archive}).axes[0]
    assert all(spine.get_visible() for spine in ax.spines.values())
    assert not any(line.get_visible() for line in ax.xaxis.get_gridlines())


def test_the_style_ends_also_where_a_figure_is_refused():
    before = dict(matplotlib.rcParams)

    @styled
    def refused():
        Figure().subplots()
        raise ValueError("nothing to draw")

    with pytest.raises(ValueError):
        refused()
    assert dict(matplotlib.rcParams) == before
