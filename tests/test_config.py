"""Settings: what the paper and its authors used, and one plain sentence for whatever cannot work."""

import json
from dataclasses import asdict, fields, replace

import pytest

from qdil.config import (
    BUDGETS,
    ROBOTS,
    Config,
    ConfigError,
    check,
    from_json,
    make_config,
    parse_settings,
    settings_help,
    to_json,
)
from qdil.methods import Method, method_names, parse_method

PAPER = {
    "actor_hidden": (128, 128),
    "critic_hidden": (256, 256),
    "num_envs": 3000,
    "window": 128,
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
    config = asdict(make_config(env, method, "full"))
    assert {name: config[name] for name in PAPER} == PAPER | changes


@pytest.mark.parametrize("env", ROBOTS)
@pytest.mark.parametrize("budget", BUDGETS)
@pytest.mark.parametrize("method", method_names())
def test_every_method_is_allowed_on_every_robot_at_every_budget(env, budget, method):
    config = make_config(env, method, budget, seed=3)
    assert (config.env, config.method, config.budget, config.seed) == (env, method, budget, 3)
    check(config)


@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("true", Method("true", False, False)),
        ("mbo-true", Method("true", False, True)),
        ("gail", Method("gail", False, False)),
        ("mcond-gail", Method("gail", True, False)),
        ("mbo-gail", Method("gail", False, True)),
        ("mconbo-gail", Method("gail", True, True)),
    ],
)
def test_methods_come_apart(name, method):
    assert parse_method(name) == method
    assert name in method_names()


@pytest.mark.parametrize("name", ["", "gial", "mconbo", "mconbo-", "mbo-mcond-gail", "GAIL", "gail-mbo", "mcond-true"])
def test_unknown_methods_are_refused(name):
    sentence = refused(parse_method, name)
    assert f"'{name}'" in sentence and "true" in sentence


def test_unknown_names_are_refused_with_what_would_be_right():
    assert "walker2d" in refused(make_config, "ant", "gail", "smoke")
    assert "laptop" in refused(make_config, "walker2d", "gail", "huge")
    assert "mconbo-gail" in refused(make_config, "walker2d", "bc", "smoke")
    assert "'widnow'" in refused(make_config, "walker2d", "gail", "smoke", widnow=3)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("minibatches", 5),
        ("num_envs", 25),
        ("iterations", 0),
        ("window", -16),
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
    ],
)
def test_what_cannot_work_is_refused_by_name(name, value):
    assert refused(make_config, "walker2d", "gail", "smoke", **{name: value}).startswith(f"{name}=")


def test_changes_go_on_top_of_the_budget():
    config = make_config("walker2d", "gail", "laptop", sigma0=0.25, actor_hidden=(7,))
    assert config == replace(make_config("walker2d", "gail", "laptop"), sigma0=0.25, actor_hidden=(7,))


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
    ["sigma0", "sigma=1", "=1", "", "iterations=1.5", "sigma0=big", "actor_hidden=64;64", "sample_actions=yes"],
)
def test_settings_that_do_not_fit_are_refused(pair):
    assert f"--set {pair}" in refused(parse_settings, [pair])


@pytest.mark.parametrize("pair", ["env=humanoid", "method=gail", "budget=full", "seed=2"])
def test_what_has_its_own_option_is_no_setting(pair):
    refused(lambda: make_config("walker2d", "gail", "smoke", 1, **parse_settings([pair])))


def test_help_names_every_setting():
    text = settings_help()
    explained = {line.split("=")[0].strip() for line in text.splitlines()[1:]}
    assert explained == {f.name for f in fields(Config)} - {"env", "method", "budget", "seed"}


@pytest.mark.parametrize("budget", BUDGETS)
def test_json_round_trip(budget):
    config = make_config("humanoid", "mcond-gail", budget, seed=5)
    assert from_json(json.loads(json.dumps(to_json(config)))) == config


# The released program's choices


RELEASED_BY_HAND = {
    "selection": "true",
    "walk_weights": "fitness",
    "bonus_scope": "window",
    "bonus_p": 0.0,
    "bonus_q": 2.0,
    "expert_alignment": "shifted",
    "expert_obs": "raw",
    "penalty_mixing": "element",
    "vail_beta": "fixed",
    "pwil_coupling": "step",
}


@pytest.mark.parametrize("budget", BUDGETS)
@pytest.mark.parametrize("method", ["true", "mconbo-gail", "vail-obs", "mbo-airl"])
def test_the_released_protocol_changes_what_it_lists_and_nothing_else(budget, method):
    usual, released = (asdict(make_config("humanoid", method, budget, protocol=p)) for p in ("paper", "released"))
    assert usual == asdict(make_config("humanoid", method, budget))
    assert released == usual | RELEASED_BY_HAND | {"protocol": "released"}
    assert all(usual[name] != value for name, value in RELEASED_BY_HAND.items())


@pytest.mark.parametrize("name", list(RELEASED_BY_HAND))
def test_an_explicit_setting_wins_over_the_protocol(name):
    papers = asdict(make_config("walker2d", "mconbo-vail", "smoke"))[name]
    config = make_config("walker2d", "mconbo-vail", "smoke", protocol="released", **{name: papers})
    assert {n: asdict(config)[n] for n in RELEASED_BY_HAND} == RELEASED_BY_HAND | {name: papers}


# Rewards of either sign


SIGNED = ("airl", "maxent", "zero")


@pytest.mark.parametrize("env", ROBOTS)
@pytest.mark.parametrize(("budget", "length"), [("full", 1000), ("laptop", None), ("smoke", 50)])
@pytest.mark.parametrize("method", method_names())
def test_archives_of_rewards_that_may_be_negative_start_low(env, budget, length, method):
    length = length or (200 if env == "halfcheetah" else 300)
    config = make_config(env, method, budget)
    assert config.simulation.episode_length == length
    assert (config.ppga.threshold_min == -10.0 * length) == (parse_method(method).base in SIGNED)


def test_the_low_start_follows_the_episodes_length_and_gives_way():
    assert make_config("walker2d", "mconbo-airl", "laptop", episode_length=7).ppga.threshold_min == -70
    assert make_config("walker2d", "airl-obs", "laptop", threshold_min=3.0).ppga.threshold_min == 3


@pytest.mark.parametrize(
    "name",
    [
        "protocol", "expert_alignment", "expert_obs", "bonus_scope", "penalty_mixing", "vail_beta", "pwil_coupling",
        "walk_weights", "selection", "backend",
    ],
)  # fmt: skip
@pytest.mark.parametrize("wrong", ["", "neither", "Paper", "raw,normalised", None])
def test_choices_refuse_what_is_none_of_theirs(name, wrong):
    sentence = refused(make_config, "walker2d", "gail", "smoke", **{name: wrong})
    assert sentence.startswith(f"{name}=") and str(getattr(Config, name)) in sentence


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
        ("gradient_penalty", float("inf")),
    ],
)
def test_reward_settings_that_cannot_work_are_refused(name, value):
    assert refused(make_config, "walker2d", "vail", "smoke", **{name: value}).startswith(f"{name}=")
