"""Small ASCII FBX 7.4 files for tests: a strip of a mesh on two bones, in any unit and axes, with takes, a picture on it and blend shapes."""

import base64
from dataclasses import dataclass

import numpy as np

SECOND = 46186158000
"""Ticks of FBX time."""
AXES = {"y": (1, 2, 0), "z": (2, 1, 0)}
"""Up, front and right of the header's `UpAxis`, `FrontAxis`, `CoordAxis`."""


def strip(rows=5, length=2.0):
    """Vertices and quads of a strip that stands on the ground, one unit wide, bending weights."""
    heights = np.linspace(0, length, rows)
    vertices = np.array([[x, y, 0.0] for y in heights for x in (-0.5, 0.5)])
    quads = [(2 * r, 2 * r + 1, 2 * r + 3, 2 * r + 2) for r in range(rows - 1)]
    return vertices, quads, np.clip(heights / length, 0, 1).repeat(2)


@dataclass
class Picture:
    """A picture on the strip, each quad of which shows the whole of it: all vertices but those at the ends lie on seams."""

    content: bytes = b""
    """Embedded, where there is any."""
    relative: str = "paint.png"
    absolute: str = "C:\\\\nowhere\\\\paint.png"
    slot: str = "DiffuseColor"
    uv: float = 1.0
    """How often it repeats."""
    uv_set: str = "map1"
    """Of the two sets that the strip has, map1 and map2, the one that it says it lies on."""
    scale: float = 1.0
    """Of the texture itself."""


@dataclass
class Shapes:
    """A channel of blend shapes: the n-th moves the upper end n + 1 units along z, and is full at its weight (per cent)."""

    full: tuple[float, ...] = (100.0,)
    rest: float = 0.0
    """Per cent without animation."""
    end: float | None = None
    """Per cent that every take reaches, from `rest`; without one nothing is animated."""
    vertices: tuple[int, ...] = (8, 9)


