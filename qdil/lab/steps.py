"""The rewards that one reward model gives to steps of known kinds, in more detail than a whole run shows.

The model learns briefly from demonstrations and then rewards steps that were demonstrated, held out, given other
actions, or taken by an untrained policy. Or it learns from any rows, such as points in a plane, round by round.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy.stats import mannwhitneyu

from qdil.config import Config, make_config
from qdil.engine.programs import search_programs
from qdil.errors import ConfigError
from qdil.imitation.reward_model import Demonstrations, InputModel, Inputs, reward_model
from qdil.methods import parse_method
from qdil.rl.normalise import init_obs_stats, update_obs_stats
from qdil.rl.rollout import rollout, start
from qdil.rl.vppo import act_with_copies
from qdil.robots import register
from qdil.robots.environment import Environment
from qdil.types import ObsStats, Params, RewardContext, Transitions

ENVS, STEPS = 16, 96  # robots and steps of an untrained policy: enough rows to learn from, and quickly simulated
RIDGE = 0.01  # weight of the ridge penalty per row


class Split(NamedTuple):
    """Demonstrations with one of them held out."""

    learned: Demonstrations  # (N) rows to learn from
    seen: Transitions  # (T, 1) the first episode of these rows
    held_out: Transitions  # (T', 1) the episode held out


def split(path: Path, out: int = -1, keep: int | None = None) -> Split:
    """Read a demonstrations file and hold out episode ``out`` (negative: counted from the last).

    The first ``keep`` ≥ 1 of the other episodes are learned from (None: all of them). Of a single episode, the second
    half is held out. Raises ConfigError if the file or the episode does not exist or there are fewer than ``keep``.
    """
    if not path.is_file():
        raise ConfigError(f"no demonstrations at {path}: make them with 'qdil demos'.")
    with np.load(path, allow_pickle=False) as file:
        data = {name: file[name] for name in file.files}
    numbers = np.unique(data["episode"])
    if not -len(numbers) <= out < len(numbers):
        raise ConfigError(f"{path} has {len(numbers)} episodes: there is no episode {out} to hold out.")
    held_out = data["episode"] == numbers[out]
    if len(numbers) == 1:
        held_out = np.arange(len(held_out)) >= len(held_out) // 2
    rest = np.unique(data["episode"][~held_out])
    if keep is not None and not 1 <= keep <= len(rest):
        raise ConfigError(f"{path} leaves {len(rest)} episodes to learn from: keep={keep} must be from 1 to that.")
    learned = ~held_out & np.isin(data["episode"], rest[:keep])
    rows = (jnp.asarray(data[name][learned], jnp.float32) for name in Demonstrations._fields)
    seen = learned & (data["episode"] == rest[0])
    return Split(Demonstrations(*rows), _as_steps(data, seen), _as_steps(data, held_out))


def _as_steps(data: Mapping[str, np.ndarray], rows: np.ndarray) -> Transitions:
    """Rows of one episode in a demonstrations file as the steps (T, 1) of one robot."""
    fields = {name: jnp.asarray(data[name][rows])[:, None] for name in Transitions._fields if name in data}
    so_far = jnp.cumsum(fields["proxy"], axis=0) / jnp.arange(1, rows.sum() + 1)[:, None, None]
    return Transitions(**fields, measures_so_far=so_far)


def with_other_actions(steps: Transitions, seed: int) -> Transitions:
    """The same states, with their actions permuted at random."""
    order = np.random.default_rng(seed).permutation(len(steps.action))
    return steps._replace(action=steps.action[order])


def untrained(env: str, seed: int, robots: int = ENVS, steps: int = STEPS) -> Transitions:
    """Transitions (steps, robots) of θ_0, an untrained policy, which acts mostly by chance."""
    config = make_config(env, "true", "laptop")
    robot, length = register.make(env), config.simulation.episode_length
    key = jax.random.key(seed)
    train_state, stats, _ = search_programs(robot, config.ppo, config.evaluation, length, 1).init(key)
    return _roll_out(robot, train_state.policy, stats, jax.random.fold_in(key, 1), robots, steps, length)


@partial(jax.jit, static_argnums=(0, 4, 5, 6))
def _roll_out(
    robot: Environment, policy: Params, stats: ObsStats, key: jax.Array, robots: int, steps: int, episode_length: int
) -> Transitions:
    """Transitions (steps, robots) of one policy with sampled actions."""
    act = act_with_copies(jax.tree.map(lambda leaf: leaf[None], policy), stats, 1)
    begun = start(robot, jax.random.split(key, robots), episode_length)
    return rollout(robot, act, begun, steps, episode_length)[1]


def rewards_for(
    config: Config, learned: Demonstrations, policy: Transitions, shown: Mapping[str, Transitions], seed: int
) -> dict[str, np.ndarray]:
    """The rewards (T, E), without bonus, that the model of ``config`` gives to each kind of steps ``shown`` (T, E).

    First the model learns once (``reward_steps`` steps) from the demonstrations ``learned`` and the steps ``policy`` of
    a policy. The observations of both give the normaliser.
    """
    model = reward_model(config, register.make(config.env, config.simulation.backend))

    def learn_and_reward(demos: Demonstrations, policy: Transitions, shown: list[Transitions]) -> list:
        obs = jnp.concatenate([demos.obs, policy.obs.reshape(-1, demos.obs.shape[1])])
        stats = update_obs_stats(init_obs_stats(demos.obs.shape[1]), obs, axis=None)
        context = RewardContext(stats.normaliser, jnp.zeros((1,) * demos.proxy.shape[1], bool))
        begin_key, learn_key = jax.random.split(jax.random.key(seed))
        state, _ = model.update(learn_key, model.init(begin_key, demos), context, demos, policy)
        return [model.reward(state, model.begin(state, some.obs.shape[1]), context, some)[1] for some in shown]

    rewards = jax.jit(learn_and_reward)(learned, policy, list(shown.values()))
    return {kind: np.asarray(reward) for kind, reward in zip(shown, rewards, strict=True)}


def actions_explained(split: Split, names: Sequence[str]) -> dict[str, float]:
    """The share of the actions' variance that a linear function of some fields explains, by kind of steps.

    ``names`` are fields of ``Demonstrations``. The function is fitted to ``split.learned`` by ridge regression
    (``RIDGE`` per row, every column divided by its deviation), so that it does not overfit a few rows. Shares are
    at most 1, negative if a constant explains more, and NaN for actions that never change.
    """
    held_out = Demonstrations(*(getattr(split.held_out, name)[:, 0] for name in Demonstrations._fields))
    known = _columns(split.learned, names)
    center, spread = known.mean(axis=0), np.maximum(known.std(axis=0), 1e-3)
    action = np.asarray(split.learned.action, float)
    x, mean = (known - center) / spread, action.mean(axis=0)
    ridge = RIDGE * len(x) * np.eye(x.shape[1])
    weights = np.linalg.solve(x.T @ x + ridge, x.T @ (action - mean))

    def share(rows: Demonstrations) -> float:
        action = np.asarray(rows.action, float)
        residual = action - mean - (_columns(rows, names) - center) / spread @ weights
        variation = np.square(action - action.mean(axis=0)).sum()
        return float(1 - np.square(residual).sum() / variation) if variation else float("nan")

    return {"learned from": share(split.learned), "held out": share(held_out)}


def _columns(rows: Demonstrations, names: Sequence[str]) -> np.ndarray:
    """Some fields of N rows side by side (N, …), in double precision."""
    return np.concatenate([np.asarray(getattr(rows, name), float) for name in names], axis=1)


def chance_above(some: np.ndarray, others: np.ndarray) -> float:
    """The probability that a random one of ``some`` is above a random one of ``others``; ties count half."""
    some, others = np.ravel(some), np.ravel(others)
    return float(mannwhitneyu(some, others).statistic / (some.size * others.size))


def compare_rewards(rewards: Mapping[str, Mapping[str, np.ndarray]], against: str) -> pd.DataFrame:
    """A row per model: the mean reward of every kind of steps, and the probability that it exceeds ``against``'s.

    ``rewards`` are ``rewards_for``'s results by model. A probability of ½ means that the model does not tell the two
    kinds apart.
    """
    kinds = list(next(iter(rewards.values()), {}))
    means = {("mean reward", kind): {model: float(by[kind].mean()) for model, by in rewards.items()} for kind in kinds}
    chances = {
        (f"higher than {against}", kind): {model: chance_above(by[kind], by[against]) for model, by in rewards.items()}
        for kind in kinds
        if kind != against
    }
    return pd.DataFrame(means | chances)


class Learned(NamedTuple):
    """A reward model that has learned from rows, and its measurements while it learned."""

    model: InputModel
    state: Any
    history: pd.DataFrame  # the model's own measurements, a row per round; index: updates so far

    def reward(self, inputs: Inputs) -> np.ndarray:
        """Rewards (N,) of rows (N), each a whole episode."""
        alone = jax.tree.map(lambda x: x[None], inputs)
        memory = self.model.begin(self.state, len(inputs.obs))
        return np.asarray(self.model.reward(self.state, memory, alone, jnp.ones((1, len(inputs.obs)), bool))[1][0])


def rows_of(points: np.ndarray, action: np.ndarray | None = None, proxy: np.ndarray | None = None) -> Inputs:
    """Inputs whose observations are ``points`` (N, O). Next states have width 0, as have an action or proxy of None."""
    none = np.zeros((len(points), 0), np.float32)
    parts = (points, none if action is None else action, none, none if proxy is None else proxy)
    return Inputs(*(jnp.asarray(part, jnp.float32) for part in parts))


def learn_in_rounds(config: Config, expert: Inputs, policy: Inputs, rounds: int, seed: int) -> Learned:
    """The base model of ``config`` after ``rounds`` rounds of ``reward_steps`` updates on rows.

    The rows are the model's inputs as they are: nothing is normalised, and nothing hidden.
    """
    widths = Inputs(*(part.shape[-1] for part in expert))
    model = parse_method(config.method).base.build(config, widths)
    key = jax.random.key(seed)
    state, update, rows = model.init(key, expert), jax.jit(model.update), []
    for i in range(rounds):
        state, info = update(jax.random.fold_in(key, i), state, expert, policy)
        rows.append({name: float(value) for name, value in info.items()})
    per_round = config.reward.reward_steps
    updates = pd.RangeIndex(per_round, per_round * (rounds + 1), per_round)
    return Learned(model, state, pd.DataFrame(rows, index=updates))
