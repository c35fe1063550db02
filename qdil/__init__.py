"""qdil: quality-diversity imitation learning in JAX, the reproducible companion to MConbo-GAIL."""

from qdil import _startup

_startup.prepare()

__version__ = "0.1.0"
