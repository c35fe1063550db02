"""Notebook 02 takes an iteration apart: a cell that is executed again gives the same numbers and changes no others."""

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from IPython.core.inputtransformer2 import TransformerManager
from ribs.archives import GridArchive
from test_notebooks import code_of

from qdil.lab import dissect
from qdil.qd import archive
from qdil.qd.xnes import XNES

pytestmark = pytest.mark.physics


def test_a_cell_of_notebook_02_gives_the_same_when_it_is_executed_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # so that the old folder comes back
    cells = code_of("02_ppga")
    stop = next(number for number, code in enumerate(cells) if "page.runs(" in code)
    scope = {}
    for number, code in enumerate(cells[:stop]):
        execute(code, scope)
        if number == 0:
            scope["budget"] = "smoke"
            continue
        first = numbers_in(scope)
        execute(code, scope)
        again = numbers_in(scope)
        assert first.keys() == again.keys()
        changed = [name for name in first if not same(first[name], again[name])]
        assert not changed, f"executed again, this cell changes {', '.join(changed)}:\n{code}"
    assert len(first["improvement"][0]) and first["search"] and first["followed"]


def execute(code, scope):
    lines = "\n".join(line for line in code.splitlines() if not line.startswith("%"))
    exec(compile(TransformerManager().transform_cell(lines), "02_ppga", "exec"), scope)


def numbers_in(scope):
    """The numbers in every variable that holds any, archives and random generators included."""
    found = {name: [x for leaf in jax.tree.leaves(value) for x in numbers_of(leaf)] for name, value in scope.items()}
    return {name: numbers for name, numbers in found.items() if numbers and not name.startswith("__")}


def numbers_of(leaf):
    if isinstance(leaf, GridArchive):
        return list(archive.content(leaf).values())
    if isinstance(leaf, XNES):
        return [*dissect.distribution(leaf), str(leaf.rng.bit_generator.state)]
    if isinstance(leaf, np.random.Generator):
        return [str(leaf.bit_generator.state)]
    if isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        leaf = jax.random.key_data(leaf)
    if isinstance(leaf, pd.DataFrame):
        return [leaf]
    return [np.array(leaf)] if isinstance(leaf, jax.Array | np.ndarray | float | int | str) else []


def same(ones, others):
    return len(ones) == len(others) and all(map(equal, ones, others))


def equal(one, other):
    if isinstance(one, pd.DataFrame):
        return one.equals(other)  # missing values are equal to missing values
    if isinstance(one, np.ndarray) and one.dtype.kind in "fc":
        return np.array_equal(one, other, equal_nan=True)
    return np.array_equal(one, other)
