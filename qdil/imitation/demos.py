"""Demonstrations: recording the episodes of the chosen elites (``selection``), reading and writing the file.

A "demonstrator" is an elite of the expert's archive that was chosen; a "demonstration" is one episode of it.
"""

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

FIELDS = ("obs", "action", "next_obs", "proxy")  # columns of a file that every reward model's ``Demonstrations`` has


def record(
    env: Environment,
    template: Params,
    elites: dict[str, np.ndarray],
    key: jax.Array,
    episode_length: int,
    sample_actions: bool,
) -> dict[str, np.ndarray]:
    """One whole episode of each of n elites, one row per step t: s_t, a_t, s_{t+1}, δ(s_t), true reward, how it ended.

    ``elites`` has ``solution`` (n, P), ``obs_mean`` and ``obs_std`` (n, O); ``template`` is a tree of a policy's
    parameters. Returns columns (N, …) by name; ``episode`` (N,) numbers the episode of each row. ``episode_return``
    (n,) and ``episode_measures`` (n, k) are those of whole episodes.
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
    """Write recorded episodes, with the robot's name and backend, to an .npz file."""
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
    """Read and check a demonstrations file of ``robot`` on ``backend``.

    With ``needs_actions`` False, a file without an ``action`` column, or with one of width 0, is accepted.
    ``alignment`` "shifted" pairs states and actions as the authors' released program does (``shifted``), with delays
    drawn from ``seed``. ``episodes`` is the number that the file must hold; it is not checked in a file without an
    ``episode`` column.

    Raises ValueError in one sentence for a missing or unreadable file, for demonstrations of another robot or backend,
    for missing columns, unequal numbers of rows, no rows, another number of episodes, or numbers that are not finite.
    """
    if not path.is_file():
        raise ValueError(f"no demonstrations at {path}: make them with 'qdil demos --env {robot}'.")
    data = _columns(path, (*FIELDS, "episode") if alignment == "shifted" else FIELDS)
    if str(data["robot"]) != robot or str(data["backend"]) != backend:
        raise ValueError(
            f"{path} holds demonstrations of {data['robot']} on {data['backend']}, not of {robot} on {backend}."
        )
    if needs_actions and data["action"].shape[1:] == (0,):
        raise ValueError(f"{path} has no actions: only the methods that end in -obs can learn from it.")
    found = len(np.unique(data["episode"])) if "episode" in data else None
    if None not in (episodes, found) and found != episodes:
        raise ValueError(f"{path} holds {found} demonstrations, not {episodes}: add --set demo_episodes={found}.")
    if alignment == "shifted":
        data = shifted(data, np.random.default_rng(seed))
    return Demonstrations(*(jnp.asarray(data[name], jnp.float32) for name in FIELDS))


def _columns(path: Path, needed: tuple[str, ...]) -> dict[str, np.ndarray]:
    """A file's arrays by name: ``FIELDS`` in float32, ``action`` of width 0 if it is missing. Raises ValueError."""
    try:
        with np.load(path, allow_pickle=False) as file:
            data = {name: file[name] for name in file.files}
    except Exception as error:  # zipfile, zlib and numpy raise errors of different types for other files
        raise ValueError(f"{path} is damaged or not a demonstrations file ({type(error).__name__}).") from None
    missing = [name for name in (*needed, "robot", "backend") if name not in data]
    if missing == ["action"]:
        missing, data["action"] = [], np.zeros((*data["obs"].shape[:1], 0), np.float32)
    if missing:
        raise ValueError(f"{path} is not a demonstrations file: it has no {', '.join(missing)}.")
    counts = {data[name].shape[0] if data[name].ndim == (1 if name == "episode" else 2) else 0 for name in needed}
    if len(counts) != 1 or 0 in counts:
        raise ValueError(f"{path} has columns of {sorted(counts)} rows; all must be tables with equally many rows.")
    with np.errstate(over="ignore"):  # numbers beyond float32 become infinite and are refused next
        data |= {name: data[name].astype(np.float32) for name in FIELDS if data[name].dtype.kind == "f"}
    if not all(data[name].dtype == np.float32 and np.isfinite(data[name]).all() for name in FIELDS):
        raise ValueError(f"{path} contains numbers that are not finite, or no numbers at all.")
    return data


def made_up(env: Environment, rows: int, seed: int = 0) -> Demonstrations:
    """``rows`` steps of noise in the shapes of a robot's demonstrations: for timing, not for learning."""
    rng, widths = np.random.default_rng(seed), (env.obs_size, env.action_size, env.obs_size, len(env.measure_names))
    return Demonstrations(*(jnp.asarray(rng.normal(size=(rows, width)), jnp.float32) for width in widths))


def check_fits(demos: Demonstrations, env: Environment) -> None:
    """Raise ValueError unless the columns of ``demos`` have the robot's widths; actions may be missing."""
    widths = {"obs": env.obs_size, "action": env.action_size, "next_obs": env.obs_size, "proxy": len(env.measure_names)}
    for name, width in widths.items():
        found = getattr(demos, name).shape[1]
        if found != width and not (name == "action" and found == 0):
            raise ValueError(f"the demonstrations have {name} of width {found}, but {env.name} has {width}.")


def shifted(data: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Rows as the authors' released program pairs them: action a_t with state s_{t+1+j} instead of s_t.

    j is drawn from 0 to 19 for every episode. Actions near the end of an episode that have no such state are dropped.
    The last state of an episode stands in for the unknown state after it.
    """
    parts = []
    for episode in np.unique(data["episode"]):
        steps = {name: data[name][data["episode"] == episode] for name in FIELDS}
        length = len(steps["obs"])
        delay = min(int(rng.integers(20)), length - 1)
        after = np.minimum(np.arange(delay, length) + 1, length - 1)
        parts.append({
            "obs": steps["next_obs"][delay:],
            "action": steps["action"][: length - delay],
            "next_obs": steps["next_obs"][after],
            "proxy": steps["proxy"][after],
        })  # fmt: skip
    return {name: np.concatenate([part[name] for part in parts]) for name in FIELDS}