def document(
    unit=1.0, up="y", takes=(("Take 001", 30.0),), pre_rotation=(0, 0, 0), color=(0.2, 0.4, 0.6), ranged=True,
    picture=None, shapes=None, bones=True,
):  # fmt: skip
    """The text of a file. `unit` in centimetres; a take is (name, degrees that the upper bone bends about x in a second),
    and says from when to when it lasts where it is `ranged`; without `bones` no joint moves anything."""
    vertices, quads, upper = strip()
    axis = {"y": (1, 1, 2, 1, 0, 1), "z": (2, 1, 1, -1, 0, 1)}[up]
    polygons = ",".join(str(corner if place < 3 else -corner - 1) for quad in quads for place, corner in enumerate(quad))
    out = [
        "; FBX 7.4.0 project file",
        "FBXHeaderExtension: {\n FBXHeaderVersion: 1003\n FBXVersion: 7400\n}",
        _settings(unit, axis),
        "Objects: {",
        _model(1, "Mesh", "Mesh", (0, 0, 0)),
        _model(2, "Lower", "LimbNode", (0, 0, 0)),
        _model(3, "Upper", "LimbNode", (0, 1, 0), pre_rotation),
        f' Geometry: 10, "Geometry::Strip", "Mesh" {{\n  Vertices: *{vertices.size} {{\n   a: {_numbers(vertices)}\n  }}\n'
        f"  PolygonVertexIndex: *{4 * len(quads)} {{\n   a: {polygons}\n  }}\n  GeometryVersion: 124\n"
        '  LayerElementMaterial: 0 {\n   Version: 101\n   Name: ""\n   MappingInformationType: "AllSame"\n'
        '   ReferenceInformationType: "IndexToDirect"\n   Materials: *1 {\n    a: 0\n   }\n  }\n'
        '  Layer: 0 {\n   Version: 100\n   LayerElement:  {\n    Type: "LayerElementMaterial"\n    TypedIndex: 0\n   }\n'
        f"{UV_LAYER if picture else ''}  }}\n{_coordinates(len(quads), picture) if picture else ''} }}",
        ' Material: 20, "Material::Skin", "" {\n  ShadingModel: "lambert"\n  Properties70:  {\n'
        f'   P: "DiffuseColor", "Color", "", "A",{_numbers(color)}\n  }}\n }}',
        ' Deformer: 30, "Deformer::Skin", "Skin" {\n  Version: 101\n }',
        _cluster(31, 1.0 - upper, (0, 0, 0)),
        _cluster(32, upper, (0, 1, 0), pre_rotation),
    ]
    links = [(1, 0), (2, 0), (3, 2), (10, 1), (20, 1), (30, 10), (31, 30), (32, 30), (2, 31), (3, 32)]
    curves = []
    if not bones:
        out = [part for part in out if "LimbNode" not in part and "Deformer" not in part]
        links = [(1, 0), (10, 1), (20, 1)]
    if picture:
        out += _texture(picture)
        links.append((41, 40))
        curves.append(f' C: "OP",40,20, "{picture.slot}"')
    if shapes:
        out += _shapes(shapes)
        links += [(60, 10), (61, 60), *((70 + number, 61) for number in range(len(shapes.full)))]
    lasts = f'   P: "LocalStart", "KTime", "Time", "",0\n   P: "LocalStop", "KTime", "Time", "",{SECOND}\n' if ranged else ""
    for number, (name, bend) in enumerate(takes):
        stack, layer, node, curve = (100 * (number + 1) + step for step in range(4))
        out += [
            f' AnimationStack: {stack}, "AnimStack::{name}", "" {{\n  Properties70:  {{\n{lasts}  }}\n }}',
            f' AnimationLayer: {layer}, "AnimLayer::Base", "" {{\n }}',
            f' AnimationCurveNode: {node}, "AnimCurveNode::R", "" {{\n  Properties70:  {{\n'
            '   P: "d|X", "Number", "", "A",0\n   P: "d|Y", "Number", "", "A",0\n   P: "d|Z", "Number", "", "A",0\n  }\n }',
            _curve(curve, 0, bend),
        ]
        links += [(layer, stack), (node, layer)]
        curves += [f' C: "OP",{node},3, "Lcl Rotation"', f' C: "OP",{curve},{node}, "d|X"'] if bones else []
        if shapes and shapes.end is not None:
            weight, keys = curve + 1, curve + 2
            out += [
                f' AnimationCurveNode: {weight}, "AnimCurveNode::DeformPercent", "" {{\n  Properties70:  {{\n'
                f'   P: "d|DeformPercent", "Number", "", "A",{shapes.rest}\n  }}\n }}',
                _curve(keys, shapes.rest, shapes.end),
            ]
            links.append((weight, layer))
            curves += [f' C: "OP",{weight},61, "DeformPercent"', f' C: "OP",{keys},{weight}, "d|DeformPercent"']
    out += ["}", "Connections: {", *(f' C: "OO",{child},{parent}' for child, parent in links), *curves, "}"]
    return "\n".join(out) + "\n"


UV_LAYER = (
    '   LayerElement:  {\n    Type: "LayerElementUV"\n    TypedIndex: 0\n   }\n  }\n'
    '  Layer: 1 {\n   Version: 100\n   LayerElement:  {\n    Type: "LayerElementUV"\n    TypedIndex: 1\n   }\n'
)


def _coordinates(quads, picture):
    corners = np.tile(np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * picture.uv, (quads, 1))
    return "".join(
        f'  LayerElementUV: {number} {{\n   Version: 101\n   Name: "map{number + 1}"\n   MappingInformationType: "ByPolygonVertex"\n'
        f'   ReferenceInformationType: "Direct"\n   UV: *{corners.size} {{\n    a: {_numbers(corners * (1 - number))}\n   }}\n  }}\n'
        for number in (0, 1)
    )


def _texture(picture):
    paths = f'  FileName: "{picture.absolute}"\n  RelativeFilename: "{picture.relative}"\n'
    content = f'  Content: , "{base64.b64encode(picture.content).decode()}"\n' if picture.content else ""
    return [
        f' Texture: 40, "Texture::paint", "" {{\n  Type: "TextureVideoClip"\n  Version: 202\n  Properties70:  {{\n'
        f'   P: "Scaling", "Vector", "", "A",{picture.scale},{picture.scale},1\n   P: "UVSet", "KString", "", "", "{picture.uv_set}"\n  }}\n{paths} }}',
        f' Video: 41, "Video::paint", "Clip" {{\n  Type: "Clip"\n{paths}{content} }}',
    ]


