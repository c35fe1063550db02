"""Notebooks whose runs do not exist yet: each lists what is missing, and none raises an error."""

import json

import pytest
from fake_runs import write_run
from IPython.core.inputtransformer2 import TransformerManager
from test_notebooks import NAMES, code_of

from qdil.config import make_config, to_json
from qdil.lab import steps
from qdil.series import page

pytestmark = pytest.mark.compiles

ABOUT_RUNS = [name for name in NAMES if "05" <= name[:2] <= "11" or name[:2] == "13"]


@pytest.fixture
def root(tmp_path, monkeypatch):
    """An empty root, in which small experiments are over at once."""
    learn = steps.learn_in_rounds
    monkeypatch.setattr(steps, "learn_in_rounds", lambda *args: learn(*args[:3], 1, args[4]))
    monkeypatch.setattr(page, "ROOT", tmp_path)
    monkeypatch.chdir(tmp_path)  # so that the old folder comes back
    return tmp_path


def execute(name, env):
    """A notebook's code in this process, at ``laptop``, where nothing is trained that is missing."""
    scope = {}
    for code in code_of(name):
        lines = [line for line in code.splitlines() if not line.startswith("%")]
        if lines[0].startswith("budget ="):
            lines += ['budget = "laptop"', f'env = "{env}"']
        exec(compile(TransformerManager().transform_cell("\n".join(lines)), name, "exec"), scope)


@pytest.mark.parametrize("name", ABOUT_RUNS)
def test_an_expert_without_demonstrations_is_enough(name, root):
    """As where an expert's archive was kept and its policies were not."""
    expert = write_run(root / "results", "halfcheetah", "true", 1)
    (expert / "config.json").write_text(json.dumps(to_json(make_config("halfcheetah", "true", "laptop"))))
    execute(name, "halfcheetah")


@pytest.mark.parametrize("name", [name for name in ABOUT_RUNS if name[:2] in ("05", "10", "11")])
def test_nothing_at_all_is_enough(name, root):
    """For those notebooks that draw the expert."""
    execute(name, "humanoid")
    assert not (root / "results").exists()
