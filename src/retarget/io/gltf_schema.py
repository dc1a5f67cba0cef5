"""The shape of a glTF document, as far as we read it: checked once, so that everything after may trust it.

Rules are small functions `rule(value, root)` that raise `Wrong`; records and lists put the place in front of it
("accessors[3].count"). What a rule does not name (extras, extensions, other properties) is not looked at.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from retarget.io import meshopt

Rule = Callable[[Any, dict], None]


class Wrong(Exception):
    """A value of the wrong kind; `place` grows from the inside out."""

    def __init__(self, problem: str, place: str = "") -> None:
        super().__init__(problem)
        self.problem, self.place = problem, place

    def within(self, step: str) -> Wrong:
        inner = self.place if not self.place or self.place.startswith("[") else "." + self.place
        return Wrong(self.problem, step + inner)


def shown(value: Any) -> str:
    """A value as an error message quotes it: short, whatever it is."""
    text = repr(value) if not isinstance(value, (dict, list)) else f"{type(value).__name__} of {len(value)}"
    return text if len(text) <= 40 else text[:37] + "..."


def natural(value: Any, root: dict) -> None:
    if type(value) is not int or not 0 <= value < 2**53:
        raise Wrong(f"must be an integer of at least 0, received {shown(value)}")


def number(value: Any, root: dict) -> None:
    if type(value) not in (int, float) or not -1e300 < value < 1e300:
        raise Wrong(f"must be a finite number, received {shown(value)}")


def text(value: Any, root: dict) -> None:
    if type(value) is not str:
        raise Wrong(f"must be a string, received {shown(value)}")


def flag(value: Any, root: dict) -> None:
    if type(value) is not bool:
        raise Wrong(f"must be true or false, received {shown(value)}")


def one_of(*allowed: Any) -> Rule:
    known = frozenset(allowed)

    def rule(value: Any, root: dict) -> None:
        if type(value) not in (int, str) or value not in known:
            raise Wrong(f"must be one of {', '.join(map(str, allowed))}, received {shown(value)}")

    return rule


def index(kind: str) -> Rule:
    """The number of an entry of the document's top-level list `kind`."""

    def rule(value: Any, root: dict) -> None:
        if type(value) is not int:
            raise Wrong(f"must be the number of one of the {kind}, received {shown(value)}")
        count = len(root.get(kind, ()))
        if not 0 <= value < count:
            raise Wrong(f"names number {shown(value)} of {count} {kind}")

    return rule


def numbers(count: int) -> Rule:
    def rule(value: Any, root: dict) -> None:
        if type(value) is not list or len(value) != count:
            raise Wrong(f"must be a list of {count} numbers, received {shown(value)}")
        for each in value:
            if type(each) not in (int, float) or not math.isfinite(each) or abs(each) > 1e30:
                raise Wrong(f"must hold finite numbers, received {shown(each)}")

    return rule


def list_of(rule: Rule, at_least: int = 0) -> Rule:
    def check(value: Any, root: dict) -> None:
        if type(value) is not list:
            raise Wrong(f"must be a list, received {shown(value)}")
        if len(value) < at_least:
            raise Wrong("must not be empty")
        position = 0
        try:
            for position, each in enumerate(value):  # noqa: B007
                rule(each, root)
        except Wrong as wrong:
            raise wrong.within(f"[{position}]") from None

    return check


def mapping(rule: Rule) -> Rule:
    def check(value: Any, root: dict) -> None:
        if type(value) is not dict:
            raise Wrong(f"must be an object, received {shown(value)}")
        for key, each in value.items():
            try:
                rule(each, root)
            except Wrong as wrong:
                raise wrong.within(shown(key)[1:-1]) from None

    return check


def record(fields: dict[str, Rule], required: tuple[str, ...] = ()) -> Rule:
    """An object whose named fields obey their rules; those `required` must be there."""

    def check(value: Any, root: dict) -> None:
        if type(value) is not dict:
            raise Wrong(f"must be an object, received {shown(value)}")
        for key in required:
            if key not in value:
                raise Wrong(f"lacks {key!r}")
        for key in value:
            if key in fields:
                try:
                    fields[key](value[key], root)
                except Wrong as wrong:
                    raise wrong.within(key) from None

    return check


