"""``qdil bench``: how fast a run is on this machine, as ratios to the bare simulator.

The bare simulator steps the same robots on the same devices with random actions. The bench times it and ``workloads``
alternately (``timing``), and reports medians of ratios within a round.
"""

import json
import os
import resource
import statistics
import subprocess
import sys
from functools import partial

import jax
import jax.numpy as jnp

from qdil import ppga
from qdil.config import make_config, value_of
from qdil.tools import workloads
from qdil.tools.compiled_code import compiled_code
from qdil.tools.start import start_seconds
from qdil.tools.timing import in_turns, on_one_core, speeds_and_ratios, timed

Row = dict[str, float]  # figures of one robot by name


def everything(env: str, budget: str, rounds: int) -> Row:
    """All figures of one robot. Prints each measurement's name to standard error as it starts."""

    def announce(what: str) -> None:
        print(f"{env}: {what} …", file=sys.stderr, flush=True)

    announce("starting a run, with an empty and a warm cache")
    row = start_seconds(env)
    announce(f"{rounds} rounds at {budget}, minutes")
    row |= run_speeds(env, budget, rounds)
    announce("the full budget's networks")
    row |= full_networks(env, rounds)
    announce("compiled code")
    return row | compiled_code(env)


def in_own_process(env: str, budget: str, rounds: int) -> dict[str, Row]:
    """``everything`` of one robot, by robot, measured in a new process."""
    command = [sys.executable, "-m", "qdil", "bench", "--env", env, "--budget", budget, "--rounds", str(rounds)]
    return json.loads(subprocess.run([*command, "--json"], check=True, stdout=subprocess.PIPE).stdout)


def run_speeds(env: str, budget: str, rounds: int) -> Row:
    """Speeds of one robot's runs. Takes minutes: every program is compiled for one device and for all of them."""
    true = workloads.prepared(env, "true", budget)
    row = _expert(true, rounds)
    row["peak_memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # of one run, before the others
    row |= _imitator(workloads.prepared(env, "mconbo-gail", budget, like=true), rounds)
    if jax.local_device_count() > 1:
        row |= _devices(true, workloads.prepared(env, "true", budget, like=true, devices=1), rounds)
    return row


def _expert(true: ppga.Search, rounds: int) -> Row:
    """The expert's iterations and their parts; the bare simulator as Brax's and as a run's."""
    devices = true.engine.num_devices
    turns = in_turns(
        {
            "simulator": workloads.bare_simulator(true.config, devices, as_brax=True),
            "tuned": workloads.bare_simulator(true.config, devices),
            "vppo": partial(workloads.walk, true),
            "evaluation": partial(workloads.evaluation, true),
            "iteration": workloads.iterations_of(true),
        },
        rounds,
    )
    speeds, over = speeds_and_ratios(turns, "simulator")
    return {
        "simulator_steps_per_second": speeds["simulator"],
        "vppo_over_simulator": over["vppo"],
        "evaluation_over_simulator": over["evaluation"],
        "iteration_steps_per_second": speeds["iteration"],
        "iteration_over_simulator": over["iteration"],
        "tuned_simulator_over_simulator": over["tuned"],
        "iteration_over_tuned_simulator": speeds_and_ratios(turns, "tuned")[1]["iteration"],
    }


def _imitator(imitator: ppga.Search, rounds: int) -> Row:
    """The imitator's iterations, and the share of them that its reward model's learning takes."""
    devices = imitator.engine.num_devices
    turns = in_turns(
        {
            "simulator": workloads.bare_simulator(imitator.config, devices, as_brax=True),
            "tuned": workloads.bare_simulator(imitator.config, devices),
            "iteration": workloads.iterations_of(imitator),
            "reward": partial(workloads.reward_update, imitator),
        },
        rounds,
    )
    seconds = {name: statistics.median(s for _, s in results) for name, results in turns.items()}
    return {
        "mconbo_gail_iteration_over_simulator": speeds_and_ratios(turns, "simulator")[1]["iteration"],
        "mconbo_gail_iteration_over_tuned_simulator": speeds_and_ratios(turns, "tuned")[1]["iteration"],
        "reward_update_share": seconds["reward"] / seconds["iteration"],
    }


def _devices(together: ppga.Search, alone: ppga.Search, rounds: int) -> Row:
    """All devices against one: the bare simulator, and whole iterations."""
    bare = {
        "one": workloads.bare_simulator(alone.config, 1),
        "all": workloads.bare_simulator(together.config, together.engine.num_devices),
    }
    one, all_devices = workloads.same_iterations(alone, together)

    def speedup(turns: dict) -> float:
        return speeds_and_ratios(in_turns(turns, rounds), "one")[1]["all"]

    row = {"simulator_device_speedup": speedup(bare), "device_speedup": speedup({"one": one, "all": all_devices})}
    if hasattr(os, "sched_setaffinity"):
        row["all_cores_over_one"] = speedup({"one": on_one_core(one), "all": all_devices})
    return row


def full_networks(env: str, rounds: int) -> Row:
    """VPPO with the ``full`` budget's networks and 192 robots, against the sum of two floors.

    The floors: bare simulation, and the update's floating-point operations at the rate of a plain matrix product.
    """
    full = make_config(env, "true", "full")
    names = ("actor_hidden", "critic_hidden", "minibatches", "epochs")
    changes = {name: value_of(full, name) for name in names}
    # No KL divergence exceeds this target, so every epoch is done and the operations can be counted.
    search = ppga.begin(make_config(env, "true", "laptop", num_envs=192, target_kl=1e9, **changes), None)
    config = search.config
    size, product_flop = 1024, 2.0 * 1024**3
    matrix, product = jnp.ones((size, size)), jax.jit(lambda x: x @ x)
    turns = in_turns(
        {
            "simulator": workloads.bare_simulator(config, search.engine.num_devices),
            "vppo": partial(workloads.walk, search),
            "product": lambda: timed(product, matrix, product_flop),
        },
        rounds,
    )
    steps, flop = config.ppo.rollout_length * config.ppo.num_envs, workloads.update_flop(search)
    simulation = [steps * seconds / amount for amount, seconds in turns["simulator"]]  # seconds of an update's floor
    arithmetic = [flop * seconds / amount for amount, seconds in turns["product"]]
    updates = [steps * seconds / amount for amount, seconds in turns["vppo"]]
    over = [u / (s + a) for u, s, a in zip(updates, simulation, arithmetic, strict=True)]
    return {
        "full_networks_simulation_floor_seconds": statistics.median(simulation),
        "full_networks_arithmetic_floor_seconds": statistics.median(arithmetic),
        "full_networks_over_floor": statistics.median(over),
    }


# Report


def table(rows: dict[str, Row]) -> str:
    """Rows by robot as an aligned table."""
    names = list(dict.fromkeys(name for row in rows.values() for name in row))
    width = max(map(len, names), default=0)
    lines = [" " * width + "".join(f"{env:>14}" for env in rows)]
    for name in names:
        lines.append(f"{name:{width}}" + "".join(f"{row.get(name, float('nan')):14.3g}" for row in rows.values()))
    return "\n".join(lines)


def as_json(rows: dict[str, Row]) -> str:
    """An object per robot."""
    return json.dumps(
        {env: {name: round(value, 4) for name, value in row.items()} for env, row in rows.items()}, indent=2
    )
