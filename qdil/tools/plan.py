"""What a run will do and about how long it will take on this machine, before it is begun."""

import json
import time
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdil.compiled import Compiled, compile_run
from qdil.config import Config, to_json

CALIBRATION_UPDATES = 3


class Plan(NamedTuple):
    """Environment steps of a run's parts, and seconds per part from a short calibration."""

    warm_up_steps: int
    training_steps: int  # both VPPO phases of all iterations
    evaluation_steps: int  # if every episode lasts to its time limit
    compile_seconds: float
    training_steps_per_second: float
    evaluation_steps_per_second: float

    @property
    def seconds(self) -> float:
        """An estimate of the whole run, from above where episodes end early."""
        trained = self.warm_up_steps + self.training_steps
        return (
            self.compile_seconds
            + trained / self.training_steps_per_second
            + self.evaluation_steps / self.evaluation_steps_per_second
        )


def plan(config: Config) -> Plan:
    """Count the steps of ``config`` and time a few VPPO updates and one chunk of evaluation, on the true reward.

    A learned reward adds its own inference and learning, usually a few percent.
    """
    began = time.monotonic()
    compiled = compile_run(replace(config, method="true"))
    window = config.window * config.num_envs
    _train(config, compiled, 1), _evaluate(config, compiled)
    compiled_after = time.monotonic() - began
    return Plan(
        config.warmup_updates * window,
        config.iterations * (config.gradient_updates + config.walk_updates) * window,
        config.iterations * config.candidates * config.episodes * config.episode_length,
        compiled_after,
        CALIBRATION_UPDATES * window / _train(config, compiled, CALIBRATION_UPDATES),
        config.candidates * config.episodes * config.eval_chunk / _evaluate(config, compiled),
    )


def _train(config: Config, compiled: Compiled, updates: int) -> float:
    """Seconds of so many VPPO updates, whole epochs included."""
    state = compiled.init(jax.random.key(0), None)
    occupied = jnp.zeros((config.cells,) * (compiled.parts.streams - 1), bool)
    began = time.monotonic()
    weights = jnp.eye(compiled.parts.streams)
    jax.block_until_ready(compiled.train(state, occupied, weights, False, updates, config.epochs).theta)
    return time.monotonic() - began


def _evaluate(config: Config, compiled: Compiled) -> float:
    """Seconds of one chunk of candidates' steps."""
    state = compiled.init(jax.random.key(0), None)
    coefficients = jnp.zeros((config.candidates, compiled.parts.streams))
    policies, _ = compiled.branch(state, jnp.zeros((compiled.parts.streams, 1)), coefficients)
    keys = compiled.place(jax.random.split(jax.random.key(0), (config.candidates, config.episodes)))
    actors, tally = compiled.episodes.begin(keys)
    began = time.monotonic()
    jax.block_until_ready(compiled.episodes.advance(policies, actors, tally)[1].length)
    return time.monotonic() - began


def report(config: Config, planned: Plan) -> str:
    """The resolved configuration, the steps and the estimate, for people."""
    million = 1e6
    lines = [
        json.dumps(to_json(config), indent=2),
        f"warm-up:     {planned.warm_up_steps / million:8.2f} million environment steps",
        f"training:    {planned.training_steps / million:8.2f} million",
        f"candidates:  {planned.evaluation_steps / million:8.2f} million, if no episode ends early",
        f"here: {planned.training_steps_per_second:,.0f} steps/s in training, "
        f"{planned.evaluation_steps_per_second:,.0f} in evaluation, {planned.compile_seconds:.0f} s to compile",
        f"estimate:    {planned.seconds / 60:8.1f} minutes",
    ]
    return "\n".join(lines)
