"""Settings: what the paper and its authors used, and one plain sentence for whatever cannot work."""

import json
import subprocess
import sys
from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

from qdil.config import (
    BUDGETS,
    GROUP_OF,
    IDENTITY,
    SPEED_ONLY,
    Config,
    change,
    check,
    choices,
    descriptions,
    flat,
    from_json,
    make_config,
    parse_settings,
    settings_help,
    to_json,
    value_of,
)
from qdil.config.text import BEFORE
from qdil.errors import ConfigError
from qdil.methods import method_names, parse_method
from qdil.robots.register import PAPER_ROBOTS
from qdil.runs.folder import expert_seed_of

PAPER = {
    "actor_hidden": (128, 128),
    "critic_hidden": (256, 256),
    "num_envs": 3000,
    "rollout_length": 128,
    "episode_length": 1000,
    "minibatches": 8,
    "epochs": 4,
    "gamma": 0.99,
    "gae_lambda": 0.95,
    "clip": 0.2,
    "value_coef": 2.0,
    "entropy_coef": 0.0,
    "max_grad_norm": 1.0,
    "learning_rate": 1e-3,
    "target_kl": 0.008,
    "candidates": 300,
    "episodes": 10,
    "gradient_updates": 10,
    "walk_updates": 10,
    "warmup_updates": 0,
    "cells": 50,
    "sigma0": 1.0,
    "archive_learning_rate": 0.5,
    "threshold_min": 200.0,
    "iterations": 2000,
    "demo_episodes": 4,
    "bonus_p": 0.5,
    "bonus_q": 0.5,
    "reward_hidden": (100, 100),
    "reward_learning_rate": 3e-4,
    "gradient_penalty": 10.0,
    "selection": "learned",
    "backend": "spring",
}
HUMANOID = {"sigma0": 0.5, "archive_learning_rate": 0.1, "learning_rate": 3e-4}


def refused(call, *args, **changes) -> str:
    """The sentence with which ``call`` refuses its arguments."""
    with pytest.raises(ConfigError) as error:
        call(*args, **changes)
    sentence = str(error.value)
    assert "\n" not in sentence and sentence.endswith(".") and len(sentence) > 10
    return sentence


@pytest.mark.parametrize(
    ("env", "method", "changes"),
    [
        ("walker2d", "mconbo-gail", {}),
        ("humanoid", "mconbo-gail", HUMANOID),
        ("humanoid", "true", HUMANOID),
        ("halfcheetah", "gail", {"threshold_min": -500.0}),
        ("halfcheetah", "true", {}),
        ("halfcheetah", "mbo-true", {}),
    ],
)
def test_full_budget_is_the_papers(env, method, changes):
    config = flat(make_config(env, method, "full"))
    assert {name: config[name] for name in PAPER} == PAPER | changes


@pytest.mark.parametrize("env", [*PAPER_ROBOTS, "hopper", "ant"])
@pytest.mark.parametrize("budget", BUDGETS)
def test_every_method_is_allowed_on_every_robot_at_every_budget(env, budget):
    for method in method_names():
        config = make_config(env, method, budget, seed=3)
        assert (config.env, config.method, config.budget, config.seed) == (env, method, budget, 3)
        check(config)


