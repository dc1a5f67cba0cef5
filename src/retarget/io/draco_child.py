"""Runs in a process of its own (`child.py`): pieces of Draco data in, plain arrays out.

SOURCE holds a line of JSON, the lengths of the pieces, and the pieces behind it. OUTPUT becomes the arrays one behind the
other, and the answer says for each piece what lies where.
"""

from __future__ import annotations

import json
from typing import Any

MOST_BYTES = 1 << 30
"""Of all arrays together."""


def work(source: str, output: str) -> list[dict[str, Any]]:
    """For each piece its `points` (their number), its `faces` and its `attributes` by unique id, each an array's place:
    `[offset, dtype, rows, columns]`."""
    import DracoPy
    import numpy as np

    with open(source, "rb") as file:
        pieces = [file.read(length) for length in json.loads(file.readline())]
    found, size = [], 0
    with open(output, "wb") as file:

        def put(array: Any) -> list[Any]:
            nonlocal size
            array = np.ascontiguousarray(array)
            start, size = size, size + array.nbytes
            if size > MOST_BYTES:
                raise ValueError(f"it unfolds to more than {MOST_BYTES} bytes")
            file.write(array.astype(array.dtype.newbyteorder("<")).tobytes())
            return [start, array.dtype.newbyteorder("<").str, *array.shape]

        for number, piece in enumerate(pieces):
            try:
                mesh = DracoPy.decode(piece)
            except Exception as error:
                raise ValueError(f"piece {number}: {error}") from None
            faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), dtype=np.uint32).reshape(-1, 3)
            attributes = {each["unique_id"]: put(each["data"]) for each in mesh.attributes}
            found.append({"points": len(mesh.points), "faces": put(faces), "attributes": attributes})
    return found
