"""Run by an interpreter that has bpy: where Blender's imports of an FBX file put all joints on every frame of its takes.

    python blender_reads_fbx.py FILE OUT.npz

Writes 'names', 'takes', and for the take number n the world positions of all bone heads, array 'n' (frames joints 3), turned
back from Blender's Z-up to Y-up. Blender has two importers, which disagree on some files; what the older one (in Python)
says of the same take is the array 'n_older', where it reads the file and names the same bones.
"""

import os
import sys

import bpy
import numpy as np


def places_of(armature, take):
    """World positions of all bone heads on every frame of a take (frames joints 3)."""
    armature.animation_data_create().action = take
    armature.animation_data.action_slot = next(slot for slot in take.slots if slot.target_id_type == "OBJECT")
    first, last = (round(frame) for frame in take.frame_range)
    places = []
    for frame in range(first, last + 1):
        bpy.context.scene.frame_set(frame)
        bpy.context.view_layer.update()
        places.append([(armature.matrix_world @ bone.matrix).translation[:] for bone in armature.pose.bones])
    x, y, z = np.moveaxis(np.array(places), -1, 0)
    return np.stack([x, z, -y], axis=-1)


def imported(read):
    """The armature and the takes after a file was read into an empty scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    read()
    armature = next(each for each in bpy.data.objects if each.type == "ARMATURE")
    return armature, list(bpy.data.actions), [bone.name for bone in armature.pose.bones]


def older(path):
    import addon_utils

    addon_utils.enable("io_scene_fbx")
    bpy.ops.import_scene.fbx(filepath=path)


path, out = sys.argv[1:]
armature, takes, names = imported(lambda: bpy.ops.wm.fbx_import(filepath=path))
titles = [take.name for take in takes]
found = {"names": np.array(names), "takes": np.array(titles)}
found |= {str(number): places_of(armature, take) for number, take in enumerate(takes)}
try:
    armature, takes, others = imported(lambda: older(path))
    for take in takes if set(names) <= set(others) else ():
        title = take.name if take.name in titles else take.name.split("|", 1)[-1]  # it puts the armature before the name
        if title in titles:
            found[f"{titles.index(title)}_older"] = places_of(armature, take)[:, [others.index(name) for name in names]]
except RuntimeError:  # it does not read ASCII files, among others
    pass
np.savez(out, **found)
sys.stdout.flush()
os._exit(0)