def test_unknown_names_are_refused_with_what_would_be_right():
    assert "walker2d" in refused(make_config, "dog", "gail", "smoke")
    assert "laptop" in refused(make_config, "walker2d", "gail", "huge")
    assert "gail, vail" in refused(make_config, "walker2d", "bc", "smoke")
    assert "mconbo-gail" in refused(make_config, "walker2d", "mconbo-gial", "smoke")
    assert "'widnow'" in refused(make_config, "walker2d", "gail", "smoke", widnow=3)
    assert "gae_lambda" in refused(make_config, "walker2d", "gail", "smoke", gae_lamda=0.9)
    assert "rollout_length" in refused(make_config, "walker2d", "gail", "smoke", window=3)
    assert "'widnow'" in refused(change, make_config("walker2d", "gail", "smoke"), widnow=3)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("minibatches", 5),
        ("num_envs", 25),
        ("iterations", 0),
        ("rollout_length", -16),
        ("cells", 0),
        ("sigma0", 0.0),
        ("sigma0", float("nan")),
        ("threshold_min", float("nan")),
        ("learning_rate", -1e-3),
        ("learning_rate", float("inf")),
        ("target_kl", 0.0),
        ("gamma", 0.0),
        ("gamma", 1.01),
        ("gae_lambda", float("nan")),
        ("archive_learning_rate", 0.0),
        ("archive_learning_rate", 1.5),
        ("bonus_p", -0.1),
        ("bonus_q", float("nan")),
        ("seed", -1),
        ("devices", -1),
        ("actor_hidden", ()),
        ("critic_hidden", (64, 0)),
        ("backend", "bullet"),
        ("selection", "both"),
        ("iterations", "7"),
        ("iterations", 2.0),
        ("iterations", True),
        ("gamma", "0.9"),
        ("gamma", None),
        ("sigma0", True),
        ("sample_actions", 1),
        ("sample_actions", "true"),
        ("actor_hidden", 64),
        ("actor_hidden", (64, 0.5)),
        ("backend", 3),
        ("episode_length", "short"),
    ],
)
def test_what_cannot_work_is_refused_by_name(name, value):
    for method in ("gail", "airl"):  # the second has a threshold that follows from other settings
        assert refused(make_config, "walker2d", method, "smoke", **{name: value}).startswith(f"{name}=")


def test_refusals_say_what_would_be_right():
    def sentence(**changes):
        return refused(make_config, "walker2d", "gail", "smoke", **changes)

    assert sentence(iterations=0) == "iterations=0 must be at least 1."
    assert sentence(iterations="7") == "iterations='7' must be an integer."
    assert sentence(sample_actions=1) == "sample_actions=1 must be true or false."
    assert sentence(gamma=float("nan")) == "gamma=nan must be a finite number."
    assert sentence(minibatches=5) == "minibatches=5 must divide rollout_length=16."
    assert sentence(selection="both") == "selection=both must be one of learned, true."
    assert "divisible by 3," in sentence(num_envs=25) and "2 measures of walker2d" in sentence(num_envs=25)
    assert "divisible by 2," in refused(make_config, "hopper", "gail", "smoke", num_envs=25)


def test_changes_go_on_top_of_the_budget():
    config = make_config("walker2d", "gail", "laptop", sigma0=0.25, actor_hidden=(7,))
    plain = make_config("walker2d", "gail", "laptop")
    assert flat(config) == flat(plain) | {"sigma0": 0.25, "actor_hidden": (7,)}
    assert config == change(plain, sigma0=0.25, actor_hidden=(7,)) != plain
    assert (config.ppga.sigma0, config.ppo.actor_hidden) == (0.25, (7,))


def test_a_configuration_is_a_value():
    config, same, other = (make_config("walker2d", "gail", "smoke", gamma=gamma) for gamma in (0.9, 0.9, 0.8))
    assert config == same and hash(config) == hash(same) and config != other and len({config, same, other}) == 2
    assert config.ppo == same.ppo != other.ppo and config.ppga == other.ppga
    for holder, name in ((config, "seed"), (config.ppo, "gamma")):
        with pytest.raises(FrozenInstanceError):
            setattr(holder, name, 1)


def test_settings_are_typed():
    pairs = ["iterations=7", "sigma0=0.5", "actor_hidden=64,32", "bonus_in_fitness=True", "selection=true"]
    settings = parse_settings(pairs)
    assert settings == {
        "iterations": 7,
        "sigma0": 0.5,
        "actor_hidden": (64, 32),
        "bonus_in_fitness": True,
        "selection": "true",
    }
    assert [type(value) for value in settings.values()] == [int, float, tuple, bool, str]
    assert parse_settings(["sigma0=2", "sample_actions=false"]) == {"sigma0": 2.0, "sample_actions": False}


