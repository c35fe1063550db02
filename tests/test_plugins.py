"""A user's own modules: found by name or by an installed package, on the command line, and refused in a sentence."""

import os
import subprocess
import sys

import pytest

from qdil import methods, plugins
from qdil.errors import ConfigError
from qdil.robots import register

MODULE = """
import jax
import jax.numpy as jnp
from qdil.imitation.reward_model import InputModel
from qdil.methods import register
from qdil.robots.environment import Environment, Outcome, RobotState
from qdil.robots.register import register_robot


@register("near", "minus the distance to the demonstrations' mean", signed=True)
def near(config, widths):
    def reward(state, memory, inputs, ended):
        return memory, -jnp.linalg.norm(inputs.obs - state, axis=-1)

    return InputModel(init=lambda key, expert: expert.obs.mean(axis=0), reward=reward)


def at(position):
    return RobotState(position, position, (position > 0.5).astype(jnp.float32))


def step(state, action):
    position = state.physics + 0.1 * jnp.clip(action, -1.0, 1.0)
    return at(position), Outcome(position.sum(), jnp.any(position > 3.0), jnp.ones((), bool))


three = Environment("three", "points", 3, 3, ("left", "middle", "right"), 0.1, lambda key: at(jnp.zeros(3)), step)
register_robot("three", environment=three)
register_robot("ant-1", brax_env="ant", feet=["left_foot_geom"])
"""


@pytest.fixture
def fresh(monkeypatch):
    """No plugin is loaded; what the test registers is forgotten afterwards."""
    monkeypatch.setattr(methods, "_BASES", dict(methods._BASES))
    monkeypatch.setattr(register, "_ROBOTS", dict(register._ROBOTS))
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setenv(plugins.VARIABLE, "")  # so that it is restored, too
    plugins.load.cache_clear()
    modules = set(sys.modules)
    yield
    for name in set(sys.modules) - modules:
        if name.startswith("my_"):
            del sys.modules[name]
    plugins.load.cache_clear()


def refused(call, *args) -> str:
    with pytest.raises(ConfigError) as error:
        call(*args)
    sentence = str(error.value)
    assert "\n" not in sentence and sentence.endswith(".")
    return sentence


# In one process


def test_a_module_in_the_working_directory_is_found(fresh, tmp_path, monkeypatch):
    (tmp_path / "my_module.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    assert "near" not in methods.bases() and "three" not in register.robot_names()
    plugins.request(["my_module"])
    assert methods.parse_method("mcond-near-obs").base.name == "near"
    assert register.count_measures("three") == 3
    assert os.environ[plugins.VARIABLE] == "my_module"  # what processes of this one import, too


def test_requests_add_up_and_repeat_without_harm(fresh, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("my_a", "my_b"):
        (tmp_path / f"{name}.py").write_text(f"from qdil.methods import register\nregister('{name[3:]}1', '')(print)\n")
        plugins.request([name, name])
    plugins.request(["my_a"])
    assert os.environ[plugins.VARIABLE] == "my_a,my_b"
    assert list(methods.bases())[-2:] == ["a1", "b1"]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("raise RuntimeError('half\\ninstalled')", "RuntimeError: half installed"),
        ("this is no Python", "SyntaxError"),
        ("import nowhere_to_be_found", "No module named 'nowhere_to_be_found'"),
        ("from qdil.robots.register import register_robot\nregister_robot('dog', brax_env='ant')", "0 feet"),
        ("from qdil.methods import register\nregister('gail', 'mine')(print)", "already a reward model called 'gail'"),
    ],
)
def test_a_module_that_cannot_be_loaded_is_named(fresh, tmp_path, monkeypatch, text, named):
    (tmp_path / "my_broken.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    plugins.request(["my_broken"])
    sentence = refused(methods.bases)
    assert "'my_broken' named by --import" in sentence and named in sentence


def test_a_module_that_is_nowhere_is_named(fresh):
    plugins.request(["my_lost_module"])
    assert "'my_lost_module'" in refused(register.robot_names)


def install(folder, text):
    """A package ``qdil-elsewhere`` as an installer leaves it, with an entry point."""
    (folder / "my_elsewhere.py").write_text(text)
    info = folder / "qdil_elsewhere-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: qdil-elsewhere\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{plugins.ENTRY_POINTS}]\nmine = my_elsewhere\n")


def test_installed_packages_are_found_by_their_entry_points(fresh, tmp_path, monkeypatch):
    install(tmp_path, MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    assert methods.parse_method("mcond-near-obs").base.build is sys.modules["my_elsewhere"].near
    assert "three" in register.robot_names()


def test_an_installed_package_that_cannot_be_loaded_is_named(fresh, tmp_path, monkeypatch):
    install(tmp_path, "raise RuntimeError('half installed')\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert "plugin 'mine' cannot be loaded (RuntimeError: half installed)" in refused(methods.bases)


# On the command line


def qdil(folder, *arguments):
    command = [sys.executable, "-m", "qdil", *arguments]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    environment.pop(plugins.VARIABLE, None)
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)


TRAIN = ["train", "--method", "mconbo-near", "--budget", "smoke"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mine")
    (folder / "my_module.py").write_text(MODULE)
    (folder / "my_broken.py").write_text("raise RuntimeError('half installed')\n")
    return folder


@pytest.mark.physics
def test_the_command_line_lists_an_imported_method(folder):
    done = qdil(folder, "--import", "my_module", "methods")
    assert done.returncode == 0 and done.stderr == ""
    lines = dict(line.split("  ", 1) for line in done.stdout.splitlines())
    assert "mconbo-near-obs" in {name.strip() for name in lines} and "true" in {name.strip() for name in lines}


@pytest.mark.physics
def test_the_command_line_plans_a_run_of_an_imported_robot_and_reward(folder):
    done = qdil(folder, "--import", "my_module", *TRAIN, "--env", "three", "--dry-run")
    assert done.returncode == 0, done.stderr
    assert '"env": "three"' in done.stdout and '"method": "mconbo-near"' in done.stdout and "estimate" in done.stdout


@pytest.mark.physics
@pytest.mark.parametrize(("env", "copies"), [("three", 4), ("ant-1", 2)])
def test_settings_of_an_imported_robot_are_checked(folder, env, copies):
    done = qdil(folder, "--import", "my_module", *TRAIN, "--env", env, "--set", "num_envs=25")
    assert done.returncode == 2 and f"divisible by {copies}," in done.stderr


@pytest.mark.physics
@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--import", "my_broken", "methods"], "'my_broken'"),
        (["--import", "my_lost", "train", "--env", "walker2d", "--method", "true"], "'my_lost'"),
        (["--import", "my_module", *TRAIN, "--env", "dog"], "'dog'"),
        ([*TRAIN, "--env", "walker2d"], "'mconbo-near'"),
    ],
)
def test_what_cannot_be_found_ends_in_a_sentence_and_code_two(folder, arguments, named):
    done = qdil(folder, *arguments)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("qdil: ") and named in done.stderr and done.stderr.count("\n") == 1
