"""The door to Brax: its robots with foot contacts; nothing else imports Brax's physics."""

import io
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jax.extend.core import jaxpr_as_fun

from qdil.errors import ConfigError
from qdil.finite import is_smaller
from qdil.robots.batched.batch_last import batch_last
from qdil.robots.environment import Environment, Outcome, RobotState
from qdil.robots.register import BACKENDS, Robot

DIVERGED = 1e6  # an observation or reward this large is no robot's: physics about to become infinite
# How far from the ground a foot may be and touch it, in metres. The positional backend moves what has sunk into the
# ground out of it before a step ends: there feet rest a hair above, 0.05 mm on walker2d.
TOUCHES = {"positional": 1e-3}


Step = Callable[[RobotState, jax.Array], tuple[RobotState, Outcome]]


def foot_links(robot: Robot, mj: Any) -> list[int]:
    """Indices of a robot's feet among the links of its MuJoCo model ``mj``; link i is body i + 1.

    A foot is named by its link, or by a shape of its link. Raises ConfigError unless every foot is exactly one link,
    and another one for each foot.
    """
    bodies = [mj.body(i).name for i in range(1, mj.nbody)]
    shapes = [(mj.geom(i).name, int(mj.geom_bodyid[i]) - 1) for i in range(mj.ngeom) if mj.geom_bodyid[i] > 0]
    found = {
        foot: {i for i, name in [*enumerate(bodies), *((i, n) for n, i in shapes)] if name == foot}
        for foot in robot.feet
    }
    wrong = [foot for foot, links in found.items() if len(links) != 1 or not foot]
    if wrong:
        names = ", ".join(filter(None, [*bodies, *(name for name, _ in shapes)]))
        raise ConfigError(
            f"robot '{robot.name}': {', '.join(map(repr, wrong))} is none of its links or shapes ({names})."
        )
    links = [links.pop() for links in found.values()]
    if len(set(links)) < len(links):
        raise ConfigError(f"robot '{robot.name}': two of its feet, {', '.join(robot.feet)}, are the same link.")
    return links


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


@cache
def model(robot: Robot) -> Any:
    """The MuJoCo model (``mujoco.MjModel``) that a robot is read from: its links, shapes and joints.

    Raises ConfigError for a robot that Brax does not simulate, or whose Brax environment does not exist.
    """
    return _brax_env(robot, BACKENDS[0]).sys.mj_model


def _brax_env(robot: Robot, backend: str) -> Any:
    if robot.brax_env is None:
        raise ConfigError(f"robot '{robot.name}' is an environment of its own: it has no model to draw.")
    with _quiet():
        from brax import envs

        try:
            with _constants_on_this_host():
                return envs.get_environment(robot.brax_env, backend=backend)
        except KeyError:
            raise ConfigError(f"robot '{robot.name}': Brax has no environment called '{robot.brax_env}'.") from None


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


def _traced_materialise(function: Callable[..., Any], *like: Any) -> tuple[Callable[..., Any], Any]:
    """``function`` as a replay of one trace, for arguments like these, and what it returns, as shapes.

    Tracing Brax takes a second, and ``jax.jit`` does so again outside a mesh and inside one.
    """
    trace, shapes = jax.make_jaxpr(function, return_shape=True)(*like)
    replayed = jaxpr_as_fun(trace)

    def replay(*args: Any) -> Any:
        return jax.tree.unflatten(jax.tree.structure(shapes), replayed(*jax.tree.leaves(args)))

    return replay, shapes


@cache
def make(robot: Robot, backend: str, as_brax: bool = False) -> Environment:
    """Build a robot on a Brax ``backend`` (one of ``BACKENDS``). Raises ConfigError for feet that are not its links.

    The proxy δ(s) ∈ {0,1}^k is 1 where any collision shape of a foot's link touches the ground
    (contact distance ≤ 0, or ``TOUCHES``), computed from the same contacts the simulator resolves. Actions are
    clipped to [-1, 1] before they reach the robot, so that its control cost counts what was applied.

    On the spring backend a ``jax.vmap`` of the step simulates its robots as ``batch_last`` lays them; ``as_brax``
    leaves it as Brax and JAX have it, to compare with.
    """
    env = _brax_env(robot, backend)
    feet = jnp.asarray(foot_links(robot, env.sys.mj_model))
    with _quiet():
        from brax import contact
        from brax.envs.base import State

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
            finite = _materialise(jnp.all(is_smaller(after.obs, DIVERGED)) & is_smaller(after.reward, DIVERGED))
            obs = jnp.where(finite, after.obs, state.obs)
            terminated = _materialise((after.done > 0.5) | ~finite)
            outcome = Outcome(jnp.where(finite, after.reward, 0.0), terminated, finite)
            return RobotState(after.pipeline_state, obs, proxy(after.pipeline_state)), outcome

        begin, (start, metrics) = _traced_materialise(begin, jax.random.key(0))  # the collision code is imported here
        acting = jax.ShapeDtypeStruct((int(env.action_size),), jnp.float32)
        step, _ = _traced_materialise(move, start, acting)

    if backend == "spring" and not as_brax:
        step = _batch_rule(step, start, acting)

    def reset(key: jax.Array) -> RobotState:
        return begin(key)[0]

    # ``inline`` leaves no mark in the programs that these become part of.
    reset, step = jax.jit(reset, inline=True), jax.jit(step, inline=True)
    obs_size = start.obs.shape[-1]  # the property of Brax traces a reset to find out
    return Environment(robot.name, backend, obs_size, int(env.action_size), robot.feet, float(env.dt), reset, step)


def _materialise(mask: jax.Array) -> jax.Array:
    """``mask``, computed only once.

    XLA recomputes cheap producers inside every consumer kernel; a square root is expensive enough that it does not.
    """
    return jnp.sqrt(mask.astype(jnp.float32)) > 0.5


def _batch_rule(step: Step, *like: Any) -> Step:
    """``step``, with ``batch_last`` in place of what ``jax.vmap`` would make of it."""
    one, many = custom_vmap(step), batch_last(step, *like)

    @one.def_vmap
    def all_of_them(count: int, own: Any, *args: Any) -> tuple[Any, Any]:
        each = jax.tree.map(lambda x, mine: x if mine else jnp.broadcast_to(x, (count, *x.shape)), list(args), own)
        results = many(*each)
        return results, jax.tree.map(lambda _: True, results)

    return one
