"""A setting that is recorded has its effect: every one, changed in turn, changes a program or what a run leaves."""

import hashlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dial import SIZE, config_of, demonstrations, dial

from qdil.config import GROUP_OF, IDENTITY, choices, value_of
from qdil.engine import aot
from qdil.engine.engine import Engine
from qdil.errors import ConfigError
from qdil.imitation import demos as demonstrations_file
from qdil.imitation.reward_model import InputModel
from qdil.methods import bases, register
from qdil.qd import archive
from qdil.robots import register as robots
from qdil.runs.report import AfterIteration
from qdil.runs.train import train

pytestmark = pytest.mark.compiles

# Values that keep to the rules between settings, or that differ enough to be noticed in a short run.
OTHERS = {
    "num_envs": 30,
    "rollout_length": 40,
    "minibatches": 4,
    "devices": 1,
    "threshold_min": 1e3,
    "archive_learning_rate": 0.1,
    "giril_steps": 30,
    "eval_batch_size": 4,
    "diffail_levels": 3,
    "expert_seed": 3,
}
SMALL = {"iterations": 3, "giril_steps": 20, "eval_chunk_steps": 5}
# So few candidates and cells that some iterations add nothing, and the search restarts.
RESTARTS = {**SMALL, "iterations": 10, "candidates": 2, "cells": 2}
BASES = {"restart": RESTARTS, "rejects": RESTARTS}  # by how a setting's name begins
METHODS = {
    "vail": "mconbo-vail",
    "giril": "giril",
    "pwil": "pwil",
    "diffail": "diffail",
}  # by how a setting's name begins


def other_value(name, value):
    """A value that the setting may take, and that is not ``value``."""
    if name in OTHERS:
        return OTHERS[name]
    if choices(name):
        return next(choice for choice in choices(name) if choice != value)
    if isinstance(value, bool):
        return not value
    if isinstance(value, tuple):
        return (4, *value)
    return value + 1 if isinstance(value, int) else 0.5 * value if value else 0.5


class Texts:
    """Stands in for the compiler of ``qdil.engine.aot``: keeps the programs' text and compiles nothing."""

    def __init__(self):
        self.of = {}

    def __call__(self, program, *args):
        lowered, results = program.lower(*args)
        self.of[program.name] = hashlib.sha256(lowered.as_text().encode()).hexdigest()
        return results


def texts(config):
    engine, programs = Engine(config), Texts()
    key, demos = jax.random.key(config.seed), demonstrations(count=1)
    aot._compile_in_order(programs, engine.search, engine.reward, config, key, demos)
    return programs.of


@pytest.fixture(scope="module")
def demos_file(tmp_path_factory):
    """A file of one demonstration on two dials, of the expert of seed 1, and with the usual number of attempts."""
    steps = demonstrations(count=1)
    path = tmp_path_factory.mktemp("demos") / "demos-1.npz"
    rows = {name: np.asarray(values) for name, values in steps._asdict().items()}
    origin = {"expert_seed": np.array(1), "demo_attempts": np.array(config_of().demos.demo_attempts)}
    demonstrations_file.save(path, {**rows, **origin, "episode": np.zeros(len(steps.obs), int)}, dial())
    return path


@pytest.fixture(scope="module")
def outcome_of(demos_file, tmp_path_factory):
    """What a run leaves: its files but for times, the thresholds of its soft archive, or its refusal."""

    def outcome(config):
        folder, last = tmp_path_factory.mktemp("run"), []
        try:
            train(config, folder, demos_file, AfterIteration(lambda search, row: last.append((search, row))))
        except ConfigError as refusal:
            return str(refusal)
        rows = [{name: value for name, value in row.items() if name != "wall_seconds"} for _, row in last]
        soft = archive.content(last[-1][0].archives.soft)
        return rows, (folder / "archive.npz").read_bytes(), {name: soft[name].tobytes() for name in sorted(soft)}

    return outcome


@pytest.fixture(scope="module")
def usual(outcome_of):
    """Texts and outcome of the unchanged configuration of each method, computed once."""
    known = {}

    def of(method, base, what):
        key = method, what, base is SMALL
        if key not in known:
            known[key] = (texts if what == "texts" else outcome_of)(config_of(method, **base))
        return known[key]

    return of


@pytest.mark.parametrize("name", [name for name in GROUP_OF if name not in (*IDENTITY[:3], "backend")])
def test_every_setting_changes_a_program_or_what_a_run_leaves(name, usual, outcome_of):
    kind = name.split("_")[0]
    method, base = METHODS.get(kind, "mconbo-gail"), BASES.get(kind, SMALL)
    before = value_of(config_of(method, **base), name)
    config = config_of(method, **(base | {name: 2 if name == "seed" else other_value(name, before)}))
    assert value_of(config, name) != before
    if texts(config) == usual(method, base, "texts"):
        assert outcome_of(config) != usual(method, base, "outcome")


def test_the_backend_decides_how_a_robot_is_made(monkeypatch):
    asked = []
    monkeypatch.setattr(robots, "make", lambda name, backend: asked.append((name, backend)) or dial())
    from qdil.config import make_config

    for backend in ("spring", "positional"):
        Engine(make_config("walker2d", "true", "smoke", backend=backend))
    assert {backend for _, backend in asked} == {"spring", "positional"}


def test_a_reward_of_ones_own_reads_the_runs_settings_not_defaults():
    """A registered reward that returns a setting of PPO and one of the search, none of them a reward setting."""
    if "reads-settings" not in bases():

        @register("reads-settings", "gamma, and the seed")
        def reads_settings(config, widths):
            value = config.ppo.gamma + 10 * config.seed + 100 * config.ppo.rollout_length

            def reward(state, memory, inputs, ended):
                return memory, jnp.full(ended.shape, value)

            return InputModel(lambda key, expert: (), reward)

    engine = Engine(config_of("reads-settings", seed=3, gamma=0.75, **SMALL))
    state = engine.init(jax.random.key(0), demonstrations(count=1))
    rewards = float(engine.rollout(state, jnp.zeros((SIZE["cells"],) * 2, bool)).info.fitness_reward)
    assert rewards == pytest.approx(0.75 + 30 + 100 * SIZE["rollout_length"])
