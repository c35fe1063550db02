"""``qdil bench --against``: whole iterations of this version of qdil and of another checkout, alternating.

Every measurement runs in a new process: it begins a run, does one iteration, warms up and then times some iterations.
The processes of the two versions alternate, so that the machine's drift affects both. Each version has its own
compilation cache, which is empty for its first process. So its first start is cold, and the later ones are warm.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

import qdil
from qdil.config import make_config
from qdil.errors import ConfigError
from qdil.files import write_npz
from qdil.imitation.demos import made_up
from qdil.robots import register

METHODS = ("true", "mconbo-gail")
WARM_UP = 100  # VPPO updates before the timed iterations; untrained robots only fall, and a run's robots do not
ITERATIONS = 15  # timed in each process

# Uses only what every version of qdil has had.
MEASURE = """
import json, sys, time
from pathlib import Path
env, method, budget, warm_up, iterations, demos, began = sys.argv[1:]
import qdil
assert Path(qdil.__file__).is_relative_to(Path.cwd()), qdil.__file__
getattr(qdil, "use_all_cores", lambda: None)()  # earlier versions did this when imported
import jax
import numpy as np
from qdil import ppga
from qdil.config import make_config
from qdil.imitation.reward_model import Demonstrations

def iteration(search):
    search, info = ppga.iteration(search)
    jax.block_until_ready(search.state.key)
    return search, float(info["steps"] if isinstance(info, dict) else info.steps)

arrays = np.load(demos)
made_up = Demonstrations(*(jax.numpy.asarray(arrays[name]) for name in Demonstrations._fields))
search, _ = iteration(ppga.begin(make_config(env, method, budget), None if method == "true" else made_up))
start = time.time() - float(began)
search = ppga.warmed_up(search, int(warm_up))
steps, seconds = [], []
for _ in range(int(iterations)):
    before = time.monotonic()
    search, count = iteration(search)
    steps.append(count)
    seconds.append(time.monotonic() - before)
print(json.dumps({"start": start, "steps": steps, "seconds": seconds}))
"""


class Measured(NamedTuple):
    """What one process measured."""

    start: float  # seconds from the start of the process to the end of its first iteration
    steps: list[float]  # environment steps of the timed iterations
    seconds: list[float]  # times of these iterations


def check(checkout: Path) -> None:
    """Raise ConfigError unless ``checkout`` is a folder that holds a version of qdil."""
    if not (checkout / "qdil" / "ppga.py").is_file():
        raise ConfigError(f"--against {checkout}: there is no version of qdil in this folder.")


def compare(
    checkout: Path, env: str, budget: str, rounds: int, warm_up: int = WARM_UP, iterations: int = ITERATIONS
) -> dict[str, float]:
    """Measure both versions in ``rounds`` alternations for each of ``METHODS``, and return ``figures``.

    Raises ConfigError if a version cannot run.
    """
    versions = {"here": Path(qdil.__file__).parents[1], "other": checkout.resolve()}
    row: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_demonstrations(folder / "demos.npz", env, budget)
        for method in METHODS:
            measured: dict[str, list[Measured]] = {version: [] for version in versions}
            for number in range(rounds):
                order = list(versions) if number % 2 == 0 else list(versions)[::-1]
                for version in order:
                    print(f"{env} {method}: round {number + 1} of {rounds}, {version} …", file=sys.stderr, flush=True)
                    words = [env, method, budget, str(warm_up), str(iterations), str(folder / "demos.npz")]
                    measured[version].append(_measure(versions[version], folder / f"cache-{version}", words))
            row |= {f"{method.replace('-', '_')}_{name}": value for name, value in figures(**measured).items()}
    return row


def figures(here: list[Measured], other: list[Measured]) -> dict[str, float]:
    """Ratios of this version to the other, and the starts of both in seconds.

    ``iteration_speed_over_other``: the ratio of the median speeds over all timed iterations. ``steps_over_other`` is 1
    where both did the same work. ``warm_start``: the median; missing after a single round.
    """
    row = {
        "iteration_speed_over_other": _median_speed(here) / _median_speed(other),
        "steps_over_other": sum(sum(p.steps) for p in here) / sum(sum(p.steps) for p in other),
    }
    for name, processes in (("", here), ("other_", other)):
        cold, *warm = [process.start for process in processes]
        row[f"{name}cold_start_seconds"] = cold
        if warm:
            row[f"{name}warm_start_seconds"] = statistics.median(warm)
    return row


def _median_speed(processes: list[Measured]) -> float:
    """Median environment steps per second over the iterations of all processes."""
    return statistics.median(s / t for p in processes for s, t in zip(p.steps, p.seconds, strict=True))


def _write_demonstrations(path: Path, env: str, budget: str) -> None:
    """Made-up demonstrations of the robot, the same for both versions."""
    config = make_config(env, "mconbo-gail", budget)
    demos = made_up(register.make(env), config.demos.demo_episodes * config.simulation.episode_length)
    write_npz(path, **{name: np.asarray(values) for name, values in demos._asdict().items()})


def _measure(checkout: Path, cache: Path, words: list[str]) -> Measured:
    """Run ``MEASURE`` with the version in ``checkout``, from its folder."""
    variables = os.environ | {"PYTHONPATH": str(checkout), "JAX_COMPILATION_CACHE_DIR": str(cache)}
    command = [sys.executable, "-c", MEASURE, *words, str(time.time())]
    done = subprocess.run(command, cwd=checkout, env=variables, stdout=subprocess.PIPE, text=True)
    if done.returncode != 0:
        raise ConfigError(f"the version of qdil in {checkout} failed to run {words[1]} on {words[0]}.")
    return Measured(**json.loads(done.stdout.splitlines()[-1]))
