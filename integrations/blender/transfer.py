# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes between Blender and the program `retarget`: GLB files there, keyframes back."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import bpy

VARIABLE = "RETARGET_COMMAND"
MOTION_FILES = {".bvh", ".fbx", ".glb", ".gltf"}


def program(named: str) -> str:
    """The program to call: as named in the preferences, by the environment, or on the PATH. Raises `ValueError`."""
    for each in (named, os.environ.get(VARIABLE, ""), "retarget"):
        found = shutil.which(bpy.path.abspath(each)) if each else None
        if found:
            return found
        if each and each != "retarget":
            raise ValueError(f"{each} is no program")
    raise ValueError("the program retarget is not installed: pip install retarget, or name it in the preferences")


def export_target(armature: bpy.types.Object, path: Path) -> None:
    """The armature with all meshes that it moves, without any animation."""
    _export(armature, [each for each in bpy.data.objects if _moved_by(each, armature)], path, export_animations=False)


def export_mesh(mesh: bpy.types.Object, path: Path) -> None:
    """A bare mesh as it stands, with its materials: it comes back rigged. Raises `ValueError` for one without faces."""
    if not mesh.data.polygons:
        raise ValueError(f"{mesh.name} has no faces")
    _export(mesh, [], path, export_animations=False, export_materials="EXPORT", export_apply=True)


def export_source(armature: bpy.types.Object, path: Path) -> str:
    """The armature with its meshes and its current action; returns the action's name. Raises `ValueError` without one."""
    data = armature.animation_data
    if data is None or data.action is None:
        raise ValueError(f"{armature.name} has no action")
    _export(
        armature,
        [each for each in bpy.data.objects if _moved_by(each, armature)],
        path,
        export_animations=True,
        export_animation_mode="ACTIVE_ACTIONS",
        export_force_sampling=True,
        export_optimize_animation_size=False,
        export_nla_strips_merged_animation_name=data.action.name,
    )
    return data.action.name


def bring_back(path: Path, armature: bpy.types.Object, name: str) -> bpy.types.Action:
    """The animation of a result as a new action on the armature itself, on its own bones with their own roll."""
    before = {kind: set(getattr(bpy.data, kind)) for kind in ("objects", "actions", "armatures", "meshes", "materials", "images")}
    # "BLENDER" keeps the axes that the exporter wrote, which are the bones' own: rest poses are the same on both sides.
    bpy.ops.import_scene.gltf(filepath=str(path), bone_heuristic="BLENDER", disable_bone_shape=True)
    new = {kind: set(getattr(bpy.data, kind)) - old for kind, old in before.items()}
    try:
        made = next((each for each in new["objects"] if each.type == "ARMATURE"), None)
        if made is None:
            raise ValueError("the result holds no armature")
        return _copied(made, armature, name)
    finally:
        for kind, found in new.items():
            own = getattr(bpy.data, kind)
            for each in found:
                own.remove(each)


def bring_character(path: Path, mesh: bpy.types.Object, name: str) -> bpy.types.Action:
    """The rigged character made of a bare mesh, as new objects beside it; the mesh itself is hidden."""
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=str(path), bone_heuristic="TEMPERANCE", disable_bone_shape=True)
    made = next((each for each in set(bpy.data.objects) - before if each.type == "ARMATURE"), None)
    if made is None or made.animation_data is None or made.animation_data.action is None:
        raise ValueError("the result holds no animated armature")
    made.name = f"{mesh.name} rig"
    made.animation_data.action.name = name
    mesh.hide_set(True)
    return made.animation_data.action


def is_bare(each: bpy.types.Object) -> bool:
    """Whether this is a mesh that no armature moves."""
    return each.type == "MESH" and each.find_armature() is None


def _moved_by(each: bpy.types.Object, armature: bpy.types.Object) -> bool:
    modified = any(modifier.type == "ARMATURE" and modifier.object == armature for modifier in each.modifiers)
    return each.type == "MESH" and (modified or each.parent == armature)


def _export(armature: bpy.types.Object, meshes: list[bpy.types.Object], path: Path, **options) -> None:
    chosen, active = list(bpy.context.selected_objects), bpy.context.view_layer.objects.active
    shown = {each: each.hide_get() for each in (armature, *meshes)}
    try:
        bpy.ops.object.select_all(action="DESELECT")
        for each in shown:
            each.hide_set(False)
            each.select_set(True)
        bpy.context.view_layer.objects.active = armature
        bpy.ops.export_scene.gltf(
            filepath=str(path), export_format="GLB", use_selection=True, export_yup=True, export_skins=True,
            export_def_bones=False, export_rest_position_armature=True, **{"export_materials": "NONE", **options},
        )  # fmt: skip
    finally:
        bpy.ops.object.select_all(action="DESELECT")
        for each, hidden in shown.items():
            each.hide_set(hidden)
        for each in chosen:
            each.select_set(True)
        bpy.context.view_layer.objects.active = active


def _copied(made: bpy.types.Object, armature: bpy.types.Object, name: str) -> bpy.types.Action:
    """Keys on every frame of what the bones of the imported armature do, for bones of the same name."""
    scene, first = bpy.context.scene, bpy.context.scene.frame_current
    source = made.animation_data.action if made.animation_data else None
    if source is None:
        raise ValueError("the result holds no animation")
    action = bpy.data.actions.new(name)
    armature.animation_data_create().action = action
    bones = [bone for bone in armature.pose.bones if bone.name in made.pose.bones]
    start, stop = (round(frame) for frame in source.frame_range)
    try:
        for frame in range(start, stop + 1):
            scene.frame_set(frame)
            for bone in bones:
                bone.matrix_basis = made.pose.bones[bone.name].matrix_basis
                _key(bone, frame)
    finally:
        scene.frame_set(first)
    return action


def _key(bone: bpy.types.PoseBone, frame: int) -> None:
    bone.keyframe_insert("location", frame=frame, group=bone.name)
    if bone.rotation_mode == "QUATERNION":
        path = "rotation_quaternion"
    else:
        path = "rotation_axis_angle" if bone.rotation_mode == "AXIS_ANGLE" else "rotation_euler"
    bone.keyframe_insert(path, frame=frame, group=bone.name)
