"""Run by an interpreter that has bpy: what Blender makes of a glTF file.

    python blender_shows.py FILE CLIP SECONDS,SECONDS,... OUT.npz

Writes, for every instant, the world positions of all bone heads (array 'joints', names in 'names') and of all vertices
of each mesh object (arrays named by the object), turned back from Blender's Z-up to glTF's Y-up.
"""

import os
import sys

import bpy
import numpy as np


def y_up(points):
    return np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)


path, clip, seconds, out = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = 30
bpy.ops.import_scene.gltf(filepath=path)
action = bpy.data.actions[clip]
armatures = [each for each in bpy.data.objects if each.type == "ARMATURE"]
for each in armatures:
    for track in each.animation_data.nla_tracks:
        track.mute = True
    each.animation_data.action = action
    if hasattr(action, "slots"):
        each.animation_data.action_slot = action.slots[0]
found = {}
for instant in map(float, seconds.split(",")):
    frame = instant * scene.render.fps
    scene.frame_set(int(frame), subframe=frame - int(frame))
    graph = bpy.context.evaluated_depsgraph_get()
    heads = [each.matrix_world @ bone.head for each in armatures for bone in each.evaluated_get(graph).pose.bones]
    found.setdefault("joints", []).append(y_up(np.array(heads)))
    for each in bpy.data.objects:
        if each.type != "MESH" or each.name.startswith("Icosphere"):
            continue
        shown = each.evaluated_get(graph)
        mesh = shown.to_mesh()
        points = np.empty(len(mesh.vertices) * 3)
        mesh.vertices.foreach_get("co", points)
        world = np.array(shown.matrix_world)
        found.setdefault(each.name, []).append(y_up(points.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]))
        shown.to_mesh_clear()
names = [bone.name for each in armatures for bone in each.pose.bones]
np.savez(out, names=np.array(names), **{key: np.array(value) for key, value in found.items()})
sys.stdout.flush()
os._exit(0)  # leaving normally, bpy may crash on its way out