def _shapes(shapes):
    which, number = np.array(shapes.vertices), len(shapes.full)
    moved = [
        f' Geometry: {70 + step}, "Geometry::Bulge{step}", "Shape" {{\n  Version: 100\n  Indexes: *{len(which)} {{\n   a: {_numbers(which)}\n  }}\n'
        f"  Vertices: *{3 * len(which)} {{\n   a: {_numbers(np.tile([0, 0, step + 1], (len(which), 1)))}\n  }}\n }}"
        for step in range(number)
    ]
    return [
        ' Deformer: 60, "Deformer::", "BlendShape" {\n  Version: 100\n }',
        f' Deformer: 61, "SubDeformer::Bulge", "BlendShapeChannel" {{\n  Version: 100\n  DeformPercent: {shapes.rest}\n'
        f'  FullWeights: *{number} {{\n   a: {_numbers(shapes.full)}\n  }}\n  Properties70:  {{\n'
        f'   P: "DeformPercent", "Number", "", "A",{shapes.rest}\n  }}\n }}',
        *moved,
    ]


def _curve(number, start, end):
    """From one value to another in the first second."""
    return (
        f' AnimationCurve: {number}, "AnimCurve::", "" {{\n  Default: 0\n  KeyVer: 4008\n  KeyTime: *2 {{\n   a: 0,{SECOND}\n  }}\n'
        f"  KeyValueFloat: *2 {{\n   a: {start},{end}\n  }}\n  KeyAttrFlags: *1 {{\n   a: 4\n  }}\n"
        "  KeyAttrDataFloat: *4 {\n   a: 0,0,0,0\n  }\n  KeyAttrRefCount: *1 {\n   a: 2\n  }\n }"
    )


def _settings(unit, axis):
    names = ("UpAxis", "UpAxisSign", "FrontAxis", "FrontAxisSign", "CoordAxis", "CoordAxisSign")
    rows = [f'  P: "{name}", "int", "Integer", "",{value}' for name, value in zip(names, axis)]
    rows += [f'  P: "UnitScaleFactor", "double", "Number", "",{unit}', '  P: "TimeMode", "enum", "", "",6']
    return "GlobalSettings: {\n Version: 1000\n Properties70:  {\n" + "\n".join(rows) + "\n }\n}"


def _model(number, name, kind, translation, pre_rotation=(0, 0, 0)):
    rows = [f'   P: "Lcl Translation", "Lcl Translation", "", "A",{_numbers(translation)}']
    if any(pre_rotation):
        rows += ['   P: "RotationActive", "bool", "", "",1', f'   P: "PreRotation", "Vector3D", "Vector", "",{_numbers(pre_rotation)}']
    body = "\n".join(rows)
    return f' Model: {number}, "Model::{name}", "{kind}" {{\n  Version: 232\n  Properties70:  {{\n{body}\n  }}\n }}'


def _cluster(number, weights, place, turned=(0, 0, 0)):
    """A bone at `place`, turned by Euler angles about one axis at most, degrees."""
    which = np.flatnonzero(weights > 0)
    world = np.eye(4)
    axis = int(np.flatnonzero(turned)[0]) if any(turned) else 0
    a, b = (axis + 1) % 3, (axis + 2) % 3
    angle = np.radians(turned[axis])
    world[a, a] = world[b, b] = np.cos(angle)
    world[b, a], world[a, b] = np.sin(angle), -np.sin(angle)
    world[:3, 3] = place
    inverse = np.linalg.inv(world)
    return (
        f' Deformer: {number}, "SubDeformer::", "Cluster" {{\n  Version: 100\n  Indexes: *{len(which)} {{\n   a: {_numbers(which)}\n  }}\n'
        f"  Weights: *{len(which)} {{\n   a: {_numbers(weights[which])}\n  }}\n"
        f"  Transform: *16 {{\n   a: {_numbers(inverse.T)}\n  }}\n  TransformLink: *16 {{\n   a: {_numbers(world.T)}\n  }}\n }}"
    )


def _numbers(values):
    return ",".join(f"{value:.9g}" for value in np.asarray(values).ravel())
