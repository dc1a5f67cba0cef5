"""A glTF document being written: entries and bytes are only ever added behind what is there."""

from __future__ import annotations

import base64
import json
import os
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from retarget.errors import FileError
from retarget.io import meshopt
from retarget.io.gltf_document import BIN_CHUNK, DTYPES, JSON_CHUNK, MAGIC, Document, resource

Array = np.ndarray

COMPONENTS = {dtype: code for code, dtype in DTYPES.items()}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
VERTEX_DATA, INDEX_DATA = 34962, 34963
PICTURES = {
    b"\x89PNG\r\n\x1a\n": "image/png",
    b"\xff\xd8\xff": "image/jpeg",
    b"RIFF": "image/webp",
    b"\xabKTX 20": "image/ktx2",
}


@dataclass(eq=False)
class Draft:
    """JSON, and the bytes of its first buffer, to which everything new goes."""

    json: dict[str, Any]
    binary: bytearray
    source: Document | None = None

    @classmethod
    def of(cls, document: Document, keep_clips: bool = True) -> Draft:
        """A draft that begins as a document. Entries of its lists are shared with it: replace, never change them."""
        copied = {key: list(value) if isinstance(value, list) else value for key, value in document.json.items()}
        copied["asset"] = dict(document.json["asset"])
        if not keep_clips:
            copied.pop("animations", None)
        document = _real_buffers_first(document, copied)
        first = document.buffers[0][: copied["buffers"][0]["byteLength"]] if document.buffers else b""
        return cls(copied, bytearray(first), document)

    @classmethod
    def empty(cls) -> Draft:
        return cls({"asset": {"version": "2.0"}}, bytearray())

    def add(self, kind: str, entry: dict[str, Any]) -> int:
        """Append an entry to a top-level list and return its number."""
        entries = self.json.setdefault(kind, [])
        entries.append(entry)
        return len(entries) - 1

    def add_view(self, data: bytes, **properties: int) -> int:
        """Append bytes (4-byte aligned) as a new buffer view."""
        self.binary.extend(b"\0" * (-len(self.binary) % 4))
        start = len(self.binary)
        self.binary.extend(data)
        if not self.json.get("buffers"):
            self.json["buffers"] = [{"byteLength": 0}]
        return self.add("bufferViews", {"buffer": 0, "byteOffset": start, "byteLength": len(data), **properties})

    def add_accessor(self, values: Array, bounds: bool = False, **view: int) -> int:
        """Append an array (count, width) as an accessor with a view of its own; `bounds` writes min and max."""
        return self.add_accessors([values], bounds, **view)[0]

    def add_accessors(self, arrays: list[Array], bounds: bool = False, **view: int) -> list[int]:
        """Append arrays as accessors that share one view, one behind the other (four-byte components)."""
        dtype = arrays[0].dtype.newbyteorder("<")
        number = self.add_view(b"".join(np.ascontiguousarray(each, dtype).tobytes() for each in arrays), **view)
        numbers, offset = [], 0
        for each in arrays:
            entry = {
                "bufferView": number,
                "componentType": COMPONENTS[dtype],
                "count": len(each),
                "type": TYPES[each.shape[1]],
            }
            if offset:
                entry["byteOffset"] = offset
            if bounds:
                entry["min"], entry["max"] = each.min(axis=0).tolist(), each.max(axis=0).tolist()
            offset += each.nbytes
            numbers.append(self.add("accessors", entry))
        return numbers

    def glb(self, path: Path) -> dict[Path, bytes]:
        """The draft as one self-contained file: buffers and pictures that lay beside the source move inside."""
        for number, image in enumerate(self.json.get("images", ())):
            if "uri" in image and image["uri"][:5].lower() != "data:":
                self._embed_image(number, image)
        buffers = self.json.get("buffers", [])
        for number, entry in enumerate(buffers[1:], start=1):
            if entry.get("uri", "data:")[:5].lower() != "data:":
                payload = base64.b64encode(self.source.buffers[number]).decode()
                buffers[number] = {**entry, "uri": f"data:application/octet-stream;base64,{payload}"}
        if buffers:
            buffers[0] = {key: value for key, value in buffers[0].items() if key != "uri"} | {
                "byteLength": len(self.binary)
            }
        chunks = [(JSON_CHUNK, self._text(path), b" ")]
        if buffers:
            chunks.append((BIN_CHUNK, bytes(self.binary), b"\0"))
        chunks += [(kind, data, b"\0") for kind, data in (self.source.chunks if self.source else ())]
        parts = []
        for kind, data, filler in chunks:
            padded = data + filler * (-len(data) % 4)
            parts += [struct.pack("<II", len(padded), kind), padded]
        length = 12 + sum(map(len, parts))
        if length >= 2**32:
            raise FileError(path, f"needs {length} bytes; a GLB file holds less than 4 GiB")
        return {path: b"".join([struct.pack("<III", MAGIC, 2, length), *parts])}

    def gltf(self, path: Path) -> dict[Path, bytes]:
        """The draft as JSON with its first buffer beside it; other buffers and pictures of the source come along."""
        files: dict[Path, bytes] = {}
        for kind in ("buffers", "images"):
            for number, entry in enumerate(self.json.get(kind, ())):
                own = kind == "buffers" and number == 0
                if own or "uri" not in entry or entry["uri"][:5].lower() == "data:":
                    continue
                self._bring_along(path, kind, number, entry, files)
        if self.json.get("buffers"):
            beside = path.with_suffix(".bin")
            while beside in files:
                beside = beside.with_name(f"{beside.stem}_motion.bin")
            files[beside] = bytes(self.binary)
            from urllib.parse import quote

            self.json["buffers"][0] = {
                **self.json["buffers"][0],
                "uri": quote(beside.name),
                "byteLength": len(self.binary),
            }
        files[path] = self._text(path)
        return files

    def _embed_image(self, number: int, image: dict[str, Any]) -> None:
        try:
            data = resource(self.source.path, image["uri"], f"images[{number}]")
        except FileError:
            return  # it was missing when the file was read (and noted then)
        mime = image.get("mimeType") or next((m for head, m in PICTURES.items() if data.startswith(head)), "image/png")
        kept = {key: value for key, value in image.items() if key != "uri"}
        self.json["images"][number] = {**kept, "bufferView": self.add_view(data), "mimeType": mime}

    def _bring_along(self, path: Path, kind: str, number: int, entry: dict[str, Any], files: dict[Path, bytes]) -> None:
        from urllib.parse import quote, unquote

        try:
            data = self.source.buffers[number] if kind == "buffers" else resource(self.source.path, entry["uri"], "")
        except FileError:
            return
        target = path.parent / unquote(entry["uri"])
        # Another file of that name may lie there already, of another character: it is not ours to replace.
        while (
            (target in files and files[target] != data)
            or (target.exists() and target.read_bytes() != data)
            or target == path
        ):
            target = target.with_name(f"{path.stem}_{target.name}")
        files[target] = data
        relative = target.relative_to(path.parent).as_posix()
        if relative != unquote(entry["uri"]):
            self.json[kind][number] = {**entry, "uri": quote(relative)}

    def _text(self, path: Path) -> bytes:
        try:
            return json.dumps(self.json, separators=(",", ":"), allow_nan=False).encode()
        except (ValueError, RecursionError) as error:
            raise FileError(path, f"the source holds a number that JSON cannot express: {error}") from None


