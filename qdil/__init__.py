"""qdil: quality-diversity imitation learning in JAX, the reproducible companion to MConbo-GAIL.

Importing it changes nothing in the process. ``qdil.use_all_cores()`` makes every CPU core a device.
"""

from typing import TYPE_CHECKING, Any

from qdil.devices.start import use_all_cores as use_all_cores

if TYPE_CHECKING:
    from qdil.explorer import explore as explore
    from qdil.explorer import render as render

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Import ``qdil.explore`` and ``qdil.render`` on first use, because they import widgets and the simulator."""
    if name in ("explore", "render"):
        from qdil import explorer

        return getattr(explorer, name)
    raise AttributeError(f"module 'qdil' has no attribute '{name}'")
