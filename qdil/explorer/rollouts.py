"""Whole episodes of elites for drawing: the pose of every link, the feet on the ground, the reward of every step."""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdil.rl import networks
from qdil.rl.evaluate import Policies
from qdil.rl.rollout import where_each
from qdil.robots import register
from qdil.robots.environment import RobotState
from qdil.types import Normaliser

BATCH = 4  # episodes simulated together, as many as the explorer shows: one compiled program serves every call
CHUNK = 100  # steps per call of the compiled program: no call follows once every robot has fallen


class Rollout(NamedTuple):
    """One episode of T steps; row t belongs to s_t, the state in which the robot takes action a_t."""

    position: np.ndarray  # (T, L, 3) links' frames in the world, metres; x forward, y to the left, z up
    rotation: np.ndarray  # (T, L, 4) unit quaternions, real part first
    contact: np.ndarray  # (T, k) bool, δ(s_t): True where a foot touches the ground
    reward: np.ndarray  # (T,) the environment's own reward of step t
    seconds: float  # length of a step
    fell: bool  # the episode terminated before its time limit


class _Seen(NamedTuple):
    """A chunk of T steps of E robots, axes (T, E) in front."""

    position: jax.Array
    rotation: jax.Array
    contact: jax.Array
    reward: jax.Array
    counted: jax.Array  # the episode had not ended before this step


class _Player(NamedTuple):
    """Compiled functions for one robot and one size of network."""

    begin: Callable[[jax.Array], RobotState]  # key (E,)
    advance: Callable[..., tuple[RobotState, jax.Array, _Seen]]  # (policies, robot, alive (E,)) -> ..., (T, E)


class _Sizes(NamedTuple):
    """Sizes of a robot and its network."""

    theta: int  # parameters of a policy
    obs: int  # numbers in an observation
    seconds: float  # length of a step


def play(config: Mapping[str, Any], policies: Policies, seed: int = 0) -> list[Rollout]:
    """An episode of each of n ``policies``.

    Each takes its mean action, with its own observation statistics, until it falls or reaches the run's time limit.
    All start in the same state, drawn by ``seed``. ``config`` holds a run's settings, of which env, backend,
    actor_hidden and episode_length are read. Raises ValueError for policies of another size.
    """
    player, sizes = _player(config["env"], config["backend"], tuple(config["actor_hidden"]))
    given = (policies.theta.shape[-1], policies.obs_mean.shape[-1])
    if given != (sizes.theta, sizes.obs):
        raise ValueError(
            f"these policies have {given[0]} parameters for {given[1]} observations; a {config['env']} with layers "
            f"{tuple(config['actor_hidden'])} needs {sizes.theta} for {sizes.obs}."
        )
    rollouts: list[Rollout] = []
    count = len(policies.theta)
    for first in range(0, count, BATCH):
        rows = np.minimum(np.arange(first, first + BATCH), count - 1)  # the last policy fills an unfinished batch
        # NumPy takes the rows: JAX would compile this step anew for every number of policies.
        some = Policies(*(jnp.asarray(np.asarray(field, np.float32)[rows]) for field in policies))
        rollouts += _batch(player, some, int(config["episode_length"]), sizes.seconds, seed)[: count - first]
    return rollouts


def _batch(player: _Player, policies: Policies, length: int, seconds: float, seed: int) -> list[Rollout]:
    robot = player.begin(jnp.broadcast_to(jax.random.key(seed), (BATCH,)))
    alive, chunks = jnp.ones(BATCH, bool), []
    for _ in range(-(-length // CHUNK)):
        robot, alive, seen = player.advance(policies, robot, alive)
        chunks.append(jax.tree.map(np.asarray, seen))
        if not np.asarray(alive).any():
            break
    position, rotation, contact, reward, counted = (
        np.concatenate(field)[:length] for field in zip(*chunks, strict=True)
    )
    steps, fell = counted.sum(axis=0), ~np.asarray(alive)
    return [
        Rollout(position[:n, e], rotation[:n, e], contact[:n, e], reward[:n, e], seconds, bool(n < length or fell[e]))
        for e, n in enumerate(steps)
    ]


@lru_cache(maxsize=8)
def _player(name: str, backend: str, hidden: Sequence[int]) -> tuple[_Player, _Sizes]:
    """The compiled functions of a robot and network, and their sizes."""
    env = register.make(name, backend)
    template = networks.template_of(env.obs_size, env.action_size, hidden)

    def act(policy: Policies, obs: jax.Array) -> jax.Array:
        normaliser = Normaliser(policy.obs_mean, policy.obs_std)
        return networks.policy_mean(networks.unflatten(policy.theta, template), normaliser, obs)

    def advance(policies: Policies, robot: RobotState, alive: jax.Array):
        def step(carry, _):
            robot, alive = carry
            after, outcome = jax.vmap(env.step)(robot, jax.vmap(act)(policies, robot.obs))
            x = robot.physics.x
            seen = _Seen(x.pos, x.rot, robot.proxy > 0.5, outcome.reward, alive)
            goes_on = alive & ~outcome.terminated
            return (where_each(goes_on, after, robot), goes_on), seen

        (robot, alive), seen = jax.lax.scan(step, (robot, alive), None, CHUNK)
        return robot, alive, seen

    player = _Player(jax.jit(jax.vmap(env.reset)), jax.jit(advance))
    return player, _Sizes(networks.flat_size(template), env.obs_size, env.step_seconds)
