"""The geometry of robots for drawing: capsules and spheres, and their places in the pose in which episodes begin."""

from functools import cache
from typing import NamedTuple

import mujoco
import numpy as np

from qdil.robots import register
from qdil.robots.brax_robots import first_positions, foot_links, model


class Shapes(NamedTuple):
    """A robot's capsules, axis (G) in front, lengths in metres. A sphere is a capsule whose two ends coincide."""

    link: np.ndarray  # (G,) int, index of the link to which the capsule is fixed
    ends: np.ndarray  # (G, 2, 3) centres of its two round ends, in the link's own frame
    radius: np.ndarray  # (G,)
    foot: np.ndarray  # (G,) int, index of the foot to which the capsule belongs; -1 if it belongs to none


class Pose(NamedTuple):
    """Position and rotation of a robot's L links; x points forward, y to the left, z up."""

    position: np.ndarray  # (L, 3) metres
    rotation: np.ndarray  # (L, 4) unit quaternions, real part first


@cache
def shapes(name: str) -> Shapes:
    """The capsules of a robot. Raises ConfigError for an unknown robot and for a user's own environment."""
    robot = register.find(name)
    mj = model(robot)
    kept = np.flatnonzero((mj.geom_bodyid > 0) & np.isin(mj.geom_type, (CAPSULE, SPHERE)))
    half = np.where(mj.geom_type[kept] == CAPSULE, mj.geom_size[kept, 1], 0.0)
    along = rotated(mj.geom_quat[kept], np.array([0.0, 0.0, 1.0])) * half[:, None]
    ends = np.stack([mj.geom_pos[kept] - along, mj.geom_pos[kept] + along], axis=1)
    link = mj.geom_bodyid[kept] - 1  # body 0 is the world
    feet = foot_links(robot, mj)
    foot = np.array([feet.index(i) if i in feet else -1 for i in link])
    return Shapes(link, ends, mj.geom_size[kept, 0].copy(), foot)


CAPSULE, SPHERE = int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_SPHERE)


@cache
def first_pose(name: str) -> Pose:
    """The pose in which a robot's episodes begin, without the small random change of each episode."""
    robot = register.find(name)
    mj = model(robot)
    data = mujoco.MjData(mj)
    data.qpos[:] = first_positions(robot)
    mujoco.mj_kinematics(mj, data)
    return Pose(data.xpos[1:].copy(), data.xquat[1:].copy())


def placed(robot: Shapes, pose: Pose) -> np.ndarray:
    """The ends (G, 2, 3) of a robot's capsules in world coordinates, metres."""
    ends = rotated(pose.rotation[robot.link, None], robot.ends)
    return ends + pose.position[robot.link, None]


def rotated(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """``vector`` (…, 3) rotated by unit quaternions (…, 4), real part first; leading axes broadcast."""
    real, axis = quaternion[..., :1], quaternion[..., 1:]
    across = 2 * np.cross(axis, vector)
    return vector + real * across + np.cross(axis, across)
