"""Run by an interpreter that has bpy: where Blender's import of an FBX file puts all joints on every frame of its takes.

    python blender_reads_fbx.py FILE OUT.npz

Writes 'names', 'takes', and for the take number n the world positions of all bone heads, array 'n' (frames joints 3), turned
back from Blender's Z-up to Y-up.
"""

import os
import sys

import bpy
import numpy as np

path, out = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.fbx_import(filepath=path)
armature = next(each for each in bpy.data.objects if each.type == "ARMATURE")
takes = list(bpy.data.actions)
found = {"names": np.array([bone.name for bone in armature.pose.bones]), "takes": np.array([take.name for take in takes])}
for number, take in enumerate(takes):
    armature.animation_data_create().action = take
    armature.animation_data.action_slot = next(slot for slot in take.slots if slot.target_id_type == "OBJECT")
    first, last = (round(frame) for frame in take.frame_range)
    places = []
    for frame in range(first, last + 1):
        bpy.context.scene.frame_set(frame)
        bpy.context.view_layer.update()
        places.append([(armature.matrix_world @ bone.matrix).translation[:] for bone in armature.pose.bones])
    x, y, z = np.moveaxis(np.array(places), -1, 0)
    found[str(number)] = np.stack([x, z, -y], axis=-1)
np.savez(out, **found)
sys.stdout.flush()
os._exit(0)
