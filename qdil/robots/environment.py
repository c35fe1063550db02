"""What a robot is to the rest of the library: a small value of pure functions, whatever simulates it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp


class RobotState(NamedTuple):
    """One robot at one moment t; with axis (E) in front, many robots."""

    physics: Any  # the simulator's own state, a tree of arrays that no other module reads
    obs: jax.Array  # (O,) observation s_t
    proxy: jax.Array  # (k,) Markovian measure proxy δ(s_t) in [0, 1]; for feet, 1 where one touches the ground


class Outcome(NamedTuple):
    """What one step yields besides the next state."""

    reward: jax.Array  # () the environment's own ("true") reward, finite
    terminated: jax.Array  # () bool, the episode ended by itself (a fall); rollouts apply the time limit
    finite: jax.Array  # () bool, False if the physics diverged, and then ``terminated`` is True


class Environment(NamedTuple):
    """A simulated robot, also known as the environment or, with a reward, as the Markov decision process.

    ``reset`` and ``step`` are pure functions of one robot that ``jax.vmap`` can map over many. To use a simulator of
    your own, fill in these fields and call ``qdil.robots.register.register_robot(name, environment=...)``.
    """

    name: str  # by which the robot is registered
    backend: str  # name of the simulator
    obs_size: int  # O
    action_size: int  # A
    measure_names: tuple[str, ...]  # one per measure, for Brax's robots its feet; k = len(measure_names)
    step_seconds: float  # simulated time of one step, s
    reset: Callable[[jax.Array], RobotState]  # random key -> state at the start of an episode
    step: Callable[[RobotState, jax.Array], tuple[RobotState, Outcome]]  # action (A,); the robot clips it to [-1, 1]


def problem_of(env: Environment) -> str | None:
    """The first thing in which ``reset`` and ``step`` do not fit the other fields, in words; None if all fits.

    Both functions are traced, not run: shapes and types are checked, numbers are not.
    """
    try:
        # The key is made inside: outside, it would start JAX's devices, perhaps before their settings.
        state = jax.eval_shape(lambda: env.reset(jax.random.key(0)))
        after, outcome = jax.eval_shape(env.step, state, jax.ShapeDtypeStruct((env.action_size,), jnp.float32))
    except Exception as error:  # a user's functions may raise anything
        reason = " ".join(str(error).split())[:200]
        return f"reset or step cannot be traced by JAX ({type(error).__name__}: {reason})"
    number, truth = jnp.floating, jnp.bool_
    expected = {
        "obs of reset": (state.obs, (env.obs_size,), number),
        "proxy of reset": (state.proxy, (len(env.measure_names),), number),
        "reward of step": (outcome.reward, (), number),
        "terminated of step": (outcome.terminated, (), truth),
        "finite of step": (outcome.finite, (), truth),
    }
    for what, (array, shape, kind) in expected.items():
        if array.shape != shape or not jnp.issubdtype(array.dtype, kind):
            word = "bool" if kind is truth else "float"
            return f"{what} has shape {array.shape} and type {array.dtype}; it needs shape {shape} and type {word}"
    if _shapes(after) != _shapes(state):
        return "step returns a state of other shapes or types than reset"
    return None


def _shapes(tree: Any) -> Any:
    """The structure of a tree, and the shape and type of each of its arrays."""
    leaves, structure = jax.tree.flatten(tree)
    return structure, [(leaf.shape, leaf.dtype) for leaf in leaves]
