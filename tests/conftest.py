"""Imported before any test: ``qdil`` first, so that JAX starts with one host device per core."""

from hypothesis import settings

import qdil  # noqa: F401

settings.register_profile("qdil", deadline=None, max_examples=50, derandomize=True)
settings.load_profile("qdil")
