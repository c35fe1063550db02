"""The robots on Brax's physics: contact measures, falls, time limits, random resets, divergence."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdil.errors import ConfigError
from qdil.rl.rollout import rollout, start
from qdil.robots import brax_robots, register
from qdil.robots.environment import Environment, RobotState

pytestmark = pytest.mark.physics

FEET = {"halfcheetah": 2, "walker2d": 2, "humanoid": 2, "hopper": 1, "ant": 4}


@pytest.fixture(scope="module", params=FEET)
def robot(request) -> Environment:
    return register.make(request.param)


def test_every_robot_of_ours_is_tested():
    assert set(FEET) == {robot.name for robot in register.BUILT_IN}


@pytest.mark.parametrize("backend", [b for b in register.BACKENDS if b != "spring"])
def test_the_other_backends_step_and_feel_the_ground(backend):
    """Walker2d stands where it starts: let go, it sinks onto its feet, whatever simulates it."""
    env = register.make("walker2d", backend)
    state = jax.jit(env.reset)(jax.random.key(0))
    proxies = settle(env, state)
    assert np.isfinite(np.asarray(state.obs)).all() and state.obs.shape == (env.obs_size,)
    assert set(np.unique(proxies)) <= {0.0, 1.0} and proxies.max() == 1.0


def test_robots_move_as_braxs_own_do(robot):
    """Steps from the same states, by the same actions, of many of our robots and of Brax's as they come."""
    from brax import envs

    plain = envs.get_environment(robot.name, backend="spring")
    keys = jax.random.split(jax.random.key(4), 6)
    ours, of_brax = jax.jit(jax.vmap(robot.reset))(keys), jax.jit(jax.vmap(plain.reset))(keys)
    np.testing.assert_array_equal(ours.obs, of_brax.obs)
    step, plain_step = jax.jit(jax.vmap(robot.step)), jax.jit(jax.vmap(plain.step))
    touched = False
    for action in np.random.default_rng(0).uniform(-1, 1, (25, 6, robot.action_size)).astype(np.float32):
        before = RobotState(of_brax.pipeline_state, of_brax.obs, ours.proxy)
        (ours, outcome), of_brax = step(before, action), plain_step(of_brax, action)
        touched |= bool(ours.proxy.any())
        np.testing.assert_allclose(ours.obs, of_brax.obs, rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(outcome.reward, of_brax.reward, rtol=1e-3, atol=1e-3)
        leaves = zip(jax.tree.leaves(ours.physics), jax.tree.leaves(of_brax.pipeline_state), strict=True)
        for our_leaf, their_leaf in leaves:
            np.testing.assert_allclose(our_leaf, their_leaf, rtol=1e-3, atol=1e-3)
    assert touched


def test_many_robots_are_simulated_batch_last(robot):
    """Only speed would show it: Brax's own step, batched, is full of products that ``batch_last`` writes out."""

    def products(env):
        """Of arrays that robots, 53 of them, do not share."""
        states = jax.eval_shape(jax.vmap(env.reset), jax.random.split(jax.random.key(0), 53))
        program = jax.jit(jax.vmap(env.step)).lower(states, jnp.zeros((53, env.action_size)))
        return sum("dot_general" in line and "53" in line.split(" : ")[-1] for line in program.as_text().splitlines())

    assert products(brax_robots.make(register.find(robot.name), "spring", as_brax=True)) > 15
    assert products(robot) <= 3  # sums of more than a few numbers


def test_one_robot_moves_as_many_do(robot):
    """A step under ``jax.vmap`` is simulated in another order; one shared action is every robot's."""
    states = jax.jit(jax.vmap(robot.reset))(jax.random.split(jax.random.key(4), 3))
    action = jnp.full(robot.action_size, 0.3)
    many = jax.jit(jax.vmap(robot.step, in_axes=(0, None)))(states, action)
    for i in range(3):
        one = jax.jit(robot.step)(jax.tree.map(lambda leaf, i=i: leaf[i], states), action)
        for alone, among in zip(jax.tree.leaves(one), jax.tree.leaves(many), strict=True):
            np.testing.assert_allclose(alone, among[i], rtol=1e-3, atol=1e-3)


def lifted(env: Environment, height: float) -> RobotState:
    """The robot's initial pose, moved up by ``height`` metres."""
    from brax import envs

    inside = envs.get_environment(env.name, backend=env.backend)
    # Planar robots have their height as the second coordinate, others (x, y, z, quaternion) as the third.
    up = 2 if env.name in ("humanoid", "ant") else 1
    physics = inside.pipeline_init(inside.sys.init_q.at[up].add(height), jnp.zeros(inside.sys.qd_size()))
    return RobotState(physics, jnp.zeros(env.obs_size), jnp.zeros(len(env.measure_names)))


def settle(env: Environment, state: RobotState) -> np.ndarray:
    """Proxies (40, k) of 40 steps under zero torque."""

    def one(state, _):
        state, _ = env.step(state, jnp.zeros(env.action_size))
        return state, state.proxy

    return np.asarray(jax.jit(lambda s: jax.lax.scan(one, s, None, 40)[1])(state))


def test_feet_touch_when_standing_and_not_in_the_air(robot):
    # Let go in its initial pose, each robot comes to rest on all its feet within a moment, before it falls over.
    landed = settle(robot, lifted(robot, 0.0))
    assert (landed == 1.0).all(axis=1).any()
    flying = settle(robot, lifted(robot, 50.0))  # still falling after the two seconds that it is watched
    assert (flying == 0.0).all()


def test_feet_touch_where_the_contact_distance_is_not_positive(robot):
    """δ(s) of random motion against contact distances, foot by foot, by the names of the links and shapes they join."""
    from brax import contact, envs

    plain = envs.get_environment(robot.name, backend="spring")
    model = plain.sys.mj_model
    link_of = {model.geom(i).name: int(model.geom_bodyid[i]) - 1 for i in range(model.ngeom)}
    link_of |= {model.body(i).name: i - 1 for i in range(1, model.nbody)}
    contacts = jax.jit(lambda physics: contact.get(plain.sys, physics.x))
    step, state = jax.jit(robot.step), jax.jit(robot.reset)(jax.random.key(2))
    seen = set()
    for action in np.random.default_rng(1).uniform(-1, 1, (60, robot.action_size)).astype(np.float32):
        found = contacts(state.physics)
        pairs = list(zip(*(np.asarray(link) for link in found.link_idx), np.asarray(found.dist), strict=True))
        for foot, proxy in zip(robot.measure_names, np.asarray(state.proxy), strict=True):
            distances = [distance for first, second, distance in pairs if link_of[foot] in (first, second)]
            assert distances and proxy == (min(distances) <= 0)
            seen.add(float(proxy))
        state, outcome = step(state, action)
        assert np.isfinite(state.obs).all() and np.isfinite(outcome.reward) and outcome.finite
    assert seen == {0.0, 1.0}


def test_sizes_are_those_of_the_robot(robot):
    state = jax.eval_shape(robot.reset, jax.random.key(0))
    assert state.obs.shape == (robot.obs_size,)
    assert state.proxy.shape == (len(robot.measure_names),) == (FEET[robot.name],)


@pytest.mark.parametrize("name, backend", [("dog", None), ("dog", "spring"), ("walker2d", "clay")])
def test_an_unknown_robot_or_backend_is_refused(name, backend):
    with pytest.raises(ConfigError, match="choose one of"):
        register.make(name, backend)


@pytest.fixture(scope="module")
def driven():
    """A rollout of walker2d, 8 robots, time limit 140 steps: half tremble and last, half fall."""
    env = register.make("walker2d")

    def act(noise, obs):
        return jnp.clip(0.6 * noise, -1.0, 1.0).at[:4].set(-1.0), jnp.zeros(len(noise))

    run = jax.jit(lambda key: rollout(env, act, start(env, key, 140), 150, 140))
    _, transitions, _ = run(jax.random.split(jax.random.key(1), 8))
    return jax.tree.map(np.asarray, transitions)


def test_falls_terminate_and_time_limits_truncate(driven):
    assert driven.terminated.any() and driven.truncated.any()
    assert not (driven.terminated & driven.truncated).any()
    # A fall leaves walker2d's healthy range of trunk height (0.8 to 2 m) or of trunk angle (±1 rad).
    height, angle = driven.next_obs[..., 0], driven.next_obs[..., 1]
    healthy = (height > 0.8) & (height < 2.0) & (np.abs(angle) < 1.0)
    assert (healthy == ~driven.terminated).all()


def test_every_robot_draws_a_start_state_of_its_own(driven):
    ended = (driven.terminated | driven.truncated)[:-1]
    after_reset = driven.obs[1:][ended]
    assert len(after_reset) > 8
    assert len(np.unique(after_reset.round(6), axis=0)) == ended.any(axis=0).sum() == 8


def test_steps_of_an_episode_follow_each_other(driven):
    ended = driven.terminated | driven.truncated
    goes_on = ~ended[:-1]
    np.testing.assert_array_equal(driven.next_obs[:-1][goes_on], driven.obs[1:][goes_on])
    assert (driven.next_obs[:-1][~goes_on] != driven.obs[1:][~goes_on]).any(axis=-1).all()


def test_diverged_physics_ends_the_episode_with_finite_numbers():
    env = register.make("walker2d")
    state = env.reset(jax.random.key(0))
    broken = state._replace(physics=jax.tree.map(lambda x: x * jnp.nan, state.physics))
    after, outcome = jax.jit(env.step)(broken, jnp.zeros(env.action_size))
    assert bool(outcome.terminated) and not bool(outcome.finite)
    assert np.isfinite(outcome.reward) and np.isfinite(after.obs).all()
