"""A glTF file as it lies on disk: the GLB container, the JSON, the buffers, and numbers out of accessors.

glTF 2.0 specification, sections 3.6 (buffers, accessors) and 4 (GLB).
"""

from __future__ import annotations

import base64
import binascii
import json
import re
import struct
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

import numpy as np

from retarget.errors import FileError
from retarget.io import gltf_schema, meshopt

Array = np.ndarray

MAGIC, JSON_CHUNK, BIN_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
DTYPES = {code: np.dtype(name) for code, name in
          {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}.items()}  # fmt: skip
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
LARGEST = (1 << 32) - 1
"""Bytes of a file that is read: a GLB tells its length in four bytes."""
# What any file may unfold to in memory (elements of an accessor without data, vertices, frames times joints); beyond
# that, as many as the file has bytes of data. A small file cannot fill the memory by naming the same data many times.
ROOM = 4_000_000

# Extensions that change how a surface looks or add data we pass over; geometry and motion stay plain glTF.
HARMLESS = {
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "KHR_texture_basisu",
    "EXT_texture_webp",
    "MSFT_texture_dds",
    "KHR_lights_punctual",
    "KHR_animation_pointer",
    "KHR_xmp_json_ld",
    "VRM",
    # Compressed data, which `view` and `gltf_draco` unfold.
    "KHR_draco_mesh_compression",
    *meshopt.EXTENSIONS,
}


class MissingFileError(FileError):
    """A file that a document refers to is not there."""


