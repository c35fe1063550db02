"""Names of methods: base reward models, the variants every base gets, and how another module adds a base."""

import re
from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, NamedTuple

from qdil.errors import ConfigError

PREFIXES = {"": (False, False), "mcond-": (True, False), "mbo-": (False, True), "mconbo-": (True, True)}
OBS_ONLY = "-obs"
BUILT_IN = "qdil.imitation.rewards"
ENTRY_POINTS = "qdil.rewards"  # the group under which an installed package names modules that register bases


class Base(NamedTuple):
    """A base reward model by name."""

    name: str
    summary: str  # one line for people
    build: Callable[..., Any]  # (config, widths) -> InputModel; without inputs: (config) -> RewardModel
    imitates: bool  # it reads inputs of demonstrations and policy, so -obs and mcond- mean something
    signed: bool  # its reward may be negative, so that an archive must not start from a threshold of 0


class Method(NamedTuple):
    """A method name taken apart."""

    base: str  # which reward model
    conditioned: bool  # δ(s) among the reward model's inputs (eq. 3)
    bonus: bool  # measure bonus added to the reward that VPPO maximises (eq. 2)
    obs_only: bool = False  # actions hidden from the reward model (eq. 20)


_BASES: dict[str, Base] = {}


def register(name: str, summary: str, imitates: bool = True, signed: bool = False) -> Callable[[Any], Any]:
    """Make a reward model known by ``name``; it gets all variants: ``mcond-``, ``mbo-``, ``mconbo-`` and ``-obs``.

    Use it as a decorator, in a module of your own, on a function that builds the model from a configuration and the
    widths of the inputs it will see (``Inputs`` of integers: 0 where a variant hides something)::

        @register("nearest", "minus the distance to the nearest demonstrated state", signed=True)
        def nearest(config, widths):
            def reward(state, carry, inputs, ended):
                rows = inputs.obs[..., None, :] - state.obs
                return carry, -jnp.linalg.norm(rows, axis=-1).min(-1)

            return InputModel(
                init=lambda key, expert: expert,
                begin=lambda state, num_envs: (),
                reward=reward,
                update=lambda key, state, expert, policy: (state, {}),
                learns=False,
            )

    Import the module before asking for the method; or let its package declare it in the entry-point group
    ``qdil.rewards``, and the command line finds it too. ``imitates=False`` is for a reward without demonstrations: a
    function of the configuration alone that returns a ``RewardModel``; it has no conditioned and no ``-obs`` variant.
    ``signed``: rewards may be negative. Raises ValueError for a name that is taken, or
    cannot be told from a variant, or is no word.
    """

    def remember(build: Any) -> Any:
        import_module(BUILT_IN)  # the paper's come first and keep their names, whoever is imported first
        taken = _BASES.get(name)
        if taken is not None and taken.build is not build:
            raise ValueError(f"there is already a reward model called '{name}'.")
        if not re.fullmatch("[a-z][a-z0-9_-]*", name):
            raise ValueError(
                f"'{name}' cannot name a reward model: use small letters, digits, - and _ (it names folders)."
            )
        if name.endswith(OBS_ONLY) or any(name.startswith(prefix) for prefix in PREFIXES if prefix):
            raise ValueError(f"'{name}' cannot name a reward model: it reads like a variant of another.")
        _BASES[name] = Base(name, summary, build, imitates, signed)
        return build

    return remember


@cache
def _load() -> None:
    import_module(BUILT_IN)
    for entry in entry_points(group=ENTRY_POINTS):
        try:
            entry.load()
        except Exception as error:  # whatever a stranger's module may raise
            raise ConfigError(
                f"the reward models of the installed entry point '{entry.name}' cannot be loaded ({error!r}): "
                "mend or uninstall its package."
            ) from error


def bases() -> dict[str, Base]:
    """All base reward models by name, the paper's first."""
    _load()
    return dict(_BASES)


def parse_method(name: str) -> Method:
    """Take a method name apart, e.g. ``mconbo-gail-obs``. Raises ConfigError for a name that means nothing."""
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
            what = "condition" if conditioned else "hide actions from"
            raise ConfigError(
                f"method '{name}': the reward of '{rest}' has no inputs to {what}; use {rest} or mbo-{rest}."
            )
        return Method(rest, conditioned, bonus, obs_only)
    raise ConfigError(f"unknown method '{name}'; choose one of {', '.join(method_names())}.")


def name_of(method: Method) -> str:
    """Undo ``parse_method``."""
    prefix = next(p for p, parts in PREFIXES.items() if parts == (method.conditioned, method.bonus))
    return prefix + method.base + (OBS_ONLY if method.obs_only else "")


def method_names() -> list[str]:
    """All method names, base by base, plain ones first."""
    names = []
    for base in bases().values():
        for suffix in ("", OBS_ONLY) if base.imitates else ("",):
            names += [p + base.name + suffix for p, (conditioned, _) in PREFIXES.items()
                      if base.imitates or not conditioned]  # fmt: skip
    return names


def describe(name: str) -> str:
    """One line that says what a method is."""
    method = parse_method(name)
    said = [bases()[method.base].summary]
    said += ["δ(s) among its inputs"] if method.conditioned else []
    said += ["actions hidden from it"] if method.obs_only else []
    said += ["plus the measure bonus"] if method.bonus else []
    return "; ".join(said)
