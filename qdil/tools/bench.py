"""How fast a run is, as shares of what the machine could do, measured side by side in one process.

Machines are shared and drift, so nothing here is worth much alone: every speed is taken in turns with the bare
simulator's (random actions, the same robots on the same devices), and the medians of their ratios are what counts.
"""

import json
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec as P

from qdil import ppga
from qdil.config import Config, make_config, value_of
from qdil.devices.mesh import AXIS, make_mesh
from qdil.devices.xla_options import single_threaded
from qdil.imitation.demos import made_up
from qdil.qd import archive
from qdil.rl.rollout import rollout, start
from qdil.robots import brax_robots, register
from qdil.tools.start import start_seconds

ROUNDS = 5  # turns that each speed is taken in
TAKEN = ("train_state", "stats", "envs")  # what a run takes over from another that has warmed up
Row = dict[str, float]


def everything(env: str, budget: str = "laptop", rounds: int = ROUNDS) -> Row:
    """All figures of one robot, saying on stderr what is being measured."""

    def say(what: str) -> None:
        print(f"{env}: {what} …", file=sys.stderr, flush=True)

    say("starting a run, with an empty and a warm cache")
    row = start_seconds(env)
    say(f"{rounds} rounds at {budget}, minutes")
    row |= bench(env, budget, rounds)
    say("the full budget's networks")
    return row | full_networks(env, rounds)


def in_a_process_of_its_own(env: str, budget: str, rounds: int) -> dict[str, Row]:
    """``everything`` of one robot, by robot."""
    command = [
        sys.executable,
        "-m",
        "qdil",
        "bench",
        "--env",
        env,
        "--budget",
        budget,
        "--rounds",
        str(rounds),
        "--json",
    ]
    return json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)