@dataclass(frozen=True, eq=False)
class Document:
    """One parsed file. Nobody changes what is in it; the writer copies."""

    path: Path
    json: dict[str, Any]
    buffers: tuple[bytes, ...]
    """Bytes of each buffer, at least `byteLength` long; none of one that only stands for compressed data."""
    chunks: tuple[tuple[int, bytes], ...] = ()
    """Chunks of a GLB beyond JSON and BIN, kept for the writer."""
    notes: tuple[str, ...] = ()
    """What was odd about the file as a container, one sentence each."""
    filled: dict[int, Array] = field(default_factory=dict, repr=False)
    """Accessors whose data came compressed (Draco): (count, width), in their own component type."""
    unfolded: dict[int, bytes] = field(default_factory=dict, repr=False)
    """Buffer views already unfolded from their compressed form (meshopt)."""
    key_times: dict[int, Array] = field(default_factory=dict, repr=False)
    """Key times already read and checked, by accessor: the channels of a clip share a few of them."""

    @property
    def room(self) -> int:
        """How many elements anything read from this file may have; see `ROOM`."""
        plain = sum(map(len, (*self.buffers, *self.unfolded.values())))
        return max(ROOM, plain + sum(each.nbytes for each in self.filled.values()))

    def fail(self, problem: str, place: str = "") -> FileError:
        return FileError(self.path, problem, place)

    def entries(self, kind: str) -> list[dict[str, Any]]:
        return self.json.get(kind, [])

    def view(self, number: int, place: str) -> memoryview:
        """The bytes of a buffer view, unfolded where it is compressed. Raises `FileError` where it reaches beyond its
        buffer, or where compressed data are damaged."""
        view = self.json["bufferViews"][number]
        packed = meshopt.compression(view)
        if packed is None:
            return self._bytes(view, number, place)
        if number not in self.unfolded:
            self.unfolded[number] = self._unfold(view, packed, number, place)
        return memoryview(self.unfolded[number])

    def _unfold(self, view: dict[str, Any], packed: dict[str, Any], number: int, place: str) -> bytes:
        count, stride = packed["count"], packed["byteStride"]
        where = f"{place} (bufferViews[{number}])"
        if view["byteLength"] != count * stride or view.get("byteStride", stride) != stride:
            raise self.fail(f"{count} compressed elements of {stride} bytes are not what the view describes", where)
        stream = bytes(self._bytes(packed, number, place))
        try:
            return meshopt.unfold(stream, count, stride, packed["mode"], packed.get("filter", "NONE"))
        except meshopt.MeshoptError as error:
            raise self.fail(f"its meshopt data are damaged: {error}", where) from None

    def _bytes(self, view: dict[str, Any], number: int, place: str) -> memoryview:
        start, length = view.get("byteOffset", 0), view["byteLength"]
        held = self.buffers[view["buffer"]]
        size = min(self.json["buffers"][view["buffer"]]["byteLength"], len(held))
        if start + length > size:
            raise self.fail(
                f"bytes {start} to {start + length} of a buffer of {size} bytes", f"{place} (bufferViews[{number}])"
            )
        return memoryview(held)[start : start + length]

    def raw(self, number: int, types: tuple[str, ...]) -> Array:
        """An accessor as it is stored: (count, width), its own component type, sparse values in place.

        Raises `FileError` if it is of none of the `types`, or if its data is not there.
        """
        accessor, place = self.json["accessors"][number], f"accessors[{number}]"
        if accessor["type"] not in types:
            raise self.fail(f"is of type {accessor['type']}, {' or '.join(types)} is needed here", place)
        dtype, width, count = DTYPES[accessor["componentType"]], WIDTHS[accessor["type"]], accessor["count"]
        if number in self.filled:
            stored = self.filled[number]
        elif "bufferView" in accessor:
            stored = self._elements(
                accessor["bufferView"], accessor.get("byteOffset", 0), count, width, dtype, place, True
            )
        elif count > self.room:
            raise self.fail(f"declares {count} elements without data", place)
        else:
            stored = np.zeros((count, width), dtype)
        return self._with_sparse(stored, accessor["sparse"], place) if "sparse" in accessor else stored

    def _elements(
        self, number: int, offset: int, count: int, width: int, dtype: np.dtype, place: str, strided: bool = False
    ) -> Array:
        data, element = self.view(number, place), width * dtype.itemsize
        stride = self.json["bufferViews"][number].get("byteStride", element) if strided else element
        if stride < element:
            raise self.fail(f"byteStride {stride} is less than one element ({element} bytes)", f"bufferViews[{number}]")
        # The length is checked in Python's unbounded integers before numpy allocates anything.
        if count and offset + stride * (count - 1) + element > len(data):
            raise self.fail(
                f"{count} elements of {element} bytes do not fit into the {len(data)} bytes of its bufferView", place
            )
        if not count:
            return np.zeros((0, width), dtype)
        return np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))

    def _with_sparse(self, base: Array, sparse: dict[str, Any], place: str) -> Array:
        count, where, what = sparse["count"], sparse["indices"], sparse["values"]
        dtype = DTYPES[where["componentType"]]
        if dtype.kind != "u":
            raise self.fail("indices must be unsigned integers", f"{place}.sparse")
        args = (f"{place}.sparse",)
        rows = self._elements(where["bufferView"], where.get("byteOffset", 0), count, 1, dtype, *args)[:, 0].astype(
            np.int64
        )
        values = self._elements(what["bufferView"], what.get("byteOffset", 0), count, base.shape[1], base.dtype, *args)
        if count and rows.max() >= len(base):
            raise self.fail(f"index {rows.max()} of {len(base)} elements", f"{place}.sparse")
        result = base.copy()
        result[rows] = values
        return result

    def floats(self, number: int, types: tuple[str, ...]) -> Array:
        """An accessor as real numbers (count, width), float64; integers are read as normalised where it says so.

        Raises `FileError` for values that are not finite, besides what `raw` raises.
        """
        values = self.decoded(number, types)
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
            raise self.fail(f"element {row} is not a finite number", f"accessors[{number}]")
        return values

    def decoded(self, number: int, types: tuple[str, ...]) -> Array:
        """`floats` for data that may hold NaN and is repaired by the caller."""
        stored = self.raw(number, types)
        with np.errstate(invalid="ignore"):  # damaged bytes may be signalling NaNs
            values = stored.astype(np.float64)
        if self.json["accessors"][number].get("normalized", False) and stored.dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(stored.dtype).max, -1.0)
        return values

    def integers(self, number: int, types: tuple[str, ...]) -> Array:
        """An accessor of unsigned integers (count, width). Raises `FileError` if it holds anything else."""
        stored = self.raw(number, types)
        if stored.dtype.kind != "u":
            raise self.fail("must hold unsigned integers", f"accessors[{number}]")
        return stored.astype(np.int64)


