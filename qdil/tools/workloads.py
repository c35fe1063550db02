"""The parts of a run that the bench times: each is a ``Turn``, or a function of a search that returns one's result."""

import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec as P

from qdil import ppga
from qdil.config import Config, make_config
from qdil.devices.mesh import AXIS, make_mesh
from qdil.devices.xla_options import single_threaded
from qdil.imitation.demos import made_up
from qdil.qd import archive
from qdil.rl.rollout import rollout, start
from qdil.robots import brax_robots, register
from qdil.tools.timing import Turn

SHARED_STATE = ("train_state", "stats", "envs")  # what ``prepared`` copies from another search


def prepared(robot: str, method: str, budget: str, like: ppga.Search | None = None, **changes: Any) -> ppga.Search:
    """A search after the budget's warm-up and one iteration, so that everything is compiled; on made-up demonstrations.

    Without the warm-up the robots would only fall, which a run's robots do not. ``like``: copy the robots, policy,
    critic and normaliser of this search instead of warming up.
    """
    config = make_config(robot, method, budget, **changes)
    env = register.make(config.env, config.simulation.backend)
    rows = config.demos.demo_episodes * config.simulation.episode_length
    search = ppga.begin(config, None if method == "true" else made_up(env, rows))
    if like is None:
        search = ppga.warmed_up(search, config.ppga.warmup_updates)
    else:
        copied = {n: with_layout_of(getattr(search.state, n), getattr(like.state, n)) for n in SHARED_STATE}
        search = search._replace(state=search.state._replace(**copied))
    return ppga.iteration(search)[0]


def with_layout_of(template: Any, values: Any) -> Any:
    """``values`` in the layout over devices of ``template``, a tree of the same structure."""
    return jax.tree.map(lambda old, new: jax.device_put(new, old.sharding), template, values)


def bare_simulator(config: Config, num_devices: int, as_brax: bool = False) -> Turn:
    """Rollouts of random actions, with resets and contacts, laid out over the devices as in a run.

    They are simulated and compiled as in a run, or, ``as_brax``, as Brax and JAX do by default.
    """
    backend, length = config.simulation.backend, config.simulation.episode_length
    if as_brax and register.find(config.env).environment is None:
        env = brax_robots.make(register.find(config.env), backend, as_brax)
    else:
        env = register.make(config.env, backend)

    def act(noise: jax.Array, obs: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jnp.clip(noise, -1.0, 1.0), jnp.zeros(len(noise))

    def drive(envs: Any) -> Any:
        envs, steps, _ = rollout(env, act, envs, config.ppo.rollout_length, length)
        return envs, jnp.sum(steps.reward)[None]

    mesh = make_mesh(num_devices)
    over_devices = jax.shard_map(drive, mesh=mesh, in_specs=P(AXIS), out_specs=(P(AXIS), P(AXIS)), check_vma=False)
    run = jax.jit(over_devices, compiler_options=None if as_brax else single_threaded(num_devices))
    keys = jax.random.split(jax.random.key(0), config.ppo.num_envs)
    envs, _ = run(jax.jit(lambda k: start(env, k, length, in_step=False))(keys))
    rollouts = config.ppga.gradient_updates + config.ppga.walk_updates

    def turn() -> tuple[float, float]:
        nonlocal envs
        began = time.monotonic()
        for _ in range(rollouts):
            envs, reward = run(envs)
        jax.block_until_ready(reward)
        return float(rollouts * config.ppo.rollout_length * config.ppo.num_envs), time.monotonic() - began

    return turn


def walk(search: ppga.Search) -> tuple[float, float]:
    """One walk: N2 VPPO updates."""
    config, occupied = search.config, jnp.asarray(archive.occupied(search.archives))
    began = time.monotonic()
    fitness_alone = np.eye(search.engine.objectives)[0]
    trained = search.engine.train_policy(search.state, occupied, fitness_alone, config.ppga.walk_updates)
    jax.block_until_ready(trained.theta)
    return float(config.ppga.walk_updates * config.ppo.rollout_length * config.ppo.num_envs), time.monotonic() - began


def evaluation(search: ppga.Search) -> tuple[float, float]:
    """λ candidates, all of them θ_μ, over whole episodes."""
    coefficients = np.zeros((search.config.ppga.candidates, search.engine.objectives))
    theta = jnp.zeros((search.engine.objectives, 1))
    policies, _ = search.engine.branch(search.state, theta, coefficients)
    began = time.monotonic()
    candidates = ppga.evaluate(search, policies, search.state.key)
    return float(candidates.length.sum() * search.config.evaluation.episodes), time.monotonic() - began


def iteration(search: ppga.Search) -> tuple[ppga.Search, tuple[float, float]]:
    """One QD iteration: the search after it, and its steps and seconds."""
    began = time.monotonic()
    search, info = ppga.iteration(search)
    jax.block_until_ready(search.state.key)
    return search, (info.steps, time.monotonic() - began)


def iterations_of(search: ppga.Search) -> Turn:
    """The next QD iteration of a search, in every turn."""

    def turn() -> tuple[float, float]:
        nonlocal search
        search, result = iteration(search)
        return result

    return turn


def same_iterations(one: ppga.Search, together: ppga.Search) -> tuple[Turn, Turn]:
    """The next QD iteration of ``together``: on the devices of ``one``, and, called after that, on its own devices.

    Two independent runs would drift apart. The one whose candidates live longer would do more of the fast steps of
    evaluations, and seem faster.
    """

    def on_one() -> tuple[float, float]:
        state = jax.block_until_ready(with_layout_of(one.state, together.state))
        return iteration(one._replace(archives=together.archives, xnes=together.xnes, rng=together.rng, state=state))[1]

    def on_all() -> tuple[float, float]:
        nonlocal together
        together, result = iteration(together)
        return result

    return on_one, on_all


def reward_update(search: ppga.Search) -> tuple[float, float]:
    """One round of the reward model's learning."""
    occupied = jnp.asarray(archive.occupied(search.archives))
    assert search.demos is not None
    fresh = search.engine.rollout(search.state, occupied)
    jax.block_until_ready(fresh.theta)
    began = time.monotonic()
    state, _ = search.engine.update_reward(fresh.state, occupied, search.demos, fresh.transitions)
    jax.block_until_ready(state.reward)
    return 1.0, time.monotonic() - began


def update_flop(search: ppga.Search) -> float:
    """Floating-point operations of one VPPO update: acting, and forward and backward passes of all epochs."""
    config, env = search.config, search.engine.env
    actor = (env.obs_size, *config.ppo.actor_hidden, env.action_size)
    critic = (env.obs_size, *config.ppo.critic_hidden, search.engine.objectives)
    weights = [sum(a * b for a, b in zip(layers, layers[1:], strict=False)) for layers in (actor, critic)]
    steps = config.ppo.rollout_length * config.ppo.num_envs
    learning = 3 * sum(weights) * config.ppo.epochs  # a backward pass costs two forward passes
    return 2.0 * steps * (learning + weights[0] + 2 * weights[1])  # the critic values both ends of a step
