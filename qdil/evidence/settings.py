"""Tables of settings: the value in a run, the value at the paper's scale, and where that is from."""

import pandas as pd

from qdil.config import Config, descriptions, make_config, value_of
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
