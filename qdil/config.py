"""Every setting of a run in typed groups, the budgets, and refusals before anything compiles.

A program depends on the groups that it is given and on nothing else, so a setting cannot be recorded without effect.
On the command line and in ``config.json`` settings are flat: ``--set gamma=0.99`` changes ``config.ppo.gamma``.
"""

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BeforeValidator, Field, ValidationError
from pydantic.dataclasses import dataclass
from pydantic.fields import FieldInfo

from qdil.errors import ConfigError
from qdil.methods import parse_method
from qdil.robots.register import backends_of, count_measures

IDENTITY = ("env", "method", "budget", "seed")  # what names a run; these have options of their own, not --set
PROTOCOLS = ("paper", "released")


def _split(text: Any) -> Any:
    return text.split(",") if isinstance(text, str) else text


AtLeastOne = Annotated[int, Field(ge=1)]
Count = Annotated[int, Field(ge=0)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(gt=0, le=1)]
Widths = Annotated[tuple[AtLeastOne, ...], Field(min_length=1), BeforeValidator(_split)]


def setting(default: Any, what: str) -> Any:
    """A setting with its ``full`` default; ``what`` says what it is, its unit, and where the default is from."""
    return Field(default, description=what)


@dataclass(frozen=True)
class Simulation:
    """The robot's physics and the length of an episode."""

    backend: str = setting("spring", "Brax backend (paper: the ancestor of spring)")
    episode_length: AtLeastOne = setting(1000, "time limit, steps (paper)")


@dataclass(frozen=True)
class PPGA:
    """The search for an archive (Algorithm 1)."""

    iterations: AtLeastOne = setting(2000, "QD iterations N_Q (paper, Fig. 5)")
    warmup_updates: Count = setting(
        0, "plain PPO updates on the method's own reward before iteration 1 (ours; 0 in the paper)"
    )
    gradient_updates: AtLeastOne = setting(
        10, "N1, VPPO updates behind each Jacobian (authors; the paper's Table 4 is lost)"
    )
    walk_updates: AtLeastOne = setting(10, "N2, VPPO updates of the walk (authors; the paper's Table 4 is lost)")
    candidates: AtLeastOne = setting(300, "λ, branched policies an iteration (authors)")
    cells: AtLeastOne = setting(50, "grid cells per measure (paper: 50x50)")
    sigma0: Positive = setting(1.0, "xNES initial step σ_g, in unit-length gradient rows (authors: 1; humanoid 0.5)")
    archive_learning_rate: Share = setting(0.5, "α of the soft archive, 0 < α ≤ 1 (authors: 0.5; humanoid 0.1)")
    threshold_min: Number = setting(200.0, "soft archive's threshold of an empty cell, return units (authors)")
    selection: Literal["learned", "true"] = setting(
        "learned", "which return fills the archive: learned (Definition 1) or true (released program)"
    )
    walk_weights: Literal["xnes", "fitness"] = setting(
        "xnes", "the walk's reward: weighted by xnes (Algorithm 1) or fitness alone (released program)"
    )


@dataclass(frozen=True)
class Evaluation:
    """How candidates are scored over whole episodes."""

    episodes: AtLeastOne = setting(10, "whole episodes per candidate (authors)")
    sample_actions: bool = setting(True, "candidates and demonstrators act by samples of π_θ (true) or by its mean")
    eval_chunk_steps: AtLeastOne = setting(50, "steps after which finished episodes make room for unfinished ones")
    eval_chunks_per_sync: AtLeastOne = setting(
        1, "chunks run before the host checks whether any episode is unfinished; memory grows with it"
    )
    eval_batch_size: AtLeastOne = setting(1000, "unfinished episodes that a device simulates together, at most")