@pytest.mark.parametrize(
    "pair",
    [
        "sigma0",
        "sigma=1",
        "=1",
        "",
        "iterations=1.5",
        "sigma0=big",
        "actor_hidden=64;64",
        "sample_actions=yes",
        "window=3",
        "protocol=mine",
        "gamma=2",
        "devices=two",
        "selection=",
    ],  # fmt: skip
)
def test_settings_that_do_not_fit_are_refused(pair):
    assert f"--set {pair}" in refused(parse_settings, [pair])


@pytest.mark.parametrize("pair", ["env=humanoid", "method=gail", "budget=full", "seed=2"])
def test_what_has_its_own_option_is_no_setting(pair):
    refused(lambda: make_config("walker2d", "gail", "smoke", 1, **parse_settings([pair])))


def test_help_names_every_setting():
    text = settings_help()
    explained = {line.split("=")[0].strip() for line in text.splitlines() if line.startswith("  ")}
    assert explained == set(GROUP_OF) - set(IDENTITY) == set(descriptions())


# config.json


def other_value(name, value):
    """A value that differs from a setting's default and that the setting can take."""
    if name == "backend":
        return "mjx"
    if choices(name):
        return next(word for word in choices(name) if word != value)
    if isinstance(value, bool):
        return not value
    chosen = {"num_envs": 48, "rollout_length": 32, "minibatches": 4}
    chosen |= {"actor_hidden": (8, 4), "critic_hidden": (8,), "reward_hidden": (7,)}
    return chosen.get(name) or (value / 2 if isinstance(value, float) and value else type(value)(value + 1))


@pytest.mark.parametrize("name", descriptions())
def test_every_setting_survives_json(name):
    plain = make_config("walker2d", "mcond-gail", "smoke", seed=5)
    value = other_value(name, value_of(plain, name))
    config = change(plain, **{name: value})
    again = from_json(json.loads(json.dumps(to_json(config))))
    assert again == config != plain and value_of(again, name) == value
    assert type(value_of(again, name)) is type(value_of(plain, name))


@pytest.mark.parametrize("budget", BUDGETS)
def test_json_round_trip(budget):
    config = make_config("humanoid", "mcond-gail", budget, seed=5, reward_hidden=(7, 6))
    assert from_json(json.loads(json.dumps(to_json(config)))) == config


def kept():
    """The content of ``config.json`` as the first version wrote it: that of a run kept in the repository."""
    names = {"rollout_length": "window", "eval_chunk_steps": "eval_chunk", "eval_batch_size": "eval_tile"}
    content = {names.get(n, n): v for n, v in to_json(make_config("walker2d", "mconbo-gail", "laptop")).items()}
    del content["eval_chunks_per_sync"]
    return content | {"window": 128, "eval_tile": 24, "bonus_scope": "window"}


def test_old_names_are_read():
    config = from_json(kept())
    assert (config.ppo.rollout_length, config.evaluation.eval_batch_size) == (128, 24)
    assert config.bonus.bonus_scope == "rollout" and config.evaluation.eval_chunk_steps == 25
    assert config.evaluation.eval_chunks_per_sync == Config.evaluation.eval_chunks_per_sync


@pytest.mark.parametrize(("seed", "expert_seed"), [(1, 0), (2, 1), (7, 1)])
def test_runs_of_earlier_versions_learned_from_the_expert_of_seed_1(seed, expert_seed):
    """For the run of seed 1 that is the expert of its own seed, which is written as 0."""
    content = to_json(make_config("walker2d", "gail", "laptop", seed))
    del content["expert_seed"], content["demo_attempts"]
    config = from_json(content)
    assert (config.demos.expert_seed, config.demos.demo_attempts) == (expert_seed, 1)
    assert expert_seed_of(config) == 1
    written = from_json(content | {"expert_seed": 5, "demo_attempts": 3})
    assert (written.demos.expert_seed, written.demos.demo_attempts) == (5, 3)


RUNS = sorted(Path(__file__).parent.parent.glob("results/*/*/*/seed-*/config.json"))


