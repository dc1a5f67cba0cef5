"""The bitstreams of EXT_meshopt_compression and KHR_meshopt_compression, undone.

Written from the text of the extensions (appendix A). What a stream needs at least is compared with its length before memory
is taken; a stream that does not end where its data says is refused.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Int, UInt8, UInt32

Array = np.ndarray

GROUP = 16
"""Elements of a group of deltas."""
WIDTHS = {"old": (0, 2, 4, 8), 0: (0, 1, 2, 4), 1: (1, 2, 4, 8)}
"""Bits a delta in a group of each of four kinds: of version 0, and of version 1 by the control of the byte."""
STILL, LITERAL = 2, 3
"""Controls of bytes without groups: all deltas are zero; all are stored as they are."""
BITS = 0xFFFFFFFF
"""Indices are counted in 32 bits and wrap around."""


class MeshoptError(ValueError):
    """A stream is not what its description says."""


def _check_room(data: bytes, header: tuple[int, ...], tail: int, least: int) -> None:
    """Check what every stream begins with, and that there is room for its tail and the least its elements need."""
    if not data or data[0] not in header:
        needed = " or ".join(f"{each:02x}" for each in header)
        raise MeshoptError(f"the stream begins with {data[:1].hex() or 'nothing'} where {needed} is needed")
    if 1 + least + tail > len(data):
        raise MeshoptError(f"{len(data)} bytes are too few for its elements, which need {1 + least + tail} at least")


# --- mode 0: attributes ---------------------------------------------------------------------------------------------


def attributes(data: bytes, count: int, stride: int) -> UInt8[Array, "count stride"]:
    """Mode 0: differences between neighbours, byte by byte of the element, in groups of 16.

    `stride` is a multiple of 4. Version 1 (0xa1) tells for every byte of a block how its groups are packed, and for every four
    bytes of the element what a difference is. Raises `MeshoptError`.
    """
    block = min(8192 // stride // GROUP * GROUP, 256)
    new = data[:1] == b"\xa1"
    last = stride + (stride // 4 if new else 0)
    tail = max(last, 24 if new else 32)
    # The least that elements take: what stands at the head of every block, or of every byte of it.
    if new:
        least = stride // 4 * -(-count // block)
    else:
        least = stride * (count // block * -(-block // (4 * GROUP)) + -(-(count % block) // (4 * GROUP)))
    _check_room(data, (0xA0, 0xA1), tail, least)
    blocks = [block] * (count // block) + [count % block] * (count % block > 0)
    starts, widths = _groups(data, stride, blocks, len(data) - tail, new)
    deltas = _deltas(np.frombuffer(data, np.uint8), starts, widths)
    planes = np.empty((count, stride), np.uint8)
    whole = count // block * block
    if whole:
        parted = deltas[: whole // GROUP * stride].reshape(-1, stride, block)
        planes[:whole] = parted.transpose(0, 2, 1).reshape(whole, stride)
    if count > whole:
        planes[whole:] = deltas[whole // GROUP * stride :].reshape(stride, -1)[:, : count - whole].T
    first = np.frombuffer(data, np.uint8, stride, len(data) - last)
    channels = data[len(data) - last + stride :] if new else bytes(stride // 4)
    parts = zip(np.split(planes, stride // 4, axis=1), np.split(first, stride // 4), channels)
    return np.concatenate(
        [_summed(np.ascontiguousarray(part), start, channel) for part, start, channel in parts], axis=1
    )


def _summed(deltas: UInt8[Array, "count 4"], first: UInt8[Array, "4"], channel: int) -> UInt8[Array, "count 4"]:
    """Four bytes of every element out of their differences: of bytes, of 16-bit numbers, or of bits in 32-bit ones."""
    if channel in (0, 1):
        changes = deltas.view("<u2") if channel else deltas
        signed = (changes >> 1) ^ (changes.dtype.type(0) - (changes & 1))
        return (np.cumsum(signed, axis=0, dtype=changes.dtype) + first.view(changes.dtype)).view(np.uint8)
    turn = channel >> 4
    if channel & 15 != 2:
        raise MeshoptError(f"a channel is of the unknown mode {channel:#04x}")
    bits = deltas.view("<u4")
    turned = (bits >> turn) | (bits << (32 - turn)) if turn else bits  # back from where the encoder turned them
    return (np.bitwise_xor.accumulate(turned, axis=0) ^ first.view("<u4")).astype("<u4").view(np.uint8)


def _groups(
    data: bytes, stride: int, blocks: list[int], end: int, new: bool
) -> tuple[Int[Array, "groups"], UInt8[Array, "groups"]]:
    """Where each group of 16 deltas begins, and how many bits each of its deltas takes.

    A value that has all its bits set stands for a byte behind the group, so the length of each is known when it is met.
    """
    padded = data + bytes(
        32 * max(blocks, default=0) + 64
    )  # one byte's groups may run over the end before it is caught
    raw = np.frombuffer(padded, np.uint8)
    sizes = {0: bytes(len(raw)), 2: _lengths(raw, 2), 4: _lengths(raw, 4), 8: bytes([GROUP]) * len(raw)}
    if new:
        sizes[1] = _lengths(raw, 1)
    starts: list[int] = []
    widths = bytearray()
    at = 1
    for elements in blocks:
        number = -(-elements // GROUP)
        head, controls = -(-number // 4), 0
        if new:
            controls = int.from_bytes(padded[at : at + stride // 4], "little")
            at += stride // 4
        for byte in range(stride):
            control = controls >> 2 * byte & 3 if new else "old"
            if control in (STILL, LITERAL):
                literal = control == LITERAL
                starts.extend(range(at, at + GROUP * number, GROUP) if literal else [at] * number)
                widths.extend(bytes([8 if literal else 0]) * number)
                at += elements if literal else 0
            else:
                bits, kinds = int.from_bytes(padded[at : at + head], "little"), WIDTHS[control]
                at += head
                for _ in range(number):
                    width = kinds[bits & 3]
                    bits >>= 2
                    starts.append(at)
                    widths.append(width)
                    at += sizes[width][at]
            if at > end:
                raise MeshoptError("the stream ends inside its deltas")
    if at != end:
        raise MeshoptError(f"{end - at} bytes are left behind its elements")
    return np.array(starts, dtype=np.int64), np.frombuffer(bytes(widths), np.uint8)


def _fields(packed: UInt8[Array, "*shape"], width: int) -> UInt8[Array, "*shape fields"]:
    """The values of `width` bits in each byte: the highest bits first, single bits from the lowest on."""
    shifts = np.arange(0, 8, width, dtype=np.uint8)
    return packed[..., None] >> (shifts if width == 1 else shifts[::-1]) & np.uint8(2**width - 1)


def _lengths(raw: UInt8[Array, "bytes"], width: int) -> bytes:
    """Length of the group packed in `width` bits that begins at each byte: its values, and one for every sentinel."""
    of_byte = (_fields(np.arange(256, dtype=np.uint8), width) == 2**width - 1).sum(axis=1)
    total = np.concatenate([[0], np.cumsum(of_byte[raw]), np.zeros(2 * width - 1, dtype=np.int64)])
    total[len(raw) + 1 :] = total[len(raw)]
    return (2 * width + total[2 * width :] - total[: -2 * width]).astype(np.uint8).tobytes()


def _deltas(
    raw: UInt8[Array, "bytes"], starts: Int[Array, "groups"], widths: UInt8[Array, "groups"]
) -> UInt8[Array, "groups 16"]:
    result = np.zeros((len(starts), GROUP), np.uint8)
    for width in (1, 2, 4):
        own = starts[widths == width, None]
        values = _fields(raw[own + np.arange(2 * width)], width).reshape(-1, GROUP)
        outside = values == 2**width - 1
        behind = own + 2 * width + np.cumsum(outside, axis=1) - 1
        values[outside] = raw[behind[outside]]
        result[widths == width] = values
    # Literal bytes of the last group may be fewer than 16; what is read behind them is cut off.
    whole = starts[widths == 8, None] + np.arange(GROUP)
    result[widths == 8] = raw[np.minimum(whole, len(raw) - 1)]
    return result


# --- modes 1 and 2: indices -----------------------------------------------------------------------------------------


def sequence(data: bytes, count: int) -> UInt32[Array, "count"]:
    """Mode 2: differences to one of two earlier indices, as numbers of up to five bytes."""
    _check_room(data, (0xD1,), 4, count)
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
    _check_room(data, (0xE1,), 16, count // 3)
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
