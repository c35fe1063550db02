"""A user's own modules: where reward models and robots that are not ours are registered.

A module is loaded if an installed package names it in the entry-point group ``qdil.plugins``, or if the command line
names it with ``--import``. That option sets the variable ``QDIL_IMPORT``, so that notebooks and the jobs of a sweep,
which are processes of their own, load the module too.
"""

import os
import sys
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points

from qdil.errors import ConfigError

ENTRY_POINTS = "qdil.plugins"
VARIABLE = "QDIL_IMPORT"  # names of modules, separated by commas


def request(modules: list[str]) -> None:
    """Have ``modules`` loaded, in this process and in those that it starts."""
    wanted = [name for name in os.environ.get(VARIABLE, "").split(",") if name]
    os.environ[VARIABLE] = ",".join(dict.fromkeys([*wanted, *modules]))
    load.cache_clear()


@cache
def load() -> None:
    """Import every plugin, once. Raises ConfigError, in one sentence, for one that cannot be imported."""
    for entry in entry_points(group=ENTRY_POINTS):
        try:
            entry.load()
        except Exception as error:  # whatever a user's module may raise
            raise ConfigError(
                f"the installed plugin '{entry.name}' cannot be loaded ({error!r}): mend or uninstall its package."
            ) from error
    for name in [name for name in os.environ.get(VARIABLE, "").split(",") if name]:
        if os.getcwd() not in sys.path:
            sys.path.append(os.getcwd())  # the folder in which the reader works, wherever the command was installed
        try:
            import_module(name)
        except Exception as error:
            raise ConfigError(f"the module '{name}' named by --import cannot be loaded ({error!r}).") from error
