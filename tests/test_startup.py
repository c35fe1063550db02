"""Process-wide settings hold whichever of qdil and JAX is imported first, and give way to a user's own."""

import os
import subprocess
import sys

import pytest

SHOW = """
import jax
print(jax.local_device_count(), jax.config.read("jax_cpu_enable_async_dispatch"))
print(jax.config.jax_persistent_cache_min_compile_time_secs, jax.config.jax_compilation_cache_dir)
"""
OURS = {"XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR", "JAX_CPU_ENABLE_ASYNC_DISPATCH"}
OURS |= {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"}


def settings_after(imports: str, **variables: str) -> list[str]:
    clean = {name: value for name, value in os.environ.items() if name not in OURS}
    done = subprocess.run(
        [sys.executable, "-c", imports + SHOW], env=clean | variables, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


@pytest.mark.parametrize("imports", ["import qdil", "import jax, qdil"])
def test_settings_hold_in_either_order(imports, tmp_path):
    devices, at_once, seconds, cache = settings_after(imports, XDG_CACHE_HOME=str(tmp_path))
    assert int(devices) == len(os.sched_getaffinity(0)) and at_once == "False"
    assert float(seconds) == 0 and cache.startswith(str(tmp_path))


@pytest.mark.parametrize("imports", ["import qdil", "import jax, qdil"])
def test_a_users_own_settings_stay(imports, tmp_path):
    own = {
        "XLA_FLAGS": "--xla_force_host_platform_device_count=3",
        "JAX_CPU_ENABLE_ASYNC_DISPATCH": "true",
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "own"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "7",
    }
    assert settings_after(imports, **own) == ["3", "True", "7.0", str(tmp_path / "own")]
