"""Tables of settings show a run's values, the paper's scale and the source of every setting."""

import pytest

from qdil.config import PROTOCOLS, descriptions, flat, make_config
from qdil.errors import ConfigError
from qdil.evidence import settings


def test_settings_are_the_runs_and_the_papers_scale_with_their_sources():
    config = make_config("walker2d", "mconbo-gail", "laptop", bonus_q=1.5)
    table = settings.table(["bonus_q", "cells", "actor_hidden"], config)
    assert table.iloc[:, 0].tolist() == ["1.5", str(config.ppga.cells), str(config.ppo.actor_hidden)]
    full = make_config("walker2d", "mconbo-gail", "full")
    assert table.iloc[:, 1].tolist() == [str(full.bonus.bonus_q), str(full.ppga.cells), str(full.ppo.actor_hidden)]
    assert "eq. 2" in table.iloc[0, 2] and "grid cells" in table.iloc[1, 2]
    with pytest.raises(ConfigError, match="speed"):
        settings.table(["speed"], config)


def test_every_setting_that_can_be_changed_has_a_row_with_a_description():
    config = make_config("walker2d", "gail", "full")
    table = settings.table(list(descriptions()), config)
    assert set(table.index) == set(flat(config)) - {"env", "method", "budget", "seed"}
    assert table.iloc[:, 2].str.len().min() > 5


def test_the_table_of_protocols_shows_every_choice_of_each():
    table = settings.protocols("walker2d", "mconbo-gail", "laptop")
    for protocol, changes in PROTOCOLS.items():
        for name, value in changes.items():
            assert table.loc[name, protocol] == str(value) != table.loc[name, "paper"]
    assert (table["paper"] != table["released"]).sum() == len(PROTOCOLS["released"])