@dataclass(frozen=True)
class PPO:
    """The policy, its critic, and how VPPO trains them."""

    actor_hidden: Widths = setting((128, 128), "tanh layers of the policy (authors)")
    critic_hidden: Widths = setting((256, 256), "tanh layers of the critic (authors)")
    initial_std: Positive = setting(1.0, "initial deviation of the action distribution, in action units (authors)")
    num_envs: AtLeastOne = setting(3000, "robots simulated side by side (authors)")
    rollout_length: AtLeastOne = setting(128, "steps per robot and VPPO update (authors)")
    minibatches: AtLeastOne = setting(8, "minibatches per epoch (authors)")
    epochs: AtLeastOne = setting(4, "passes over a rollout (authors)")
    gamma: Share = setting(0.99, "discount (authors)")
    gae_lambda: Share = setting(0.95, "λ of GAE (authors)")
    clip: Positive = setting(0.2, "PPO's ratio and value clip (authors)")
    value_coef: NotNegative = setting(2.0, "weight of the value loss (authors)")
    entropy_coef: NotNegative = setting(0.0, "weight of the entropy bonus (authors)")
    max_grad_norm: Positive = setting(1.0, "largest norm of a gradient (authors)")
    learning_rate: Positive = setting(1e-3, "Adam's step size (authors: 1e-3; humanoid 3e-4)")
    target_kl: Positive = setting(0.008, "nats; a copy stops its epochs beyond it (authors)")


@dataclass(frozen=True)
class Demos:
    """The demonstrations that imitation learns from."""

    demo_episodes: AtLeastOne = setting(4, "demonstrations (paper, section 5.2)")
    expert_alignment: Literal["aligned", "shifted"] = setting(
        "aligned", "aligned: (s_t, a_t); shifted: (s_{t+1+j}, a_t) with j = 0-19 per episode (released program)"
    )
    expert_obs: Literal["normalised", "raw"] = setting(
        "normalised", "expert observations: normalised as the policy's are, or raw (released program)"
    )


@dataclass(frozen=True)
class Bonus:
    """The measure bonus (eq. 2)."""

    bonus_scope: Literal["episode", "rollout"] = setting(
        "episode", "the bonus reads the measure of a step's episode, or of its rollout (released program)"
    )
    bonus_p: NotNegative = setting(0.5, "p of eq. 2, reward per step (paper)")
    bonus_q: NotNegative = setting(0.5, "q of eq. 2, reward per step (paper; its own study prefers 1)")
    bonus_in_fitness: bool = setting(False, "add the bonus to the fitness that fills the archive, too")


@dataclass(frozen=True)
class Reward:
    """The reward models; each reads the settings that bear its name and the common ones."""

    reward_hidden: Widths = setting((100, 100), "tanh layers of reward networks (authors; the paper's Table 5 is lost)")
    reward_learning_rate: Positive = setting(3e-4, "Adam's step size (authors; the paper's Table 5 is lost)")
    reward_steps: AtLeastOne = setting(100, "discriminator steps per QD iteration (ours)")
    reward_batch: AtLeastOne = setting(512, "expert rows, and as many policy rows, per discriminator step (ours)")
    gradient_penalty: NotNegative = setting(
        10.0, "weight λ of GAIL's and VAIL's gradient penalty (authors; the paper does not mention it)"
    )
    penalty_mixing: Literal["sample", "element"] = setting(
        "sample", "one mixing weight of the penalty per sample (Gulrajani et al.) or per element (released program)"
    )
    vail_beta: Literal["adaptive", "fixed"] = setting(
        "adaptive", "adaptive: dual ascent and a sampled latent (paper); fixed: 1 and the mean (released program)"
    )
    vail_information: NotNegative = setting(0.5, "I_c, nats that VAIL's bottleneck lets through (Peng et al., 2018)")
    vail_beta_rate: Positive = setting(1e-5, "dual ascent's step size (Peng et al., 2018)")
    vail_latent: AtLeastOne = setting(128, "size of VAIL's latent z (Peng et al., 2018)")
    giril_steps: AtLeastOne = setting(5000, "steps of GIRIL's training before the run (ours)")
    giril_learning_rate: Positive = setting(3e-4, "Adam's step size for GIRIL (ours; as the other reward models')")
    giril_action_weight: NotNegative = setting(1.0, "α of eq. 9 (ours; the paper's Table 7 is lost)")
    pwil_alpha: Positive = setting(5.0, "PWIL's largest reward per step (Dadashi et al., 2021)")
    pwil_beta: Positive = setting(5.0, "how fast PWIL's reward falls with the cost (Dadashi et al., 2021)")
    pwil_coupling: Literal["episode", "step"] = setting(
        "episode", "expert mass is used up over an episode, or restored at each step (released program)"
    )


