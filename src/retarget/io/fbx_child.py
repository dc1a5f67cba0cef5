"""Runs in a process of its own (`child.py`): one FBX file, read by ufbx, written as the GLB it would be.

Every node of the file becomes one of the GLB; what shows is added by `fbx_surface.py` with `fbx_looks.py` and
`fbx_shapes.py`, what moves by `fbx_takes.py`.
"""

from __future__ import annotations

from typing import Any

from retarget.io.fbx_looks import Looks
from retarget.io.fbx_scene import hold, items, open_scene
from retarget.io.fbx_surface import add_mesh
from retarget.io.fbx_takes import add_takes
from retarget.io.glb import Glb


def work(source: str, output: str) -> dict[str, Any]:
    """Write the GLB; returns what the file says of itself. Raises `Refused` for more than anyone would make."""
    scene = open_scene(source)
    settings = hold(scene.settings)
    glb, nodes, notes = Glb(), items(scene.nodes), []
    number = {node.element_id: place for place, node in enumerate(nodes)}
    roots = [place for place, node in enumerate(nodes) if node.is_root]
    glb.json |= {"scene": 0, "scenes": [{"nodes": roots}]}
    for place, node in enumerate(nodes):
        glb.append("nodes", _node(node, place, number))
    looks = Looks(glb, items(scene.materials), source, notes)
    morphs = []
    for place, node in enumerate(nodes):
        mesh = hold(node.mesh)
        if mesh is not None and mesh.num_vertices and mesh.num_indices:
            morphs += add_mesh(glb, place, node, mesh, number, looks, notes)
    bones = [place for place, node in enumerate(nodes) if hold(node.bone) is not None]
    if bones:  # all of them, as in Blender: those that move no vertex hold skeletons together and end their limbs
        glb.append("skins", {"joints": bones})
    fps = float(settings.frames_per_second) or 30.0
    add_takes(glb, items(scene.anim_stacks), nodes, morphs, fps)
    glb.write(output)
    version = int(hold(scene.metadata).version)
    return {
        "version": version, "fps": fps, "notes": list(dict.fromkeys(notes)), "beside": sorted(looks.looked),
        "unit_m": float(settings.original_unit_meters), "up": hold(settings.original_axis_up).name,
    }  # fmt: skip


def _node(node: Any, place: int, number: dict[int, int]) -> dict[str, Any]:
    transform = hold(node.local_transform)
    entry: dict[str, Any] = {
        "name": node.name or ("root" if node.is_root else f"node_{place}"),
        "translation": list(transform.translation), "rotation": list(transform.rotation), "scale": list(transform.scale),
    }  # fmt: skip
    children = [number[child.element_id] for child in items(node.children)]
    return entry | ({"children": children} if children else {})
