"""The time from the start of a ``qdil train`` process to the end of a run of one iteration, cold and warm.

Cold: the cache of compiled programs is empty. Warm: it holds every program.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time

WARM_STARTS = 3  # a single one depends too much on what else the machine does

# ``qdil train``, which also prints the seconds that compiling all programs, or loading them from the cache, took.
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
    """Seconds at ``smoke``, cold (one start) and warm (the median of ``WARM_STARTS``).

    ``*_start_seconds``: the whole process. ``*_compile_seconds``: the sum over its programs of the time to compile or
    load them. Programs compile beside each other and beside other work, so the sum may exceed the whole.
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
