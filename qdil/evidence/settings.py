"""Tables of settings: values in a run, at the paper's scale and by protocol, and where they are from."""

import pandas as pd

from qdil.config import PROTOCOLS, Config, descriptions, make_config, value_of
from qdil.errors import ConfigError


def table(names: list[str], config: Config) -> pd.DataFrame:
    """A row per setting: its value in ``config``, at ``full``, what it is. Raises ConfigError for an unknown one."""
    known = descriptions()
    if unknown := [name for name in names if name not in known]:
        raise ConfigError(f"there is no setting '{unknown[0]}'.")
    full = make_config(config.env, config.method, "full", config.seed)
    rows = {name: [str(value_of(config, name)), str(value_of(full, name)), known[name]] for name in names}
    columns = [f"{config.budget} budget", "full budget", "what it is (and where the full budget's value is from)"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("setting")


def protocols(env: str, method: str, budget: str) -> pd.DataFrame:
    """A row per setting in which protocols differ: its value in each of them, and what it is."""
    names = dict.fromkeys(name for changes in PROTOCOLS.values() for name in changes)
    configs = {protocol: make_config(env, method, budget, protocol=protocol) for protocol in PROTOCOLS}
    rows = {
        name: [*(str(value_of(config, name)) for config in configs.values()), descriptions()[name]] for name in names
    }
    return pd.DataFrame.from_dict(rows, orient="index", columns=[*configs, "what it is"]).rename_axis("setting")
