"""The runs behind the paper's figures, tables and claims, and their names. Does not import JAX.

An *experiment* is a method with the settings that differ from its budget's, for example ``mconbo-gail+bonus_q=1.0``.
A *study* is the list of experiments behind one figure or question.
"""

from collections.abc import Iterable
from typing import Any

from qdil.config import PROTOCOLS, SPEED_ONLY, Config, make_config, parse_settings, value_of
from qdil.errors import ConfigError
from qdil.methods import BUILT_IN

PROTOCOL_NAMES = tuple(PROTOCOLS)  # readings of the algorithm, the default first
DEMONSTRATIONS = (1, 2, 10)  # besides the budget's own number (Appendix H)


def name_of(method: str, env: str = "walker2d", budget: str = "full", **changes: Any) -> str:
    """The name of the experiment ``method`` with ``changes``.

    Settings with the value that budget and protocol give them are left out, and so are those that change nothing but
    the speed. So a departure from a protocol always shows: ``mconbo-gail+protocol=released+selection=learned``.
    """
    protocol = changes.get("protocol", "paper")
    default = make_config(env, method, budget, protocol=protocol)
    ordinary = (key for key in changes if key != "protocol" and key not in SPEED_ONLY)
    changed = ["protocol"] if protocol != "paper" else []
    changed += sorted(key for key in ordinary if changes[key] != value_of(default, key))
    return "+".join([method, *(f"{key}={_text(changes[key])}" for key in changed)])


def _text(value: Any) -> str:
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


def config_of(experiment: str, env: str, budget: str, seed: int = 1) -> Config:
    """The configuration of an experiment. Raises ConfigError for an unknown method or setting."""
    method, *changes = experiment.split("+")
    return make_config(env, method, budget, seed, **parse_settings(changes))


def under(experiment: str, protocol: str) -> str:
    """The name of an experiment under a protocol; one that names its protocol already keeps it.

    ``paper`` is the default and never part of the result: ``true+protocol=paper`` becomes ``true``. The protocol comes
    first, as in ``name_of``.
    """
    method, *settings = experiment.split("+")
    own = next((setting for setting in settings if setting.startswith("protocol=")), f"protocol={protocol}")
    others = [setting for setting in settings if not setting.startswith("protocol=")]
    return "+".join([method, *([own] if own != f"protocol={PROTOCOL_NAMES[0]}" else []), *others])


def without_protocol(experiment: str) -> str:
    """The name of an experiment as under the default protocol, ``paper``."""
    return "+".join(part for part in experiment.split("+") if not part.startswith("protocol="))


def budget_of(name: str) -> tuple[str | None, str]:
    """The budget that a name such as ``desk/gail`` starts with (None without one), and the experiment."""
    budget, _, experiment = name.rpartition("/")
    return budget or None, experiment


MAIN = ("true", "gail", "mconbo-gail")
# A study leaves out what is not built in.
LATER_BASES = tuple(name for name in ("gail", "vail", "diffail") if name in {base.name for base in BUILT_IN})
STUDIES: dict[str, tuple[str, ...]] = {
    "expert": ("true",),  # Figs. 4, 9, Table 3
    "main": MAIN,  # Figs. 5, 6
    "vail": ("true", "vail", "mconbo-vail"),  # Fig. 8
    "baselines": (*MAIN, "vail", "mconbo-vail", "airl", "giril", "pwil", "maxent"),  # Table 1
    "every-base": tuple(
        f"{p}{b}" for b in ("airl", "giril", "pwil", "maxent", "diffail") for p in ("", "mconbo-")
    ),  # Q4
    "parts": ("gail", "mcond-gail", "mbo-gail", "mconbo-gail"),  # Figs. 7, 11, Table 9
    "p-and-q": (  # Fig. 10
        *(name_of("mconbo-gail", bonus_p=p, bonus_q=q) for p in (0.0, 0.5, 1.0) for q in (0.0, 0.5, 1.0)),
    ),
    "observation": ("true", "mconbo-gail", "mconbo-gail-obs"),  # Fig. 15, Table 2
    "demonstrations": (  # Figs. 12-14
        "true",
        *("gail", "mconbo-gail"),
        *(f"{method}+demo_episodes={n}" for method in ("gail", "mconbo-gail") for n in DEMONSTRATIONS),
    ),
    "true-reward": ("true", "mbo-true", "mconbo-gail"),  # Fig. 16
    "survival": (  # Q1
        "zero",
        "mbo-zero+bonus_q=0.0",
        "mbo-zero+bonus_p=0.0",
        "mbo-zero",
        "mconbo-gail",
        "mconbo-gail+bonus_p=0.0",
    ),
    "protocols": (  # Q5, Q6
        *MAIN,
        *("gail+protocol=released", "mbo-gail+protocol=released", "mconbo-gail+protocol=released"),
        *("gail+protocol=improved", "mconbo-gail+protocol=improved"),
    ),
    "later": (  # the later version's arms (E1 to E5)
        *(under(f"{prefix}{base}", "released") for base in LATER_BASES for prefix in ("", "mbo-")),
        *("true", under("true", "released"), under("mbo-true", "released")),
    ),
    "released": (  # every difference between paper and released program, one at a time (Q2, Q3)
        "mconbo-gail",
        "mconbo-gail+protocol=released",
        "mconbo-gail+selection=true",
        "mconbo-gail+walk_weights=fitness",
        "mconbo-gail+fitness_coefficient=signed",
        "mconbo-gail+xnes_center=random",
        "mconbo-gail+rejects=difference",
        "mconbo-gail+restart_order=before-walk",
        "mconbo-gail+restart_statistics=other",
        "mconbo-gail+restart_samples=same",
        "mconbo-gail+copies_scaled=together",
        "mconbo-gail+reward_schedule=update+reward_steps=1",
        "mconbo-gail+bonus_scope=rollout",
        "mconbo-gail+bonus_p=0.0+bonus_q=2.0",
        "mconbo-gail+expert_alignment=shifted",
        "mconbo-gail+expert_obs=raw",
        "mconbo-gail+expert_batches=first",
        "mconbo-gail+penalty_mixing=element",
        "mconbo-gail+gradient_penalty=0.0",  # the other way round: the program has one, the paper mentions none
        "mconbo-vail",
        "mconbo-vail+vail_beta=fixed",
        "mconbo-vail+vail_encoder=squashed",
        "mconbo-vail+vail_visits=True",
        "mconbo-pwil",
        "mconbo-pwil+pwil_coupling=step",
        "mconbo-pwil+pwil_alpha=1.0+pwil_beta=1.0",
        "mconbo-diffail",
        "mconbo-diffail+diffail_steps=100",
        "mconbo-diffail+diffail_penalty=10.0",
        "mconbo-diffail+diffail_loss=logit",
        "mconbo-diffail+diffail_reward=element",
    ),
}
assert all(any(f"+{name}=" in e for e in STUDIES["released"]) for name in PROTOCOLS["released"])


# One demonstration is the default of smoke, and its few elites do not suffice for ten.
SMOKE_CANNOT = ("demo_episodes=1", "demo_episodes=10")


def experiments_of(studies: Iterable[str], budget: str) -> tuple[str, ...]:
    """The experiments of ``studies`` at a budget, without repeats. Raises ConfigError for an unknown study."""
    names: list[str] = []
    for study in studies:
        if study not in STUDIES:
            raise ConfigError(f"unknown study '{study}'; choose one of {', '.join(STUDIES)}.")
        names += STUDIES[study]
    left_out = SMOKE_CANNOT if budget == "smoke" else ()
    return tuple(name for name in dict.fromkeys(names) if not name.endswith(left_out))
