"""Before any test: every CPU core becomes a JAX device."""

import gc
from pathlib import Path

import pytest
from hypothesis import settings

import qdil
from qdil.engine import programs

qdil.use_all_cores()

settings.register_profile("qdil", deadline=None, max_examples=50, derandomize=True)
settings.load_profile("qdil")

MAPS = Path("/proc/self/maps")  # Linux
MANY_MAPS = 20_000  # Linux allows 65,530; beyond that XLA crashes without a message


@pytest.fixture(autouse=True, scope="module")
def forget_programs():
    """Every compiled program stays mapped into memory, a map for each of its parts: forget them when they are many."""
    yield
    if MAPS.exists() and len(MAPS.read_text().splitlines()) > MANY_MAPS:
        programs.forget_programs()
        gc.collect()
