"""Requests that cannot be met end in exit code 2 and one sentence, before a run's modules are even imported."""

import os
import sys

import pytest

from qdil import plugins
from qdil.cli import COMMANDS, main
from qdil.config import GROUP_OF, IDENTITY


@pytest.fixture(autouse=True)
def no_run(monkeypatch):
    """Any attempt to begin a run fails; what ``--import`` sets is undone."""
    for module in ("qdil.runs.train", "qdil.ppga", "qdil.engine.engine"):
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setenv(plugins.VARIABLE, os.environ.get(plugins.VARIABLE, ""))
    yield
    plugins.load.cache_clear()


TRAIN = ["train", "--env", "walker2d", "--method", "gail", "--budget", "smoke"]
BROKEN = "broken_module_of_a_user"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["train", "--env", "crab", "--method", "gail"], "unknown robot 'crab'"),
        (["train", "--env", "crab", "--method", "gail", "--dry-run"], "unknown robot 'crab'"),
        (["train", "--env", "walker2d", "--method", "gial"], "unknown method 'gial'"),
        ([*TRAIN, "--budget", "huge"], "'huge'"),
        ([*TRAIN, "--seed", "-1"], "seed=-1"),
        ([*TRAIN, "--set", "rolout_length=3"], "rolout_length"),
        ([*TRAIN, "--set", "rollout_length"], "rollout_length"),
        ([*TRAIN, "--set", "rollout_length=long"], "rollout_length=long"),
        ([*TRAIN, "--set", "gamma=1.5"], "gamma=1.5 must be at most 1"),
        ([*TRAIN, "--set", "minibatches=5"], "minibatches=5"),
        ([*TRAIN, "--set", "num_envs=25"], "num_envs=25"),
        ([*TRAIN, "--set", "backend=bullet"], "backend=bullet"),
        ([*TRAIN, "--set", "env=humanoid"], "use --env"),
        (["--import", "no_such_module", *TRAIN], "'no_such_module'"),
        (["--import", BROKEN, *TRAIN], "robot 'cube' has 0 feet"),
        (["demos", "--env", "crab"], "unknown robot 'crab'"),
        (["demos", "--env", "walker2d", "--budget", "huge"], "'huge'"),
        (["demos", "--env", "walker2d", "--episodes", "0"], "--episodes 0"),
        (["demos", "--env", "walker2d", "--attempts", "0"], "--attempts 0"),
        (["diagnose"], "either the run's folder, or both"),
        (["diagnose", "--env", "crab", "--method", "gail"], "unknown robot 'crab'"),
        (["diagnose", "nowhere"], "no run in nowhere"),
        (["study", "fame", "--env", "walker2d"], "unknown study 'fame'"),
        (["study", "main", "--env", "crab"], "unknown robot 'crab'"),
    ],
)
def test_a_bad_request_is_refused_in_one_line(arguments, named, capsys, tmp_path, monkeypatch):
    (tmp_path / f"{BROKEN}.py").write_text(
        "from qdil.robots.register import register_robot\nregister_robot('cube', brax_env='ant')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("qdil: ") and named in captured.err
    assert captured.err.count("\n") == 1 and captured.err.endswith(".\n")


@pytest.mark.parametrize(
    "arguments", [[], ["fly"], ["train"], [*TRAIN, "--seed", "one"], [*TRAIN, "--colour", "red"], ["--import"]]
)
def test_a_malformed_command_exits_with_code_two(arguments, capsys):
    with pytest.raises(SystemExit) as exit_:
        main(arguments)
    assert exit_.value.code == 2
    assert "qdil" in capsys.readouterr().err


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command, capsys):
    with pytest.raises(SystemExit) as exit_:
        main([command, "--help"])
    assert exit_.value.code == 0
    text = capsys.readouterr().out
    assert f"qdil {command}" in text and len(text.splitlines()) > 5
    assert "default" in text or "[" not in text.replace("[-h]", "")  # an option that may be left out has a default


def test_the_help_of_train_lists_every_setting_once_under_a_heading(capsys):
    with pytest.raises(SystemExit):
        main(["train", "--help"])
    lines = capsys.readouterr().out.split("settings (")[1].splitlines()
    names = [line.split("=")[0].strip() for line in lines if line.startswith("  ")]
    assert sorted(names) == sorted(set(GROUP_OF) - set(IDENTITY))
    headings = [line for line in lines[1:] if line and not line.startswith(" ")]
    assert len(headings) == len(set(GROUP_OF.values()))
