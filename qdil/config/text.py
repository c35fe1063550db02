"""Settings as text: ``--set NAME=VALUE``, the command line's help, and ``config.json``."""

from typing import Any, get_origin

from pydantic import ValidationError

from qdil.config.checks import OLD_NAMES, from_settings, refusal, unknown
from qdil.config.settings import (
    GROUP_OF,
    GROUP_TYPES,
    GROUPS,
    IDENTITY,
    SPEED_ONLY,
    Config,
    changeable,
    descriptions,
    flat,
    type_of,
)
from qdil.errors import ConfigError


def parse_settings(pairs: list[str]) -> dict[str, Any]:
    """Turn texts ``NAME=VALUE`` into settings of the right type.

    Raises ConfigError for an unknown name, for a name that has its own option (``--env``), and for a value that its
    setting cannot take.
    """
    settings = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if name in IDENTITY:
            raise ConfigError(f"'--set {pair}': use --{name} instead.")
        if not equals or not name:
            raise ConfigError(f"'--set {pair}': write NAME=VALUE; 'qdil train --help' lists the names.")
        if name not in GROUP_OF:
            raise ConfigError(f"'--set {pair}': {unknown(name)}")
        settings[name] = _checked(name, _typed(type_of(name), text), pair)
    return settings


def _typed(kind: Any, text: str) -> Any:
    """``text`` converted to a setting's type, or unchanged if that is not possible."""
    try:
        if kind is bool:
            return {"true": True, "false": False}.get(text.lower(), text)
        if get_origin(kind) is tuple:
            return tuple(int(part) for part in text.split(","))
        return kind(text) if kind in (int, float) else text
    except ValueError:
        return text


def _checked(name: str, value: Any, pair: str) -> Any:
    """``value`` as its group takes it. Raises ConfigError for a value that the setting cannot take."""
    group = GROUP_OF[name]
    try:
        if group is None:
            return getattr(Config(env="", method="", budget="", **{name: value}), name)
        return getattr(GROUP_TYPES[group](**{name: value}), name)
    except ValidationError as error:
        raise ConfigError(f"'--set {pair}': {refusal(error)}") from None


def settings_help() -> str:
    """The settings that ``--set`` takes, by group, each with its ``full`` default and its meaning."""
    what = descriptions()
    lines = ["settings (with the defaults of the full budget):"]
    for group in (None, *GROUPS):
        lines += ["", "The run as a whole." if group is None else GROUP_TYPES[group].__doc__ or group]
        lines += [f"  {n}={_text(f.default)}: {what[n]}" for n, f in changeable().items() if GROUP_OF[n] == group]
    return "\n".join(lines)


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


def same_but_for_speed(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether the contents of two ``config.json`` agree in everything but ``SPEED_ONLY``."""
    names = (set(one) | set(other)) - set(SPEED_ONLY)
    return all(name in one and name in other and one[name] == other[name] for name in names)


# Settings that earlier versions did not have, and the values that describe best what those versions did.
BEFORE = {
    "fitness_coefficient": "folded",  # candidates had |c_0|, but xNES was told the sample as drawn
    "xnes_center": "zero",
    "rejects": "zero",
    "restart_order": "last",
    "restart_statistics": "own",
    "restart_samples": "fresh",
    "restart_rounds": 0,
    "copies_scaled": "each",
    "reward_schedule": "iteration",
    "replay_share": 0.0,
    "expert_batches": "random",
    "vail_encoder": "linear",
    "vail_visits": False,
    "diffail_steps": 10,  # there was no DiffAIL
    "diffail_levels": 10,
    "diffail_penalty": 0.1,
    "diffail_loss": "probability",
    "diffail_reward": "row",
    "demo_attempts": 1,
    "rescore_episodes": 1,  # one round of ``episodes``
}

OLD_VALUES = {("bonus_scope", "window"): "rollout"}  # values that earlier versions wrote into ``config.json``


def with_current_names(content: dict[str, Any]) -> dict[str, Any]:
    """The content of any version's ``config.json``, with the present names and values."""
    renamed = {OLD_NAMES.get(name, name): value for name, value in content.items()}
    renamed = {n: OLD_VALUES.get((n, v), v) if isinstance(v, str) else v for n, v in renamed.items()}
    return {"expert_seed": _earlier_expert(renamed)} | renamed


def _earlier_expert(content: dict[str, Any]) -> int:
    """The ``expert_seed`` of a run of a version without this setting: all of them learned from the expert of seed 1.

    For a run of seed 1 that is the expert of its own seed, which is written as 0.
    """
    return 0 if content.get("seed") == 1 else 1


def to_json(config: Config) -> dict[str, Any]:
    """Plain values by flat name, for ``config.json``."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in flat(config).items()}


def from_json(content: dict[str, Any]) -> Config:
    """Undo ``to_json`` and check. A setting that an older version did not write takes its value in ``BEFORE``.

    A setting of ``SPEED_ONLY`` that is missing takes its default. Raises ConfigError if any other setting is unknown
    or missing, or a value is not allowed.
    """
    settings = BEFORE | with_current_names(content)
    odd = {name: "unknown" for name in settings if name not in GROUP_OF}
    odd |= {name: "missing" for name in GROUP_OF if name not in settings and name not in SPEED_ONLY}
    if odd:
        named = ", ".join(f"{name} ({what})" for name, what in sorted(odd.items()))
        raise ConfigError(f"these settings are of another version: {named}.")
    return from_settings(settings)
