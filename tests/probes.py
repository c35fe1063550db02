"""Robots so simple that every quantity can be worked out by hand, and small helpers around them."""

import jax
import jax.numpy as jnp
import numpy as np

from qdil.config import make_config
from qdil.imitation.reward_model import Demonstrations, RewardModel, reward_model
from qdil.robots.environment import Environment, Outcome, RobotState
from qdil.types import Normaliser, ObsStats, RewardContext, Transitions

SPEED_LIMIT = 1.0  # actions are clipped to ± this, as every robot does


def counter(bound: float, diverges_above: float = np.inf) -> Environment:
    """A point that its action pushes along a line, s' = s + a, and that falls once it has reached ``bound``.

    Starts evenly in [0, 1); reward s' + a/4; δ(s) = (s ≥ 1, s ≥ 2). It diverges where s' passes ``diverges_above``.
    """

    def at(position: jax.Array) -> RobotState:
        proxy = (position >= jnp.array([1.0, 2.0])).astype(jnp.float32)
        return RobotState(position, position[None], proxy)

    def reset(key: jax.Array) -> RobotState:
        return at(jax.random.uniform(key))

    def step(state: RobotState, action: jax.Array) -> tuple[RobotState, Outcome]:
        push = jnp.clip(action[0], -SPEED_LIMIT, SPEED_LIMIT)
        position = state.physics + push
        finite = position <= diverges_above
        return at(position), Outcome(position + push / 4, (position >= bound) | ~finite, finite)

    return Environment("counter", "probe", 1, 1, ("past one", "past two"), 0.1, reset, step)


def target(best: float = 0.5) -> Environment:
    """A bandit: reward −(a − ``best``)², whatever the state; δ(s) = (last a > ¾, last a < 0). It never falls."""

    def at(position: jax.Array) -> RobotState:
        return RobotState(position, position[None], jnp.stack([position > 0.75, position < 0]).astype(jnp.float32))

    def reset(key: jax.Array) -> RobotState:
        return at(jnp.zeros(()))

    def step(state: RobotState, action: jax.Array) -> tuple[RobotState, Outcome]:
        push = jnp.clip(action[0], -SPEED_LIMIT, SPEED_LIMIT)
        return at(push), Outcome(-jnp.square(push - best), jnp.zeros((), bool), jnp.ones((), bool))

    return Environment("target", "probe", 1, 1, ("right", "left"), 0.1, reset, step)


def true_rewards(carry, stats, transitions):
    """The environment's own reward, in the form that VPPO and evaluation ask for."""
    return carry, transitions.reward


def transitions(time: int, envs: int, obs_size: int = 1, action_size: int = 1, k: int = 2, **fields) -> Transitions:
    """Steps (time, envs) that are zero everywhere but in ``fields``."""
    rows = (time, envs)
    no = np.zeros(rows, bool)
    obs, proxy = np.zeros((*rows, obs_size), np.float32), np.zeros((*rows, k), np.float32)
    blank = Transitions(obs, np.zeros((*rows, action_size), np.float32), obs, proxy, obs[..., 0], no, no, proxy)
    return jax.tree.map(jnp.asarray, blank._replace(**fields))


def obs_stats(mean, std) -> ObsStats:
    """A normaliser with this mean and spread."""
    mean, std = jnp.asarray(mean, jnp.float32), jnp.asarray(std, jnp.float32)
    return ObsStats(mean, std, jnp.square(std), jnp.ones(()))


# Reward models

OBS, ACTIONS, PROXIES = 3, 2, 2
ROBOT = counter(4.0)._replace(obs_size=OBS, action_size=ACTIONS)  # for its widths
STATS = Normaliser(jnp.array([1.0, -2.0, 0.0]), jnp.array([2.0, 0.5, 1.0]))
CONTEXT = RewardContext(STATS, jnp.zeros((4, 4), bool))


def steps_of(rng, time=8, envs=16, shift=0.0):
    """Random policy steps, moved by ``shift`` deviations."""

    def draw(width):
        return rng.normal(size=(time, envs, width)).astype(np.float32)

    obs, next_obs = (STATS.mean + STATS.std * (draw(OBS) + shift) for _ in range(2))
    proxy = (draw(PROXIES) > 0).astype(np.float32)
    fields = {"obs": obs, "next_obs": next_obs, "action": np.tanh(draw(ACTIONS)), "proxy": proxy}
    return transitions(time, envs, OBS, ACTIONS, PROXIES, **fields)


def demos_of(steps) -> Demonstrations:
    """The same steps as expert rows."""
    return Demonstrations(*(getattr(steps, n).reshape(-1, getattr(steps, n).shape[-1]) for n in Demonstrations._fields))


def built(method: str, **settings) -> RewardModel:
    """A reward model by name, small unless ``settings`` say otherwise."""
    settings = {"reward_hidden": (8,), "reward_steps": 3, "reward_batch": 16} | settings
    return reward_model(make_config("walker2d", method, "smoke", **settings), ROBOT)


def in_numpy(params):
    """Networks' weights in double precision."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, float), params)


def forward(layers, x):
    """A tanh perceptron, layer by layer, in NumPy."""
    for layer in layers[:-1]:
        x = np.tanh(x @ layer["w"] + layer["b"])
    return x @ layers[-1]["w"] + layers[-1]["b"]


def area_under_curve(high, low) -> float:
    """The chance that a random one of ``high`` is above a random one of ``low``."""
    return float(np.mean(np.ravel(high)[:, None] > np.ravel(low)[None]))


TURN = 0.97 * np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, -1.0]])  # how an expert's state moves by itself
PUSH = np.array([[0.3, 0.0], [0.0, 0.3], [0.2, 0.2]])  # and by its action
LAW = np.array([[0.4, -0.2, 0.1], [0.1, 0.3, -0.5]])  # its action by its state
HOME = np.array([1.2, 1.2, -1.2])  # around which it moves


def expert_steps(rng, time=8, envs=32):
    """A feedback law at work: x' = TURN x + PUSH a + noise, a = −LAW x + noise, the state HOME + x in deviations."""
    x, rows = rng.normal(size=(envs, OBS)) / 2, []
    for t in range(time + 20):  # the first 20 to settle
        action = np.clip(-x @ LAW.T + 0.05 * rng.normal(size=(envs, ACTIONS)), -1, 1)
        after = x @ TURN.T + action @ PUSH.T + 0.1 * rng.normal(size=(envs, OBS))
        rows += [(HOME + x, action, HOME + after)] if t >= 20 else []
        x = after
    return _moved(*(np.stack(column) for column in zip(*rows, strict=True)))


def random_steps(rng, time=8, envs=32):
    """No law at all: states, actions and next states each drawn by themselves."""
    obs, next_obs = rng.normal(size=(2, time, envs, OBS))
    return _moved(obs, rng.uniform(-1, 1, (time, envs, ACTIONS)), next_obs)


def _moved(obs, action, next_obs) -> Transitions:
    """Steps whose states are given in deviations of ``STATS``; each of two feet touches the ground by the state."""
    mean, std = np.asarray(STATS.mean), np.asarray(STATS.std)
    values = {"obs": mean + std * obs, "action": action, "next_obs": mean + std * next_obs}
    values["proxy"] = obs[..., :PROXIES] > HOME[:PROXIES]
    fields = {name: value.astype(np.float32) for name, value in values.items()}
    return transitions(*action.shape[:2], OBS, ACTIONS, PROXIES, **fields)
