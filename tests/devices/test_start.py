"""Importing qdil changes nothing in a process; ``use_all_cores`` keeps its promises and the settings of the user."""

import json
import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.physics  # starts processes

OURS = {"XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"}
CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()


def printed(code: str, **variables: str) -> str:
    """The last line printed by a process that starts without any of our variables."""
    clean = {name: value for name, value in os.environ.items() if name not in OURS}
    done = subprocess.run([sys.executable, "-c", code], env=clean | variables, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


STATE = """
import json, os, jax
print(json.dumps([dict(os.environ), {name: repr(value) for name, value in jax.config.values.items()}]))
"""


@pytest.mark.parametrize("module", ["qdil", "qdil.cli", "qdil.ppga", "qdil.runs.train"])
def test_importing_changes_neither_variables_nor_jax(module):
    before, after = json.loads(printed(STATE)), json.loads(printed(f"import {module}" + STATE))
    assert after == before
    assert not OURS & set(after[0])


SETTINGS = """
import jax
print(jax.local_device_count(), jax.config.jax_persistent_cache_min_compile_time_secs, end=" ")
print(jax.config.jax_compilation_cache_dir)
"""
ORDERS = ["import qdil; qdil.use_all_cores()", "import jax, qdil; qdil.use_all_cores()"]


@pytest.mark.parametrize("code", ORDERS)
def test_every_core_becomes_a_device_and_programs_are_kept(code, tmp_path):
    devices, seconds, cache = printed(code + SETTINGS, XDG_CACHE_HOME=str(tmp_path)).split()
    assert int(devices) == CORES
    assert float(seconds) == 0 and cache.startswith(str(tmp_path / "qdil"))


def test_the_cache_keeps_a_small_program(tmp_path):
    code = "import qdil; qdil.use_all_cores(); import jax; jax.jit(lambda x: x + 1)(1.0); print()"
    printed(code, XDG_CACHE_HOME=str(tmp_path))
    assert any(path.is_file() for path in (tmp_path / "qdil").rglob("*"))


@pytest.mark.parametrize("code", ORDERS)
def test_a_users_own_settings_stay(code, tmp_path):
    own = {
        "XLA_FLAGS": "--xla_force_host_platform_device_count=3",
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "own"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "7",
    }
    assert printed(code + SETTINGS, **own).split() == ["3", "7.0", str(tmp_path / "own")]


def test_a_users_other_flags_are_kept():
    code = "import os, qdil; qdil.use_all_cores(); print(os.environ['XLA_FLAGS'])"
    flags = printed(code, XLA_FLAGS="--xla_cpu_enable_fast_math=false").split()
    assert flags == ["--xla_cpu_enable_fast_math=false", f"--xla_force_host_platform_device_count={CORES}"]


def test_a_cache_that_code_has_set_stays(tmp_path):
    code = f"import jax; jax.config.update('jax_compilation_cache_dir', {str(tmp_path)!r}); {ORDERS[0]}"
    assert printed(code + SETTINGS).split()[2] == str(tmp_path)


def test_processes_that_it_starts_inherit_the_settings(tmp_path):
    code = f"import subprocess, sys; {ORDERS[0]}\nsubprocess.run([sys.executable, '-c', {SETTINGS!r}], check=True)"
    devices, seconds, cache = printed(code, XDG_CACHE_HOME=str(tmp_path)).split()
    assert int(devices) == CORES and float(seconds) == 0 and cache.startswith(str(tmp_path))