@pytest.mark.skipif(not RUNS, reason="no kept runs here")
def test_kept_runs_are_read():
    for path in RUNS:
        content = json.loads(path.read_text())
        config = from_json(content)
        for name in set(content) & set(GROUP_OF):
            assert to_json(config)[name] == content[name]
        assert config.ppo.rollout_length == content.get("window", content.get("rollout_length"))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"wings": 2}, "wings (unknown)"),
        ({"gamma": None}, "gamma=None must be a number"),
        ({"gamma": "0.9"}, "gamma='0.9' must be a number"),
        ({"iterations": 1.0}, "iterations=1.0 must be an integer"),
        ({"iterations": True}, "iterations=True must be an integer"),
        ({"actor_hidden": 64}, "actor_hidden=64 must be integers"),
        ({"actor_hidden": [64, "64"]}, "actor_hidden='64' must be"),
        ({"selection": "both"}, "selection=both must be one of learned, true"),
        ({"bonus_scope": "year"}, "bonus_scope=year must be one of episode, rollout"),
        ({"env": "dog"}, "'dog'"),
        ({"method": "gial"}, "'gial'"),
    ],
)
def test_a_config_that_cannot_be_is_refused(changes, named):
    content = to_json(make_config("walker2d", "gail", "smoke")) | changes
    assert named in refused(from_json, content)


@pytest.mark.parametrize("name", GROUP_OF)
def test_only_settings_of_speed_and_what_earlier_versions_did_may_be_missing(name):
    content = to_json(make_config("walker2d", "gail", "smoke"))
    del content[name]
    if name in SPEED_ONLY or name in BEFORE or name == "expert_seed":
        from_json(content)
    else:
        assert f"{name} (missing)" in refused(from_json, content)


