"""Tables of hyperparameters: the value of a run, the paper's own scale, and where each is from."""

import re

import pandas as pd

from qdil.config import Config, ConfigError, make_config, settings_help


def sources() -> dict[str, str]:
    """What every setting is and where its default is from, as ``qdil.config`` says it, by name."""
    lines = (re.fullmatch(r"  (\w+)=(.*?): (.*)", line) for line in settings_help().splitlines())
    return {line[1]: line[3] for line in lines if line}


def table(names: list[str], config: Config) -> pd.DataFrame:
    """A row per setting: its value in ``config``, at ``full``, what it is. Raises ConfigError for an unknown one."""
    said = sources()
    if unknown := [name for name in names if name not in said]:
        raise ConfigError(f"there is no setting '{unknown[0]}'.")
    full = make_config(config.env, config.method, "full", config.seed)
    rows = {n: [str(getattr(config, n)), str(getattr(full, n)), said[n]] for n in names}
    columns = [f"{config.budget} budget", "full budget", "what it is (and where the full budget's value is from)"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("setting")
