"""Materials of an FBX file with their pictures, as materials of a GLB. Runs in the child.

A picture is the file's own where it carries one (embedded), else a file inside the folder of the FBX file or below it:
where the file says that it lies, then by its name alone beside the file, in `textures`, and in the `.fbm` folder into
which Autodesk's importers put them. Paths of the artist's own disk are common, so names alone count as well.
"""

from __future__ import annotations

import os
from typing import Any

from retarget.io.fbx_scene import hold, items
from retarget.io.glb import Glb
from retarget.io.pictures import picture_beside, picture_kind

GREY, WHITE = [0.8, 0.8, 0.8], [1.0, 1.0, 1.0]


class Looks:
    """Materials of the GLB: one for each of the file's, in their order."""

    def __init__(self, glb: Glb, materials: list[Any], source: str, notes: list[str]) -> None:
        self.glb, self.notes = glb, notes
        self.home = os.path.realpath(os.path.dirname(source))
        self.stem = os.path.splitext(os.path.basename(source))[0]
        self.looked: set[str] = set()
        """Files beside it that were looked for."""
        self.textures: dict[bytes, int] = {}
        """The GLB's texture of each picture."""
        self.known: dict[int, int | None] = {}
        """The GLB's texture of each of the file's; None for one that is left out."""
        self.uv_sets: dict[int, set[str]] = {}
        """The names of the coordinates that the pictures of each of the GLB's materials lie on, read or not."""
        self.numbers = {material.element_id: self._add(material) for material in materials}
        """The GLB's material of each of the file's."""

    def of_node(self, node: Any) -> list[int]:
        """The GLB's materials that the faces of a node's mesh count through."""
        return [self.numbers[material.element_id] for material in items(node.materials)]

    def _add(self, material: Any) -> int:
        pbr = hold(material.pbr)
        sets: set[str] = set()
        base, relief = hold(pbr.base_color), hold(pbr.normal_map)
        picture, bumps = self._texture(base, material.name, sets), self._texture(relief, material.name, sets)
        color = [float(part) for part in hold(base.value_vec4)][:3] if base.has_value else GREY
        if picture is not None:
            color = WHITE  # in FBX a picture stands in a colour's place
        clipped = [min(max(part, 0.0), 1.0) for part in color]
        look: dict[str, Any] = {"baseColorFactor": [*clipped, 1.0], "metallicFactor": 0.0}
        entry: dict[str, Any] = {"name": material.name, "pbrMetallicRoughness": look}
        if picture is not None:
            look["baseColorTexture"] = {"index": picture}
        if bumps is not None:
            entry["normalTexture"] = {"index": bumps}
        number = self.glb.append("materials", entry)
        self.uv_sets[number] = sets
        return number

    def _texture(self, shown: Any, material: str, sets: set[str]) -> int | None:
        """The GLB's texture for what a material shows in one place; the name of its coordinates goes into `sets`."""
        texture = hold(shown.texture)
        if texture is None or not shown.texture_enabled:
            return None
        files = items(texture.file_textures)
        if not files:
            self.notes.append(f"the material {material!r} shows a texture without a picture, which is left out")
            return None
        if len(files) > 1:
            self.notes.append(f"of {len(files)} pictures in one layered texture of {material!r} only the first is shown")
        chosen = files[0]
        sets.add(chosen.uv_set)
        if chosen.has_uv_transform:
            self.notes.append(f"a texture of the material {material!r} is moved or scaled on it, which is left out")
        if chosen.element_id not in self.known:
            self.known[chosen.element_id] = self._picture(chosen)
        return self.known[chosen.element_id]

    def _picture(self, texture: Any) -> int | None:
        video = hold(texture.video)
        sources = [texture] if video is None else [texture, video]
        paths = [path.replace("\\", "/") for each in sources for path in (each.relative_filename, each.filename, each.absolute_filename)]
        name = next((base for base in map(os.path.basename, paths) if base), "")
        data = next((content for content in (bytes(each.content) for each in sources) if content), None)
        if data is None:
            guesses = [name, f"textures/{name}", f"{self.stem}.fbm/{name}"] if name else []
            data = picture_beside(self.home, [*paths, *guesses], self.looked)
        if data is None:
            self.notes.append(f"the picture {name[:80]!r} is neither in the file nor in its folder, and is left out")
            return None
        if data not in self.textures:
            kind = picture_kind(data)
            if kind is None:
                self.notes.append(f"the picture {name[:80]!r} is neither PNG nor JPEG, or too large, and is left out")
                return None
            self.textures[data] = self.glb.add_picture(data, kind)
        return self.textures[data]
