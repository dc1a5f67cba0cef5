"""Mesh sequences in glTF: a mesh whose morph targets are its frames (specification 3.7.2.2 and 3.11)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from retarget.character import Mesh, MeshMotion, PointMotion
from retarget.errors import FileError
from retarget.io.gltf_build import add_mesh
from retarget.io.gltf_clips import key_times
from retarget.io.gltf_document import Document
from retarget.io.gltf_draft import Draft, write_files
from retarget.io.gltf_nodes import NodeTree
from retarget.io.timeline import timeline

Array = np.ndarray

LARGEST = 1 << 31
"""Bytes of vertices that are held at most."""
BLOCK = 1 << 22
"""Numbers that are worked on at a time: in double precision all frames would take several times the memory."""
VERTEX_DATA = 34962
POINTS = 0
"""The mode of a primitive without edges."""


def animates_weights(document: Document) -> bool:
    """Whether some animation moves morph targets."""
    return any(
        channel["target"]["path"] == "weights" and "node" in channel["target"]
        for animation in document.entries("animations")
        for channel in animation["channels"]
    )


def read_sequence(document: Document, tree: NodeTree, mesh: Mesh) -> MeshMotion | None:
    """The first animation of morph targets, sampled on an even grid; None where the mesh that moves is not the whole
    surface, whose places in the world `mesh` holds, with targets that all its primitives share. Raises `FileError` for keys
    that claim more frames than can be held, and for weights and targets of other numbers."""
    animation, channel = next(
        (animation, channel)
        for animation in document.entries("animations")
        for channel in animation["channels"]
        if channel["target"]["path"] == "weights" and "node" in channel["target"]
    )
    node = channel["target"]["node"]
    shown = [number for number, each in enumerate(document.json["nodes"]) if "mesh" in each]
    primitives = document.json["meshes"][document.json["nodes"][node]["mesh"]]["primitives"] if node in shown else []
    if shown != [node] or not primitives[0].get("targets"):
        return None
    own = [(each["attributes"].get("POSITION"), each.get("targets")) for each in primitives]
    if any(each != own[0] for each in own) or own[0][0] is None:
        return None
    targets = [target["POSITION"] for target in primitives[0]["targets"] if "POSITION" in target]
    if len(targets) != len(primitives[0]["targets"]):
        return None
    sampler = animation["samplers"][channel["sampler"]]
    times = key_times(document, sampler["input"])
    grid = timeline(times)
    if grid.frames * len(targets) > document.room:
        problem = f"the sequence claims {grid.frames / grid.fps:.3g} seconds, more than its data can fill"
        raise document.fail(problem, f"accessors[{sampler['input']}]")
    if 12 * len(mesh.vertices) * grid.frames > LARGEST:
        problem = f"the sequence has {grid.frames} frames of {len(mesh.vertices)} vertices; up to {LARGEST} bytes of them are read"
        raise document.fail(problem, f"accessors[{sampler['input']}]")
    weights = _weights(document, sampler, times, grid.times, len(targets))
    base = document.floats(primitives[0]["attributes"]["POSITION"], ("VEC3",))
    if len(base) != len(mesh.vertices) or 12 * len(base) * 2 * len(targets) > LARGEST:
        return None
    moves = [document.floats(target, ("VEC3",)) for target in targets]
    for target, move in zip(targets, moves):
        if len(move) != len(base):
            raise document.fail(f"a morph target has {len(move)} vertices for {len(base)}", f"accessors[{target}]")
    world = tree.world[node]
    moves, places = np.stack(moves), np.empty((grid.frames, *base.shape), np.float32)
    block = max(1, BLOCK // base.size)
    for start in range(0, grid.frames, block):
        moved = base + np.tensordot(weights[start : start + block], moves, axes=1)
        places[start : start + block] = moved @ world[:3, :3].T + world[:3, 3]
    return MeshMotion(mesh, places, grid.fps, animation.get("name") or document.path.stem)


def _weights(
    document: Document, sampler: dict[str, Any], times: Array, at: Float[Array, "frames"], targets: int
) -> Float[Array, "frames targets"]:
    """Weights of all targets at some times. Raises `FileError` for another number of values than keys and targets need."""
    mode = sampler.get("interpolation", "LINEAR")
    rows = document.floats(sampler["output"], ("SCALAR",))[:, 0]
    if len(rows) != len(times) * targets * (3 if mode == "CUBICSPLINE" else 1):
        raise document.fail(
            f"has {len(rows)} weights for {len(times)} keys of {targets} morph targets", f"accessors[{sampler['output']}]"
        )
    if mode == "CUBICSPLINE":
        rows = rows.reshape(len(times), 3, targets)[:, 1]  # the keys themselves; tangents matter between frames only
    values = rows.reshape(len(times), targets)
    if mode == "STEP":
        return values[np.clip(np.searchsorted(times, at + 1e-6, side="right") - 1, 0, len(times) - 1)]
    return np.stack([np.interp(at, times, column) for column in values.T], axis=1)


def save_sequence(path: str | Path, motion: MeshMotion) -> None:
    """Write a mesh sequence as .glb or .gltf: every frame but the first is a morph target, and the animation goes from each
    to the next. Raises `FileError` where it cannot be written."""
    path = Path(path)
    if path.suffix.lower() not in (".glb", ".gltf"):
        raise FileError(path, f"glTF is written as .glb or .gltf, received the suffix {path.suffix!r}")
    draft, name = Draft.empty(), motion.name or "sequence"
    mesh = add_mesh(draft, motion.mesh, motion.vertices[0].astype(np.float64), None, None, name)
    _write_moving(path, draft, mesh, motion.vertices, motion.fps, name)


def save_points(path: str | Path, motion: PointMotion) -> None:
    """Write points over time, the same ones on each frame, as a mesh of points with a morph target a frame. Raises `FileError`
    for frames of different numbers of points, or without any, and where it cannot be written."""
    path, counts = Path(path), {len(cloud) for cloud in motion.clouds}
    if len(counts) > 1 or counts == {0}:
        raise FileError(path, f"a .glb holds the same points on every frame; these have {min(counts)} to {max(counts)}")
    draft, name, places = Draft.empty(), motion.name or "points", np.stack(motion.clouds)
    position = draft.add_accessor(places[0], bounds=True, target=VERTEX_DATA)
    mesh = draft.add("meshes", {"name": name, "primitives": [{"attributes": {"POSITION": position}, "mode": POINTS}]})
    _write_moving(path, draft, mesh, places, motion.fps, name)


def _write_moving(
    path: Path, draft: Draft, mesh: int, places: Float32[Array, "frames vertices 3"], fps: float, name: str
) -> None:
    """Give a mesh of the draft a morph target for every frame after the first, an animation from each to the next, and write."""
    moves = places[1:] - places[:1]
    targets = [{"POSITION": draft.add_accessor(each, bounds=True, target=VERTEX_DATA)} for each in moves]
    node: dict[str, Any] = {"name": name, "mesh": mesh}
    if targets:
        entry = draft.json["meshes"][mesh]
        entry["primitives"] = [{**each, "targets": targets} for each in entry["primitives"]]
        entry["weights"] = [0.0] * len(targets)
        times = (np.arange(len(places)) / fps).astype(np.float32)[:, None]
        weights = np.eye(len(places), dtype=np.float32)[:, 1:].reshape(-1, 1)
        sampler = {"input": draft.add_accessor(times, bounds=True), "output": draft.add_accessor(weights)}
        channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
        draft.add("animations", {"name": name, "samplers": [sampler], "channels": [channel]})
    draft.add("nodes", node)
    draft.add("scenes", {"nodes": [0]})
    draft.json["scene"] = 0
    write_files(draft.gltf(path) if path.suffix.lower() == ".gltf" else draft.glb(path))