@dataclass(frozen=True)
class Config:
    """A run, nothing implied. Defaults are the ``full`` budget: the paper's and its authors' settings."""

    env: str
    method: str
    budget: str
    seed: Count = 1
    protocol: Literal["paper", "released"] = setting(
        "paper", "paper, or released: that program's choices wherever a setting of this list has them"
    )
    devices: Count = setting(0, "local devices to shard over; 0: as many as divide the counts")
    simulation: Simulation = Simulation()
    ppga: PPGA = PPGA()
    evaluation: Evaluation = Evaluation()
    ppo: PPO = PPO()
    demos: Demos = Demos()
    bonus: Bonus = Bonus()
    reward: Reward = Reward()


GROUPS = ("simulation", "ppga", "evaluation", "ppo", "demos", "bonus", "reward")
_GROUP_TYPES: dict[str, type] = {field.name: field.type for field in dataclasses.fields(Config) if field.name in GROUPS}  # type: ignore[misc]
# The group of every setting by its flat name; None for the settings of ``Config`` itself.
GROUP_OF: dict[str, str | None] = {f.name: None for f in dataclasses.fields(Config) if f.name not in GROUPS} | {
    field.name: group for group, kind in _GROUP_TYPES.items() for field in dataclasses.fields(kind)
}

# Settings that change how fast a run is, and not what it finds.
SPEED_ONLY = ("eval_chunk_steps", "eval_chunks_per_sync", "eval_batch_size", "devices")


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
    "eval_chunk_steps": 25,
    "eval_chunks_per_sync": 4,
    "eval_batch_size": 48,
    "actor_hidden": (64, 64),
    "critic_hidden": (64, 64),
    "num_envs": 192,
    "rollout_length": 64,
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
    "rollout_length": 16,
    "episode_length": 50,
    "gamma": 0.99,
    "minibatches": 2,
    "epochs": 2,
    "demo_episodes": 1,
    "reward_steps": 4,
    "giril_steps": 200,
}

# What each budget changes of the defaults.
BUDGETS: dict[str, dict[str, Any]] = {"smoke": SMOKE, "laptop": LAPTOP, "full": {}}

