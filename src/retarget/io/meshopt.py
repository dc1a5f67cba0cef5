"""Streams of EXT_meshopt_compression: the bytes of a buffer view out of their compressed form.

Written from the text of the extension (appendix A: bitstreams, appendix B: filters). Every declared size is compared with
the length of the stream before memory is taken; a stream that does not end where its data says is refused.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Int, Int16, Int32, UInt8, UInt32

Array = np.ndarray

EXTENSION = "EXT_meshopt_compression"
MODES = ("ATTRIBUTES", "TRIANGLES", "INDICES")
FILTERS = ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL")
MOST_UNFOLDED = 64
"""Bytes that one byte of a stream can stand for: attributes that do not change take 2 bits for 16 bytes."""
GROUP = 16
"""Elements of a group of deltas."""
BITS = 0xFFFFFFFF
"""Indices are counted in 32 bits and wrap around."""


class MeshoptError(ValueError):
    """A stream is not what its description says."""


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
    if stride not in {"OCTAHEDRAL": (4, 8), "QUATERNION": (8,)}.get(filter_, (stride,)):
        raise MeshoptError(f"the filter {filter_} does not go with a byteStride of {stride}")


def _body(data: bytes, header: int, tail: int, least: int) -> None:
    """Check what every stream begins with, and that there is room for its tail and the least its elements need."""
    if not data or data[0] != header:
        raise MeshoptError(f"the stream begins with {data[:1].hex() or 'nothing'} where {header:02x} is needed")
    if 1 + least + tail > len(data):
        raise MeshoptError(f"{len(data)} bytes are too few for its elements, which need {1 + least + tail} at least")


# --- mode 0: attributes ---------------------------------------------------------------------------------------------


def attributes(data: bytes, count: int, stride: int) -> UInt8[Array, "count stride"]:
    """Mode 0: differences between neighbours, byte by byte of the element, in groups of 16."""
    block = min(8192 // stride // GROUP * GROUP, 256)
    blocks = [block] * (count // block) + [count % block] * (count % block > 0)
    groups = [-(-elements // GROUP) for elements in blocks]
    tail = max(stride, 32)
    _body(data, 0xA0, tail, stride * sum(-(-each // 4) for each in groups))
    starts, kinds = _groups(data, stride, groups, len(data) - tail)
    deltas = _deltas(np.frombuffer(data, np.uint8), starts, kinds)
    planes = np.empty((count, stride), np.uint8)
    whole = count // block * block
    if whole:
        parted = deltas[: whole // GROUP * stride].reshape(-1, stride, block)
        planes[:whole] = parted.transpose(0, 2, 1).reshape(whole, stride)
    if count > whole:
        planes[whole:] = deltas[whole // GROUP * stride :].reshape(stride, -1)[:, : count - whole].T
    changes = (planes >> 1) ^ (np.uint8(0) - (planes & 1))
    first = np.frombuffer(data, np.uint8, stride, len(data) - stride)
    return np.cumsum(changes, axis=0, dtype=np.uint8) + first


def _groups(data: bytes, stride: int, groups: list[int], end: int) -> tuple[Int[Array, "groups"], UInt8[Array, "groups"]]:
    """Where each group of 16 deltas begins, and how it is packed: 0 all zero, 1 in 2 bits, 2 in 4 bits, 3 in bytes.

    A value that has all its bits set stands for a byte behind the group, so the length of each is known when it is met.
    """
    padded = data + bytes(32 * max(groups, default=0) + 64)  # one plane may run over the end before it is caught
    raw = np.frombuffer(padded, np.uint8)
    in_two = sum(((raw >> shift & 3) == 3).astype(np.uint8) for shift in (0, 2, 4, 6))
    in_four = ((raw >> 4) == 15).astype(np.uint8) + ((raw & 15) == 15)
    sizes = (bytes(len(raw)), _windows(in_two, 4), _windows(in_four, 8), bytes([16]) * len(raw))
    starts: list[int] = []
    kinds = bytearray()
    at = 1
    for number in groups:
        head = -(-number // 4)
        for _ in range(stride):
            bits = int.from_bytes(padded[at : at + head], "little")
            at += head
            for _ in range(number):
                kind = bits & 3
                bits >>= 2
                starts.append(at)
                kinds.append(kind)
                at += sizes[kind][at]
            if at > end:
                raise MeshoptError("the stream ends inside its deltas")
    if at != end:
        raise MeshoptError(f"{end - at} bytes are left behind its elements")
    return np.array(starts, dtype=np.int64), np.frombuffer(bytes(kinds), np.uint8)


def _windows(sentinels: UInt8[Array, "bytes"], width: int) -> bytes:
    """Length of the packed group that begins at each byte: `width` bytes, and one for every sentinel in them."""
    total = np.concatenate([[0], np.cumsum(sentinels, dtype=np.int64), np.zeros(width - 1, dtype=np.int64)])
    total[len(sentinels) + 1 :] = total[len(sentinels)]
    return (width + total[width:] - total[:-width]).astype(np.uint8).tobytes()


def _deltas(
    raw: UInt8[Array, "bytes"], starts: Int[Array, "groups"], kinds: UInt8[Array, "groups"]
) -> UInt8[Array, "groups 16"]:
    result = np.zeros((len(starts), GROUP), np.uint8)
    for kind, width, shifts in ((1, 4, (6, 4, 2, 0)), (2, 8, (4, 0))):
        own = starts[kinds == kind, None]
        top = np.uint8(2 ** (8 // len(shifts)) - 1)
        packed = raw[own + np.arange(width)]
        values = (packed[:, :, None] >> np.array(shifts, np.uint8) & top).reshape(-1, GROUP)
        outside = values == top
        behind = own + width + np.cumsum(outside, axis=1) - 1
        values[outside] = raw[behind[outside]]
        result[kinds == kind] = values
    result[kinds == 3] = raw[starts[kinds == 3, None] + np.arange(GROUP)]
    return result


# --- modes 1 and 2: indices -----------------------------------------------------------------------------------------


def sequence(data: bytes, count: int) -> UInt32[Array, "count"]:
    """Mode 2: differences to one of two earlier indices, as numbers of up to five bytes."""
    _body(data, 0xD1, 4, count)
    raw = np.frombuffer(data, np.uint8)[1:-4].astype(np.int64)
    ends = np.flatnonzero(raw < 128)
    if len(ends) != count or (len(raw) and raw[-1] > 127):
        raise MeshoptError(f"holds {len(ends)} indices, {count} are declared")
    first = np.concatenate([[0], ends[:-1] + 1])[:count]
    lengths = ends + 1 - first
    if lengths.max(initial=0) > 5:
        raise MeshoptError("a number has more than five bytes")
    place = np.arange(len(raw)) - np.repeat(first, lengths)
    values = np.add.reduceat((raw & 127) << 7 * place, first) & BITS if count else raw
    changes = (values >> 2) ^ -(values >> 1 & 1)
    result = np.zeros(count, dtype=np.int64)
    for baseline in (0, 1):
        result[values & 1 == baseline] = np.cumsum(changes[values & 1 == baseline])
    return (result & BITS).astype(np.uint32)


def triangles(data: bytes, count: int) -> UInt32[Array, "count"]:
    """Mode 1: a code a triangle, which takes corners from the last 16 edges and vertices, or from the data behind."""
    _body(data, 0xE1, 16, count // 3)
    table, codes, at, end = data[-16:], data[1 : 1 + count // 3], 1 + count // 3, len(data) - 16
    if table[14] or table[15] or any(each >> 4 == 15 or each & 15 == 15 for each in table):
        raise MeshoptError("its table of codes is damaged")
    edges: list[tuple[int, int]] = [(-1, -1)] * 16
    vertices = [-1] * 16
    corners: list[int] = []
    edge = vertex = following = last = 0

    def number() -> int:
        """An index told by its difference to the last one told."""
        nonlocal at, last
        value = shift = 0
        while True:
            if at >= end or shift > 28:
                raise MeshoptError("an index is cut off")
            byte = data[at]
            at += 1
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                break
        value &= BITS
        last = (last + ((value >> 1) ^ -(value & 1))) & BITS
        return last

    for code in codes:
        high, low = code >> 4, code & 15
        if high < 15:
            a, b = edges[(edge - 1 - high) & 15]
            if low == 0:
                c, following = following, following + 1
            elif low < 13:
                c = vertices[(vertex - 1 - low) & 15]
            elif low < 15:
                c = last = (last + (1 if low == 14 else -1)) & BITS
            else:
                c = number()
            fresh = (c,) if low == 0 or low > 12 else ()
        else:
            if low < 14:
                second, third, told = table[low] >> 4, table[low] & 15, False
            else:
                if at >= end:
                    raise MeshoptError("a triangle is cut off")
                second, third, told = data[at] >> 4, data[at] & 15, low == 15
                at += 1
                if second == third == 0:
                    following = 0
            if told:
                a = number()
            else:
                a, following = following, following + 1
            picked = []
            for which in (second, third):
                if which == 0:
                    picked.append(following)
                    following += 1
                else:
                    picked.append(number() if which == 15 else vertices[(vertex - which) & 15])
            b, c = picked
            edges[edge & 15] = b, a
            edge += 1
            fresh = (a, *(each for which, each in ((second, b), (third, c)) if which in (0, 15)))
        edges[edge & 15], edges[(edge + 1) & 15] = (c, b), (a, c)
        edge += 2
        for each in fresh:
            vertices[vertex & 15] = each
            vertex += 1
        corners += (a, b, c)
    if at != end:
        raise MeshoptError(f"{end - at} bytes are left behind its triangles")
    result = np.array(corners, dtype=np.int64)
    if result.min(initial=0) < 0:
        raise MeshoptError("a triangle names an edge or vertex that was never there")
    return (result & BITS).astype(np.uint32)


# --- filters --------------------------------------------------------------------------------------------------------


def filtered(elements: UInt8[Array, "count stride"], filter_: str) -> Array:
    """The elements behind a filter; as they are where there is none."""
    if filter_ == "OCTAHEDRAL":
        return octahedral(elements.view("<i1" if elements.shape[1] == 4 else "<i2"))
    if filter_ == "QUATERNION":
        return quaternions(elements.view("<i2"))
    if filter_ == "EXPONENTIAL":
        return exponential(elements.view("<i4"))
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
    with np.errstate(over="ignore", under="ignore"):  # damaged exponents; what is not finite is refused where it is used
        return np.ldexp((packed << 8 >> 8).astype(np.float32), packed >> 24).astype("<f4")


def _rounded(values: Array, top: np.float32) -> Array:
    """To the nearest integer, halves away from zero, within what the component holds."""
    return np.clip(np.trunc(values + np.copysign(np.float32(0.5), values)), -top, top)
