"""Base colours of a USD stage and their pictures, as materials of a GLB. Runs in the child.

Colours are the constant inputs of a UsdPreviewSurface, or the mesh's display colour. A picture (UsdUVTexture) is read
where it is a PNG or JPEG inside the file's folder or package, and where each point has one texture coordinate: points
keep their number and order, so those on seams, which have several, are not taken apart.
"""

from __future__ import annotations

import os
import zipfile
from typing import Any

import numpy as np

from retarget.io.child import Refused
from retarget.io.glb import Glb
from retarget.io.pictures import is_inside, picture_kind
from retarget.io.usd_assets import read_asset

GREY = (0.8, 0.8, 0.8)
LEFT_OUT = (
    "textures are left out where a point has several coordinates, "
    "or the picture is no PNG or JPEG inside the file's folder"
)


def first(attribute: Any) -> Any:
    """An attribute's value at the first time there is; None where it has none."""
    from pxr import Usd

    return attribute.Get(Usd.TimeCode.EarliestTime()) if attribute else None


class Looks:
    """Materials of the GLB, made as meshes ask for them."""

    def __init__(self, glb: Glb, home: str, notes: list[str]) -> None:
        self.glb, self.home, self.notes = glb, home, notes
        self.pictures: dict[str, int | None] = {}
        """The GLB's texture of each file."""

    def of_faces(
        self, mesh: Any, faces: int, corners: np.ndarray, points: int
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """The GLB's material of each face (the mesh's, or that of the subset it lies in), and texture coordinates of
        the points where a picture is shown. Raises `Refused` for a subset with other faces than the mesh has."""
        from pxr import UsdGeom, UsdShade

        uvs: dict[str, np.ndarray | None] = {}

        def mapped(name: str) -> bool:
            """Whether the pictures' coordinates of that name can be had; one mesh has one set."""
            if not uvs:
                uvs[name] = self._coordinates(mesh, name, corners, points)
            return uvs.get(name) is not None

        materials = np.full(faces, self._material(mesh, mesh.GetPrim(), mapped), dtype=np.int64)
        for subset in UsdShade.MaterialBindingAPI(mesh.GetPrim()).GetMaterialBindSubsets():
            if str(first(subset.GetElementTypeAttr())) != UsdGeom.Tokens.face:
                continue
            own = np.array(first(subset.GetIndicesAttr()) or (), dtype=np.int64)
            if len(own) and not 0 <= own.min() <= own.max() < faces:
                raise Refused(f"the subset {subset.GetPath()} names face {int(own.max())} of {faces}")
            materials[own] = self._material(mesh, subset.GetPrim(), mapped)
        return materials, next(iter(uvs.values()), None)

    def _material(self, mesh: Any, prim: Any, mapped: Any) -> int:
        """Number of the GLB's material for what is bound to a prim."""
        from pxr import UsdShade

        bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        name, alpha, color, texture = "", 1.0, _display_color(mesh), None
        if bound:
            name = bound.GetPrim().GetName()
            shader = bound.ComputeSurfaceSource()[0]
            if shader:
                alpha = _clipped(_constant(shader, "opacity"), 1, [1.0])[0]
                picture = _source(shader, "diffuseColor")
                if picture is None:
                    color = _clipped(_constant(shader, "diffuseColor"), 3, color)
                else:
                    color = _clipped(_constant(picture, "scale"), 3, [1.0] * 3)
                    texture = self._texture(picture) if mapped(_coordinate_name(picture)) else None
                    if texture is None:
                        self.notes.append(LEFT_OUT)
        look: dict[str, Any] = {"baseColorFactor": [*color, alpha], "metallicFactor": 0.0}
        if texture is not None:
            look["baseColorTexture"] = {"index": texture}
        entry = {"name": name, "doubleSided": bool(first(mesh.GetDoubleSidedAttr())), "pbrMetallicRoughness": look}
        known = self.glb.json.setdefault("materials", [])
        if entry not in known:
            known.append(entry)
        return known.index(entry)

    def _texture(self, shader: Any) -> int | None:
        """The GLB's texture of a UsdUVTexture's picture; None where it may not or cannot be read."""
        given = _constant(shader, "file")
        place = getattr(given, "resolvedPath", "")
        if place not in self.pictures:
            self.pictures[place] = self._picture(place)
        return self.pictures[place]

    def _picture(self, place: str) -> int | None:
        outer, _, inner = place.partition("[")
        real = os.path.realpath(outer) if outer else ""
        if not is_inside(real, self.home) or not os.path.isfile(real):
            return None
        try:
            data = read_asset(real, inner.removesuffix("]"))
        except (OSError, zipfile.BadZipFile):
            return None
        kind = picture_kind(data or b"")
        return None if kind is None else self.glb.add_picture(data, kind)

    def _coordinates(self, mesh: Any, name: str, corners: np.ndarray, points: int) -> np.ndarray | None:
        """Texture coordinates (points, 2) from the top left; None where there are none, or several for one point."""
        from pxr import UsdGeom

        if not name:
            return None
        primvar = UsdGeom.PrimvarsAPI(mesh.GetPrim()).FindPrimvarWithInheritance(name)
        values = primvar.ComputeFlattened() if primvar and primvar.HasAuthoredValue() else None
        try:
            rows = np.array(values if values is not None else (), dtype=np.float64).reshape(-1, 2) * [1, -1] + [0, 1]
        except (TypeError, ValueError):
            return None
        if not len(rows) or not np.isfinite(rows).all() or np.abs(rows).max() > 1e6:
            return None
        kind = str(primvar.GetInterpolation())
        if kind in ("vertex", "varying"):
            return rows if len(rows) == points else None
        if kind != "faceVarying" or len(rows) != len(corners):
            return None
        uvs = np.zeros((points, 2))
        uvs[corners] = rows
        return uvs if np.abs(uvs[corners] - rows).max() < 1e-6 else None


def _display_color(mesh: Any) -> list[float]:
    """The colour of the whole mesh; grey where it has none, or one for each point or face."""
    primvar = mesh.GetDisplayColorPrimvar()
    value = first(primvar.GetAttr()) if primvar else None
    return list(GREY) if value is None or len(value) != 1 else _clipped(value[0], 3, list(GREY))


def _producer(shader: Any, name: str) -> Any:
    """The attribute that an input has its value from, through the interfaces that hand it on; None without one."""
    from pxr import UsdShade

    given = shader.GetInput(name)
    sources = UsdShade.Utils.GetValueProducingAttributes(given) if given else []
    return sources[0] if sources else None


def _is_output(attribute: Any) -> bool:
    from pxr import UsdShade

    return UsdShade.Utils.GetType(attribute.GetName()) == UsdShade.AttributeType.Output


def _constant(shader: Any, name: str) -> Any:
    """The value of an input that no other shader computes; None otherwise."""
    producer = _producer(shader, name)
    return None if producer is None or _is_output(producer) else first(producer)


def _source(shader: Any, name: str) -> Any:
    """The shader that computes an input; None where it is constant."""
    from pxr import UsdShade

    producer = _producer(shader, name)
    return UsdShade.Shader(producer.GetPrim()) if producer is not None and _is_output(producer) else None


def _coordinate_name(picture: Any) -> str:
    """The primvar that a picture's coordinates are read from; "" for one that is computed in another way."""
    if str(first(picture.GetIdAttr())) != "UsdUVTexture":
        return ""
    reader = _source(picture, "st")
    if reader is None:
        return "st"
    if str(first(reader.GetIdAttr())) != "UsdPrimvarReader_float2":
        return ""
    return str(_constant(reader, "varname") or "st")


def _clipped(value: Any, width: int, otherwise: list[float]) -> list[float]:
    """The first `width` numbers of a value, within 0 and 1; `otherwise` where they are none."""
    try:
        numbers = np.atleast_1d(np.array(value, dtype=np.float64)).ravel()
    except (TypeError, ValueError):
        return otherwise
    if len(numbers) < width or not np.isfinite(numbers[:width]).all():
        return otherwise
    return np.clip(numbers[:width], 0.0, 1.0).tolist()
