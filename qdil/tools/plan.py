"""``qdil train --dry-run``: a run's environment steps, and an estimate of its time on this machine."""

import json
import math
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdil.config import Config, to_json
from qdil.engine.engine import Engine, State, Trained
from qdil.imitation.demos import made_up
from qdil.imitation.reward_model import Demonstrations
from qdil.methods import parse_method

CALIBRATION_UPDATES = 3


class Steps(NamedTuple):
    """Environment steps of a run's parts, if every episode lasts to its time limit."""

    warm_up: int
    training: int  # gradients and walks of all iterations, and the rollouts that the reward model learns from
    evaluation: int
    rescoring: int  # all elites again at the end, if every cell is filled


class Speed(NamedTuple):
    """Speeds measured by a short calibration on this machine."""

    start_seconds: float  # to compile every program, and for what the reward model learns before iteration 1
    training: float  # environment steps per second
    evaluation: float  # environment steps per second
    reward_seconds: float  # one update of the reward model; 0 if it does not learn


class Plan(NamedTuple):
    """A run's environment steps and speeds, and the time that follows from them."""

    steps: Steps
    speed: Speed
    reward_rounds: int

    @property
    def seconds(self) -> float:
        """Estimated time of the whole run; too long if episodes end early."""
        steps, speed = self.steps, self.speed
        return (
            speed.start_seconds
            + (steps.warm_up + steps.training) / speed.training
            + (steps.evaluation + steps.rescoring) / speed.evaluation
            + self.reward_rounds * speed.reward_seconds
        )


def plan(config: Config) -> Plan:
    """Count the steps of ``config``; time some VPPO updates, one update of the reward model, one chunk of episodes.

    A method that imitates is timed on made-up demonstrations. The estimate leaves out the computation of learned
    rewards in evaluated episodes.
    """
    engine = Engine(config)
    rounds = config.ppga.iterations + math.ceil(config.ppga.warmup_updates / config.ppga.walk_updates)
    learns = engine.model.learns
    return Plan(count(config, learns, engine.k), _calibrated(engine), rounds if learns else 0)


def count(config: Config, learns: bool, k: int) -> Steps:
    """Environment steps of a run with ``k`` measures. ``learns``: the reward model is updated in every iteration."""
    ppga = config.ppga
    rollout = config.ppo.rollout_length * config.ppo.num_envs
    episodes = ppga.candidates * config.evaluation.episodes * config.simulation.episode_length
    updates = ppga.gradient_updates + ppga.walk_updates + int(learns)
    rounds = math.ceil(config.evaluation.rescore_episodes / config.evaluation.episodes)
    return Steps(
        ppga.warmup_updates * rollout,
        ppga.iterations * updates * rollout,
        ppga.iterations * episodes,
        math.ceil(ppga.cells**k / ppga.candidates) * rounds * episodes,
    )


def _calibrated(engine: Engine) -> Speed:
    """Do everything once, to compile it, and time it the second time."""
    began, config = time.monotonic(), engine.config
    rows = config.demos.demo_episodes * config.simulation.episode_length
    demos = made_up(engine.env, rows) if parse_method(config.method).base.imitates else None
    engine.compile_all(jax.random.key(0), demos)
    state = engine.init(jax.random.key(0), demos)
    trained, _ = _train(engine, state, 1)
    _evaluate(engine, state)
    _learn(engine, trained, demos)
    start_seconds = time.monotonic() - began
    trained, seconds = _train(engine, trained.state, CALIBRATION_UPDATES)
    return Speed(
        start_seconds,
        CALIBRATION_UPDATES * config.ppo.rollout_length * config.ppo.num_envs / seconds,
        _evaluate(engine, state),
        _learn(engine, trained, demos),
    )


def _occupied(engine: Engine) -> jax.Array:
    return jnp.zeros((engine.config.ppga.cells,) * engine.k, bool)


def _train(engine: Engine, state: State, updates: int) -> tuple[Trained, float]:
    """The result of ``updates`` VPPO updates with all of their epochs, and the seconds they took."""
    began = time.monotonic()
    trained = engine.train_copies(state, _occupied(engine), updates)
    jax.block_until_ready(trained.theta)
    return trained, time.monotonic() - began


def _learn(engine: Engine, trained: Trained, demos: Demonstrations | None) -> float:
    """Seconds of one update of the reward model; 0 if it does not learn."""
    if demos is None or not engine.model.learns:
        return 0.0
    began = time.monotonic()
    state, _ = engine.update_reward(trained.state, _occupied(engine), demos, trained.transitions)
    jax.block_until_ready(jax.tree.leaves(state.reward))
    return time.monotonic() - began


def _evaluate(engine: Engine, state: State) -> float:
    """Environment steps per second of candidates.

    Untrained robots fall soon, and a fallen robot is simulated to the end of its chunk, so its whole chunk counts.
    """
    config = engine.config
    coefficients = np.zeros((config.ppga.candidates, engine.objectives))
    policies, _ = engine.branch(state, jnp.zeros((engine.objectives, 1)), coefficients)
    keys = engine.place(jax.random.split(jax.random.key(0), (config.ppga.candidates, config.evaluation.episodes)))
    envs, tally = engine.search.begin_episodes(keys)
    began, chunk = time.monotonic(), config.evaluation.eval_chunk_steps
    length = np.asarray(engine.search.advance_episodes(policies, envs, tally)[1].length)
    return float(np.sum(np.ceil(length / chunk))) * chunk / (time.monotonic() - began)


def report(config: Config, planned: Plan) -> str:
    """The configuration, the steps and the estimate as text."""
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
        lines.append(f"{rounds} updates of the reward model, {speed.reward_seconds:.2f} s each")
    return "\n".join([*lines, f"estimate:    {planned.seconds / 60:15,.1f} minutes"])