def read_document(path: Path) -> Document:
    """Parse a .glb or .gltf with everything it refers to. Raises `FileError` naming the place of the first fault."""
    try:
        size = path.stat().st_size
        if size > LARGEST:
            raise FileError(path, f"has {size} bytes; a GLB can have {LARGEST}, and more is not read")
        data = path.read_bytes()
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror or error}") from None
    if not data:
        raise FileError(path, "is empty")
    if data[:4] == b"glTF":
        text, binary, chunks = _split_glb(path, data)
    else:
        if path.suffix.lower() in (".glb", ".vrm", ".vrma"):
            raise FileError(path, "is not a GLB file: it does not begin with 'glTF'", "byte 0")
        text, binary, chunks = data, None, ()
    document = _parse(path, text)
    _check_version(path, document)
    _check_extensions(path, document)
    try:
        gltf_schema.check(document)
    except gltf_schema.Wrong as wrong:
        raise FileError(path, wrong.problem, wrong.place) from None
    stand_ins = _stand_ins(document)
    buffers = tuple(
        _buffer(path, entry, i, binary, i in stand_ins) for i, entry in enumerate(document.get("buffers", []))
    )
    _check_unfolded(path, document, sum(map(len, buffers)))
    return Document(path, document, buffers, chunks)


def _split_glb(path: Path, data: bytes) -> tuple[bytes, bytes | None, tuple[tuple[int, bytes], ...]]:
    if len(data) < 20:
        raise FileError(path, f"ends after {len(data)} bytes, inside the GLB header", f"byte {len(data)}")
    _, version, length = struct.unpack_from("<III", data)
    if version != 2:
        raise FileError(path, f"is GLB version {version}; only version 2 can be read", "byte 4")
    if length != len(data):
        raise FileError(
            path, f"the header promises {length} bytes, the file has {len(data)}: it is cut off or damaged", "byte 8"
        )
    chunks, start = [], 12
    while start < length:
        if start + 8 > length:
            raise FileError(path, "ends inside a chunk header", f"byte {start}")
        size, kind = struct.unpack_from("<II", data, start)
        if start + 8 + size > length:
            raise FileError(path, f"a chunk promises {size} bytes, {length - start - 8} are left", f"byte {start}")
        chunks.append((kind, data[start + 8 : start + 8 + size]))
        start += 8 + size
    if chunks[0][0] != JSON_CHUNK:
        raise FileError(path, "the first chunk is not JSON", "byte 16")
    has_binary = len(chunks) > 1 and chunks[1][0] == BIN_CHUNK
    return chunks[0][1], chunks[1][1] if has_binary else None, tuple(chunks[2 if has_binary else 1 :])


def _parse(path: Path, text: bytes) -> dict[str, Any]:
    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is not JSON")

    try:
        document = json.loads(text.decode("utf-8-sig"), parse_constant=refuse)
    except UnicodeDecodeError as error:
        raise FileError(path, "the JSON is not UTF-8", f"byte {error.start}") from None
    except json.JSONDecodeError as error:
        raise FileError(
            path, f"the JSON cannot be parsed: {error.msg}", f"line {error.lineno} column {error.colno}"
        ) from None
    except ValueError as error:
        raise FileError(path, f"the JSON cannot be parsed: {str(error)[:80]}") from None
    except RecursionError:
        raise FileError(path, "the JSON is nested too deeply") from None
    if type(document) is not dict:
        raise FileError(path, f"the JSON must be an object, received {gltf_schema.shown(document)}")
    return document


def _check_version(path: Path, document: dict[str, Any]) -> None:
    asset = document.get("asset")
    if type(asset) is not dict:
        raise FileError(path, "is not glTF: the JSON has no 'asset'")
    version = asset.get("minVersion", asset.get("version"))
    if type(version) is not str or not re.fullmatch(r"2\.\d+", version) or (version != "2.0" and "minVersion" in asset):
        raise FileError(path, f"is glTF version {gltf_schema.shown(version)}; version 2.0 can be read", "asset")


