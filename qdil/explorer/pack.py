"""A rollout in a few kilobytes: poses as small integers, their changes from frame to frame, deflated.

The front end's ``decode.js`` unpacks it. Layout after inflating, little-endian: the header's length (uint32), the
header (JSON), the poses' low bytes, their high bytes, the rewards' low and high bytes, one byte of contacts per step.
"""

import json
import struct
import zlib
from typing import NamedTuple

import numpy as np

from qdil.explorer.rollouts import Rollout

POSITION_UNIT = 1e-3  # metres; rounding moves a link by at most half of this
ROTATION_UNIT = 1 / 4096  # of a quaternion's parts: a quarter of a tenth of a degree
REWARD_LEVELS = 1000  # a reward is kept to a thousandth of the range within its episode
FRAMES_PER_SECOND = 63.0  # of kept poses, at most; the front end interpolates between them


class Unpacked(NamedTuple):
    """A rollout after packing and unpacking: F frames of poses, T ≥ F steps of contacts and rewards."""

    position: np.ndarray  # (F, L, 3)
    rotation: np.ndarray  # (F, L, 4)
    stride: int  # steps from frame to frame
    contact: np.ndarray  # (T, k) bool
    reward: np.ndarray  # (T,)
    seconds: float
    fell: bool


def pack(rollout: Rollout) -> bytes:
    """``rollout`` as bytes. Raises ValueError for a robot that moves more than 32 metres from one frame to the next."""
    stride = max(1, int(np.ceil(1 / (rollout.seconds * FRAMES_PER_SECOND) - 1e-6)))
    channels = _channels(rollout.position[::stride].astype(np.float64), _continuous(rollout.rotation[::stride]))
    low, high = float(rollout.reward.min()), float(rollout.reward.max())
    unit = (high - low) / REWARD_LEVELS or 1.0
    header = {
        "steps": len(rollout.reward),
        "frames": len(channels),
        "links": rollout.position.shape[1],
        "feet": rollout.contact.shape[1],
        "stride": stride,
        "seconds": rollout.seconds,
        "fell": rollout.fell,
        "position_unit": POSITION_UNIT,
        "rotation_unit": ROTATION_UNIT,
        "reward_low": low,
        "reward_unit": unit,
    }
    encoded = json.dumps(header).encode()
    contacts = (rollout.contact * (1 << np.arange(rollout.contact.shape[1]))).sum(axis=1).astype(np.uint8)
    levels = np.rint((rollout.reward.astype(np.float64) - low) / unit)[:, None]
    body = _planes(_changes(channels)) + _planes(levels.T) + contacts.tobytes()
    return zlib.compress(struct.pack("<I", len(encoded)) + encoded + body, 9)


def unpack(content: bytes) -> Unpacked:
    """Undo ``pack``, up to rounding."""
    raw = zlib.decompress(content)
    (size,) = struct.unpack_from("<I", raw)
    header = json.loads(raw[4 : 4 + size])
    frames, links, steps = header["frames"], header["links"], header["steps"]
    at, count = 4 + size, frames * links * 7
    channels = _from_planes(raw[at : at + 2 * count]).reshape(links * 7, frames).cumsum(axis=1).T
    at += 2 * count
    levels = _from_planes(raw[at : at + 2 * steps])
    contact = np.frombuffer(raw, np.uint8, steps, at + 2 * steps)
    position = channels[:, : links * 3].reshape(frames, links, 3) * header["position_unit"]
    position[:, 1:] += position[:, :1]
    rotation = channels[:, links * 3 :].reshape(frames, links, 4) * header["rotation_unit"]
    return Unpacked(
        position,
        rotation,
        header["stride"],
        (contact[:, None] >> np.arange(header["feet"])) % 2 == 1,
        header["reward_low"] + levels * header["reward_unit"],
        header["seconds"],
        header["fell"],
    )


def _channels(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """(F, 7 L) whole numbers: positions (F, L, 3), of all links but the first from the first, then rotations."""
    frames, root = len(position), np.rint(position[:, :1] / POSITION_UNIT)
    others = np.rint((position[:, 1:] - root * POSITION_UNIT) / POSITION_UNIT)
    parts = [root, others, np.rint(rotation / ROTATION_UNIT)]
    return np.concatenate([part.reshape(frames, -1) for part in parts], axis=1)


def _continuous(rotation: np.ndarray) -> np.ndarray:
    """The same rotations (F, L, 4) with signs that keep the numbers continuous: q and -q are one rotation."""
    along = np.sum(rotation[1:] * rotation[:-1], axis=-1, keepdims=True)
    signs = np.cumprod(np.where(along < 0, -1.0, 1.0), axis=0)
    return np.concatenate([rotation[:1], rotation[1:] * signs]).astype(np.float64)


def _changes(channels: np.ndarray) -> np.ndarray:
    """(F, C) to (C, F): the first value of each channel, then its changes."""
    changes = np.diff(channels, axis=0, prepend=0.0).T
    if np.abs(changes).max() > 2**15 - 1:
        raise ValueError("a link moves too far from one frame to the next: is this physics sound?")
    return changes


def _planes(whole: np.ndarray) -> bytes:
    """Integers as 16 bits with the sign in the lowest bit; all low bytes, then all high bytes, which deflates best."""
    number = whole.astype(np.int64).ravel()
    folded = np.where(number < 0, -2 * number - 1, 2 * number).astype("<u2")
    return (folded & 0xFF).astype(np.uint8).tobytes() + (folded >> 8).astype(np.uint8).tobytes()


def _from_planes(raw: bytes) -> np.ndarray:
    low, high = np.frombuffer(raw, np.uint8).reshape(2, -1).astype(np.int64)
    folded = low | high << 8
    return np.where(folded % 2 == 1, -(folded + 1) // 2, folded // 2)
