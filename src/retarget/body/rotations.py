"""Unit quaternions `xyzw` on plain arrays; every function works over any leading axes.

Written out in numpy because scipy's `Rotation` flattens batches and costs a fifth of a second to import.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

Array = np.ndarray

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
_RIGHT = np.array([
    [[0, 0, 0, 1], [0, 0, 1, 0], [0, -1, 0, 0], [-1, 0, 0, 0]],
    [[0, 0, -1, 0], [0, 0, 0, 1], [1, 0, 0, 0], [0, -1, 0, 0]],
    [[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -1, 0]],
    [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
], dtype=np.float64).reshape(4, 16)  # fmt: skip
"""Of each component of b its part in the matrix of a b as a function of a."""


def multiply(a: Float[Array, "*#batch 4"], b: Float[Array, "*#batch 4"]) -> Float[Array, "*batch 4"]:
    """The rotation `b` followed by `a` (Hamilton product a b)."""
    ax, ay, az, aw = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bx, by, bz, bw = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = aw * bx + ax * bw + ay * bz - az * by
    out[..., 1] = aw * by - ax * bz + ay * bw + az * bx
    out[..., 2] = aw * bz + ax * by - ay * bx + az * bw
    out[..., 3] = aw * bw - ax * bx - ay * by - az * bz
    return out


def right_matrices(b: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4 4"]:
    """Matrices that `b` multiplies by from the right: R(b) a = a b."""
    return (b @ _RIGHT).reshape(b.shape + (4,))


def inverse(q: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def rotate(q: Float[Array, "*#batch 4"], v: Float[Array, "*#batch 3"]) -> Float[Array, "*batch 3"]:
    """The vectors `v` turned by `q`."""
    x, y, z, w = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    vx, vy, vz = v[..., 0], v[..., 1], v[..., 2]
    tx, ty, tz = 2 * (y * vz - z * vy), 2 * (z * vx - x * vz), 2 * (x * vy - y * vx)
    out = np.empty(np.broadcast_shapes(q.shape[:-1], v.shape[:-1]) + (3,))
    out[..., 0] = vx + w * tx + y * tz - z * ty
    out[..., 1] = vy + w * ty + z * tx - x * tz
    out[..., 2] = vz + w * tz + x * ty - y * tx
    return out


def normalise(q: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """Unit length; a zero quaternion becomes the identity."""
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(length > 1e-12, q / np.maximum(length, 1e-12), IDENTITY)


def to_matrix(q: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3 3"]:
    x, y, z, w = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    out = np.empty(q.shape[:-1] + (3, 3))
    out[..., 0, 0] = 1 - 2 * (y * y + z * z)
    out[..., 0, 1] = 2 * (x * y - z * w)
    out[..., 0, 2] = 2 * (x * z + y * w)
    out[..., 1, 0] = 2 * (x * y + z * w)
    out[..., 1, 1] = 1 - 2 * (x * x + z * z)
    out[..., 1, 2] = 2 * (y * z - x * w)
    out[..., 2, 0] = 2 * (x * z - y * w)
    out[..., 2, 1] = 2 * (y * z + x * w)
    out[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return out


def from_matrix(m: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 4"]:
    """Quaternion of a rotation matrix, by the largest of the four components (stable everywhere)."""
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    # Rows of 4 q q^T; the row with the largest diagonal is q up to scale, with the least cancellation.
    outer = np.empty(m.shape[:-2] + (4, 4))
    outer[..., 0, 0] = 1 + xx - yy - zz
    outer[..., 1, 1] = 1 - xx + yy - zz
    outer[..., 2, 2] = 1 - xx - yy + zz
    outer[..., 3, 3] = 1 + xx + yy + zz
    outer[..., 0, 1] = outer[..., 1, 0] = m[..., 0, 1] + m[..., 1, 0]
    outer[..., 0, 2] = outer[..., 2, 0] = m[..., 0, 2] + m[..., 2, 0]
    outer[..., 1, 2] = outer[..., 2, 1] = m[..., 1, 2] + m[..., 2, 1]
    outer[..., 0, 3] = outer[..., 3, 0] = m[..., 2, 1] - m[..., 1, 2]
    outer[..., 1, 3] = outer[..., 3, 1] = m[..., 0, 2] - m[..., 2, 0]
    outer[..., 2, 3] = outer[..., 3, 2] = m[..., 1, 0] - m[..., 0, 1]
    best = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(outer, best[..., None, None], axis=-2)[..., 0, :]
    return normalise(row)


def from_rotation_vector(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 4"]:
    """Axis times angle (radians) to quaternion."""
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    half = 0.5 * angle
    scale = 0.5 * np.sinc(half / np.pi)  # sin(a/2)/a, finite at zero
    return np.concatenate([v * scale, np.cos(half)], axis=-1)


def to_rotation_vector(q: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3"]:
    """Quaternion to axis times angle, the angle in [0, pi]."""
    q = np.where(q[..., 3:] < 0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., 3:])
    return q[..., :3] * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)


def left_jacobian(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """J with exp(v + d) = exp(J d) exp(v) to first order, for rotation vectors v and small changes d."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    second = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    cross = np.zeros((*v.shape, 3))
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    cross -= np.swapaxes(cross, -1, -2)
    return np.eye(3) + first * cross + second * (cross @ cross)


