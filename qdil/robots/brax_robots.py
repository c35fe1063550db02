"""Brax's robots as ``Environment`` values with foot contacts. No other module imports Brax's physics."""

import io
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jax.extend.core import jaxpr_as_fun

from qdil.errors import ConfigError
from qdil.finite import is_smaller
from qdil.robots.batched.batch_last import batch_last
from qdil.robots.environment import Environment, Outcome, RobotState
from qdil.robots.robot import BACKENDS, Robot

DIVERGED = 1e6  # an observation or reward above this size means that the physics is about to become infinite
# A foot touches the ground up to this contact distance, in metres; 0 for other backends. The positional backend pushes
# feet out of the ground before a step ends, so that standing feet are slightly above it: 0.05 mm on walker2d.
TOUCHES = {"positional": 1e-3}

Step = Callable[[RobotState, jax.Array], tuple[RobotState, Outcome]]


def foot_links(robot: Robot, mj: Any) -> list[int]:
    """The link index of each of a robot's feet (k,), in their order; link i is body i + 1 of the MuJoCo model ``mj``.

    A foot is given by the name of its link, or of a collision shape of its link. Raises ConfigError if a name does not
    belong to exactly one link (the message lists all names), and if two feet are the same link.
    """
    named = [(mj.body(i).name, i - 1) for i in range(1, mj.nbody)]
    named += [(mj.geom(i).name, int(mj.geom_bodyid[i]) - 1) for i in range(mj.ngeom) if mj.geom_bodyid[i] > 0]
    links = {foot: {link for name, link in named if name == foot} for foot in robot.feet}
    wrong = [foot for foot in robot.feet if len(links[foot]) != 1 or not foot]
    if wrong:
        names = ", ".join(dict.fromkeys(name for name, _ in named if name))
        raise ConfigError(
            f"robot '{robot.name}' has no foot {' and no foot '.join(map(repr, wrong))}; choose among {names}."
        )
    feet = [links[foot].pop() for foot in robot.feet]
    if len(set(feet)) < len(feet):
        raise ConfigError(f"robot '{robot.name}': two of its feet ({', '.join(robot.feet)}) are on the same link.")
    return feet


@contextmanager
def _quiet() -> Iterator[None]:
    """Hide the warnings that importing Brax prints: its end of maintenance, optional packages, old model files."""
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
    """The MuJoCo model (``mujoco.MjModel``) of a robot: its links, shapes and joints.

    Raises ConfigError for a user's own environment, which has none, and for an unknown Brax environment.
    """
    return _brax_env(robot, BACKENDS[0]).sys.mj_model


def first_positions(robot: Robot) -> np.ndarray:
    """Joint positions (nq,) in which episodes begin, without their small random change. Raises as ``model``.

    They may differ from ``model(robot).qpos0``: the ant begins with bent legs.
    """
    return np.asarray(_brax_env(robot, BACKENDS[0]).sys.init_q, np.float64)


@cache
def _brax_env(robot: Robot, backend: str) -> Any:
    if robot.brax_env is None:
        raise ConfigError(f"robot '{robot.name}' is an environment of your own, so it has no model to draw.")
    with _quiet():
        from brax import envs

        try:
            with _constants_on_this_host():
                return envs.get_environment(robot.brax_env, backend=backend)
        except KeyError:
            raise ConfigError(f"robot '{robot.name}': Brax has no environment called '{robot.brax_env}'.") from None


@contextmanager
def _constants_on_this_host() -> Iterator[None]:
    """Let MuJoCo's loader put a model on this host's first device, not on the first device of all hosts.

    Other hosts could not read it there.
    """
    from mujoco import mjx

    original = mjx.put_model
    mjx.put_model = partial(original, device=jax.local_devices()[0])
    try:
        yield
    finally:
        mjx.put_model = original


def _traced_once(function: Callable[..., Any], *template: Any) -> tuple[Callable[..., Any], Any]:
    """``function`` traced once, for arguments shaped like ``template``, and the shapes of its results.

    The returned function replays that trace. Without it ``jax.jit`` would trace Brax, which takes a second, once inside
    and once outside a device mesh.
    """
    trace, shapes = jax.make_jaxpr(function, return_shape=True)(*template)
    replayed = jaxpr_as_fun(trace)

    def replay(*args: Any) -> Any:
        return jax.tree.unflatten(jax.tree.structure(shapes), replayed(*jax.tree.leaves(args)))

    return replay, shapes


