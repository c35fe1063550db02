"""Robots drawn in NumPy, without OpenGL: every pixel's ray against capsules and ground, lit by one lamp."""

from typing import NamedTuple

import numpy as np

from qdil.robots import shapes
from qdil.robots.shapes import Pose, Shapes

SKY, BODY = np.array([238, 242, 246], np.float32), np.array([154, 163, 178], np.float32)
TILES = np.array([[217, 221, 226], [195, 201, 209]], np.float32)
# Okabe and Ito's colours for up to six feet while they touch the ground, and their legs', as in ``colours.js``.
FEET = np.array(
    [[230, 159, 0], [86, 180, 233], [0, 158, 115], [213, 94, 0], [0, 114, 178], [204, 121, 167]], np.float32
)
LEGS = np.array(
    [[125, 107, 79], [95, 127, 150], [79, 122, 107], [138, 100, 80], [79, 102, 128], [134, 105, 122]], np.float32
)
LAMP = np.array([-0.29, -0.48, 0.83], np.float32)  # towards the light
OPENING = np.deg2rad(32.0)  # the camera's vertical angle of view
RING = (0.16, 0.21)  # metres: radii of the ring under a foot that touches the ground
BALL = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)  # corners around it
FINER = 2  # rays per pixel and direction


class View(NamedTuple):
    """The camera's place around the robot; angles in radians."""

    azimuth: float = -np.pi / 2 + 0.35  # 0: from behind; -π/2: from the right
    elevation: float = 0.16
    distance: float = 2.7  # in sizes of the robot


class Scene(NamedTuple):
    """One robot at one moment, as capsules in the world."""

    ends: np.ndarray  # (G, 2, 3)
    radius: np.ndarray  # (G,)
    colour: np.ndarray  # (G, 3)
    rings: np.ndarray  # (R, 5): x, y of a touching foot and its colour


def scene(robot: Shapes, leg: np.ndarray, pose: Pose, touching: np.ndarray) -> Scene:
    """A robot in ``pose``. ``leg`` (L,) is from ``shown.legs``; ``touching`` (k,) bool marks the feet to light."""
    ends = shapes.placed(robot, pose).astype(np.float32)
    of_leg = leg[robot.link]
    colour = np.where((of_leg >= 0)[:, None], LEGS[of_leg % len(LEGS)], BODY)
    rings = []
    for foot in np.flatnonzero(touching):
        capsules = np.flatnonzero(robot.foot == foot)
        if not len(capsules):
            continue  # a foot of another shape, which is not drawn
        colour[capsules] = FEET[foot % len(FEET)]
        middles = ends[capsules].mean(axis=1)
        rings.append([*middles[np.argmin(middles[:, 2]), :2], *FEET[foot % len(FEET)]])
    return Scene(ends, robot.radius.astype(np.float32), colour, np.reshape(rings, (-1, 5)).astype(np.float32))


def image(
    what: Scene, target: np.ndarray, size: float, width: int, height: int, view: View | None = None
) -> np.ndarray:
    """(height, width, 3) uint8: ``what`` seen by a camera that looks at ``target`` (3,); ``size`` of the robot (m)."""
    camera = _camera(np.asarray(target, np.float32), size, width * FINER, height * FINER, view or View())
    colour = _ground(what, camera, size)
    nearest = np.full(camera.rays.shape[:2], np.inf, np.float32)
    for ends, radius, paint in zip(what.ends, what.radius, what.colour, strict=True):
        middle, reach = ends.mean(axis=0), np.linalg.norm(ends[1] - ends[0]) / 2 + radius
        block = _block(camera, middle + reach * BALL)
        far = _hit(camera.eye, camera.rays[block], ends, radius)
        closer = far < nearest[block]
        nearest[block][closer] = far[closer]
        rays = camera.rays[block][closer]
        colour[block][closer] = _lit(paint, camera.eye + far[closer][:, None] * rays, ends, rays)
    fine = colour.reshape(height, FINER, width, FINER, 3).mean(axis=(1, 3))
    return np.clip(fine, 0, 255).astype(np.uint8)


class _Camera(NamedTuple):
    eye: np.ndarray  # (3,)
    axes: np.ndarray  # (3, 3) unit vectors: right, up, ahead
    scale: float  # pixels per unit of the image plane at distance 1
    rays: np.ndarray  # (H, W, 3) a unit vector for every pixel, from the top left


def _camera(target: np.ndarray, size: float, width: int, height: int, view: View) -> _Camera:
    far = view.distance * size / min(1.0, width / height)
    towards = [np.cos(view.azimuth) * np.cos(view.elevation), np.sin(view.azimuth) * np.cos(view.elevation)]
    back = np.array([*towards, np.sin(view.elevation)], np.float32)
    eye = target + far * back
    eye[2] = max(eye[2], 0.05)
    ahead = target - eye
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    scale = height / 2 / np.tan(OPENING / 2)
    x = (np.arange(width) + 0.5 - width / 2) / scale
    y = (height / 2 - np.arange(height) - 0.5) / scale
    rays = ahead + x[None, :, None] * right + y[:, None, None] * up
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return _Camera(eye, np.array([right, up, ahead], np.float32), scale, rays.astype(np.float32))


