"""Settings of the whole process: CPU cores as JAX devices, and the cache of compiled programs."""

import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path

HOST_DEVICES_FLAG = "--xla_force_host_platform_device_count"


def cores() -> int:
    """The number of CPU cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def use_all_cores() -> None:
    """Let this process train on every CPU core, and keep compiled programs between processes.

    Call it once, before JAX is used for anything else (JAX may be imported already). The command line and the
    notebooks of this project call it; importing ``qdil`` does not. It changes the process for good:

    - ``XLA_FLAGS`` makes every CPU core a JAX device, so that robots are simulated on all of them: about twice as fast
      on two cores. It has no effect once JAX's devices have started, and none on GPUs.
    - JAX's compilation cache lives in ``~/.cache/qdil``, one folder per jaxlib version and kind of processor, and
      keeps every program, however fast it compiles.

    Processes that this one starts inherit both. Settings that the user made before stay unchanged.
    """
    _set_host_devices()
    _set_compilation_cache()


def _set_host_devices() -> None:
    flags = os.environ.get("XLA_FLAGS", "")
    if HOST_DEVICES_FLAG not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {HOST_DEVICES_FLAG}={cores()}".strip()


def _set_compilation_cache() -> None:
    if "jax" in sys.modules and sys.modules["jax"].config.jax_compilation_cache_dir:
        return  # set in a user's code
    root = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    folder = root / "qdil" / f"jaxlib-{version('jaxlib')}-{platform.machine()}"
    _set("JAX_COMPILATION_CACHE_DIR", str(folder))
    _set("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", 0)  # compiling many small programs takes seconds, too


def _set(variable: str, value: str | int) -> None:
    """Set one of JAX's variables unless the user has set it; JAX may already be imported and have read them."""
    if variable not in os.environ:
        os.environ[variable] = str(value)
        if "jax" in sys.modules:
            sys.modules["jax"].config.update(variable.lower(), value)