def _check_extensions(path: Path, document: dict[str, Any]) -> None:
    required = document.get("extensionsRequired", [])
    if type(required) is not list:
        raise FileError(path, "must be a list", "extensionsRequired")
    for name in required:
        if type(name) is not str:
            raise FileError(path, f"must hold names, received {gltf_schema.shown(name)}", "extensionsRequired")
        if name not in HARMLESS and not name.startswith(("KHR_materials_", "EXT_materials_", "VRMC_")):
            raise FileError(
                path,
                f"requires the extension {name[:60]!r}, which cannot be read; export it without",
                "extensionsRequired",
            )


def _stand_ins(document: dict[str, Any]) -> set[int]:
    """Buffers that only give compressed views a place to stand: all that refers to them is compressed."""
    standing, used = set(), set()
    for view in document.get("bufferViews", ()):
        packed = meshopt.compression(view)
        (used if packed is None else standing).add(view["buffer"])
        if packed is not None:
            used.add(packed["buffer"])
    return standing - used


def _check_unfolded(path: Path, document: dict[str, Any], size: int) -> None:
    """All compressed views together must not unfold to more than the file's bytes can hold."""
    unfolded = 0
    for number, view in enumerate(document.get("bufferViews", ())):
        unfolded += view["byteLength"] if meshopt.compression(view) is not None else 0
        if unfolded > meshopt.most_unfolded(size):
            problem = "compressed data unfold to more than they can hold, or are shown again and again"
            raise FileError(path, problem, f"bufferViews[{number}]")


def _buffer(path: Path, entry: dict[str, Any], number: int, binary: bytes | None, stand_in: bool) -> bytes:
    place, size = f"buffers[{number}]", entry["byteLength"]
    if "uri" in entry:
        data = resource(path, entry["uri"], place)
    elif number == 0 and binary is not None:
        data = binary
    elif stand_in:
        return b""
    else:
        raise FileError(path, "has neither a uri nor a binary chunk", place)
    if len(data) < size:
        raise FileError(path, f"promises {size} bytes, {len(data)} are there", place)
    return data


def resource(path: Path, uri: str, place: str) -> bytes:
    """The bytes behind a URI: base64 data, or a file in the document's own folder or below it."""
    if uri[:5].lower() == "data:":
        head, _, payload = uri.partition(",")
        if not head.lower().endswith(";base64"):
            raise FileError(path, "only base64 data URIs can be read", place)
        try:
            return base64.b64decode(payload, validate=True)
        except (binascii.Error, ValueError):
            raise FileError(path, "the data URI is not valid base64", place) from None
    file = resource_file(path, uri, place)
    try:
        return file.read_bytes()
    except OSError as error:
        raise FileError(path, f"{uri[:80]!r} cannot be read: {error.strerror or error}", place) from None


def files_beside(path: Path, json: dict[str, Any]) -> tuple[Path, ...]:
    """The files of buffers and pictures that a document refers to, whether they are there or not; none outside its folder."""
    found = []
    for entry in [*json.get("buffers", ()), *json.get("images", ())]:
        uri = entry.get("uri", "data:")
        if uri[:5].lower() == "data:":
            continue
        try:
            found.append(resource_file(path, uri, ""))
        except MissingFileError:
            found.append(path.parent.resolve() / unquote(uri))
        except FileError:  # outside, and not looked at
            continue
    return tuple(found)


def resource_file(path: Path, uri: str, place: str) -> Path:
    """The file that a relative URI names. Raises `FileError` if it is missing or outside the document's own folder."""
    name = unquote(uri)  # spaces come as %20; what hides behind other escapes meets the same checks
    outside = FileError(path, f"{uri[:80]!r} points outside the file's own folder", place)
    parts = PurePosixPath(name).parts
    if (
        re.match(r"[A-Za-z][A-Za-z0-9+.\-]*:", name)
        or name.startswith("/")
        or "\\" in name
        or ".." in parts
        or "\0" in name
    ):
        raise outside
    try:
        folder, file = path.parent.resolve(), (path.parent / name).resolve()
        inside, found = file.is_relative_to(folder), file.is_file()
    except (OSError, RuntimeError, ValueError):  # a loop of links, a name too long
        inside, found = True, False
    if not inside:
        raise outside
    if not found:
        raise MissingFileError(path, f"the file {uri[:80]!r} that it refers to is not in its folder", place)
    return file
