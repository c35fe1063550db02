"""What a reward model says of steps: demonstrated, held out, with other actions, and of a policy that knows nothing.

A closer look at one reward model than a whole run gives: it learns for a moment from some demonstrations, and pays for
steps of known kinds. Or it learns from any rows at all, such as points in a plane, while one watches.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
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
from qdil.types import RewardContext, Transitions

ENVS, STEPS = 16, 96  # of an untrained policy: enough rows to learn from, and quickly simulated
RIDGE = 0.01  # of a row's own weight


class Split(NamedTuple):
    """Demonstrations with one of them held out."""

    learned: Demonstrations  # (N) rows to learn from
    seen: Transitions  # (T, 1) one of the episodes that those rows are
    held_out: Transitions  # (T', 1) an episode that they are not


def split(path: Path, out: int = -1, keep: int | None = None) -> Split:
    """Read a demonstrations file and hold episode ``out`` back (negative: from the last).

    ``keep`` ≥ 1 episodes are learned from, the first of the others (None: all of them). Where there is one episode
    alone, its second half is held back. Raises ConfigError where there is no such file or episode, or too few.
    """
    if not path.is_file():
        raise ConfigError(f"no demonstrations at {path}: make them with 'qdil demos'.")
    with np.load(path, allow_pickle=False) as file:
        data = {name: file[name] for name in file.files}
    numbers = np.unique(data["episode"])
    if not -len(numbers) <= out < len(numbers):
        raise ConfigError(f"{path} has {len(numbers)} episodes: there is no episode {out} to hold back.")
    back = data["episode"] == numbers[out]
    if len(numbers) == 1:
        back = np.arange(len(back)) >= len(back) // 2
    rest = np.unique(data["episode"][~back])
    if keep is not None and not 1 <= keep <= len(rest):
        raise ConfigError(f"{path} leaves {len(rest)} episodes to learn from, so that keep={keep} is none of them.")
    learn = ~back & np.isin(data["episode"], rest[:keep])
    rows = (jnp.asarray(data[name][learn], jnp.float32) for name in Demonstrations._fields)
    return Split(Demonstrations(*rows), _as_steps(data, learn & (data["episode"] == rest[0])), _as_steps(data, back))


def _as_steps(data: Mapping[str, np.ndarray], rows: np.ndarray) -> Transitions:
    """Rows of a demonstrations file as the steps (T, 1) of one robot."""
    fields = {name: jnp.asarray(data[name][rows])[:, None] for name in Transitions._fields if name in data}
    so_far = jnp.cumsum(fields["proxy"], axis=0) / jnp.arange(1, rows.sum() + 1)[:, None, None]
    return Transitions(**fields, measures_so_far=so_far)


def with_other_actions(steps: Transitions, seed: int) -> Transitions:
    """The same states with each other's actions: what was done is nowhere what that state called for."""
    order = np.random.default_rng(seed).permutation(len(steps.action))
    return steps._replace(action=steps.action[order])


def untrained(env: str, seed: int, robots: int = ENVS, steps: int = STEPS) -> Transitions:
    """(steps, robots) of θ_0, a policy that has learned nothing and acts mostly by chance."""
    return _beginner(env, robots, steps)(jax.random.key(seed))


@lru_cache(maxsize=4)
def _beginner(env: str, robots: int, steps: int) -> Callable[[jax.Array], Transitions]:
    """``untrained`` as a compiled function of the key."""
    config = make_config(env, "true", "laptop")
    robot, length = register.make(env), config.simulation.episode_length
    programs = search_programs(robot, config.ppo, config.evaluation, length, 1)

    def roll(key: jax.Array) -> Transitions:
        train_state, stats, _ = programs.init(key)
        act = act_with_copies(jax.tree.map(lambda leaf: leaf[None], train_state.policy), stats, 1)
        keys = jax.random.split(jax.random.fold_in(key, 1), robots)
        return rollout(robot, act, start(robot, keys, length), steps, length)[1]

    return jax.jit(roll)


def rewards_for(
    config: Config, learned: Demonstrations, policy: Transitions, shown: Mapping[str, Transitions], seed: int
) -> dict[str, np.ndarray]:
    """Rewards per step, by kind of ``shown`` and in its shapes (T, E), of the model of ``config``, without bonus.

    The model learns once (``reward_steps`` steps) from ``learned`` against ``policy``, whose observations also
    give the normaliser, and is then asked about ``shown``.
    """
    model = reward_model(config, register.make(config.env, config.simulation.backend))

    def learn_and_reward(demos: Demonstrations, policy: Transitions, shown: list[Transitions]) -> list:
        obs = jnp.concatenate([demos.obs, policy.obs.reshape(-1, demos.obs.shape[1])])
        stats = update_obs_stats(init_obs_stats(demos.obs.shape[1]), obs, axis=None)
        context = RewardContext(stats.normaliser, jnp.zeros((1,) * demos.proxy.shape[1], bool))
        begin_key, learn_key = jax.random.split(jax.random.key(seed))
        state, _ = model.update(learn_key, model.init(begin_key, demos), context, demos, policy)
        return [model.reward(state, model.begin(state, some.obs.shape[1]), context, some)[1] for some in shown]

    answers = jax.jit(learn_and_reward)(learned, policy, list(shown.values()))
    return {kind: np.asarray(answer) for kind, answer in zip(shown, answers, strict=True)}


