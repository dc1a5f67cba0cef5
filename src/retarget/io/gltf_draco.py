"""Primitives compressed with KHR_draco_mesh_compression: their accessors filled with what the compressed data hold.

The decoder (DracoPy) is native code and files come from everywhere: it works in a process of its own (`draco_child.py`), and
nothing that it says is believed without a look. The document keeps the compressed data, so that a character is written back
as it came.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from retarget.errors import FileError
from retarget.io.child import ChildError, ChildTimeout, run_child
from retarget.io.gltf_document import DTYPES, WIDTHS, Document

Array = np.ndarray

EXTENSION = "KHR_draco_mesh_compression"
SECONDS = 120.0
"""How long decoding all of a file may take."""
READ = ("POSITION", "TEXCOORD_0", "JOINTS_", "WEIGHTS_")
"""Attributes that are decoded, by how their names begin."""


@dataclass(frozen=True)
class Part:
    """One compressed primitive."""

    place: str
    view: int
    accessors: dict[int, int | None]
    """Accessors without data of their own, to the unique id of the attribute that fills them; None: the triangles."""


def decompressed(document: Document) -> Document:
    """The document with the accessors of its Draco primitives filled. Primitives that also bring plain data are left alone.

    Raises `FileError` for data that cannot be decoded or contradict their accessors.
    """
    parts = _parts(document)
    if not parts:
        return document
    views = sorted({part.view for part in parts})
    pieces = [bytes(document.view(view, f"bufferViews[{view}]")) for view in views]
    with tempfile.TemporaryDirectory(prefix="retarget-") as folder:
        source, output = Path(folder) / "pieces", Path(folder) / "arrays"
        source.write_bytes(json.dumps(list(map(len, pieces))).encode() + b"\n" + b"".join(pieces))
        found = _decode(document, source, output)
        data = output.read_bytes() if output.exists() else b""
    if type(found) is not list or len(found) != len(views):
        raise document.fail("the Draco decoder gave no usable answer")
    filled: dict[int, Array] = {}
    notes = []
    for part in parts:
        answer = found[views.index(part.view)]
        for accessor, attribute in part.accessors.items():
            try:
                values = _filled(document, part, answer, data, accessor, attribute)
            except FileError:
                raise
            except (KeyError, TypeError, ValueError):  # not of the form that the child gives
                raise document.fail("the Draco decoder gave no usable answer") from None
            if accessor in filled and not np.array_equal(filled[accessor], values):
                raise document.fail("is filled with different data by two Draco primitives", f"accessors[{accessor}]")
            filled[accessor] = values
            told = document.json["accessors"][accessor]["count"]
            if len(values) != told:
                notes.append(
                    f"accessor {accessor} declares {told} elements, its Draco data hold {len(values)}; these are read"
                )
    return replace(document, filled=filled, notes=(*document.notes, *notes))


def _parts(document: Document) -> list[Part]:
    accessors = document.entries("accessors")
    parts = []
    for number, mesh in enumerate(document.entries("meshes")):
        for position, primitive in enumerate(mesh["primitives"]):
            packed = primitive.get("extensions", {}).get(EXTENSION)
            if packed is None:
                continue
            place = f"meshes[{number}].primitives[{position}]"
            own: dict[int, int | None] = {}
            for name, attribute in packed["attributes"].items():
                accessor = primitive["attributes"].get(name)
                if accessor is None:
                    raise document.fail(f"compresses {name[:40]!r}, which the primitive does not have", place)
                if name.startswith(READ) and "bufferView" not in accessors[accessor]:
                    own[accessor] = attribute
            if "indices" in primitive and "bufferView" not in accessors[primitive["indices"]]:
                own[primitive["indices"]] = None
            if own:
                parts.append(Part(place, packed["bufferView"], own))
    return parts


def _decode(document: Document, source: Path, output: Path) -> Any:
    try:
        return run_child("draco_child", [source, output], SECONDS)
    except ChildTimeout:
        problem = (
            f"its Draco data take longer than {SECONDS:g} s to decode; they are damaged, or larger than any we know"
        )
    except ChildError as error:
        problem = f"its Draco data cannot be decoded ({error}); export it again, without compression if that persists"
        if "No module named 'DracoPy'" in str(error):
            problem = "is compressed with Draco, which the package DracoPy decodes: pip install DracoPy"
    raise document.fail(problem)


def _filled(
    document: Document, part: Part, answer: dict[str, Any], data: bytes, accessor: int, attribute: int | None
) -> Shaped[Array, "count width"]:
    """What an accessor holds, in its own component type."""
    entry, points = document.json["accessors"][accessor], answer["points"]
    dtype, width = DTYPES[entry["componentType"]], WIDTHS.get(entry["type"], 0)
    if attribute is None:
        values = _array(document, answer["faces"], data).reshape(-1, 1)
        if len(values) and int(values.max()) >= points:
            raise document.fail(f"a Draco triangle names vertex {int(values.max())} of {points}", part.place)
    elif str(attribute) not in answer["attributes"]:
        raise document.fail(f"its Draco data have no attribute {attribute}", part.place)
    else:
        values = _array(document, answer["attributes"][str(attribute)], data)
        if len(values) != points:
            raise document.fail(f"its Draco data have {len(values)} values for {points} vertices", part.place)
    if values.shape[1] != width:
        problem = f"is of type {entry['type']}, its Draco data have {values.shape[1]} components"
        raise document.fail(problem, f"accessors[{accessor}]")
    with np.errstate(invalid="ignore", over="ignore"):
        stored = values.astype(dtype)
    if dtype.kind != "f" and not np.array_equal(stored, values):
        raise document.fail("its Draco data do not fit into its component type", f"accessors[{accessor}]")
    return stored


def _array(document: Document, where: list[Any], data: bytes) -> Array:
    """An array that the child wrote; the place it names must exist."""
    start, dtype, rows, columns = where
    kind = np.dtype(dtype)
    if kind.kind not in "iuf" or not 0 <= start <= start + rows * columns * kind.itemsize <= len(data):
        raise document.fail("the Draco decoder gave no usable answer")
    return np.frombuffer(data, kind, rows * columns, start).reshape(rows, columns)
