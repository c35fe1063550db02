"""Process-wide settings that count before JAX's devices start: how many on the host, and the compilation cache."""

import os
import platform
import sys
from pathlib import Path

HOST_DEVICES_FLAG = "--xla_force_host_platform_device_count"


def cores() -> int:
    """CPU cores this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _set(variable: str, value: str | int) -> None:
    """One of JAX's settings, unless the user has set it; also where JAX was imported, and has read variables, first."""
    if variable not in os.environ:
        os.environ[variable] = str(value)
        if "jax" in sys.modules:
            sys.modules["jax"].config.update(variable.lower(), value)


def _set_host_devices() -> None:
    """Show each CPU core to JAX as a device, so the environment axis can be sharded over them.

    Worth a factor of two in simulation speed on two cores. A user's own setting is left alone. XLA reads it when the
    first device is asked for, so JAX may be imported already.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if HOST_DEVICES_FLAG not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {HOST_DEVICES_FLAG}={cores()}".strip()


def _set_compilation_cache() -> None:
    """Keep compiled programs between processes, in one folder per jaxlib version and kind of machine."""
    from importlib.metadata import version

    if "jax" in sys.modules and sys.modules["jax"].config.jax_compilation_cache_dir:
        return  # set in a user's code
    root = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    folder = root / "qdil" / f"jaxlib-{version('jaxlib')}-{platform.machine()}"
    _set("JAX_COMPILATION_CACHE_DIR", str(folder))
    _set("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", 0)  # many small programs are seconds too


def prepare() -> None:
    """Apply all settings; called once, when ``qdil`` is imported."""
    _set_host_devices()
    _set_compilation_cache()
