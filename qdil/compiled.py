"""A run's phases, each compiled once and laid out over a mesh of devices."""

from functools import partial
from typing import Any, NamedTuple

import jax
from jax.sharding import PartitionSpec as P

from qdil import phases
from qdil.config import Config
from qdil.phases import Parts, State, Trained
from qdil.sharding import AXIS, by_environment, choose_num_devices, make_mesh, replicated


class Compiled(NamedTuple):
    """The run's compiled functions (see ``qdil.phases`` for what each does) and what they were built around."""

    parts: Parts
    num_devices: int
    init: Any  # (key, demos) -> State
    train: Any  # (state, occupied, weights (K, 1+k), tied, num_updates, epochs) -> Trained
    branch: Any  # (state, theta (K, P), coefficients (λ, 1+k)) -> (candidates: Policies, jacobian (1+k, P))
    score: Any  # (Policies, state, occupied, key (λ, n)) -> Scores
    update_reward: Any  # (state, occupied, demos, transitions) -> (State, info)
    jump: Any  # (state, theta (P,), obs mean, obs std) -> State at an elite
    place: Any  # a tree with axis (λ) in front, laid out over the devices as ``score`` expects it


def compile_run(config: Config) -> Compiled:
    """Build every function of a run; each compiles when first called. Raises ConfigError or ValueError before that."""
    num_devices = choose_num_devices(config.devices, config.num_envs // 3, config.candidates)
    parts = phases.assemble(config)
    mesh = make_mesh(num_devices)
    whole, split = replicated(mesh), by_environment(mesh)
    each: Any = P()  # a specification stands where arrays will be
    in_state, of_state = _layout(P(), P(AXIS)), _layout(whole, split)
    trained = Trained(in_state, each, P(None, AXIS), each)  # type: ignore[arg-type]
    shard: dict[str, Any] = {"mesh": mesh, "check_vma": False}
    train = jax.shard_map(
        partial(phases.train, parts), in_specs=(in_state, each, each, each, each, each), out_specs=trained, **shard
    )
    score = jax.shard_map(
        partial(phases.score, parts), in_specs=(P(AXIS), in_state, each, P(AXIS)), out_specs=P(AXIS), **shard
    )
    update_reward = jax.shard_map(
        partial(_update_reward_everywhere, parts),
        in_specs=(in_state, each, each, P(None, AXIS)),
        out_specs=(in_state, each),
        **shard,
    )
    return Compiled(
        parts,
        num_devices,
        init=jax.jit(partial(phases.init, parts), out_shardings=of_state),
        train=jax.jit(train),
        branch=jax.jit(phases.branch, out_shardings=(split, whole)),
        score=jax.jit(score),
        update_reward=jax.jit(update_reward),
        jump=jax.jit(partial(phases.jump, parts), out_shardings=of_state),
        place=lambda tree: jax.device_put(tree, split),
    )


def _update_reward_everywhere(parts: Parts, state: State, occupied: Any, demos: Any, transitions: Any) -> Any:
    """Every device learns the same reward model from all robots' steps: one exchange of data, then none."""
    everyones = jax.tree.map(lambda x: jax.lax.all_gather(x, AXIS, axis=1, tiled=True), transitions)
    return phases.update_reward(parts, state, occupied, demos, everyones)


def _layout(whole: Any, split: Any) -> Any:
    """How each part of ``State`` lies on the devices: robots and what goes with them split, the rest whole."""
    return State(key=whole, learner=whole, stats=whole, actors=split, reward=whole, reward_carry=split)
