"""Every setting of a run: a frozen dataclass, three budgets, method names, and refusals before anything compiles."""

import dataclasses
import inspect
import math
import re
from dataclasses import dataclass, fields, replace
from typing import Any, get_args

from qdil.errors import ConfigError
from qdil.registry import bases, parse_method

BUDGETS = ("smoke", "laptop", "full")
ROBOTS = ("halfcheetah", "walker2d", "humanoid")
BACKENDS = ("spring", "positional", "generalized", "mjx")
PROTOCOLS = ("paper", "released")

IDENTITY = ("env", "method", "budget", "seed")  # what names a run; these have options of their own, not --set


@dataclass(frozen=True)
class Config:
    """A run, nothing implied. Defaults are the ``full`` budget: the paper's and its authors' settings."""

    # What is run
    env: str = "walker2d"
    method: str = "mconbo-gail"
    budget: str = "full"
    seed: int = 1
    backend: str = "spring"  # Brax backend (paper: the ancestor of spring)
    devices: int = 0  # local devices to shard over; 0: as many as divide the counts

    # PPGA (Algorithm 1)
    iterations: int = 2000  # QD iterations N_Q (paper, Fig. 5)
    warmup_updates: int = 0  # plain PPO updates on the method's own reward before iteration 1 (ours; 0 in the paper)
    gradient_updates: int = 10  # N1, VPPO updates behind each Jacobian (authors; the paper's Table 4 is lost)
    walk_updates: int = 10  # N2, VPPO updates of the walk (authors; the paper's Table 4 is lost)
    candidates: int = 300  # λ, branched policies an iteration (authors' setting)
    episodes: int = 10  # whole episodes per candidate (authors' setting)
    cells: int = 50  # grid cells per measure (paper: 50x50)
    sigma0: float = 1.0  # xNES initial step σ_g, in unit-length gradient rows (authors: 1; humanoid 0.5)
    archive_learning_rate: float = 0.5  # α of the soft archive, 0 < α ≤ 1 (authors: 0.5; humanoid 0.1)
    threshold_min: float = 200.0  # soft archive's threshold of an empty cell, return units (authors)
    selection: str = "learned"  # which return fills the archive: "learned" (Definition 1) or "true" (released program)
    walk_weights: str = "xnes"  # the walk's reward: weighted by "xnes" (Algorithm 1) or "fitness" alone (released)
    sample_actions: bool = True  # candidates and demonstrators act by samples of π_θ (True) or by its mean
    eval_chunk: int = 50  # steps after which evaluated robots that have finished make room for others
    eval_turns: int = 1  # chunks between looks of the host whether anybody is left; their steps take memory
    eval_tile: int = 1000  # evaluated robots that a device simulates together; those that have finished are left out

    # VPPO
    actor_hidden: tuple[int, ...] = (128, 128)  # tanh layers (authors)
    critic_hidden: tuple[int, ...] = (256, 256)  # tanh layers (authors)
    initial_std: float = 1.0  # of the action distribution, in action units
    num_envs: int = 3000  # robots simulated side by side (authors)
    window: int = 128  # steps per robot and VPPO update (authors)
    episode_length: int = 1000  # time limit, steps (paper)
    minibatches: int = 8  # per epoch (authors)
    epochs: int = 4  # passes over a window (authors)
    gamma: float = 0.99  # discount (authors)
    gae_lambda: float = 0.95  # λ of GAE (authors)
    clip: float = 0.2  # PPO's ratio and value clip (authors)
    value_coef: float = 2.0  # (authors)
    entropy_coef: float = 0.0  # (authors)
    max_grad_norm: float = 1.0  # (authors)
    learning_rate: float = 1e-3  # Adam (authors: 1e-3; humanoid 3e-4)
    target_kl: float = 0.008  # nats; a copy stops its epochs beyond it (authors)

    # Bonus and demonstrations
    protocol: str = "paper"  # "paper", or "released": that program's choices wherever a setting of this list has them
    demo_episodes: int = 4  # demonstrations (paper, section 5.2)
    expert_alignment: str = "aligned"  # (s_t, a_t), or "shifted" (released): (s_{t+1+j}, a_t), j = 0-19 per episode
    expert_obs: str = "normalised"  # as policy observations are, or "raw" (released program)
    bonus_scope: str = "episode"  # the bonus reads the measure of a step's "episode" or of its "window" (released)
    bonus_p: float = 0.5  # p of eq. 2, reward per step (paper)
    bonus_q: float = 0.5  # q of eq. 2, reward per step (paper; its own study prefers 1)
    bonus_in_fitness: bool = False  # add the bonus to the fitness that fills the archive too

    # Reward models
    reward_hidden: tuple[int, ...] = (100, 100)  # tanh layers of reward networks (authors; the paper's Table 5 is lost)
    reward_learning_rate: float = 3e-4  # Adam (authors; the paper's Table 5 is lost)
    reward_steps: int = 100  # discriminator steps per QD iteration (ours)
    reward_batch: int = 512  # expert rows, and as many policy rows, per discriminator step (ours)
    gradient_penalty: float = 10.0  # weight λ of GAIL's and VAIL's penalty (authors; the paper does not mention it)
    penalty_mixing: str = "sample"  # penalty's mixing weight per "sample" (Gulrajani et al.) or "element" (released)
    vail_beta: str = "adaptive"  # dual ascent and a sampled latent (paper), or "fixed": 1 and the mean (released)
    vail_information: float = 0.5  # I_c, nats that VAIL's bottleneck lets through (Peng et al., 2018)
    vail_beta_rate: float = 1e-5  # dual ascent's step size (Peng et al., 2018)
    vail_latent: int = 128  # size of VAIL's latent z (Peng et al., 2018)
    giril_steps: int = 5000  # steps of GIRIL's training before the run (ours)
    giril_learning_rate: float = 3e-4  # Adam (ours; as the other reward models')
    giril_action_weight: float = 1.0  # α of eq. 9 (ours; the paper's Table 7 is lost)
    pwil_alpha: float = 5.0  # largest reward per step (Dadashi et al., 2021)
    pwil_beta: float = 5.0  # how fast the reward falls with the cost (Dadashi et al., 2021)
    pwil_coupling: str = "episode"  # expert mass used up over an "episode", or restored each "step" (released program)