def _block(camera: _Camera, corners: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of the picture that hold the hull of ``corners`` (N, 3); all of them if a corner is behind."""
    height, width = camera.rays.shape[:2]
    right, up, ahead = camera.axes @ (corners - camera.eye).T
    if ahead.min() < 0.05:
        return slice(0, height), slice(0, width)
    x, y = width / 2 + right / ahead * camera.scale, height / 2 - up / ahead * camera.scale
    rows = np.clip([np.floor(y.min()), np.ceil(y.max()) + 1], 0, height).astype(int)
    columns = np.clip([np.floor(x.min()), np.ceil(x.max()) + 1], 0, width).astype(int)
    return slice(rows[0], rows[1]), slice(columns[0], columns[1])


def _hit(origin: np.ndarray, rays: np.ndarray, ends: np.ndarray, radius: float) -> np.ndarray:
    """Distance (...) along unit ``rays`` (..., 3) from ``origin`` ((3,) or (..., 3)) to a capsule; infinite if missed.

    A ray hits the cylinder where the hit lies between the two ends, otherwise the ball around one end.
    """
    axis, start = ends[1] - ends[0], origin - ends[0]
    long, drift, offset = axis @ axis, rays @ axis, start @ axis
    along, square = _dot(rays, start), _dot(start, start)
    a = long - drift * drift
    b = long * along - offset * drift
    c = long * (square - radius * radius) - offset * offset
    with np.errstate(divide="ignore", invalid="ignore"):
        side = (-b - np.sqrt(b * b - a * c)) / a
        foot = offset + side * drift
        on_side = (foot > 0) & (foot < long) & (side > 0)
        caps = np.minimum(_ball(start, rays, radius), _ball(origin - ends[1], rays, radius))
    return np.where(on_side, side, caps)


def _dot(rays: np.ndarray, other: np.ndarray) -> np.ndarray:
    return rays @ other if other.ndim == 1 else np.einsum("...i,...i->...", rays, other)


def _ball(start: np.ndarray, rays: np.ndarray, radius: float) -> np.ndarray:
    along = _dot(rays, start)
    inside = along * along - _dot(start, start) + radius * radius
    far = -along - np.sqrt(inside)
    return np.where((inside >= 0) & (far > 0), far, np.inf)


def _lit(paint: np.ndarray, points: np.ndarray, ends: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Colours (N, 3) of ``points`` on a capsule: light from the sky, from the lamp, and a small highlight."""
    axis = ends[1] - ends[0]
    share = np.clip((points - ends[0]) @ axis / max(axis @ axis, 1e-9), 0, 1)
    normal = points - ends[0] - share[:, None] * axis
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    lamp = np.clip(normal @ LAMP, 0, None)
    half = LAMP - rays
    shine = np.clip((normal * half).sum(-1) / np.linalg.norm(half, axis=1), 0, None) ** 40
    light = 0.52 + 0.12 * normal[:, 2] + 0.52 * lamp
    return paint * light[:, None] + 60 * shine[:, None]


def _ground(what: Scene, camera: _Camera, size: float) -> np.ndarray:
    """Colours (H, W, 3) behind the robot: sky, tiles of a metre fading into it, shadow, rings under touching feet."""
    colour = np.broadcast_to(SKY, camera.rays.shape).copy()
    below = int(np.argmax(camera.rays[:, 0, 2] < -1e-3)) if camera.rays[-1, 0, 2] < -1e-3 else len(camera.rays)
    down = camera.rays[below:]
    far = -camera.eye[2] / down[..., 2]
    points = camera.eye[:2] + far[..., None] * down[..., :2]
    paint = TILES[np.floor(points).astype(np.int32).sum(axis=-1) % 2]
    for x, y, *ring in what.rings:
        corners = np.array([[x + dx, y + dy, 0] for dx in (-RING[1], RING[1]) for dy in (-RING[1], RING[1])])
        block = _below(_block(camera, corners), below)
        gap = np.hypot(points[block][..., 0] - x, points[block][..., 1] - y)
        paint[block][(gap > RING[0]) & (gap < RING[1])] = ring
    paint[_shaded(what, camera, points, below)] *= 0.62
    haze = np.clip((far / size - 4) / 14, 0, 1)[..., None]
    colour[below:] = paint + haze * (SKY - paint)
    return colour


def _below(block: tuple[slice, slice], first: int) -> tuple[slice, slice]:
    """The same block with rows counted from row ``first``."""
    rows, columns = block
    return slice(max(rows.start - first, 0), max(rows.stop - first, 0)), columns


def _shaded(what: Scene, camera: _Camera, points: np.ndarray, below: int) -> np.ndarray:
    """(H', W) bool: the ground ``points`` (H', W, 2), from row ``below`` on, that lie in the robot's shadow."""
    dark = np.zeros(points.shape[:2], bool)
    lamp = LAMP / np.linalg.norm(LAMP)
    for ends, radius in zip(what.ends, what.radius, strict=True):
        cast = ends - ends[:, 2:] / lamp[2] * lamp  # the shadows of the ends on the ground
        reach = radius / lamp[2]
        corners = [end + [dx, dy, 0] for end in cast for dx in (-reach, reach) for dy in (-reach, reach)]
        block = _below(_block(camera, np.array(corners)), below)
        flat = points[block]
        origin = np.concatenate([flat, np.zeros_like(flat[..., :1])], axis=-1)
        rays = np.broadcast_to(lamp, origin.shape)
        dark[block] |= np.isfinite(_hit(origin, rays, ends, radius))
    return dark
