"""A user's own modules, which register reward models (``qdil.methods``) or robots (``qdil.robots.register``).

``load`` imports a module if an installed package names it in the entry-point group ``qdil.plugins``, or if the command
line names it with ``--import``. That option sets the variable ``QDIL_IMPORT``, so that notebooks and the jobs of a
sweep, which run in other processes, import the module too.
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
    """Request ``modules`` by name. The next ``load`` imports them, in this process and in processes that it starts.

    Those processes may work in other folders, so the working directory joins Python's path for them. Raises ConfigError
    for the name of a file.
    """
    for name in modules:
        if name.endswith(".py"):
            raise ConfigError(f"--import takes the name of a module, without .py: --import {name.removesuffix('.py')}.")
    if modules:
        paths = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
        os.environ["PYTHONPATH"] = os.pathsep.join(dict.fromkeys([*paths, os.getcwd()]))
    os.environ[VARIABLE] = ",".join(dict.fromkeys([*_requested(), *modules]))
    load.cache_clear()


def _requested() -> list[str]:
    return [name for name in os.environ.get(VARIABLE, "").split(",") if name]


@cache
def load() -> None:
    """Import every requested module, once per process.

    Modules are searched on Python's path, then in the working directory. Raises ConfigError, in one sentence that names
    the module, if a module cannot be imported or registers something impossible.
    """
    for entry in entry_points(group=ENTRY_POINTS):
        try:
            entry.load()
        except Exception as error:  # a user's module may raise anything
            raise _refusal(f"the installed plugin '{entry.name}'", error) from error
    for name in _requested():
        if os.getcwd() not in sys.path:
            sys.path.append(os.getcwd())  # Python does this for ``python -m qdil``, but not for the command ``qdil``
        try:
            import_module(name)
        except Exception as error:
            raise _refusal(f"the module '{name}' named by --import", error) from error


def _refusal(what: str, error: Exception) -> ConfigError:
    reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return ConfigError(f"{what} cannot be loaded ({' '.join(reason.split()).rstrip('.')}).")