COMPONENT = one_of(5120, 5121, 5122, 5123, 5125, 5126)
TEXTURE = record({"index": index("textures"), "texCoord": natural}, ("index",))
SPARSE = record(
    {
        "count": natural,
        "indices": record({"bufferView": index("bufferViews"), "byteOffset": natural, "componentType": COMPONENT},
                          ("bufferView", "componentType")),
        "values": record({"bufferView": index("bufferViews"), "byteOffset": natural}, ("bufferView",)),
    },
    ("count", "indices", "values"),
)  # fmt: skip
ACCESSOR = record(
    {
        "bufferView": index("bufferViews"),
        "byteOffset": natural,
        "componentType": COMPONENT,
        "normalized": flag,
        "count": natural,
        "type": one_of("SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"),
        "sparse": SPARSE,
    },
    ("componentType", "count", "type"),
)
NODE = record(
    {
        "children": list_of(index("nodes")),
        "mesh": index("meshes"),
        "skin": index("skins"),
        "matrix": numbers(16),
        "translation": numbers(3),
        "rotation": numbers(4),
        "scale": numbers(3),
        "name": text,
        "weights": list_of(number),
    }
)
DRACO = record({"bufferView": index("bufferViews"), "attributes": mapping(natural)}, ("bufferView", "attributes"))
MESHOPT = record(
    {
        "buffer": index("buffers"), "byteOffset": natural, "byteLength": natural, "byteStride": natural,
        "count": natural, "mode": one_of(*meshopt.MODES), "filter": one_of(*meshopt.FILTERS),
    },
    ("buffer", "byteLength", "byteStride", "count", "mode"),
)  # fmt: skip
PRIMITIVE = record(
    {
        "attributes": mapping(index("accessors")),
        "indices": index("accessors"),
        "material": index("materials"),
        "mode": one_of(0, 1, 2, 3, 4, 5, 6),
        "targets": list_of(mapping(index("accessors"))),
        "extensions": record({"KHR_draco_mesh_compression": DRACO}),
    },
    ("attributes",),
)
MATERIAL = record(
    {
        "name": text,
        "doubleSided": flag,
        "pbrMetallicRoughness": record({"baseColorFactor": numbers(4), "baseColorTexture": TEXTURE}),
    }
)
CHANNEL = record(
    {"sampler": natural, "target": record({"node": index("nodes"), "path": text}, ("path",))}, ("sampler", "target")
)
SAMPLER = record(
    {
        "input": index("accessors"),
        "output": index("accessors"),
        "interpolation": one_of("LINEAR", "STEP", "CUBICSPLINE"),
    },
    ("input", "output"),
)
DOCUMENT = record(
    {
        "asset": record({"version": text, "minVersion": text, "copyright": text}, ("version",)),
        "extensionsUsed": list_of(text),
        "extensionsRequired": list_of(text),
        "scene": index("scenes"),
        "scenes": list_of(record({"nodes": list_of(index("nodes")), "name": text})),
        "nodes": list_of(NODE),
        "meshes": list_of(
            record({"primitives": list_of(PRIMITIVE), "name": text, "weights": list_of(number)}, ("primitives",))
        ),
        "skins": list_of(
            record(
                {
                    "joints": list_of(index("nodes"), at_least=1),
                    "inverseBindMatrices": index("accessors"),
                    "skeleton": index("nodes"),
                    "name": text,
                },
                ("joints",),
            )
        ),
        "animations": list_of(
            record({"channels": list_of(CHANNEL), "samplers": list_of(SAMPLER), "name": text}, ("channels", "samplers"))
        ),
        "materials": list_of(MATERIAL),
        "textures": list_of(record({"source": index("images")})),
        "images": list_of(record({"uri": text, "bufferView": index("bufferViews"), "mimeType": text})),
        "accessors": list_of(ACCESSOR),
        "bufferViews": list_of(
            record(
                {
                    "buffer": index("buffers"),
                    "byteOffset": natural,
                    "byteLength": natural,
                    "byteStride": natural,
                    "extensions": record(dict.fromkeys(meshopt.EXTENSIONS, MESHOPT)),
                },
                ("buffer", "byteLength"),
            )
        ),
        "buffers": list_of(record({"uri": text, "byteLength": natural}, ("byteLength",))),
    },
    ("asset",),
)


def check(document: Any) -> None:
    """Raises `Wrong` (problem and place) where the document is not of the form that glTF 2.0 prescribes."""
    if type(document) is not dict:
        raise Wrong(f"the JSON must be an object, received {shown(document)}")
    # `index` rules count the top-level lists, so these must be lists before anything else is looked at.
    for kind in ("nodes", "meshes", "skins", "materials", "textures", "images", "accessors", "bufferViews", "buffers",
                 "scenes"):  # fmt: skip
        if kind in document and type(document[kind]) is not list:
            raise Wrong(f"must be a list, received {shown(document[kind])}", kind)
    DOCUMENT(document, document)
    for number_, animation in enumerate(document.get("animations", ())):
        count = len(animation["samplers"])
        for position, channel in enumerate(animation["channels"]):
            if channel["sampler"] >= count:
                place = f"animations[{number_}].channels[{position}].sampler"
                raise Wrong(f"names number {channel['sampler']} of {count} samplers", place)
