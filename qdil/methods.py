"""Names of methods: base reward models, the variants that every base gets, and how another module adds a base.

A method name is ``[prefix-]base[-obs]``, for example ``mconbo-gail-obs``. The base names a reward model. The prefix
``mcond-`` adds measure conditioning (eq. 3), ``mbo-`` the measure bonus (eq. 2), ``mconbo-`` both. The suffix ``-obs``
hides actions from the reward model (eq. 20). Importing this module does not import JAX.
"""

import re
from collections.abc import Callable
from difflib import get_close_matches
from pkgutil import resolve_name
from typing import Any, NamedTuple

from qdil import plugins
from qdil.errors import ConfigError

# prefix -> (measure conditioning, measure bonus)
PREFIXES = {"": (False, False), "mcond-": (True, False), "mbo-": (False, True), "mconbo-": (True, True)}
OBS_ONLY = "-obs"

Build = Callable[..., Any]  # (config, widths) -> InputModel; without inputs: (config) -> RewardModel


class Base(NamedTuple):
    """A base reward model by name."""

    name: str
    summary: str  # one line for ``qdil methods``
    function: Build | str  # the function that builds the model, or "module:name" of a function to import when needed
    imitates: bool = (
        True  # whether it learns from demonstrations; only then are there mcond-, mconbo- and -obs variants
    )
    signed: bool = False  # whether its reward may be negative; an archive then starts from a low threshold, not from 0

    @property
    def build(self) -> Build:
        """The function that builds the model. Imports its module, which imports JAX."""
        return resolve_name(self.function) if isinstance(self.function, str) else self.function


_REWARDS = "qdil.imitation.rewards"

# The paper's reward models in the order of its Table 1, then that of its later version. Their modules import JAX, so
# this table only names them.
BUILT_IN = (
    Base("true", "the environment's own reward: PPGA, the expert", f"{_REWARDS}.plain:true_reward", imitates=False),
    Base(
        "zero",
        "zero everywhere: mbo-zero shows how far the measure bonus alone gets",
        f"{_REWARDS}.plain:zero_reward",
        imitates=False,
        signed=True,
    ),
    Base("gail", "−log(1−D) of GAIL's discriminator D(s, a)", f"{_REWARDS}.gail:gail"),
    Base("vail", "−log(1−D) of VAIL's discriminator behind an information bottleneck", f"{_REWARDS}.vail:vail"),
    Base("airl", "log D − log(1−D) of a discriminator of (s, a, s')", f"{_REWARDS}.airl:airl", signed=True),
    Base(
        "giril",
        "prediction error of a model of the demonstrator's transitions, trained before the run",
        f"{_REWARDS}.giril:giril",
    ),
    Base(
        "pwil",
        "a falling function of the cost of coupling the episode with the demonstrations",
        f"{_REWARDS}.pwil:pwil",
    ),
    Base(
        "maxent",
        "a reward network trained to be high on demonstrations and low on the policy's steps",
        f"{_REWARDS}.maxent:maxent",
        signed=True,
    ),
    Base("diffail", "−log(1−D) with D = exp(−loss) of a diffusion model of (s, a)", f"{_REWARDS}.diffail:diffail"),
)
_BASES: dict[str, Base] = {base.name: base for base in BUILT_IN}


class Method(NamedTuple):
    """The parts of a method name."""

    base: Base  # which reward model
    conditioned: bool  # whether δ(s) is among the reward model's inputs (eq. 3)
    bonus: bool  # whether the measure bonus is added to the reward that VPPO maximises (eq. 2)
    obs_only: bool = False  # whether actions are hidden from the reward model (eq. 20)


