"""Recording demonstrations: several episodes of each chosen elite are simulated, and the best of them are kept."""

import jax
import jax.numpy as jnp
import numpy as np

from qdil.imitation.demos import FIELDS
from qdil.imitation.selection import best_first
from qdil.rl import networks
from qdil.rl.rollout import rollout, start
from qdil.robots.environment import Environment
from qdil.types import Normaliser, Params, Transitions

Episode = dict[str, np.ndarray]  # a column (T, …) per name, a row per step


def record(
    env: Environment,
    template: Params,
    elites: dict[str, np.ndarray],
    key: jax.Array,
    episode_length: int,
    sample_actions: bool,
    attempts: int = 1,
) -> dict[str, np.ndarray]:
    """One whole episode of each of n elites, one row per step t: s_t, a_t, s_{t+1}, δ(s_t), true reward, how it ended.

    ``elites`` has ``solution`` (n, P), ``obs_mean`` and ``obs_std`` (n, O), and ``measures`` (n, k), their means over
    fresh episodes; ``template`` is a tree of a policy's parameters. Of ``attempts`` episodes of an elite, that one is
    recorded which comes first in ``selection.best_first``.

    Returns columns (N, …) by name; ``episode`` (N,) numbers the episode of each row. ``episode_return`` (n,) and
    ``episode_measures`` (n, k) are those of whole episodes, ``falls`` (n,) counts the attempts that end in a fall.
    With two or more attempts, the columns ``heldout_obs``, ``heldout_action``, ``heldout_next_obs``,
    ``heldout_proxy`` and ``heldout_episode`` (M, …) hold one further episode of each elite, that which comes second.
    No method learns from it, so that a discriminator can be tested on it.
    """
    simulated = _episodes(env, template, elites, key, episode_length, sample_actions, attempts)
    ranked = [_ranked(own, target) for own, target in zip(simulated, elites["measures"], strict=True)]
    best = [own[0] for own in ranked]
    columns = _joined(best)
    columns["episode_return"] = np.array([episode["reward"].sum() for episode in best])
    columns["episode_measures"] = np.array([episode["proxy"].mean(axis=0) for episode in best])
    columns["falls"] = np.array([sum(bool(episode["terminated"][-1]) for episode in own) for own in simulated])
    if attempts > 1:
        further = _joined([own[1] for own in ranked])
        columns |= {f"heldout_{name}": further[name] for name in (*FIELDS, "episode")}
    return columns


def _episodes(
    env: Environment,
    template: Params,
    elites: dict[str, np.ndarray],
    key: jax.Array,
    episode_length: int,
    sample_actions: bool,
    attempts: int,
) -> list[list[Episode]]:
    """``attempts`` whole episodes of each elite, simulated side by side."""
    count = len(elites["solution"])
    solution, mean, std = (np.repeat(elites[name], attempts, axis=0) for name in ("solution", "obs_mean", "obs_std"))

    # Policies are arguments, not constants of the program, so that one compiled program serves every expert.
    @jax.jit
    def run(policies: Params, normaliser: Normaliser, keys: jax.Array) -> Transitions:
        def act(noise: jax.Array, obs: jax.Array) -> tuple[jax.Array, jax.Array]:
            spread = jnp.exp(policies["log_std"]) if sample_actions else 0.0
            return jax.vmap(networks.policy_mean)(policies, normaliser, obs) + noise * spread, jnp.zeros(len(noise))

        return rollout(env, act, start(env, keys, episode_length), episode_length, episode_length)[1]

    policies = jax.vmap(lambda t: networks.unflatten(t, template))(jnp.asarray(solution))
    normaliser = Normaliser(jnp.asarray(mean), jnp.asarray(std))
    steps = jax.tree.map(np.asarray, run(policies, normaliser, jax.random.split(key, count * attempts)))
    lengths = np.argmax(steps.ended, axis=0) + 1
    episodes = [
        {name: getattr(steps, name)[:n, i] for name in (*FIELDS, "reward", "terminated", "truncated")}
        for i, n in enumerate(lengths)
    ]
    return [episodes[first : first + attempts] for first in range(0, len(episodes), attempts)]


def _ranked(episodes: list[Episode], target: np.ndarray) -> list[Episode]:
    """The episodes of one elite, the one to record first."""
    measures = np.array([episode["proxy"].mean(axis=0) for episode in episodes])
    fell = np.array([episode["terminated"][-1] for episode in episodes])
    length = np.array([len(episode["reward"]) for episode in episodes])
    return [episodes[i] for i in best_first(measures, fell, length, target)]


def _joined(episodes: list[Episode]) -> dict[str, np.ndarray]:
    """Episodes one after the other; ``episode`` numbers the episode of each row."""
    columns = {name: np.concatenate([episode[name] for episode in episodes]) for name in episodes[0]}
    lengths = [len(episode["reward"]) for episode in episodes]
    return columns | {"episode": np.repeat(np.arange(len(episodes)), lengths)}