def bench(env: str, budget: str = "laptop", rounds: int = ROUNDS) -> Row:
    """Speeds of one robot's runs. Takes minutes: it compiles everything anew for one and for all devices."""
    row: Row = {}
    true = _begun(env, "true", budget)
    devices = true.engine.num_devices
    bare = _bare_simulator(true.config, devices, as_brax=True)
    tuned = _bare_simulator(true.config, devices)
    ratios = _in_turns(
        {
            "simulator": bare,
            "tuned": tuned,
            "vppo": partial(_updates, true),
            "evaluation": partial(_evaluation, true),
            "iteration": _iterations_of(true),
        },
        rounds,
    )
    speeds, over = _against(ratios, "simulator")
    row["simulator_steps_per_second"] = speeds["simulator"]
    row["vppo_over_simulator"] = over["vppo"]
    row["evaluation_over_simulator"] = over["evaluation"]
    row["iteration_steps_per_second"] = speeds["iteration"]
    row["iteration_over_simulator"] = over["iteration"]
    row["tuned_simulator_over_simulator"] = over["tuned"]
    row["iteration_over_tuned_simulator"] = _against(ratios, "tuned")[1]["iteration"]
    row["peak_memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # of one run, before the others
    imitator = _begun(env, "mconbo-gail", budget, like=true)
    works = {"simulator": bare, "tuned": tuned, "iteration": _iterations_of(imitator)}
    ratios = _in_turns({**works, "reward": partial(_reward_update, imitator)}, rounds)
    row["mconbo_gail_iteration_over_simulator"] = _against(ratios, "simulator")[1]["iteration"]
    row["mconbo_gail_iteration_over_tuned_simulator"] = _against(ratios, "tuned")[1]["iteration"]
    seconds = {name: statistics.median(s for _, s in turns) for name, turns in ratios.items()}
    row["reward_update_share"] = seconds["reward"] / seconds["iteration"]
    if jax.local_device_count() > 1:
        alone = _begun(env, "true", budget, like=true, devices=1)
        one, together = _same_iterations(alone, true)
        bare_one = _bare_simulator(alone.config, 1)
        row["simulator_device_speedup"] = _against(_in_turns({"one": bare_one, "all": tuned}, rounds), "one")[1]["all"]
        row["device_speedup"] = _against(_in_turns({"one": one, "all": together}, rounds), "one")[1]["all"]
        if hasattr(os, "sched_setaffinity"):
            turns = _in_turns({"one": _on_one_core(one), "all": together}, rounds)
            row["all_cores_over_one"] = _against(turns, "one")[1]["all"]
    return row


def full_networks(env: str, rounds: int = ROUNDS) -> Row:
    """VPPO with the ``full`` budget's networks and 192 robots, against the sum of two floors.

    The floors: bare simulation, and the update's floating-point operations at the rate of a plain matrix product.
    """
    full = make_config(env, "true", "full")
    names = ("actor_hidden", "critic_hidden", "minibatches", "epochs")
    changes = {name: value_of(full, name) for name in names}
    # The target is out of reach so that every epoch is done, and can be counted.
    search = ppga.begin(make_config(env, "true", "laptop", num_envs=192, target_kl=1e9, **changes), None)
    config = search.config
    size, rate = 1024, 2.0 * 1024**3
    matrix = jnp.ones((size, size))
    product = jax.jit(lambda x: x @ x)
    devices = search.engine.num_devices
    bare = _bare_simulator(config, devices)
    turns = _in_turns(
        {"simulator": bare, "vppo": partial(_updates, search), "product": lambda: _timed(product, matrix, rate)}, rounds
    )
    steps = config.ppo.rollout_length * config.ppo.num_envs
    floors = []
    for (s_steps, s_seconds), (v_steps, v_seconds), (flop, p_seconds) in zip(
        turns["simulator"], turns["vppo"], turns["product"], strict=True
    ):
        floor = v_steps * s_seconds / s_steps + _update_flop(search) * (v_steps / steps) * p_seconds / flop
        floors.append(v_seconds / floor)
    return {
        "full_networks_simulation_floor_seconds": steps * statistics.median(s / n for n, s in turns["simulator"]),
        "full_networks_arithmetic_floor_seconds": _update_flop(search)
        * statistics.median(s / n for n, s in turns["product"]),
        "full_networks_over_floor": statistics.median(floors),
    }


def _begun(robot: str, method: str, budget: str, like: ppga.Search | None = None, **changes: Any) -> ppga.Search:
    """A run with everything compiled, after one iteration; on made-up demonstrations.

    It begins as the budget's runs do, after their warm-up: a robot that can only fall says little about a run. With
    ``like`` it takes the robots, policy, critic and normaliser of that other run instead, on its own devices.
    """
    config = make_config(robot, method, budget, **changes)
    env = register.make(config.env, config.simulation.backend)
    rows = config.demos.demo_episodes * config.simulation.episode_length
    search = ppga.begin(config, None if method == "true" else made_up(env, rows))
    if like is None:
        search = ppga.warmed_up(search, config.ppga.warmup_updates)
    else:
        mine, theirs = search.state, like.state
        moved = {name: _laid_out_as(getattr(mine, name), getattr(theirs, name)) for name in TAKEN}
        search = search._replace(state=mine._replace(**moved))
    return ppga.iteration(search)[0]


def _laid_out_as(mine: Any, theirs: Any) -> Any:
    """The numbers of ``theirs`` in the layout over devices of ``mine``."""
    return jax.tree.map(lambda here, there: jax.device_put(there, here.sharding), mine, theirs)


Turn = Callable[[], tuple[float, float]]  # does some work; returns how many steps of it, and the seconds they took


def _on_one_core(work: Turn) -> Turn:
    """``work`` with all of the process's threads on one core: one device alone spreads over several (Linux only)."""

    def pin(cores: set[int]) -> None:
        for thread in os.listdir("/proc/self/task"):
            with suppress(ProcessLookupError):  # it has just ended
                os.sched_setaffinity(int(thread), cores)

    def turn() -> tuple[float, float]:
        cores = os.sched_getaffinity(0)
        pin({min(cores)})
        try:
            return work()
        finally:
            pin(cores)

    return turn


def _in_turns(works: dict[str, Turn], rounds: int) -> dict[str, list[tuple[float, float]]]:
    for work in works.values():
        work()  # compiles
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            taken[name].append(work())
    return taken


def _against(taken: dict[str, list[tuple[float, float]]], base: str) -> tuple[dict[str, float], dict[str, float]]:
    """Median steps per second of each, and the median ratio of each to ``base`` in the same round."""
    rates = {name: [steps / seconds for steps, seconds in turns] for name, turns in taken.items()}
    speeds = {name: statistics.median(values) for name, values in rates.items()}
    over = {n: statistics.median(a / b for a, b in zip(v, rates[base], strict=True)) for n, v in rates.items()}
    return speeds, over


def _timed(function: Any, argument: Any, amount: float) -> tuple[float, float]:
    began = time.monotonic()
    jax.block_until_ready(function(argument))
    return amount, time.monotonic() - began


def _bare_simulator(config: Config, num_devices: int, as_brax: bool = False) -> Turn:
    """Rollouts of random actions, resets and contacts included, on the run's own layout of robots over devices.

    Simulated and compiled as a run's rollouts are; or ``as_brax``, as Brax and JAX do it by themselves.
    """
    backend = config.simulation.backend
    env = brax_robots.make(register.find(config.env), backend, as_brax)

    def act(noise: jax.Array, obs: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jnp.clip(noise, -1.0, 1.0), jnp.zeros(len(noise))

    def drive(envs: Any) -> Any:
        envs, steps, _ = rollout(env, act, envs, config.ppo.rollout_length, config.simulation.episode_length)
        return envs, jnp.sum(steps.reward)[None]

    mesh = make_mesh(num_devices)
    over_devices = jax.shard_map(drive, mesh=mesh, in_specs=P(AXIS), out_specs=(P(AXIS), P(AXIS)), check_vma=False)
    run = jax.jit(over_devices, compiler_options=None if as_brax else single_threaded(num_devices))
    keys = jax.random.split(jax.random.key(0), config.ppo.num_envs)
    now = [run(jax.jit(lambda k: start(env, k, config.simulation.episode_length, in_step=False))(keys))[0]]
    rollouts = config.ppga.gradient_updates + config.ppga.walk_updates

    def turn() -> tuple[float, float]:
        began = time.monotonic()
        for _ in range(rollouts):
            now[0], reward = run(now[0])
        jax.block_until_ready(reward)
        return float(rollouts * config.ppo.rollout_length * config.ppo.num_envs), time.monotonic() - began

    return turn


def _updates(search: ppga.Search) -> tuple[float, float]:
    """One walk: N2 VPPO updates."""
    config, occupied = search.config, jnp.asarray(archive.occupied(search.archives))
    began = time.monotonic()
    fitness_alone = np.eye(search.engine.objectives)[0]
    trained = search.engine.train_policy(search.state, occupied, fitness_alone, config.ppga.walk_updates)
    jax.block_until_ready(trained.theta)
    return float(config.ppga.walk_updates * config.ppo.rollout_length * config.ppo.num_envs), time.monotonic() - began


def _evaluation(search: ppga.Search) -> tuple[float, float]:
    """All candidates at θ_μ over whole episodes."""
    coefficients = np.zeros((search.config.ppga.candidates, search.engine.objectives))
    theta = jnp.zeros((search.engine.objectives, 1))
    policies, _ = search.engine.branch(search.state, theta, coefficients)
    began = time.monotonic()
    candidates = ppga.evaluate(search, policies, search.state.key)
    return float(candidates.length.sum() * search.config.evaluation.episodes), time.monotonic() - began


def _iteration(search: ppga.Search) -> tuple[ppga.Search, tuple[float, float]]:
    """What follows one whole QD iteration; its steps and seconds."""
    began = time.monotonic()
    search, info = ppga.iteration(search)
    jax.block_until_ready(search.state.key)
    return search, (info.steps, time.monotonic() - began)


def _iterations_of(search: ppga.Search) -> Turn:
    """One whole QD iteration after the other."""
    now = [search]

    def turn() -> tuple[float, float]:
        now[0], taken = _iteration(now[0])
        return taken

    return turn


def _same_iterations(one: ppga.Search, together: ppga.Search) -> tuple[Turn, Turn]:
    """One whole QD iteration after the other by ``together``, and, each before it, the same by the devices of ``one``.

    Two runs would drift apart, and where candidates live longer more of an iteration's steps are the fast ones of
    evaluations.
    """
    now = [together]

    def before() -> tuple[float, float]:
        theirs = now[0]
        state = jax.block_until_ready(_laid_out_as(one.state, theirs.state))
        same = one._replace(archives=theirs.archives, xnes=theirs.xnes, rng=theirs.rng, state=state)
        return _iteration(same)[1]

    def turn() -> tuple[float, float]:
        now[0], taken = _iteration(now[0])
        return taken

    return before, turn


def _reward_update(search: ppga.Search) -> tuple[float, float]:
    """One round of the reward model's learning."""
    occupied = jnp.asarray(archive.occupied(search.archives))
    assert search.demos is not None
    fresh = search.engine.rollout(search.state, occupied)
    jax.block_until_ready(fresh.theta)
    began = time.monotonic()
    state, _ = search.engine.update_reward(fresh.state, occupied, search.demos, fresh.transitions)
    jax.block_until_ready(state.reward)
    return 1.0, time.monotonic() - began


def _update_flop(search: ppga.Search) -> float:
    """Floating-point operations of one VPPO update: forward and backward passes of all epochs, and the acting."""
    config, env = search.config, search.engine.env
    actor = (env.obs_size, *config.ppo.actor_hidden, env.action_size)
    critic = (env.obs_size, *config.ppo.critic_hidden, search.engine.objectives)
    weights = [sum(a * b for a, b in zip(layers, layers[1:], strict=False)) for layers in (actor, critic)]
    steps = config.ppo.rollout_length * config.ppo.num_envs
    learning = 3 * sum(weights) * config.ppo.epochs  # forward once, backward twice as much
    return 2.0 * steps * (learning + weights[0] + 2 * weights[1])  # acting; values of both ends of each step


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