def angle_between(a: Float[Array, "*#batch 4"], b: Float[Array, "*#batch 4"]) -> Float[Array, "*batch"] | float:
    """The angle of the rotation from `a` to `b`, radians in [0, pi]."""
    return np.linalg.norm(to_rotation_vector(multiply(inverse(a), b)), axis=-1)


def swing_between(a: Float[Array, "*#batch 3"], b: Float[Array, "*#batch 3"]) -> Float[Array, "*batch 4"]:
    """The smallest rotation that turns direction `a` into direction `b` (neither need be of unit length).

    For opposite directions any axis normal to `a` serves; the one returned is fixed, so results are deterministic.
    """
    a, b = np.broadcast_arrays(unit(a), unit(b))
    real = 1.0 + (a * b).sum(axis=-1, keepdims=True)
    helper = np.where(np.abs(a[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    flip = np.concatenate([unit(np.cross(a, helper)), np.zeros_like(real)], axis=-1)
    return normalise(np.where(real > 1e-9, np.concatenate([np.cross(a, b), real], axis=-1), flip))


def twist_about(q: Float[Array, "*#batch 4"], axis: Float[Array, "*#batch 3"]) -> Float[Array, "*batch 4"]:
    """The part of `q` that turns about `axis`: q = swing · twist, the swing's axis normal to `axis`."""
    along = (q[..., :3] * axis).sum(axis=-1, keepdims=True)
    return normalise(np.concatenate([along * axis, q[..., 3:]], axis=-1))


def slerp(
    a: Float[Array, "*#batch 4"], b: Float[Array, "*#batch 4"], t: Float[Array, "*#batch"] | float
) -> Float[Array, "*batch 4"]:
    """Shortest-arc interpolation from `a` (t = 0) to `b` (t = 1); extrapolates for t outside [0, 1]."""
    return multiply(a, from_rotation_vector(to_rotation_vector(multiply(inverse(a), b)) * np.asarray(t)[..., None]))


def continuous(q: Float[Array, "frames *batch 4"]) -> Float[Array, "frames *batch 4"]:
    """The same rotations with signs chosen so that neighbouring frames never flip."""
    if len(q) < 2:
        return q
    flips = (q[1:] * q[:-1]).sum(axis=-1) < 0
    sign = np.where(np.cumsum(flips, axis=0) % 2, -1.0, 1.0)
    return np.concatenate([q[:1], q[1:] * sign[..., None]], axis=0)


def from_frame(x: Float[Array, "*batch 3"], y: Float[Array, "*batch 3"]) -> Float[Array, "*batch 4"]:
    """The rotation whose first axis is `x` and whose second axis is `y` made normal to it."""
    x = unit(x)
    z = unit(np.cross(x, y))
    return from_matrix(np.stack([x, np.cross(z, x), z], axis=-1))


def unit(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """Directions of length one; zero stays zero."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return v / np.maximum(length, 1e-12)


def from_euler(angles: Float[Array, "*batch axes"], order: str) -> Float[Array, "*batch 4"]:
    """Rotations from angles (radians) about the named axes: 'ZXY' means R = Rz Rx Ry, as BVH reads its channels."""
    half = 0.5 * angles
    result = None
    for i, axis in enumerate(order):
        q = np.zeros(angles.shape[:-1] + (4,))
        q[..., "XYZ".index(axis)] = np.sin(half[..., i])
        q[..., 3] = np.cos(half[..., i])
        result = q if result is None else multiply(result, q)
    return result if result is not None else np.broadcast_to(IDENTITY, angles.shape[:-1] + (4,)).copy()


def to_euler(q: Float[Array, "*batch 4"], order: str) -> Float[Array, "*batch 3"]:
    """Angles (radians) about three different axes, inverse of `from_euler`; the middle one in [-pi/2, pi/2]."""
    i, j, k = ("XYZ".index(axis) for axis in order)
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    m = to_matrix(q)
    middle = np.arcsin(np.clip(sign * m[..., i, k], -1.0, 1.0))
    locked = np.abs(m[..., i, k]) > 1 - 1e-13  # gimbal lock: give the whole turn to the first angle
    first = np.where(
        locked, np.arctan2(sign * m[..., k, j], m[..., j, j]), np.arctan2(-sign * m[..., j, k], m[..., k, k])
    )
    third = np.where(locked, 0.0, np.arctan2(-sign * m[..., i, j], m[..., i, i]))
    return np.stack([first, middle, third], axis=-1)
