"""Demonstrations: recording the episodes of the chosen elites (``selection``), and keeping them in a file."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from qdil.files import write_npz
from qdil.imitation.reward_model import Demonstrations
from qdil.imitation.selection import farthest_points as farthest_points
from qdil.imitation.selection import select as select
from qdil.imitation.selection import top_fifth as top_fifth
from qdil.rl import networks
from qdil.rl.rollout import rollout, start
from qdil.robots.environment import Environment
from qdil.types import Normaliser, Params

FIELDS = ("obs", "action", "next_obs", "proxy")


def record(
    env: Environment,
    template: Params,
    elites: dict[str, np.ndarray],
    key: jax.Array,
    episode_length: int,
    sample_actions: bool,
) -> dict[str, np.ndarray]:
    """One whole episode of each elite, a row per step: (s_t, a_t, s_{t+1}, δ(s_t), …), all of the same step t.

    ``elites`` has ``solution`` (n, P), ``obs_mean`` and ``obs_std`` (n, O). Also returns, per episode,
    ``episode_return`` and ``episode_measures``; ``episode`` (N,) says which episode a row belongs to.
    """
    policies = jax.vmap(lambda t: networks.unflatten(t, template))(jnp.asarray(elites["solution"]))
    normaliser = Normaliser(jnp.asarray(elites["obs_mean"]), jnp.asarray(elites["obs_std"]))

    def act(noise: jax.Array, obs: jax.Array) -> tuple[jax.Array, jax.Array]:
        spread = jnp.exp(policies["log_std"]) if sample_actions else 0.0
        return jax.vmap(networks.policy_mean)(policies, normaliser, obs) + noise * spread, jnp.zeros(len(noise))

    keys = jax.random.split(key, len(elites["solution"]))
    run = jax.jit(lambda k: rollout(env, act, start(env, k, episode_length), episode_length, episode_length)[1])
    steps = jax.tree.map(np.asarray, run(keys))
    lengths = np.argmax(steps.ended, axis=0) + 1
    episodes = [
        {name: getattr(steps, name)[:n, i] for name in (*FIELDS, "reward", "terminated", "truncated")}
        for i, n in enumerate(lengths)
    ]
    joined = {name: np.concatenate([e[name] for e in episodes]) for name in episodes[0]}
    joined["episode"] = np.repeat(np.arange(len(lengths)), lengths)
    joined["episode_return"] = np.array([e["reward"].sum() for e in episodes])
    joined["episode_measures"] = np.array([e["proxy"].mean(axis=0) for e in episodes])
    return joined


def save(path: Path, recorded: dict[str, np.ndarray], env: Environment) -> None:
    """Write recorded episodes with the robot's name and backend beside them."""
    write_npz(path, **recorded, robot=np.array(env.name), backend=np.array(env.backend))


def load(
    path: Path,
    robot: str,
    backend: str,
    needs_actions: bool = True,
    alignment: str = "aligned",
    seed: int = 0,
    episodes: int | None = None,
) -> Demonstrations:
    """Read and check a demonstrations file; ``episodes``: how many it must hold, if its rows say of which they are.

    A file without an ``action`` column, or with one of width 0, is welcome where ``needs_actions`` is False.
    ``alignment`` "shifted" pairs states with actions as the authors' released program does, see ``shifted``. Raises
    ValueError in one sentence for a missing or unreadable file, another robot's or backend's demonstrations, missing
    columns, unequal rows, no rows, another number of episodes, or numbers that are not finite.
    """
    if not path.is_file():
        raise ValueError(f"no demonstrations at {path}: make them with 'qdil demos --env {robot}'.")
    try:
        with np.load(path, allow_pickle=False) as file:
            data = {name: file[name] for name in file.files}
    except Exception as error:  # zipfile, zlib and numpy each have errors of their own for what is not an .npz
        raise ValueError(f"{path} is damaged or not a demonstrations file ({type(error).__name__}).") from None
    columns = (*FIELDS, "episode") if alignment == "shifted" else FIELDS
    missing = [name for name in (*columns, "robot", "backend") if name not in data]
    if missing == ["action"]:
        missing, data["action"] = [], np.zeros((*data["obs"].shape[:1], 0), np.float32)
    if missing:
        raise ValueError(f"{path} is not a demonstrations file: it has no {', '.join(missing)}.")
    if str(data["robot"]) != robot or str(data["backend"]) != backend:
        raise ValueError(
            f"{path} holds demonstrations of {data['robot']} on {data['backend']}, not of {robot} on {backend}."
        )
    if needs_actions and data["action"].shape[1:] == (0,):
        raise ValueError(f"{path} has no actions: only the methods that end in -obs can learn from it.")
    lengths = {data[name].shape[0] if data[name].ndim == (1 if name == "episode" else 2) else 0 for name in columns}
    if len(lengths) != 1 or 0 in lengths:
        raise ValueError(f"{path} has columns of {sorted(lengths)} rows; they must be tables that agree and not empty.")
    found = len(np.unique(data["episode"])) if "episode" in data else None
    if None not in (episodes, found) and found != episodes:
        raise ValueError(f"{path} holds {found} demonstrations, not {episodes}: add --set demo_episodes={found}.")
    with np.errstate(over="ignore"):
        data |= {name: data[name].astype(np.float32) for name in FIELDS if data[name].dtype.kind == "f"}
    if not all(data[name].dtype == np.float32 and np.isfinite(data[name]).all() for name in FIELDS):
        raise ValueError(f"{path} contains numbers that are not finite, or no numbers at all.")
    if alignment == "shifted":
        data = shifted(data, np.random.default_rng(seed))
    return Demonstrations(*(jnp.asarray(data[name], jnp.float32) for name in FIELDS))


def made_up(env: Environment, rows: int, seed: int = 0) -> Demonstrations:
    """``rows`` steps of noise in the shapes of a robot's demonstrations: fit to be timed, not to be learned from."""
    rng, widths = np.random.default_rng(seed), (env.obs_size, env.action_size, env.obs_size, len(env.measure_names))
    return Demonstrations(*(jnp.asarray(rng.normal(size=(rows, width)), jnp.float32) for width in widths))


def check_fits(demos: Demonstrations, env: Environment) -> None:
    """Raise ValueError unless the demonstrations' columns are as wide as the robot's (actions may be missing)."""
    widths = {"obs": env.obs_size, "action": env.action_size, "next_obs": env.obs_size, "proxy": len(env.measure_names)}
    for name, width in widths.items():
        given = getattr(demos, name).shape[1]
        if given != width and not (name == "action" and given == 0):
            raise ValueError(f"the demonstrations have {name} of width {given}, but {env.name} has {width}.")


def shifted(data: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Rows as the authors' released program pairs them: the state *after* action t, and j steps later still.

    j is drawn from 0-19 for every ``episode``; the steps at an episode's end that have no such state are dropped.
    """
    parts = []
    for episode in np.unique(data["episode"]):
        mine = {name: data[name][data["episode"] == episode] for name in FIELDS}
        length = len(mine["obs"])
        late = min(int(rng.integers(20)), length - 1)
        parts.append({
            "obs": mine["next_obs"][late:],
            "action": mine["action"][: length - late],
            "next_obs": mine["next_obs"][np.minimum(np.arange(late, length) + 1, length - 1)],
            "proxy": mine["proxy"][np.minimum(np.arange(late, length) + 1, length - 1)],
        })  # fmt: skip
    return {name: np.concatenate([part[name] for part in parts]) for name in FIELDS}
