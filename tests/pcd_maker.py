"""PCD files in all three forms, with a compressor of our own: greedy, and enough to make repetitions of every kind."""

import struct

import numpy as np


def pcd_of(points, form="binary", colour=True, height=1, **lines):
    """The bytes of a PCD file of float points (points, 3), with a colour between y and z if asked for; `lines` replace
    those of the header, and leave out those that are None."""
    count = len(points)
    names, types = ("x y rgb z", "F F U F") if colour else ("x y z", "F F F")
    head = {
        "VERSION": "0.7", "FIELDS": names, "SIZE": " ".join("4" for _ in names.split()), "TYPE": types,
        "COUNT": " ".join("1" for _ in names.split()), "WIDTH": str(count // height), "HEIGHT": str(height),
        "VIEWPOINT": "0 0 0 1 0 0 0", "POINTS": str(count), "DATA": form,
    }  # fmt: skip
    head |= lines
    text = "# .PCD v0.7 - Point Cloud Data file format\n"
    text += "".join(f"{word} {rest}\n" for word, rest in head.items() if rest is not None)
    columns = [np.asarray(points[:, axis], dtype="<f4") for axis in range(3)]
    if colour:
        columns.insert(2, np.arange(count).astype("<u4"))
    if form == "ascii":
        rows = zip(*(column.tolist() for column in columns))
        return (text + "".join(" ".join(repr(value) for value in row) + "\n" for row in rows)).encode()
    if form == "binary_compressed":
        raw = b"".join(column.tobytes() for column in columns)
        packed = lzf_packed(raw)
        return text.encode() + struct.pack("<II", len(packed), len(raw)) + packed
    return text.encode() + b"".join(
        b"".join(column[row : row + 1].tobytes() for column in columns) for row in range(count)
    )


def lzf_packed(raw):
    """LZF of some bytes: the latest earlier place of the next three bytes is repeated as far as it goes."""
    out, waiting, seen, at = bytearray(), bytearray(), {}, 0

    def flush():
        while waiting:
            piece = bytes(waiting[:32])
            out.append(len(piece) - 1)
            out.extend(piece)
            del waiting[:32]

    while at < len(raw):
        back = at - seen.get(raw[at : at + 3], -(1 << 20))
        seen[raw[at : at + 3]] = at
        length = 0
        if back <= 8192:
            while length < 264 and at + length < len(raw) and raw[at + length] == raw[at + length - back]:
                length += 1
        if length < 3:
            waiting.append(raw[at])
            at += 1
            continue
        flush()
        short = length - 2
        out.append((min(short, 7) << 5) + ((back - 1) >> 8))
        if short >= 7:
            out.append(short - 7)
        out.append((back - 1) & 255)
        at += length
    flush()
    return bytes(out)
