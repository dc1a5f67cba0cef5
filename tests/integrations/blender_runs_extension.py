"""Run by an interpreter that has bpy: the extension puts the action of one character onto another.

    python blender_runs_extension.py SOURCE.glb TARGET.glb OUT.npz STATUE.glb

Writes where the target's bones are on every frame ('names', 'places': frames bones 3, +Y up), what stood wrong ('said'), what
was left in the scene ('objects'), the rest matrices of the target's bones before and after, and how a bare mesh came back
('rigged', its bones on two frames 'moving', its 'faces', whether the bare one is 'hidden').
"""

import os
import sys
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "integrations"))
import blender as extension  # noqa: E402


def imported(path):
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=path)
    return next(each for each in set(bpy.data.objects) - before if each.type == "ARMATURE")


def imported_mesh(path):
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=path)
    return next(each for each in set(bpy.data.objects) - before if each.type == "MESH")


source_path, target_path, out = sys.argv[1:4]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 30
source, target = imported(source_path), imported(target_path)
roll = np.array([bone.matrix_local for bone in target.data.bones])
extension.register()
settings = bpy.context.scene.retarget
settings.source, settings.target = source, target
target.pose.bones[3].rotation_mode = "XYZ"
objects = {each.name for each in bpy.data.objects}
done = bpy.ops.retarget.run()
action = target.animation_data.action
first, last = (round(frame) for frame in action.frame_range)
places = []
for frame in range(first, last + 1):
    bpy.context.scene.frame_set(frame)
    bpy.context.view_layer.update()
    places.append([(target.matrix_world @ bone.matrix).translation[:] for bone in target.pose.bones])
x, y, z = np.moveaxis(np.array(places), -1, 0)
said = ""
settings.target = source
try:
    bpy.ops.retarget.run()
except RuntimeError as error:
    said = str(error)
left = sorted({each.name for each in bpy.data.objects} ^ objects)
statue = imported_mesh(sys.argv[4])
settings.source, settings.target = source, statue
rigged = bpy.ops.retarget.run()
made = bpy.data.objects.get(f"{statue.name} rig")
moving = []
for frame in (1, 10):
    bpy.context.scene.frame_set(frame)
    bpy.context.view_layer.update()
    moving.append([(made.matrix_world @ bone.matrix).translation[:] for bone in made.pose.bones])
skinned = [each for each in bpy.data.objects if each.type == "MESH" and each.find_armature() == made]
hidden = statue.hide_get()
extension.unregister()
np.savez(
    out,
    names=np.array([bone.name for bone in target.pose.bones]),
    places=np.stack([x, z, -y], axis=-1),
    done=np.array(sorted(done)),
    action=action.name,
    said=said,
    left=np.array(left),
    rigged=np.array(sorted(rigged)),
    moving=np.array(moving),
    faces=sum(len(each.data.polygons) for each in skinned),
    hidden=hidden,
    roll=np.abs(np.array([bone.matrix_local for bone in target.data.bones]) - roll).max(),
)
sys.stdout.flush()
os._exit(0)
