"""The places of a robot's capsules, against MuJoCo's and Brax's own kinematics."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from probes import counter
from scipy.spatial.transform import Rotation

from qdil.errors import ConfigError
from qdil.robots import brax_robots, register, shapes

pytestmark = pytest.mark.physics
ROBOTS = [robot.name for robot in register.BUILT_IN]


@pytest.mark.parametrize("name", ROBOTS)
def test_capsules_lie_where_mujoco_puts_them(name):
    model = brax_robots.model(register.find(name))
    data = mujoco.MjData(model)
    data.qpos[:] = brax_robots.first_positions(register.find(name))
    mujoco.mj_kinematics(model, data)
    robot = shapes.shapes(name)
    ends = shapes.placed(robot, shapes.first_pose(name))
    drawn = np.isin(model.geom_type, (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE))
    bodies = np.flatnonzero((model.geom_bodyid > 0) & drawn)
    assert len(bodies) > 3
    np.testing.assert_allclose(ends.mean(axis=1), data.geom_xpos[bodies], atol=1e-9)
    axes = data.geom_xmat[bodies].reshape(-1, 3, 3)[:, :, 2]
    lengths = np.where(model.geom_type[bodies] == mujoco.mjtGeom.mjGEOM_CAPSULE, model.geom_size[bodies, 1], 0)
    np.testing.assert_allclose((ends[:, 1] - ends[:, 0]) / 2, axes * lengths[:, None], atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_links_are_numbered_as_the_simulator_numbers_them(name):
    with brax_robots._quiet():
        from brax import envs, kinematics

        system = envs.get_environment(register.find(name).brax_env, backend="spring").sys
        x, _ = jax.jit(kinematics.forward)(system, system.init_q, jnp.zeros(system.qd_size()))
    pose = shapes.first_pose(name)
    np.testing.assert_allclose(pose.position, x.pos, atol=1e-5)
    np.testing.assert_allclose(pose.rotation, x.rot, atol=1e-5)


@pytest.mark.parametrize("name", ROBOTS)
def test_feet_are_the_lowest_links_and_stand_on_the_ground(name):
    robot = shapes.shapes(name)
    bottom = shapes.placed(robot, shapes.first_pose(name))[:, :, 2].min(axis=1) - robot.radius
    for foot in range(register.count_measures(name)):
        lowest = bottom[robot.foot == foot].min()
        assert -0.11 < lowest < 0.15  # metres: an episode begins with feet near the ground, at most a little in it
        assert lowest <= bottom[robot.foot == -1].min()


def test_turning_agrees_with_scipy():
    rng = np.random.default_rng(0)
    turns, vectors = Rotation.random(20, rng=rng), rng.normal(size=(20, 3))
    quaternions = turns.as_quat(scalar_first=True)
    np.testing.assert_allclose(shapes.rotated(quaternions, vectors), turns.apply(vectors), atol=1e-12)


def test_unknown_robot_is_refused():
    with pytest.raises(ConfigError, match="unknown robot 'dog'"):
        shapes.shapes("dog")


def test_an_environment_of_ones_own_has_no_shapes(monkeypatch):
    monkeypatch.setattr(register, "_ROBOTS", dict(register._ROBOTS))
    register.register_robot("dog", environment=counter(4.0))
    for call in (shapes.shapes, shapes.first_pose):
        with pytest.raises(ConfigError, match="no model to draw"):
            call("dog")
