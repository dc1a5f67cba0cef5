"""Draco-compressed primitives of glTF (KHR_draco_mesh_compression), decoded by Google's library in a process of its own.

What is decoded takes the place of the accessors' data while reading; the document itself stays as it is, so that a character
is written back with its compressed data untouched.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from retarget.io.child_process import ChildFailed, run_child
from retarget.io.gltf_document import DTYPES, WIDTHS, Document

Array = np.ndarray

EXTENSION = "KHR_draco_mesh_compression"
SECONDS = 120.0
"""How long decoding may take."""
MOST = 20_000_000
"""Vertices, or corners of faces, of one primitive."""


def decode(document: Document) -> dict[int, Array]:
    """Arrays (count, width) of the accessors whose data are compressed only, in the component types they declare.

    Raises `FileError` for data that cannot be decoded, or is not what the accessors declare, and without DracoPy.
    """
    jobs = list(_jobs(document))
    if not jobs:
        return {}
    with tempfile.TemporaryDirectory(prefix="retarget-") as folder:
        blob, plan, found = (Path(folder) / name for name in ("data.bin", "plan.json", "found.npz"))
        with open(blob, "wb") as file:
            for job in jobs:
                job["start"] = file.tell()
                job["length"] = file.write(document.view(job["view"], job["place"]))
        plan.write_text(json.dumps([{key: job[key] for key in ("start", "length", "ids")} for job in jobs]))
        try:
            run_child(document.path, "retarget.io.gltf_draco_child", [str(blob), str(plan), str(found)], SECONDS)
        except ChildFailed as error:
            if "No module named 'DracoPy'" in str(error):
                raise document.fail("is compressed with Draco, which needs DracoPy: pip install DracoPy") from None
            raise document.fail(f"its Draco data cannot be decoded ({error}); export it without compression") from None
        with np.load(found, allow_pickle=False) as archive:
            return {number: values for k, job in enumerate(jobs) for number, values in _arrays(document, job, k, archive)}


def _jobs(document: Document):
    """Primitives with data that are compressed only: the view, ids and accessors of their attributes."""
    for mesh, entry in enumerate(document.entries("meshes")):
        for number, primitive in enumerate(entry["primitives"]):
            extension = primitive.get("extensions", {}).get(EXTENSION) if isinstance(primitive.get("extensions"), dict) else None
            if extension is None:
                continue
            place = f"meshes[{mesh}].primitives[{number}].extensions.{EXTENSION}"
            accessors = _accessors(document, primitive, extension, place)
            if all("bufferView" in document.json["accessors"][accessor] for accessor in accessors.values()):
                continue  # the plain data lie beside the compressed ones
            yield {
                "view": extension["bufferView"], "place": place, "accessors": accessors,
                "ids": {name: int(key) for name, key in extension["attributes"].items() if name in accessors},
            }  # fmt: skip


def _accessors(document: Document, primitive: dict[str, Any], extension: Any, place: str) -> dict[str, int]:
    """Accessor of every compressed attribute by its name, and of the faces by 'indices'. Raises `FileError` for an extension
    of another form."""
    known = len(document.entries("bufferViews"))
    view = extension.get("bufferView") if isinstance(extension, dict) else None
    ids = extension.get("attributes") if isinstance(extension, dict) else None
    if type(view) is not int or not 0 <= view < known or not isinstance(ids, dict):
        raise document.fail("must name a bufferView and attributes", place)
    if any(type(key) is not int or key < 0 for key in ids.values()):
        raise document.fail("must name its attributes by whole numbers", place)
    found = {name: primitive["attributes"][name] for name in ids if name in primitive["attributes"]}
    if primitive.get("indices") is not None:
        found["indices"] = primitive["indices"]
    for accessor in found.values():
        if document.json["accessors"][accessor]["count"] > MOST:
            raise document.fail(f"declares more than {MOST} elements", f"accessors[{accessor}]")
    return found


def _arrays(document: Document, job: dict[str, Any], number: int, archive: Any):
    """What was decoded for a primitive, as its accessors declare it."""
    arrays: dict[str, Array] = {}
    for name, accessor in job["accessors"].items():
        declared, key = document.json["accessors"][accessor], f"{number}.{name}"
        dtype, width, count = DTYPES[declared["componentType"]], WIDTHS[declared["type"]], declared["count"]
        if key not in archive:
            raise document.fail(f"its Draco data hold no {name}", job["place"])
        values = archive[key]
        values = values.reshape(-1, 1) if name == "indices" else values
        if values.shape != (count, width):
            raise document.fail(f"its Draco data hold {values.shape} {name} where {(count, width)} are declared", job["place"])
        if dtype.kind in "iu" and values.size and not (
            np.iinfo(dtype).min <= values.min() and values.max() <= np.iinfo(dtype).max
        ):
            raise document.fail(f"its Draco data hold {name} beyond what is declared", job["place"])
        arrays[name] = np.ascontiguousarray(values, dtype)
    # Quantised weights no longer sum to one.
    weights = [name for name in arrays if name.startswith("WEIGHTS_") and arrays[name].dtype.kind == "f"]
    total = sum((arrays[name].sum(axis=1, keepdims=True, dtype=np.float64) for name in weights), np.zeros(1))
    for name in weights:
        arrays[name] = (arrays[name] / np.where(total > 0, total, 1.0)).astype("<f4")
    for name, values in arrays.items():
        yield job["accessors"][name], values