def _real_buffers_first(document: Document, copied: dict[str, Any]) -> Document:
    """Renumber buffers so that those that only stand for compressed data are the last: what is new goes into the first."""
    order = sorted(range(len(document.buffers)), key=lambda number: not document.buffers[number])
    if order == list(range(len(order))):
        return document
    number = {old: new for new, old in enumerate(order)}
    copied["buffers"] = [copied["buffers"][old] for old in order]
    for position, view in enumerate(copied.get("bufferViews", ())):
        view = {**view, "buffer": number[view["buffer"]]}
        for name in meshopt.EXTENSIONS:
            if name in view.get("extensions", {}):
                packed = view["extensions"][name]
                moved = {**packed, "buffer": number[packed["buffer"]]}
                view["extensions"] = {**view["extensions"], name: moved}
        copied["bufferViews"][position] = view
    return replace(document, buffers=tuple(document.buffers[old] for old in order))


def write_files(files: dict[Path, bytes]) -> None:
    """Write all files, the last one last, each under a temporary name first: they appear whole or not at all."""
    pending: list[tuple[Path, Path]] = []
    path = next(iter(files))
    try:
        for path, data in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
            pending.append((temporary, path))
            temporary.write_bytes(data)
        for temporary, path in pending:
            os.replace(temporary, path)
    except OSError as error:
        raise FileError(path, f"cannot be written: {error.strerror or error}") from None
    finally:
        for temporary, _ in pending:
            temporary.unlink(missing_ok=True)
