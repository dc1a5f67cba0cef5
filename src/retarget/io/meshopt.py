"""EXT_meshopt_compression and KHR_meshopt_compression: the bytes of a buffer view out of their compressed form.

The second is the first with a newer stream of attributes and a filter for colours. Streams are undone in
`meshopt_streams.py`; filters, which turn what streams hold into vectors and numbers, here (appendix B of both).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Int, Int16, Int32, UInt, UInt8

from retarget.io.meshopt_streams import MeshoptError, attributes, sequence, triangles

Array = np.ndarray

EXTENSIONS = ("EXT_meshopt_compression", "KHR_meshopt_compression")
MODES = ("ATTRIBUTES", "TRIANGLES", "INDICES")
FILTERS = ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR")


def compression(view: dict[str, Any]) -> dict[str, Any] | None:
    """What a buffer view says of its compressed form; None where it has none."""
    held = view.get("extensions", {})
    return next((held[name] for name in EXTENSIONS if name in held), None)


def most_unfolded(size: int) -> int:
    """How many bytes compressed data of a size may unfold to: at best 2 bits stand for 16 bytes that do not change, and a
    newer stream says that in next to nothing, of which a flat amount is believed."""
    return 64 * size + (64 << 20)


def unfold(data: bytes, count: int, stride: int, mode: str, filter_: str) -> bytes:
    """The `count` elements of `stride` bytes in a stream. Raises `MeshoptError` for a wrong layout or damaged data."""
    _check_layout(count, stride, mode, filter_)
    if mode == "ATTRIBUTES":
        return filtered(attributes(data, count, stride), filter_).tobytes()
    indices = triangles(data, count) if mode == "TRIANGLES" else sequence(data, count)
    if stride == 2 and indices.max(initial=0) > 0xFFFF:
        raise MeshoptError(f"index {int(indices.max())} does not fit into 2 bytes")
    return indices.astype("<u2" if stride == 2 else "<u4").tobytes()


def _check_layout(count: int, stride: int, mode: str, filter_: str) -> None:
    if mode == "ATTRIBUTES":
        if stride % 4 or not 0 < stride <= 256:
            raise MeshoptError(f"byteStride {stride} is no multiple of 4 up to 256")
    elif stride not in (2, 4) or filter_ != "NONE":
        raise MeshoptError("indices have a byteStride of 2 or 4 and no filter")
    elif mode == "TRIANGLES" and count % 3:
        raise MeshoptError(f"{count} indices make no whole triangles")
    if stride not in {"OCTAHEDRAL": (4, 8), "QUATERNION": (8,), "COLOR": (4, 8)}.get(filter_, (stride,)):
        raise MeshoptError(f"the filter {filter_} does not go with a byteStride of {stride}")


# --- filters --------------------------------------------------------------------------------------------------------


def filtered(elements: UInt8[Array, "count stride"], filter_: str) -> Array:
    """The elements behind a filter; as they are where there is none."""
    if filter_ == "OCTAHEDRAL":
        return octahedral(elements.view("<i1" if elements.shape[1] == 4 else "<i2"))
    if filter_ == "QUATERNION":
        return quaternions(elements.view("<i2"))
    if filter_ == "EXPONENTIAL":
        return exponential(elements.view("<i4"))
    if filter_ == "COLOR":
        return colors(elements.view("<u1" if elements.shape[1] == 4 else "<u2"))
    return elements


def octahedral(packed: Int[Array, "count 4"]) -> Int[Array, "count 4"]:
    """Unit vectors from two octahedral coordinates; the third number is what stands for 1, the fourth stays."""
    top = np.float32(np.iinfo(packed.dtype).max)
    x, y, one, _ = packed.T.astype(np.float32)
    x, y = x / np.where(one == 0, 1, one), y / np.where(one == 0, 1, one)
    z = 1 - np.abs(x) - np.abs(y)
    fold = np.minimum(z, 0)
    x, y = x - np.copysign(fold, x), y - np.copysign(fold, y)
    scale = top / np.maximum(np.sqrt(x * x + y * y + z * z), np.float32(1e-20))
    result = packed.copy()
    result[:, :3] = _rounded(np.stack([x, y, z], axis=1) * scale[:, None], top)
    return result


def quaternions(packed: Int16[Array, "count 4"]) -> Int16[Array, "count 4"]:
    """Unit quaternions from their three smaller components; the fourth number is what stands for 1 and which is left out."""
    one = (packed[:, 3] | 3).astype(np.float32)
    small = packed[:, :3] / one[:, None] * np.float32(np.sqrt(0.5))
    largest = np.sqrt(np.maximum(0, 1 - (small * small).sum(axis=1, dtype=np.float32)))
    values = _rounded(np.concatenate([small, largest[:, None]], axis=1) * np.float32(32767), np.float32(32767))
    result = np.empty_like(packed)
    places = (packed[:, 3:] & 3) + np.array([1, 2, 3, 0], np.int16) & 3
    np.put_along_axis(result, places.astype(np.int64), values.astype(packed.dtype), axis=1)
    return result


def exponential(packed: Int32[Array, "count width"]) -> Array:
    """Single precision numbers from 24 bits of mantissa and 8 of exponent."""
    with np.errstate(
        over="ignore", under="ignore"
    ):  # damaged exponents; what is not finite is refused where it is used
        return np.ldexp((packed << 8 >> 8).astype(np.float32), packed >> 24).astype("<f4")


def colors(packed: UInt[Array, "count 4"]) -> UInt[Array, "count 4"]:
    """Red, green, blue and alpha from luma and two signed differences; the highest bit of alpha tells their precision."""
    top = np.float32(np.iinfo(packed.dtype).max)
    luma, alpha = packed[:, 0].astype(np.int64), packed[:, 3].astype(np.int64)
    orange, green = packed[:, 1:3].view(f"<i{packed.itemsize}").astype(np.int64).T
    one = 2 ** np.frexp(np.maximum(alpha, 1).astype(np.float64))[1].astype(np.int64) - 1
    alpha = alpha & (one >> 1)
    alpha = alpha << 1 | alpha & 1
    values = np.stack([luma + orange - green, luma + green, luma - orange - green, alpha], axis=1)
    return np.maximum(_rounded(values * (top / one.astype(np.float32))[:, None], top), 0).astype(packed.dtype)


def _rounded(values: Array, top: np.float32) -> Array:
    """To the nearest integer, halves away from zero, within what the component holds."""
    return np.clip(np.trunc(values + np.copysign(np.float32(0.5), values)), -top, top)