def actions_explained(split: Split, names: Sequence[str]) -> dict[str, float]:
    """The share of actions' variance that a linear function of some fields explains, in both kinds of steps.

    The function is fitted to ``split.learned`` by ridge regression (``RIDGE`` per row, every number in its own spread),
    so that a few rows do not fit by accident; ``names`` are fields of ``Demonstrations``. Shares are at most 1, and
    negative where a constant would do better.
    """
    held_out = Demonstrations(*(getattr(split.held_out, name)[:, 0] for name in Demonstrations._fields))
    known = np.concatenate([np.asarray(getattr(split.learned, name), float) for name in names], axis=1)
    center, spread = known.mean(axis=0), np.maximum(known.std(axis=0), 1e-3)

    def columns(rows: Demonstrations) -> np.ndarray:
        x = np.concatenate([np.asarray(getattr(rows, name), float) for name in names], axis=1)
        return (x - center) / spread

    x, mean = columns(split.learned), np.asarray(split.learned.action, float).mean(axis=0)
    ridge = RIDGE * len(x) * np.eye(x.shape[1])
    weights = np.linalg.solve(x.T @ x + ridge, x.T @ (np.asarray(split.learned.action, float) - mean))
    shares = {}
    for kind, rows in {"learned from": split.learned, "held out": held_out}.items():
        action = np.asarray(rows.action, float)
        wrong = np.square(action - mean - columns(rows) @ weights).sum()
        shares[kind] = float(1 - wrong / np.square(action - action.mean(axis=0)).sum())
    return shares


def chance_above(some: np.ndarray, others: np.ndarray) -> float:
    """The chance that a random one of ``some`` is above a random one of ``others``, ties counting half."""
    some, others = np.ravel(some), np.ravel(others)
    return float(mannwhitneyu(some, others).statistic / (some.size * others.size))


def opinions(rewards: Mapping[str, Mapping[str, np.ndarray]], against: str) -> pd.DataFrame:
    """A row per model: its mean reward for every kind of step, and how often a kind is paid more than ``against``.

    ``rewards`` are ``rewards_for``'s answers by model. Chances are shares from 0 to 1; ½ is no opinion.
    """
    summaries: dict[str, Callable[[np.ndarray, np.ndarray], float]] = {
        "mean reward": lambda mine, _: float(mine.mean()),
        f"paid more than {against}": chance_above,
    }
    table = {
        (what, kind): {model: of(kinds[kind], kinds[against]) for model, kinds in rewards.items()}
        for what, of in summaries.items()
        for kind in next(iter(rewards.values()), {})
        if kind != against or of is not chance_above
    }
    return pd.DataFrame(table)


class Learned(NamedTuple):
    """A reward model that has learned from rows, and how it went."""

    model: InputModel
    state: Any
    history: pd.DataFrame  # what the model reports of itself, a row per round; index: updates so far

    def reward(self, inputs: Inputs) -> np.ndarray:
        """Rewards (N,) of rows (N), each as an episode of its own."""
        alone = jax.tree.map(lambda x: x[None], inputs)
        memory = self.model.begin(self.state, len(inputs.obs))
        return np.asarray(self.model.reward(self.state, memory, alone, jnp.ones((1, len(inputs.obs)), bool))[1][0])


def rows_of(points: np.ndarray, action: np.ndarray | None = None, proxy: np.ndarray | None = None) -> Inputs:
    """Inputs whose observations are ``points`` (N, O), without actions, next states or proxies unless given."""
    nothing = np.zeros((len(points), 0), np.float32)
    parts = (points, nothing if action is None else action, nothing, nothing if proxy is None else proxy)
    return Inputs(*(jnp.asarray(part, jnp.float32) for part in parts))


def learn_in_rounds(config: Config, expert: Inputs, policy: Inputs, rounds: int, seed: int) -> Learned:
    """The base model of ``config``, taught ``rounds`` times (``reward_steps`` updates each) from rows.

    Rows are inputs as they are: nothing is normalised, and nothing hidden.
    """
    widths = Inputs(*(part.shape[-1] for part in expert))
    model = parse_method(config.method).base.build(config, widths)
    key = jax.random.key(seed)
    state, update, reports = model.init(key, expert), jax.jit(model.update), []
    for i in range(rounds):
        state, info = update(jax.random.fold_in(key, i), state, expert, policy)
        reports.append({name: float(value) for name, value in info.items()})
    each = config.reward.reward_steps
    updates = pd.RangeIndex(each, each * (rounds + 1), each)
    return Learned(model, state, pd.DataFrame(reports, index=updates))
