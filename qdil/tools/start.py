"""How long a run takes to start: from the process's start to its first iteration's end, cold and warm."""

import os
import statistics
import subprocess
import sys
import tempfile
import time

WARM_STARTS = 3  # a single one says as much of the machine's moment as of the program

# A run like any other, which also adds up what compiling, or loading from the cache, took over all of its programs.
RUN = """
import sys
import qdil.cli
import jax
took = [0.0]
def listen(event, seconds, **_):
    if event.endswith("backend_compile_duration"):
        took[0] += seconds
jax.monitoring.register_event_duration_secs_listener(listen)
code = qdil.cli.main(sys.argv[1:])
print(took[0])
sys.exit(code)
"""


def start_seconds(env: str = "walker2d", method: str = "true") -> dict[str, float]:
    """Seconds at ``smoke``, ``cold`` and ``warm``: of the whole ``start``, and of its programs' ``compile`` added up.

    Cold is one start, warm the median of ``WARM_STARTS``.
    Programs compile beside each other and beside other work, so that the sum can exceed what a start takes.
    """
    took: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        variables = {**os.environ, "JAX_COMPILATION_CACHE_DIR": f"{folder}/cache"}
        command = [sys.executable, "-c", RUN, "train", "--env", env, "--method", method, "--budget", "smoke"]
        command += ["--set", "iterations=1", "--out"]
        for number, name in enumerate(["cold"] + ["warm"] * WARM_STARTS):
            began = time.monotonic()
            done = subprocess.run([*command, f"{folder}/{number}"], env=variables, check=True, stdout=subprocess.PIPE)
            took.setdefault(f"{name}_start_seconds", []).append(time.monotonic() - began)
            took.setdefault(f"{name}_compile_seconds", []).append(float(done.stdout.split()[-1]))
    return {name: statistics.median(seconds) for name, seconds in took.items()}