LAPTOP: dict[str, Any] = {
    "iterations": 200,
    "warmup_updates": 300,
    "gradient_updates": 3,
    "walk_updates": 3,
    "candidates": 96,
    "episodes": 2,
    "cells": 20,
    "sigma0": 2.0,
    "archive_learning_rate": 1.0,
    "sample_actions": False,
    "eval_chunk": 25,
    "eval_turns": 4,
    "eval_tile": 48,
    "actor_hidden": (64, 64),
    "critic_hidden": (64, 64),
    "num_envs": 192,
    "window": 64,
    "episode_length": 300,
    "gamma": 0.993,
    "target_kl": 0.02,
    "threshold_min": 0.0,
    "reward_steps": 20,
}

SMOKE: dict[str, Any] = {
    **LAPTOP,
    "iterations": 2,
    "warmup_updates": 2,
    "gradient_updates": 1,
    "walk_updates": 1,
    "candidates": 8,
    "episodes": 2,
    "cells": 5,
    "actor_hidden": (16, 16),
    "critic_hidden": (16, 16),
    "num_envs": 24,
    "window": 16,
    "episode_length": 50,
    "gamma": 0.99,
    "minibatches": 2,
    "epochs": 2,
    "demo_episodes": 1,
    "reward_steps": 4,
    "giril_steps": 200,
}

