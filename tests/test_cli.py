"""Requests that cannot be met: exit code 2 and one line, before a run is even imported."""

import sys

import pytest

import qdil
from qdil.cli import COMMANDS, main


@pytest.fixture(autouse=True)
def no_run(monkeypatch):
    """Any attempt to begin a run fails."""
    monkeypatch.delattr(qdil, "run", raising=False)
    monkeypatch.setitem(sys.modules, "qdil.runs.train", None)


TRAIN = ["train", "--env", "walker2d", "--method", "gail", "--budget", "smoke"]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["train", "--env", "ant", "--method", "gail"], "'ant'"),
        (["train", "--env", "walker2d", "--method", "gial"], "'gial'"),
        ([*TRAIN, "--budget", "huge"], "'huge'"),
        ([*TRAIN, "--seed", "-1"], "seed=-1"),
        ([*TRAIN, "--set", "widnow=3"], "widnow"),
        ([*TRAIN, "--set", "window"], "window"),
        ([*TRAIN, "--set", "window=wide"], "wide"),
        ([*TRAIN, "--set", "minibatches=5"], "minibatches=5"),
        ([*TRAIN, "--set", "num_envs=25"], "num_envs=25"),
        ([*TRAIN, "--set", "env=humanoid"], "env"),
        (["demos", "--env", "ant"], "'ant'"),
        (["demos", "--env", "walker2d", "--budget", "huge"], "'huge'"),
        (["demos", "--env", "walker2d", "--episodes", "0"], "--episodes 0"),
    ],
)
def test_a_bad_request_is_refused_in_one_line(arguments, named, capsys):
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("qdil: ") and named in said.err
    assert said.err.count("\n") == 1 and said.err.endswith(".\n")


@pytest.mark.parametrize("arguments", [[], ["fly"], ["train"], [*TRAIN, "--seed", "one"], [*TRAIN, "--colour", "red"]])
def test_a_malformed_command_exits_with_code_two(arguments, capsys):
    with pytest.raises(SystemExit) as leaving:
        main(arguments)
    assert leaving.value.code == 2
    assert "qdil" in capsys.readouterr().err


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command, capsys):
    with pytest.raises(SystemExit) as leaving:
        main([command, "--help"])
    assert leaving.value.code == 0
    said = capsys.readouterr().out
    assert f"qdil {command}" in said and len(said.splitlines()) > 5
    assert "default" in said or "[" not in said.replace("[-h]", "")  # what may be left out has a default