@pytest.mark.physics
def test_reading_settings_needs_no_jax():
    program = """
import sys, qdil.config, qdil.methods, qdil.plugins, qdil.robots.register
qdil.config.make_config("ant", "mconbo-gail", "laptop")
print([name for name in ("jax", "brax", "mujoco", "numpy") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# The released program's choices


RELEASED_BY_HAND = {
    "selection": "true",
    "walk_weights": "fitness",
    "fitness_coefficient": "signed",
    "xnes_center": "random",
    "rejects": "difference",
    "restart_order": "before-walk",
    "restart_statistics": "other",
    "restart_samples": "same",
    "copies_scaled": "together",
    "reward_schedule": "update",
    "reward_steps": 1,
    "bonus_scope": "rollout",
    "bonus_p": 0.0,
    "bonus_q": 2.0,
    "expert_alignment": "shifted",
    "expert_obs": "raw",
    "expert_batches": "first",
    "penalty_mixing": "element",
    "vail_beta": "fixed",
    "vail_encoder": "squashed",
    "vail_visits": True,
    "pwil_coupling": "step",
    "pwil_alpha": 1.0,
    "pwil_beta": 1.0,
    "diffail_steps": 100,
    "diffail_penalty": 10.0,
    "diffail_loss": "logit",
    "diffail_reward": "element",
}


@pytest.mark.parametrize("budget", BUDGETS)
@pytest.mark.parametrize("method", ["true", "mconbo-gail", "vail-obs", "mbo-airl"])
def test_the_released_protocol_changes_what_it_lists_and_nothing_else(budget, method):
    usual, released = (flat(make_config("humanoid", method, budget, protocol=p)) for p in ("paper", "released"))
    assert usual == flat(make_config("humanoid", method, budget))
    assert released == usual | RELEASED_BY_HAND | {"protocol": "released"}
    assert all(usual[name] != value for name, value in RELEASED_BY_HAND.items())


@pytest.mark.parametrize("name", list(RELEASED_BY_HAND))
def test_an_explicit_setting_wins_over_the_protocol(name):
    papers = value_of(make_config("walker2d", "mconbo-vail", "smoke"), name)
    config = make_config("walker2d", "mconbo-vail", "smoke", protocol="released", **{name: papers})
    assert {n: value_of(config, n) for n in RELEASED_BY_HAND} == RELEASED_BY_HAND | {name: papers}


# Rewards of either sign


SIGNED = ("airl", "maxent", "zero")


@pytest.mark.parametrize("env", PAPER_ROBOTS)
@pytest.mark.parametrize(("budget", "length"), [("full", 1000), ("laptop", None), ("smoke", 50)])
def test_archives_of_rewards_that_may_be_negative_start_low(env, budget, length):
    length = length or (200 if env == "halfcheetah" else 300)
    for method in method_names():
        config = make_config(env, method, budget)
        assert config.simulation.episode_length == length
        assert (config.ppga.threshold_min == -10.0 * length) == (parse_method(method).base.name in SIGNED)


def test_the_low_start_follows_the_episodes_length_and_gives_way():
    assert make_config("walker2d", "mconbo-airl", "laptop", episode_length=7).ppga.threshold_min == -70
    assert make_config("walker2d", "airl-obs", "laptop", threshold_min=3.0).ppga.threshold_min == 3


@pytest.mark.parametrize(
    "name",
    [
        "protocol", "expert_alignment", "expert_obs", "bonus_scope", "penalty_mixing", "vail_beta", "pwil_coupling",
        "walk_weights", "selection", "backend", "expert_batches", "vail_encoder", "diffail_loss", "diffail_reward",
    ],
)  # fmt: skip
@pytest.mark.parametrize("wrong", ["", "neither", "Paper", "raw,normalised", None])
def test_choices_refuse_what_is_none_of_theirs(name, wrong):
    sentence = refused(make_config, "walker2d", "gail", "smoke", **{name: wrong})
    assert sentence.startswith(f"{name}=")
    if name != "backend" or wrong is not None:
        assert value_of(make_config("walker2d", "gail", "full"), name) in sentence


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("vail_information", -0.1),
        ("vail_beta_rate", 0.0),
        ("vail_latent", 0),
        ("giril_steps", 0),
        ("giril_learning_rate", 0.0),
        ("giril_action_weight", -1.0),
        ("pwil_alpha", 0.0),
        ("pwil_beta", -5.0),
        ("diffail_steps", 0),
        ("diffail_penalty", -0.1),
        ("gradient_penalty", float("inf")),
    ],
)
def test_reward_settings_that_cannot_work_are_refused(name, value):
    assert refused(make_config, "walker2d", "vail", "smoke", **{name: value}).startswith(f"{name}=")


# Robots of any number of measures


def cells_and_envs(env, budget, method="true"):
    config = make_config(env, method, budget)
    return config.ppga.cells, config.ppo.num_envs


@pytest.mark.parametrize(
    ("budget", "env", "cells", "envs"),
    [
        ("smoke", "walker2d", 5, 24), ("smoke", "humanoid", 5, 24), ("smoke", "halfcheetah", 5, 24),
        ("laptop", "walker2d", 20, 192), ("laptop", "humanoid", 20, 192), ("laptop", "halfcheetah", 15, 96),
        ("full", "walker2d", 50, 3000), ("full", "humanoid", 50, 3000), ("full", "halfcheetah", 50, 3000),
    ],
)  # fmt: skip
def test_the_papers_robots_keep_their_budgets(budget, env, cells, envs):
    assert cells_and_envs(env, budget) == (cells, envs)


@pytest.mark.parametrize("env", ["hopper", "ant"])
@pytest.mark.parametrize("budget", BUDGETS)
def test_other_robots_get_counts_near_the_budgets(env, budget):
    k = {"hopper": 1, "ant": 4}[env]
    (usual_cells, usual_envs), (cells, envs) = cells_and_envs("walker2d", budget), cells_and_envs(env, budget)
    assert envs % (1 + k) == 0 and envs % 4 == 0  # its copies of the policy, four devices
    assert usual_envs <= envs < usual_envs + 4 * (1 + k)
    if k == 1:
        assert usual_cells < cells < usual_cells**2
        assert cells // 5 >= 2 * make_config(env, "gail", budget).demos.demo_episodes or budget == "full"
    else:
        assert 0.5 < cells**k / usual_cells**2 < 2
