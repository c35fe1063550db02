"""Building a checked ``Config`` from flat settings; a setting that cannot work is refused in one plain sentence."""

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any, get_origin

from pydantic import ValidationError

from qdil.config.settings import GROUP_OF, GROUP_TYPES, GROUPS, Config, choices, flat, type_of, value_of
from qdil.errors import ConfigError
from qdil.methods import parse_method
from qdil.robots.register import backends_of, count_measures

# Names of settings in earlier versions, and their present names.
OLD_NAMES = {
    "window": "rollout_length",
    "eval_chunk": "eval_chunk_steps",
    "eval_turns": "eval_chunks_per_sync",
    "eval_tile": "eval_batch_size",
}

KINDS = {int: "an integer", float: "a number", bool: "true or false", str: "a text", tuple: "integers like 64,64"}


def from_settings(settings: Mapping[str, Any]) -> Config:
    """A checked configuration from flat settings by name; a setting that is not given takes its default.

    Raises ConfigError, in one sentence that names the setting, for an unknown name and for values that cannot work.
    """
    grouped: dict[str, dict[str, Any]] = {group: {} for group in GROUPS}
    own: dict[str, Any] = {}
    for name, value in settings.items():
        if name not in GROUP_OF:
            raise ConfigError(unknown(name))
        group = GROUP_OF[name]
        (own if group is None else grouped[group])[name] = value
    try:
        config = Config(**own, **{group: GROUP_TYPES[group](**values) for group, values in grouped.items()})
    except ValidationError as error:
        raise ConfigError(refusal(error)) from None
    check(config)
    return config


def change(config: Config, **changes: Any) -> Config:
    """``config`` with some settings, by flat name, replaced. Raises ConfigError as ``from_settings`` does."""
    return from_settings(flat(config) | changes)


def check(config: Config) -> None:
    """Raise ConfigError, in one sentence that names the setting, for settings that cannot work together."""
    parse_method(config.method)
    k, backends = count_measures(config.env), backends_of(config.env)
    _require(config.simulation.backend in backends, config, "backend", f"must be one of {', '.join(backends)}")
    rollout = config.ppo.rollout_length
    _require(rollout % config.ppo.minibatches == 0, config, "minibatches", f"must divide rollout_length={rollout}")
    measures = f"{k} measure{'s' if k > 1 else ''} of {config.env}"
    copies = f"must be divisible by {1 + k}, the number of copies that VPPO trains for the {measures}"
    _require(config.ppo.num_envs % (1 + k) == 0, config, "num_envs", copies)
    of_episodes = not config.bonus.bonus_in_fitness or config.bonus.bonus_scope != "step"
    rule = "must be false with bonus_scope=step, whose bonus belongs to no episode"
    _require(of_episodes, config, "bonus_in_fitness", rule)


def _require(holds: bool, config: Config, name: str, rule: str) -> None:
    if not holds:
        raise ConfigError(f"{name}={value_of(config, name)} {rule}.")


def unknown(name: str) -> str:
    """The message for a setting that does not exist: it gives the present name, or a similar one."""
    if name in OLD_NAMES:
        return f"unknown setting '{name}': it is now called {OLD_NAMES[name]}."
    close = get_close_matches(name, [*GROUP_OF, *OLD_NAMES], 1)
    hint = f"did you mean {OLD_NAMES.get(close[0], close[0])}? " if close else ""
    return f"unknown setting '{name}': {hint}'qdil train --help' lists all names."


def refusal(error: ValidationError) -> str:
    """pydantic's first error as one sentence that names the setting."""
    first = error.errors()[0]
    name, value, limits = str(first["loc"][0]), first["input"], first.get("ctx", {})
    rules = {
        "greater_than_equal": f"must be at least {limits.get('ge')}",
        "greater_than": f"must be above {limits.get('gt')}",
        "less_than_equal": f"must be at most {limits.get('le')}",
        "finite_number": "must be a finite number",
        "literal_error": f"must be one of {', '.join(choices(name))}",
        "too_short": "must name at least one layer",
    }
    if first["type"] in rules:
        return f"{name}={value} {rules[first['type']]}."
    kind = type_of(name)
    return f"{name}={value!r} must be {KINDS[get_origin(kind) or kind]}."
