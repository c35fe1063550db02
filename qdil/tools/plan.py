"""What a run will do and about how long it will take on this machine, before it is begun."""

import json
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdil.compiled import Compiled, compile_run
from qdil.config import Config, to_json
from qdil.imitation.reward_model import Demonstrations
from qdil.phases import Parts, State, Trained
from qdil.registry import bases, parse_method

CALIBRATION_UPDATES = 3


class Steps(NamedTuple):
    """Environment steps of a run's parts; those of episodes as if each lasted to its time limit."""

    warm_up: int
    training: int  # both VPPO phases of all iterations, and the windows that a reward model learns from
    evaluation: int
    rescoring: int  # of all elites at the end, as if every cell were filled


class Speed(NamedTuple):
    """What a short calibration on this machine says."""

    start_seconds: float  # to compile, and for the reward model to learn what it learns before the run
    training: float  # environment steps per second
    evaluation: float
    reward_seconds: float  # of a round of the reward model's learning; 0 where it does not learn


class Plan(NamedTuple):
    """A run's size and its estimated time."""

    steps: Steps
    speed: Speed
    reward_rounds: int

    @property
    def seconds(self) -> float:
        """An estimate of the whole run, from above where episodes end early."""
        steps, speed = self.steps, self.speed
        return (
            speed.start_seconds
            + (steps.warm_up + steps.training) / speed.training
            + (steps.evaluation + steps.rescoring) / speed.evaluation
            + self.reward_rounds * speed.reward_seconds
        )


def plan(config: Config) -> Plan:
    """Count the steps of ``config`` and time a few VPPO updates, a round of the reward's learning, a chunk of episodes.

    A method that imitates is timed on made-up demonstrations. Not timed: what its reward costs in evaluated episodes.
    """
    compiled = compile_run(config)
    learns = bool(compiled.model.learns)
    rounds = config.iterations + _batches(config.warmup_updates, config.walk_updates) if learns else 0
    return Plan(count(config, learns, compiled.parts.streams - 1), _calibrated(config, compiled), rounds)


def count(config: Config, learns: bool, k: int) -> Steps:
    """Environment steps of a run whose reward model ``learns`` or not, with ``k`` measures."""
    window, episodes = config.window * config.num_envs, config.candidates * config.episodes * config.episode_length
    updates = config.gradient_updates + config.walk_updates + int(learns)
    return Steps(
        config.warmup_updates * window,
        config.iterations * updates * window,
        config.iterations * episodes,
        _batches(config.cells**k, config.candidates) * episodes,
    )


def _batches(count: int, size: int) -> int:
    return -(-count // size)


def _calibrated(config: Config, compiled: Compiled) -> Speed:
    """Everything once, to compile it, and then again by the clock."""
    began = time.monotonic()
    imitates = bases()[parse_method(config.method).base].imitates
    demos = _made_up(config, compiled.parts) if imitates else None
    compiled.ahead(jax.random.key(0), demos)  # as a run begins
    state = compiled.init(jax.random.key(0), demos)
    trained, _ = _train(config, compiled, state, 1)
    _evaluate(config, compiled, state), _learn(config, compiled, trained, demos)
    start_seconds = time.monotonic() - began
    trained, seconds = _train(config, compiled, trained.state, CALIBRATION_UPDATES)
    return Speed(
        start_seconds,
        CALIBRATION_UPDATES * config.window * config.num_envs / seconds,
        _evaluate(config, compiled, state),
        _learn(config, compiled, trained, demos),
    )


def _made_up(config: Config, parts: Parts) -> Demonstrations:
    """As many rows as demonstrations can have, of noise: fit to be timed."""
    env = parts.env
    widths, rows = (env.obs_size, env.action_size, env.obs_size, parts.streams - 1), config.episode_length
    keys = jax.random.split(jax.random.key(0), len(widths))
    shapes = [(config.demo_episodes * rows, width) for width in widths]
    return Demonstrations(*(jax.random.normal(key, shape) for key, shape in zip(keys, shapes, strict=True)))


def _occupied(config: Config, compiled: Compiled) -> jax.Array:
    return jnp.zeros((config.cells,) * (compiled.parts.streams - 1), bool)


def _train(config: Config, compiled: Compiled, state: State, updates: int) -> tuple[Trained, float]:
    """So many VPPO updates, whole epochs included, and their seconds."""
    began = time.monotonic()
    weights = jnp.eye(compiled.parts.streams)
    trained = compiled.train(state, _occupied(config, compiled), weights, False, updates, config.epochs)
    jax.block_until_ready(trained.theta)
    return trained, time.monotonic() - began


def _learn(config: Config, compiled: Compiled, trained: Trained, demos: Demonstrations | None) -> float:
    """Seconds of a round of the reward model's learning."""
    if not compiled.model.learns:
        return 0.0
    began = time.monotonic()
    occupied = _occupied(config, compiled)
    state, _ = compiled.update_reward(trained.state, occupied, demos, trained.transitions)
    jax.block_until_ready(jax.tree.leaves(state.reward))
    return time.monotonic() - began


def _evaluate(config: Config, compiled: Compiled, state: State) -> float:
    """Steps per second of candidates; of robots that fall, whose episodes are short yet, to the end of the chunk."""
    coefficients = jnp.zeros((config.candidates, compiled.parts.streams))
    policies, _ = compiled.branch(state, jnp.zeros((compiled.parts.streams, 1)), coefficients)
    keys = compiled.place(jax.random.split(jax.random.key(0), (config.candidates, config.episodes)))
    actors, tally = compiled.episodes.begin(keys)
    began = time.monotonic()
    length = np.asarray(compiled.episodes.advance(policies, actors, tally)[1].length)
    return float(np.sum(np.ceil(length / config.eval_chunk))) * config.eval_chunk / (time.monotonic() - began)


def report(config: Config, planned: Plan) -> str:
    """The resolved configuration, the steps and the estimate, for people."""
    steps, speed, rounds = planned.steps, planned.speed, planned.reward_rounds
    lines = [
        json.dumps(to_json(config), indent=2),
        f"warm-up:     {steps.warm_up:15,} environment steps",
        f"training:    {steps.training:15,}",
        f"candidates:  {steps.evaluation:15,}, if no episode ends early",
        f"rescoring:   {steps.rescoring:15,}, if no episode ends early and every cell is filled",
        f"here: {speed.training:,.0f} steps/s in training, {speed.evaluation:,.0f} in evaluation, "
        f"{speed.start_seconds:.0f} s to compile and begin",
    ]
    if rounds:
        lines.append(f"{rounds} rounds of the reward model's learning, {speed.reward_seconds:.2f} s each")
    return "\n".join([*lines, f"estimate:    {planned.seconds / 60:15,.1f} minutes"])
