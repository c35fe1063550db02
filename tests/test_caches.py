"""docs/notes/caches.md names every cache of the process, and nothing that is none."""

import importlib
import pkgutil
import re
from pathlib import Path

import qdil

ROOT = Path(__file__).parents[1]
LISTED = set(re.findall(r"`(qdil(?:\.\w+)+)`", (ROOT / "docs" / "notes" / "caches.md").read_text().split("\n`qdil")[0]))


def cached_functions():
    """The dotted names of all module-level functions that keep their results."""
    found = set()
    for module in pkgutil.walk_packages(qdil.__path__, "qdil."):
        if module.name.endswith("__main__"):
            continue
        for name, value in vars(importlib.import_module(module.name)).items():
            if hasattr(value, "cache_clear") and value.__module__ == module.name:
                found.add(f"{module.name}.{name}")
    return found


def test_every_cache_is_listed():
    assert cached_functions() == LISTED
