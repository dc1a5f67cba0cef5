"""Compiled loops: which joints of one pose are beyond their limits, for solvers. Import only where used."""

from __future__ import annotations

import numpy as np
from numba import njit

from retarget.contact.kernels import OPTIONS
from retarget.contact.skin_kernels import multiply


@njit(**OPTIONS)
def nearest_within(world, joints, carriers, frames, carrier_frames, axes, hinges, allowed, wanted):
    """Where joints are beyond what is `allowed` (limits x swing, twist, turn about the hinge; radians), write the nearest
    world rotation within into `wanted` (limits x 4); returns which joints are (limits). Other arguments as in
    `limits.LimitBounds`; `world` are the world rotations of all joints (joints x 4)."""
    beyond = np.zeros(len(joints), dtype=np.bool_)
    zero, frame, turn, twist, swing, back = np.empty((6, 4))
    for number in range(len(joints)):
        multiply(world[carriers[number]], carrier_frames[number], zero)
        multiply(world[joints[number]], frames[number], frame)
        _inverse(zero, back)
        multiply(back, frame, turn)
        along = turn[0] * axes[number, 0] + turn[1] * axes[number, 1] + turn[2] * axes[number, 2]
        length = max(np.sqrt(along * along + turn[3] * turn[3]), 1e-12)
        for i in range(3):
            twist[i] = along * axes[number, i] / length
        twist[3] = turn[3] / length
        _inverse(twist, back)
        multiply(turn, back, swing)
        swung, twisted = _vector(swing), _vector(twist)
        swing_angle = np.sqrt((swung * swung).sum())
        twist_angle = np.sqrt((twisted * twisted).sum())
        about = (swung * hinges[number]).sum()
        most_swing, most_twist, most_about = allowed[number, 0], allowed[number, 1], allowed[number, 2]
        if swing_angle <= most_swing and twist_angle <= most_twist and about <= most_about:
            continue
        beyond[number] = True
        swung *= min(1.0, most_swing / max(swing_angle, 1e-12))
        swung -= max((swung * hinges[number]).sum() - most_about, 0.0) * hinges[number]
        twisted *= min(1.0, most_twist / max(twist_angle, 1e-12))
        _exponential(swung, swing)
        _exponential(twisted, twist)
        multiply(swing, twist, turn)
        multiply(zero, turn, frame)
        _inverse(frames[number], back)
        multiply(frame, back, wanted[number])
    return beyond


@njit(**OPTIONS)
def _inverse(q, out):
    out[0], out[1], out[2], out[3] = -q[0], -q[1], -q[2], q[3]


@njit(**OPTIONS)
def _vector(q):
    """Rotation vector of a unit quaternion, the short way."""
    sign = 1.0 if q[3] >= 0.0 else -1.0
    sine = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    scale = 2.0 * np.arctan2(sine, sign * q[3]) / sine if sine > 1e-12 else 2.0
    return sign * scale * np.array([q[0], q[1], q[2]])


@njit(**OPTIONS)
def _exponential(vector, out):
    angle = np.sqrt((vector * vector).sum())
    share = np.sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
    for i in range(3):
        out[i] = share * vector[i]
    out[3] = np.cos(0.5 * angle)


def compile_kernels() -> None:
    """Compile the kernel and keep it on disk, as `collide.compile_kernels` does."""
    one, axis = np.array([[0.0, 0, 0, 1]]), np.array([[1.0, 0, 0]])
    joint = np.zeros(1, dtype=np.int64)
    nearest_within(one, joint, joint, one, one, axis, axis, np.ones((1, 3)), np.empty((1, 4)))