# What differs between robots, by budget.
PER_ROBOT: dict[tuple[str, str], dict[str, Any]] = {
    # A step of the cheetah is 0.05 s (walker2d: 0.008 s): it needs fewer steps and a nearer horizon. It cannot fall.
    ("laptop", "halfcheetah"): {
        "gamma": 0.99,
        "episode_length": 200,
        "eval_chunk_steps": 200,
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
    "bonus_scope": "rollout",
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


def make_config(env: str, method: str, budget: str, seed: int = 1, **changes: Any) -> Config:
    """The configuration of one run: a budget, adapted to the robot, with ``changes`` by flat name on top; checked.

    Raises ConfigError for anything that cannot run.
    """
    if budget not in BUDGETS:
        raise ConfigError(f"unknown budget '{budget}'; choose one of {', '.join(BUDGETS)}.")
    base = parse_method(method).base
    for name in changes:
        if name not in GROUP_OF:
            raise ConfigError(f"unknown setting '{name}'; see 'qdil train --help' for their names.")
    chosen = BUDGETS[budget] | _for_measures(budget, count_measures(env)) | PER_ROBOT.get((budget, env), {})
    chosen |= {"backend": backends_of(env)[0]}
    if env == "halfcheetah" and base.imitates and budget == "full":
        chosen |= {"threshold_min": -500.0}  # authors, with imitation rewards
    if base.signed:
        length = changes.get("episode_length", chosen.get("episode_length", Simulation.episode_length))
        chosen |= {"threshold_min": SIGNED_THRESHOLD * length}
    if changes.get("protocol") == "released":
        chosen |= RELEASED
    identity = {"env": env, "method": method, "budget": budget, "seed": seed}
    return from_settings(identity | chosen | changes)


def _for_measures(budget: str, k: int) -> dict[str, Any]:
    """A budget's counts for a robot of ``k`` measures; unchanged for the paper's robots, which have two.

    ``num_envs`` becomes a multiple of the 1 + k copies and of four devices; the grid keeps about as many cells in all.
    """
    chosen = BUDGETS[budget]
    envs, cells = chosen.get("num_envs", PPO.num_envs), chosen.get("cells", PPGA.cells)
    per_copy = 4 * -(-envs // (4 * (1 + k)))
    return {"num_envs": per_copy * (1 + k), "cells": max(2, round(cells ** (2 / k))) if k > 2 else cells}


def from_settings(settings: Mapping[str, Any]) -> Config:
    """A checked configuration from flat settings by name; what is not named takes its default.

    Raises ConfigError, in one sentence that names the setting, for values that cannot work.
    """
    grouped: dict[str, dict[str, Any]] = {group: {} for group in GROUPS}
    own: dict[str, Any] = {}
    for name, value in settings.items():
        group = GROUP_OF[name]
        (own if group is None else grouped[group])[name] = value
    try:
        config = Config(**own, **{group: _GROUP_TYPES[group](**values) for group, values in grouped.items()})
    except ValidationError as error:
        raise ConfigError(_refusal(error)) from None
    check(config)
    return config


def change(config: Config, **changes: Any) -> Config:
    """``config`` with some settings, by flat name, replaced. Raises ConfigError as ``from_settings`` does."""
    return from_settings(flat(config) | changes)


def flat(config: Config) -> dict[str, Any]:
    """Every setting by its flat name, in the order of the groups."""
    return {name: value_of(config, name) for name in GROUP_OF}


def value_of(config: Config, name: str) -> Any:
    """The value of the setting with this flat name. Raises KeyError if there is none."""
    group = GROUP_OF[name]
    return getattr(config if group is None else getattr(config, group), name)


def check(config: Config) -> None:
    """Raise ConfigError, in one sentence that names the setting, for settings that cannot work together."""
    parse_method(config.method)
    k, backends = count_measures(config.env), backends_of(config.env)
    _require(config.simulation.backend in backends, config, "backend", f"must be one of {', '.join(backends)}")
    rollout = config.ppo.rollout_length
    _require(rollout % config.ppo.minibatches == 0, config, "minibatches", f"must divide rollout_length={rollout}")
    copies = f"must be divisible by {1 + k}, the copies that VPPO trains for the {k} measures of {config.env}"
    _require(config.ppo.num_envs % (1 + k) == 0, config, "num_envs", copies)


def _require(holds: bool, config: Config, name: str, rule: str) -> None:
    if not holds:
        raise ConfigError(f"{name}={value_of(config, name)} {rule}.")


def _refusal(error: ValidationError) -> str:
    """The first of pydantic's findings as one sentence that names the setting."""
    first = error.errors()[0]
    name, value, limits = first["loc"][0], first["input"], first.get("ctx", {})
    rules = {
        "greater_than_equal": f"must be at least {limits.get('ge')}",
        "greater_than": f"must be above {limits.get('gt')}",
        "less_than_equal": f"must be at most {limits.get('le')}",
        "finite_number": "must be a finite number",
        "literal_error": f"must be one of {', '.join(choices(str(name)))}",
        "too_short": "must name at least one layer",
    }
    kind = "integers like 64,64" if GROUP_OF.get(str(name)) and get_origin(_type(str(name))) is tuple else None
    rule = rules.get(first["type"], f"is not a value for {name} ({kind or _kind(str(name))})")
    return f"{name}={value} {rule}."


def _fields() -> dict[str, FieldInfo]:
    """Every setting that ``--set`` changes, by flat name."""
    found: dict[str, FieldInfo] = {}
    for holder in (Config, *_GROUP_TYPES.values()):
        found |= holder.__pydantic_fields__  # type: ignore[attr-defined]
    return {name: field for name, field in found.items() if name not in (*IDENTITY, *GROUPS)}


def _type(name: str) -> Any:
    """The type of a setting without its limits."""
    return _fields()[name].annotation if name in _fields() else int


def _kind(name: str) -> str:
    kind = _type(name)
    return ", ".join(get_args(kind)) if get_origin(kind) is Literal else getattr(kind, "__name__", str(kind))


def choices(name: str) -> tuple[str, ...]:
    """The values that a setting may take where it is one of a few words; empty for others."""
    kind = _type(name) if name in GROUP_OF else None
    return get_args(kind) if get_origin(kind) is Literal else ()


def parse_settings(pairs: list[str]) -> dict[str, Any]:
    """Turn ``key=value`` strings into settings. Raises ConfigError for a name that does not exist."""
    settings = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if name in IDENTITY:
            raise ConfigError(f"'--set {pair}': use --{name} instead.")
        if not equals or name not in GROUP_OF:
            names = ", ".join(_fields())
            raise ConfigError(f"'--set {pair}': expected NAME=VALUE with one of the names {names}.")
        settings[name] = _typed(name, text)
    return settings


def _typed(name: str, text: str) -> Any:
    """One setting's value from text, as its group reads it. Raises ConfigError for text that is no such value."""
    group = GROUP_OF[name]
    try:
        if group is None:
            return getattr(Config(env="", method="", budget="", **{name: text}), name)  # type: ignore[arg-type]
        return getattr(_GROUP_TYPES[group](**{name: text}), name)
    except ValidationError as error:
        raise ConfigError(f"'--set {name}={text}': {_refusal(error)}") from None


def descriptions() -> dict[str, str]:
    """What every setting is, with its unit and where its ``full`` default is from, by flat name."""
    return {name: field.description or "" for name, field in _fields().items()}


def settings_help() -> str:
    """The settings that ``--set`` takes, group by group, each with its ``full`` default and what it is."""
    defaults, whats = {name: field.default for name, field in _fields().items()}, descriptions()
    lines = ["settings (with the defaults of the full budget):"]
    for group in (None, *GROUPS):
        lines += ["", "The run as a whole." if group is None else _GROUP_TYPES[group].__doc__ or group]
        names = [name for name in whats if GROUP_OF[name] == group]
        lines += [f"  {name}={_text(defaults[name])}: {whats[name]}" for name in names]
    return "\n".join(lines)


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


def same_but_for_speed(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two ``config.json`` agree in everything but ``SPEED_ONLY``."""
    names = (set(one) | set(other)) - set(SPEED_ONLY)
    return all(name in one and name in other and one[name] == other[name] for name in names)


# Names and values of settings in ``config.json`` of earlier versions.
OLD_NAMES = {
    "window": "rollout_length",
    "eval_chunk": "eval_chunk_steps",
    "eval_turns": "eval_chunks_per_sync",
    "eval_tile": "eval_batch_size",
}
OLD_VALUES = {("bonus_scope", "window"): "rollout"}


def with_current_names(content: dict[str, Any]) -> dict[str, Any]:
    """The content of a ``config.json`` under today's names of settings."""
    renamed = {OLD_NAMES.get(name, name): value for name, value in content.items()}
    return {n: OLD_VALUES.get((n, v), v) if isinstance(v, str) else v for n, v in renamed.items()}


def to_json(config: Config) -> dict[str, Any]:
    """Plain values by flat name, for ``config.json``."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in flat(config).items()}


def from_json(content: dict[str, Any]) -> Config:
    """Undo ``to_json`` and check. What an older version did not write of ``SPEED_ONLY`` takes its default.

    Raises ConfigError if any other setting is unknown or missing, or a value is not allowed.
    """
    settings = with_current_names(content)
    unknown = sorted((set(settings) ^ set(GROUP_OF)) - (set(SPEED_ONLY) - set(settings)))
    if unknown:
        raise ConfigError(f"these settings are of another version: {', '.join(unknown)} are unknown or missing.")
    return from_settings(settings)