def register(name: str, summary: str, imitates: bool = True, signed: bool = False) -> Callable[[Build], Build]:
    """Make a reward model known by ``name``, with all variants: ``mcond-``, ``mbo-``, ``mconbo-`` and ``-obs``.

    Use it as a decorator, in a module of your own, on a function that builds the model from the run's configuration
    and the widths of its inputs (``Inputs`` of integers; the width of an input that a variant hides is 0)::

        @register("nearest", "minus the distance to the nearest demonstrated state", signed=True)
        def nearest(config, widths):
            def reward(state, memory, inputs, ended):
                rows = inputs.obs[..., None, :] - state.obs
                return memory, -jnp.linalg.norm(rows, axis=-1).min(-1)

            return InputModel(init=lambda key, expert: expert, reward=reward)

    Then ``qdil --import my_module train --method mconbo-nearest …`` trains it. An installed package may instead name
    its module in the entry-point group ``qdil.plugins``. ``imitates=False`` is for a reward without demonstrations: the
    function takes the configuration alone and returns a ``RewardModel``, and there are no ``mcond-``, ``mconbo-`` and
    ``-obs`` variants. ``signed=True`` means that rewards may be negative.

    Raises ConfigError for a name that is taken, that reads like a variant of another name, or that is not made of small
    letters, digits, - and _.
    """

    def add(function: Build) -> Build:
        taken = _BASES.get(name)
        if taken is not None and not _is_same(taken.function, function):
            raise ConfigError(f"there is already a reward model called '{name}'.")
        if not re.fullmatch("[a-z][a-z0-9_-]*", name):
            raise ConfigError(
                f"'{name}' cannot name a reward model: use small letters, digits, - and _, a letter first."
            )
        if name.endswith(OBS_ONLY) or any(name.startswith(prefix) for prefix in PREFIXES if prefix):
            raise ConfigError(f"'{name}' cannot name a reward model: it reads like a variant of another.")
        _BASES[name] = Base(name, summary, function, imitates, signed)
        return function

    return add


def _is_same(one: Build | str, other: Build) -> bool:
    """Whether two functions are one, or the same definition executed again, as when a notebook's cell is re-run."""

    def place(function: Build | str) -> tuple[str, str]:
        return getattr(function, "__module__", ""), getattr(function, "__qualname__", "")

    return one is other or (not isinstance(one, str) and place(one) == place(other))


def bases() -> dict[str, Base]:
    """All base reward models by name, the paper's first. Raises ConfigError for a plugin that cannot be loaded."""
    plugins.load()
    return dict(_BASES)


def parse_method(name: str) -> Method:
    """The parts of a method name, e.g. of ``mconbo-gail-obs``. Raises ConfigError for a name that is no method."""
    known = bases()
    for prefix in sorted(PREFIXES, key=len, reverse=True):
        if not name.startswith(prefix):
            continue
        rest = name[len(prefix) :]
        conditioned, bonus = PREFIXES[prefix]
        obs_only = rest not in known and rest.endswith(OBS_ONLY)
        rest = rest.removesuffix(OBS_ONLY) if obs_only else rest
        if rest not in known:
            continue
        if not known[rest].imitates and (conditioned or obs_only):
            raise ConfigError(
                f"method '{name}': '{rest}' does not learn from demonstrations, so it has no mcond- and -obs variants; "
                f"use {rest} or mbo-{rest}."
            )
        return Method(known[rest], conditioned, bonus, obs_only)
    close = get_close_matches(name, method_names(), 1)
    hint = f"did you mean {close[0]}? A" if close else "a"
    raise ConfigError(
        f"unknown method '{name}': {hint} method is one of {', '.join(known)}, "
        "perhaps with mcond-, mbo- or mconbo- before it and -obs after it ('qdil methods' lists all)."
    )


def name_of(method: Method) -> str:
    """The method name with these parts: the inverse of ``parse_method``."""
    prefix = next(p for p, parts in PREFIXES.items() if parts == (method.conditioned, method.bonus))
    return prefix + method.base.name + (OBS_ONLY if method.obs_only else "")


def method_names() -> list[str]:
    """All method names, base by base, plain ones first."""
    names = []
    for base in bases().values():
        for suffix in ("", OBS_ONLY) if base.imitates else ("",):
            names += [p + base.name + suffix for p, (conditioned, _) in PREFIXES.items()
                      if base.imitates or not conditioned]  # fmt: skip
    return names


def describe(name: str) -> str:
    """A method in one line: its base's summary and what the variant changes."""
    method = parse_method(name)
    parts = [method.base.summary]
    parts += ["δ(s) among its inputs"] if method.conditioned else []
    parts += ["actions hidden from it"] if method.obs_only else []
    parts += ["plus the measure bonus"] if method.bonus else []
    return "; ".join(parts)
