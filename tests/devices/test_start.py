"""Process-wide settings hold whichever of qdil and JAX is imported first, and give way to a user's own."""

import os
import subprocess
import sys

import pytest

SHOW = """
import jax
print(jax.local_device_count())
print(jax.config.jax_persistent_cache_min_compile_time_secs, jax.config.jax_compilation_cache_dir)
"""
OURS = {"XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"}


def settings_after(imports: str, **variables: str) -> list[str]:
    clean = {name: value for name, value in os.environ.items() if name not in OURS}
    done = subprocess.run(
        [sys.executable, "-c", imports + SHOW], env=clean | variables, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


@pytest.mark.parametrize("imports", ["import qdil", "import jax, qdil"])
def test_settings_hold_in_either_order(imports, tmp_path):
    devices, seconds, cache = settings_after(imports, XDG_CACHE_HOME=str(tmp_path))
    assert int(devices) == len(os.sched_getaffinity(0))
    assert float(seconds) == 0 and cache.startswith(str(tmp_path))


@pytest.mark.parametrize("imports", ["import qdil", "import jax, qdil"])
def test_a_users_own_settings_stay(imports, tmp_path):
    own = {
        "XLA_FLAGS": "--xla_force_host_platform_device_count=3",
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "own"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "7",
    }
    assert settings_after(imports, **own) == ["3", "7.0", str(tmp_path / "own")]


def test_a_cache_that_code_has_set_stays(tmp_path):
    code = f"import jax; jax.config.update('jax_compilation_cache_dir', {str(tmp_path)!r}); import qdil"
    assert settings_after(code)[-1] == str(tmp_path)