# What differs between robots, by budget.
PER_ROBOT: dict[tuple[str, str], dict[str, Any]] = {
    # A step of the cheetah is 0.05 s (walker2d: 0.008 s): it needs fewer steps and a nearer horizon. It cannot fall.
    ("laptop", "halfcheetah"): {
        "gamma": 0.99,
        "episode_length": 200,
        "eval_chunk": 200,
        "num_envs": 96,
        "iterations": 160,
        "warmup_updates": 100,
        "threshold_min": -100.0,
    },  # fmt: skip
    ("full", "humanoid"): {"sigma0": 0.5, "archive_learning_rate": 0.1, "learning_rate": 3e-4},
}


# What the authors' released program does where the paper says otherwise (p and q: its shipped runners).
RELEASED: dict[str, Any] = {
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

# An empty cell's threshold, return per step, where a reward may be negative: low enough that any first elite counts.
SIGNED_THRESHOLD = -10.0

CHOICES = {
    "backend": BACKENDS,
    "selection": ("learned", "true"),
    "walk_weights": ("xnes", "fitness"),
    "protocol": PROTOCOLS,
    "expert_alignment": ("aligned", "shifted"),
    "expert_obs": ("normalised", "raw"),
    "bonus_scope": ("episode", "window"),
    "penalty_mixing": ("sample", "element"),
    "vail_beta": ("adaptive", "fixed"),
    "pwil_coupling": ("episode", "step"),
}


def make_config(env: str, method: str, budget: str, seed: int = 1, **changes: Any) -> Config:
    """The configuration of one run: a budget, adapted to the robot, with ``changes`` on top; checked.

    Raises ConfigError for anything that cannot run.
    """
    if budget not in BUDGETS:
        raise ConfigError(f"unknown budget '{budget}'; choose one of {', '.join(BUDGETS)}.")
    if env not in ROBOTS:
        raise ConfigError(f"unknown robot '{env}'; choose one of {', '.join(ROBOTS)}.")
    base = bases()[parse_method(method).base]
    unknown = [name for name in changes if name not in {f.name for f in fields(Config)}]
    if unknown:
        raise ConfigError(f"unknown setting '{unknown[0]}'; see 'qdil train --help' for their names.")
    chosen = {"smoke": SMOKE, "laptop": LAPTOP, "full": {}}[budget] | PER_ROBOT.get((budget, env), {})
    if env == "halfcheetah" and base.imitates and budget == "full":
        chosen = {**chosen, "threshold_min": -500.0}  # authors, with imitation rewards
    if base.signed:
        length = changes.get("episode_length", chosen.get("episode_length", Config.episode_length))
        chosen = {**chosen, "threshold_min": SIGNED_THRESHOLD * length}
    if changes.get("protocol") == "released":
        chosen = {**chosen, **RELEASED}
    config = replace(Config(env=env, method=method, budget=budget, seed=seed), **(chosen | changes))
    check(config)
    return config


def parse_settings(pairs: list[str]) -> dict[str, Any]:
    """Turn ``key=value`` strings into typed settings. Raises ConfigError for a name or value that does not fit."""
    types = {f.name: f.type for f in fields(Config)}
    settings = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals or name not in types:
            raise ConfigError(f"'--set {pair}': expected NAME=VALUE with one of the names {', '.join(types)}.")
        if name in IDENTITY:
            raise ConfigError(f"'--set {pair}': use --{name} instead.")
        try:
            settings[name] = _typed(types[name], text)
        except ValueError:
            raise ConfigError(
                f"'--set {pair}': '{text}' is not a value for {name} ({_describe(types[name])})."
            ) from None
    return settings


def _describe(kind: Any) -> str:
    return "integers like 64,64" if get_args(kind) else kind.__name__


def _typed(kind: Any, text: str) -> Any:
    if get_args(kind):
        return tuple(int(part) for part in text.split(","))
    if kind is bool:
        if text.lower() not in ("true", "false"):
            raise ValueError(text)
        return text.lower() == "true"
    return kind(text)


AT_LEAST_ONE = (
    "iterations", "gradient_updates", "walk_updates", "candidates", "episodes", "cells", "eval_chunk", "eval_turns",
    "eval_tile", "num_envs", "window", "episode_length", "minibatches", "epochs", "demo_episodes", "reward_steps",
    "reward_batch", "vail_latent", "giril_steps",
)  # fmt: skip
POSITIVE = (
    "sigma0", "initial_std", "clip", "max_grad_norm", "learning_rate", "target_kl", "reward_learning_rate",
    "vail_beta_rate", "giril_learning_rate", "pwil_alpha", "pwil_beta",
)  # fmt: skip
NOT_NEGATIVE = (
    "seed", "devices", "warmup_updates", "value_coef", "entropy_coef", "bonus_p", "bonus_q", "gradient_penalty",
    "vail_information", "giril_action_weight",
)  # fmt: skip


def check(config: Config) -> None:
    """Raise ConfigError, in one sentence that names the setting, for values that cannot work."""
    parse_method(config.method)
    for field in fields(config):
        if field.type is float:
            _require(math.isfinite(getattr(config, field.name)), config, field.name, "must be a finite number")
    for name in AT_LEAST_ONE:
        _require(getattr(config, name) >= 1, config, name, "must be at least 1")
    for name in POSITIVE:
        _require(getattr(config, name) > 0, config, name, "must be positive")
    for name in NOT_NEGATIVE:
        _require(getattr(config, name) >= 0, config, name, "must not be negative")
    for name in ("gamma", "gae_lambda", "archive_learning_rate"):
        _require(0 < getattr(config, name) <= 1, config, name, "must be above 0 and at most 1")
    for name in ("actor_hidden", "critic_hidden", "reward_hidden"):
        sizes = getattr(config, name)
        _require(len(sizes) > 0 and min(sizes) >= 1, config, name, "must be layer widths of at least 1")
    for name, choices in CHOICES.items():
        _require(getattr(config, name) in choices, config, name, f"must be one of {', '.join(choices)}")
    _require(config.window % config.minibatches == 0, config, "minibatches", f"must divide window={config.window}")
    _require(config.num_envs % 3 == 0, config, "num_envs", "must divide by 3, the copies that VPPO trains (1 + k)")


def _require(holds: bool, config: Config, name: str, rule: str) -> None:
    if not holds:
        raise ConfigError(f"{name}={getattr(config, name)} {rule}.")


# Settings that change how fast a run is, and not what it finds.
SPEED_ALONE = ("eval_chunk", "eval_turns", "eval_tile", "devices")


def same_but_for_speed(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two ``config.json`` agree in everything but ``SPEED_ALONE``."""
    names = (set(one) | set(other)) - set(SPEED_ALONE)
    return all(name in one and name in other and one[name] == other[name] for name in names)


def to_json(config: Config) -> dict[str, Any]:
    """Plain values, for ``config.json``."""
    return {
        name: list(value) if isinstance(value, tuple) else value for name, value in dataclasses.asdict(config).items()
    }


def from_json(content: dict[str, Any]) -> Config:
    """Undo ``to_json`` and check. What an older version did not write of ``SPEED_ALONE`` takes its default.

    Raises ConfigError if any other setting is unknown or missing, or a value is not allowed.
    """
    values: dict[str, Any] = {field.name: field.default for field in fields(Config) if field.name in SPEED_ALONE}
    values |= {name: tuple(value) if isinstance(value, list) else value for name, value in content.items()}
    unknown = sorted(set(values) ^ {field.name for field in fields(Config)})
    if unknown:
        raise ConfigError(f"these settings are of another version: {', '.join(unknown)} are unknown or missing.")
    config = Config(**values)
    check(config)
    return config


def settings_help() -> str:
    """The settings that ``--set`` takes, each with its ``full`` default and the comment beside it above."""
    lines = ["settings for --set (defaults of the 'full' budget; 'smoke' and 'laptop' change some):"]
    for line in inspect.getsource(Config).splitlines():
        match = re.match(r"    (\w+): .* = (.*?)  # (.*)", line)
        if match and match[1] not in IDENTITY:
            lines.append(f"  {match[1]}={match[2]}: {match[3]}")
    return "\n".join(lines)
