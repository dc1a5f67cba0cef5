"""Run inside Blender, or by an interpreter that has bpy: an Alembic file becomes raw arrays, or raw arrays an Alembic file.

    blender --background --factory-startup --python alembic_child.py -- JOB.json

The job names the files and what is wanted; see `alembic.py`. Nothing of this package is imported here. What the file is to
blame for is told in the reply, `{"refused": a line}`; what else goes wrong is one line on the error stream.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections import Counter
from typing import Any

import bpy
import numpy as np

NO_SURFACES = {"EMPTY": "", "CURVE": "curves", "CURVES": "curves", "CAMERA": "cameras", "POINTCLOUD": "point clouds", "LIGHT": "lights"}
"""Objects that are left out, by type: what they are called."""


class Refused(Exception):
    """The file is to blame; the text is what the user reads."""


def main() -> None:
    with open(sys.argv[sys.argv.index("--") + 1], encoding="utf-8") as file:
        job = json.load(file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    render = bpy.context.scene.render  # its rate is a whole number over a base
    render.fps = max(1, round(job["fps"]))
    render.fps_base = render.fps / job["fps"]
    try:
        reply = {"told": {"read": read, "write": write}[job["do"]](job)}
    except Refused as refusal:
        reply = {"refused": str(refusal)}
    with open(job["reply"], "w", encoding="utf-8") as file:
        json.dump(reply, file)


def read(job: dict[str, Any]) -> dict[str, Any]:
    """Every frame's points into `job["points"]` (float32, +Y up), the triangles of the first into `job["faces"]` (int32)."""
    bpy.ops.wm.alembic_import(filepath=job["file"], set_frame_range=False, as_background_job=False)
    bodies = [each for each in bpy.context.scene.objects if each.type == "MESH"]
    bodies.sort(key=lambda each: each.name)
    others = Counter(NO_SURFACES.get(each.type, each.type.lower()) for each in bpy.context.scene.objects if each.type != "MESH")
    first: dict[str, tuple] = {}
    with open(job["points"], "wb") as points:
        for frame in range(job["frames"]):
            show(job["start"] + frame)
            graph = bpy.context.evaluated_depsgraph_get()
            for each in bodies:
                own = each.evaluated_get(graph)
                mesh = own.to_mesh()
                if frame == 0:
                    first[each.name] = topology(mesh)
                elif not same(topology(mesh), first[each.name]):
                    raise Refused(
                        f"the faces of {each.name!r} change at {(job['start'] + frame) / job['fps']:.3f} s: the frames of a mesh "
                        "sequence are one mesh; export it with the faces that it has first, or as still surfaces"
                    )
                places(mesh, own.matrix_world).tofile(points)
                own.to_mesh_clear()
            if frame == 0:
                check_size(job, first)
                triangles(bodies, graph).tofile(job["faces"])
    held = [name for name, (corners, _) in first.items() if len(corners)]
    total = sum(int(starts[-1]) for _, starts in first.values())
    left_out = [f"{count} {name}" if count > 1 else f"1 {name[:-1] if name.endswith('s') else name}" for name, count in sorted(others.items()) if name]
    return {"points": total, "meshes": len(held), "name": held[0], "left_out": left_out}


def show(frame: float) -> None:
    """Go to a frame, which may lie between two; whole ones are met without the error of sums."""
    whole = round(frame) if abs(frame - round(frame)) < 1e-5 else math.floor(frame)
    bpy.context.scene.frame_set(whole, subframe=min(max(frame - whole, 0.0), 0.999999))


def topology(mesh: Any) -> tuple[np.ndarray, np.ndarray]:
    """Vertices at the corners of all faces, and (one array) where each face begins with the number of vertices last."""
    corners = np.empty(len(mesh.loops), dtype=np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    starts = np.empty(len(mesh.polygons), dtype=np.int32)
    mesh.polygons.foreach_get("loop_start", starts)
    return corners, np.append(starts, np.int32(len(mesh.vertices)))


def same(one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other))


def check_size(job: dict[str, Any], first: dict[str, tuple]) -> None:
    total = sum(int(starts[-1]) for _, starts in first.values())
    if not any(len(corners) for corners, _ in first.values()):
        raise Refused("holds no mesh with faces on its first frame")
    if 12 * total * job["frames"] > job["largest"]:
        raise Refused(f"holds {job['frames']} frames of {total} vertices, more than is kept in memory at once")


def places(mesh: Any, T_world_mesh: Any) -> np.ndarray:
    """(vertices, 3) float32 in the world, with +Y up again as in the file."""
    local = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", local)
    matrix = np.array(T_world_mesh, dtype=np.float64)
    x, y, z = (local.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]).T
    found = np.stack([x, z, -y], axis=-1).astype(np.float32)
    if not np.isfinite(found).all():
        raise Refused(f"{mesh.name!r} has points that are not numbers")
    return found


def triangles(bodies: list[Any], graph: Any) -> np.ndarray:
    """(faces, 3) int32, the vertices of all bodies counted through."""
    parts, before = [np.zeros((0, 3), dtype=np.int32)], 0
    for each in bodies:
        own = each.evaluated_get(graph)
        mesh = own.to_mesh()
        mesh.calc_loop_triangles()
        corners = np.empty(3 * len(mesh.loop_triangles), dtype=np.int32)
        mesh.loop_triangles.foreach_get("vertices", corners)
        parts.append(corners.reshape(-1, 3) + before)
        before += len(mesh.vertices)
        own.to_mesh_clear()
    return np.concatenate(parts)


def write(job: dict[str, Any]) -> None:
    """One mesh, moved by a point cache: `job["cache"]` (PC2), faces and first places from raw files."""
    faces = np.fromfile(job["faces"], dtype=np.int32)
    points = np.fromfile(job["points"], dtype=np.float32)
    mesh = bpy.data.meshes.new(job["name"])
    mesh.vertices.add(len(points) // 3)
    mesh.vertices.foreach_set("co", points)
    mesh.loops.add(len(faces))
    mesh.loops.foreach_set("vertex_index", faces)
    mesh.polygons.add(len(faces) // 3)
    mesh.polygons.foreach_set("loop_start", np.arange(0, len(faces), 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    body = bpy.data.objects.new(job["name"], mesh)
    scene = bpy.context.scene
    scene.collection.objects.link(body)
    if job["frames"] > 1:
        cache = body.modifiers.new("cache", "MESH_CACHE")
        cache.cache_format, cache.filepath = "PC2", job["cache"]
        cache.interpolation, cache.frame_start = "NONE", 0.0
        cache.forward_axis, cache.up_axis = "POS_Y", "POS_Z"  # the cache has Blender's axes
    scene.frame_start, scene.frame_end = 0, job["frames"] - 1
    bpy.ops.wm.alembic_export(
        filepath=job["file"],
        start=0,
        end=job["frames"] - 1,
        selected=False,
        flatten=False,
        uvs=False,
        normals=False,
        face_sets=False,
        evaluation_mode="RENDER",
        as_background_job=False,
    )


try:
    main()
except BaseException as error:  # the parent tells the user one line
    sys.stderr.write(f"\n{type(error).__name__}: {' '.join(str(error).split())}\n")
    sys.stderr.flush()
    os._exit(3)
sys.stdout.flush()
os._exit(0)
