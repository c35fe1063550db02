"""Process-wide settings that only count before JAX starts: host devices, their dispatch, the compilation cache."""

import os
import platform
import sys
from pathlib import Path

HOST_DEVICES_FLAG = "--xla_force_host_platform_device_count"
ONE_CORE_FLAG = "--xla_cpu_multi_thread_eigen"


def _cores() -> int:
    """CPU cores this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _set_host_devices() -> None:
    """Show each CPU core to JAX as a device, so the environment axis can be sharded over them.

    Worth a factor of two in simulation speed on two cores. A device is one core: it does its matrix products alone.
    Spread over all threads they would wait for the other devices' work, and for ever where that waits for theirs.
    A user's own settings are left alone.
    """
    if "jax" in sys.modules:
        return
    flags = os.environ.get("XLA_FLAGS", "")
    for flag, value in ((HOST_DEVICES_FLAG, _cores()), (ONE_CORE_FLAG, "false")):
        if flag not in flags:
            flags += f" {flag}={value}"
    os.environ["XLA_FLAGS"] = flags.strip()


def _set_compilation_cache() -> None:
    """Keep compiled programs between processes, in one folder per jaxlib version and kind of machine."""
    from importlib.metadata import version

    root = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    folder = root / "qdil" / f"jaxlib-{version('jaxlib')}-{platform.machine()}"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(folder))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")  # many small programs are seconds too


def _set_dispatch() -> None:
    """One program in flight at a time where devices are CPU cores: programs that meet there compete for threads."""
    os.environ.setdefault("JAX_CPU_ENABLE_ASYNC_DISPATCH", "false")


def prepare() -> None:
    """Apply all settings; called once, when ``qdil`` is imported."""
    _set_host_devices()
    _set_compilation_cache()
    _set_dispatch()
