"""The door to Brax: halfcheetah, walker2d and humanoid with foot contacts; nothing else imports Brax's physics."""

import io
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jax.extend.core import jaxpr_as_fun

from qdil.finite import is_smaller
from qdil.robots.environment import Environment, Outcome, RobotState
from qdil.robots.robots_last import robots_last

DIVERGED = 1e6  # an observation or reward this large is no robot's: physics about to become infinite
BACKENDS = ("spring", "positional", "generalized", "mjx")
# How far from the ground a foot may be and touch it, in metres. The positional backend moves what has sunk into the
# ground out of it before a step ends: there feet rest a hair above, 0.05 mm on walker2d.
TOUCHES = {"positional": 1e-3}


Step = Callable[[RobotState, jax.Array], tuple[RobotState, Outcome]]


class Robot(NamedTuple):
    """How a robot is called in Brax and which links are its feet."""

    brax_name: str
    feet: tuple[str, ...]


# The humanoid's model has no foot links: its feet are spheres at the shins' lower ends.
ROBOTS = {
    "halfcheetah": Robot("halfcheetah", ("bfoot", "ffoot")),
    "walker2d": Robot("walker2d", ("foot", "foot_left")),
    "humanoid": Robot("humanoid", ("right_shin", "left_shin")),
}


def foot_links(link_names: list[str], feet: tuple[str, ...]) -> list[int]:
    """Indices of the feet among the links. Raises ValueError unless every foot is found exactly once."""
    missing = [foot for foot in feet if link_names.count(foot) != 1]
    if missing:
        raise ValueError(f"feet {missing} are not links of this robot; its links are {link_names}.")
    return [link_names.index(foot) for foot in feet]


@contextmanager
def _quiet() -> Iterator[None]:
    """Hide what importing Brax says of its own age, of optional parts, and of its model files' old dialect."""
    import mujoco

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        mujoco.set_mju_user_warning(before)


def _check(name: str, backend: str) -> None:
    if name not in ROBOTS:
        raise ValueError(f"unknown robot '{name}'; choose one of {', '.join(ROBOTS)}.")
    if backend not in BACKENDS:
        raise ValueError(f"unknown backend '{backend}'; choose one of {', '.join(BACKENDS)}.")


@cache
def model(name: str) -> Any:
    """The MuJoCo model (``mujoco.MjModel``) that a robot is read from: its links, shapes and joints."""
    _check(name, BACKENDS[0])
    with _quiet():
        from brax import envs

        return envs.get_environment(ROBOTS[name].brax_name, backend=BACKENDS[0]).sys.mj_model


@contextmanager
def _constants_on_this_host() -> Iterator[None]:
    """MuJoCo's loader puts a model on the first device of all hosts; put it on this host's own, which it can read."""
    from mujoco import mjx

    whole = mjx.put_model
    mjx.put_model = partial(whole, device=jax.local_devices()[0])
    try:
        yield
    finally:
        mjx.put_model = whole


def _traced_once(function: Callable[..., Any], *like: Any) -> tuple[Callable[..., Any], Any]:
    """``function`` as a replay of one trace, for arguments like these, and what it returns, as shapes.

    Tracing Brax takes a second, and ``jax.jit`` does so again outside a mesh and inside one.
    """
    trace, shapes = jax.make_jaxpr(function, return_shape=True)(*like)
    replayed = jaxpr_as_fun(trace)

    def replay(*args: Any) -> Any:
        return jax.tree.unflatten(jax.tree.structure(shapes), replayed(*jax.tree.leaves(args)))

    return replay, shapes


@cache
def make(name: str, backend: str = "spring", as_brax: bool = False) -> Environment:
    """Build a robot by name (a key of ``ROBOTS``) on a Brax ``backend`` (one of ``BACKENDS``).

    The proxy δ(s) ∈ {0,1}^k is 1 where any collision shape of a foot's link touches the ground
    (contact distance ≤ 0, or ``TOUCHES``), computed from the same contacts the simulator resolves. Actions are
    clipped to [-1, 1] before they reach the robot, so that its control cost counts what was applied.

    On the spring backend a ``jax.vmap`` of the step simulates its robots as ``robots_last`` lays them; ``as_brax``
    leaves it as Brax and JAX have it, to compare with.
    """
    _check(name, backend)
    with _quiet():
        from brax import contact, envs
        from brax.envs.base import State

        with _constants_on_this_host():
            env: Any = envs.get_environment(ROBOTS[name].brax_name, backend=backend)
        feet = jnp.asarray(foot_links(list(env.sys.link_names), ROBOTS[name].feet))

        def proxy(physics: Any) -> jax.Array:
            contacts = contact.get(env.sys, physics.x)
            touching = contacts.dist <= TOUCHES.get(backend, 0.0)
            of_foot = (contacts.link_idx[0] == feet[:, None]) | (contacts.link_idx[1] == feet[:, None])
            return jnp.any(of_foot & touching, axis=1).astype(jnp.float32)

        def begin(key: jax.Array) -> tuple[RobotState, dict[str, jax.Array]]:
            state = env.reset(key)
            return RobotState(state.pipeline_state, state.obs, proxy(state.pipeline_state)), state.metrics

        def move(state: RobotState, action: jax.Array) -> tuple[RobotState, Outcome]:
            zero = jnp.zeros(())
            before = State(state.physics, state.obs, zero, zero, dict.fromkeys(metrics, zero))
            after = env.step(before, jnp.clip(action, -1.0, 1.0))
            # A diverged robot ends its episode there; its last sound observation stands in for the lost one.
            finite = _once(jnp.all(is_smaller(after.obs, DIVERGED)) & is_smaller(after.reward, DIVERGED))
            obs = jnp.where(finite, after.obs, state.obs)
            terminated = _once((after.done > 0.5) | ~finite)
            outcome = Outcome(jnp.where(finite, after.reward, 0.0), terminated, finite)
            return RobotState(after.pipeline_state, obs, proxy(after.pipeline_state)), outcome

        begin, (start, metrics) = _traced_once(begin, jax.random.key(0))  # the collision code is imported here
        acting = jax.ShapeDtypeStruct((int(env.action_size),), jnp.float32)
        step, _ = _traced_once(move, start, acting)

    if backend == "spring" and not as_brax:
        step = _together(step, start, acting)

    def reset(key: jax.Array) -> RobotState:
        return begin(key)[0]

    # ``inline`` leaves no mark in the programs that these become part of.
    reset, step = jax.jit(reset, inline=True), jax.jit(step, inline=True)
    obs_size = start.obs.shape[-1]  # the property of Brax traces a reset to find out
    return Environment(name, backend, obs_size, int(env.action_size), ROBOTS[name].feet, float(env.dt), reset, step)


def _once(mask: jax.Array) -> jax.Array:
    """``mask``, worked out once: what leads to it, XLA would put into every kernel that reads it; but no root."""
    return jnp.sqrt(mask.astype(jnp.float32)) > 0.5


def _together(step: Step, *like: Any) -> Step:
    """``step``, with ``robots_last`` in place of what ``jax.vmap`` would make of it."""
    one, many = custom_vmap(step), robots_last(step, *like)

    @one.def_vmap
    def all_of_them(count: int, own: Any, *args: Any) -> tuple[Any, Any]:
        each = jax.tree.map(lambda x, mine: x if mine else jnp.broadcast_to(x, (count, *x.shape)), list(args), own)
        results = many(*each)
        return results, jax.tree.map(lambda _: True, results)

    return one