@cache
def make(robot: Robot, backend: str, as_brax: bool = False) -> Environment:
    """Build a robot on a Brax ``backend``, one of ``BACKENDS``. Raises ConfigError for feet that are not its links.

    The proxy δ(s) ∈ {0,1}^k is 1 where any collision shape of a foot's link touches the ground: contact distance ≤ 0,
    or ≤ ``TOUCHES``, among the contacts that the simulator resolves. Actions are clipped to [-1, 1] before they reach
    the robot, so that its control cost counts the applied action.

    On the spring backend, ``jax.vmap`` of the step uses the batch-last layout (``qdil.robots.batched.batch_last``) for
    speed. ``as_brax`` switches that off, for comparisons. Results differ by rounding only.
    """
    env = _brax_env(robot, backend)
    proxy = _proxy(env, jnp.asarray(foot_links(robot, env.sys.mj_model)), TOUCHES.get(backend, 0.0))

    def begin(key: jax.Array) -> tuple[RobotState, dict[str, jax.Array]]:
        state = env.reset(key)
        return RobotState(state.pipeline_state, state.obs, proxy(state.pipeline_state)), state.metrics

    with _quiet():
        begin, (start, metrics) = _traced_once(begin, jax.random.key(0))  # Brax imports its collision code here
        action = jax.ShapeDtypeStruct((int(env.action_size),), jnp.float32)
        step, _ = _traced_once(_step(env, proxy, tuple(metrics)), start, action)

    if backend == "spring" and not as_brax:
        step = _batch_rule(step, start, action)

    def reset(key: jax.Array) -> RobotState:
        return begin(key)[0]

    # ``inline``: the programs that call these contain their operations directly, with no inner call.
    reset, step = jax.jit(reset, inline=True), jax.jit(step, inline=True)
    obs_size = start.obs.shape[-1]  # Brax's own property ``observation_size`` would trace a reset once more
    return Environment(robot.name, backend, obs_size, int(env.action_size), robot.feet, float(env.dt), reset, step)


def _proxy(env: Any, feet: jax.Array, touches: float) -> Callable[[Any], jax.Array]:
    """The function physics -> δ(s) (k,), 1 where a link of ``feet`` (k,) is at most ``touches`` m from the ground."""
    with _quiet():
        from brax import contact

    def proxy(physics: Any) -> jax.Array:
        contacts = contact.get(env.sys, physics.x)
        if contacts is None:
            raise ConfigError("this robot of Brax has no collision shapes, so no foot can touch the ground.")
        touching = contacts.dist <= touches
        of_foot = (contacts.link_idx[0] == feet[:, None]) | (contacts.link_idx[1] == feet[:, None])
        return jnp.any(of_foot & touching, axis=1).astype(jnp.float32)

    return proxy


def _step(env: Any, proxy: Callable[[Any], jax.Array], metrics: tuple[str, ...]) -> Step:
    """One step of a Brax environment as ``Environment.step``. Brax needs ``metrics`` in its state; they are unused."""
    with _quiet():
        from brax.envs.base import State

    def step(state: RobotState, action: jax.Array) -> tuple[RobotState, Outcome]:
        zero = jnp.zeros(())
        before = State(state.physics, state.obs, zero, zero, dict.fromkeys(metrics, zero))
        after = env.step(before, jnp.clip(action, -1.0, 1.0))
        # A diverged robot ends its episode; its last finite observation replaces the lost one.
        finite = _materialise(jnp.all(is_smaller(after.obs, DIVERGED)) & is_smaller(after.reward, DIVERGED))
        obs = jnp.where(finite, after.obs, state.obs)
        terminated = _materialise((after.done > 0.5) | ~finite)
        outcome = Outcome(jnp.where(finite, after.reward, 0.0), terminated, finite)
        return RobotState(after.pipeline_state, obs, proxy(after.pipeline_state)), outcome

    return step


def _materialise(mask: jax.Array) -> jax.Array:
    """Compute ``mask`` (bool) only once.

    XLA recomputes cheap producers inside every consumer kernel; a square root is expensive enough that it does not.
    """
    return jnp.sqrt(mask.astype(jnp.float32)) > 0.5


def _batch_rule(step: Step, *template: Any) -> Step:
    """``step``, for arguments shaped like ``template``, whose ``jax.vmap`` is ``batch_last`` of it."""
    single, batch = custom_vmap(step), batch_last(step, *template)

    @single.def_vmap
    def over_robots(count: int, is_batched: Any, *args: Any) -> tuple[Any, Any]:
        batched = jax.tree.map(
            lambda x, has_axis: x if has_axis else jnp.broadcast_to(x, (count, *x.shape)), list(args), is_batched
        )
        results = batch(*batched)
        return results, jax.tree.map(lambda _: True, results)

    return single
