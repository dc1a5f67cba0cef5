"""Materials and pictures of a glTF document, as far as our own pictures need them."""

from __future__ import annotations

from collections.abc import Callable

from retarget.character import Material
from retarget.io.gltf_document import Document, MissingFileError, resource

Note = Callable[[str], None]


def read_material(document: Document, number: int | None, note: Note) -> Material:
    """Base colour and its picture; None is glTF's default material, white."""
    if number is None:
        return Material("", (1.0, 1.0, 1.0, 1.0))
    entry = document.json["materials"][number]
    look = entry.get("pbrMetallicRoughness", {})
    image = None
    if "baseColorTexture" in look:
        texture = document.json["textures"][look["baseColorTexture"]["index"]]
        if "source" in texture:
            image = read_image(document, texture["source"], note)
        else:
            note(f"the picture of material {number} is in a form that cannot be read")
    red, green, blue, alpha = (float(part) for part in look.get("baseColorFactor", (1, 1, 1, 1)))
    return Material(entry.get("name", ""), (red, green, blue, alpha), image, entry.get("doubleSided", False))


def read_image(document: Document, number: int, note: Note) -> bytes | None:
    """The encoded picture; None with a note if it is missing or neither PNG nor JPEG.

    Raises `FileError` for a URI that leaves the file's folder.
    """
    entry, place = document.json["images"][number], f"images[{number}]"
    if "bufferView" in entry:
        data = bytes(document.view(entry["bufferView"], place))
    elif "uri" not in entry:
        raise document.fail("has neither a uri nor a bufferView", place)
    else:
        try:
            data = resource(document.path, entry["uri"], place)
        except MissingFileError as error:
            note(error.problem)
            return None
    if not data.startswith((b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff")):
        note(f"picture {number} is neither PNG nor JPEG and is left out")
        return None
    return data
