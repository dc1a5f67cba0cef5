"""Run inside Blender, or by an interpreter that has bpy: a GLB file becomes FBX or Alembic.

    blender --background --factory-startup --python blender_child.py -- JOB.json
    python blender_child.py -- JOB.json

The job names the files and what is wanted of them; see `blender.py`. Nothing of this package is imported here: Blender has its
own Python. What goes wrong is one line on the error stream.
"""

from __future__ import annotations

import datetime
import json
import math
import os
import sys
import types
from collections.abc import Iterator
from typing import Any

import bpy
import mathutils

ENDINGS = {"PNG": ".png", "JPEG": ".jpg", "WEBP": ".webp"}


def main() -> None:
    with open(sys.argv[sys.argv.index("--") + 1], encoding="utf-8") as file:
        job = json.load(file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    set_rate(job["fps"])
    # "BLENDER" leaves the bones' axes as the file has them; the other heuristics turn them to point at their children.
    bpy.ops.import_scene.gltf(filepath=job["glb"], bone_heuristic="BLENDER", disable_bone_shape=True)
    armatures = [each for each in bpy.data.objects if each.type == "ARMATURE"]
    actions = match_actions(job["clips"], armatures)
    bpy.context.scene.frame_start = round(min((each.frame_range[0] for each in actions), default=0))
    bpy.context.scene.frame_end = round(max((each.frame_range[1] for each in actions), default=0))
    WRITERS[job["format"]](job, armatures, actions)


def set_rate(fps: float) -> None:
    """Blender's rate is a whole number over a base."""
    scene = bpy.context.scene
    scene.render.fps = max(1, round(fps))
    scene.render.fps_base = scene.render.fps / fps


def match_actions(names: dict[str, str], armatures: list[Any]) -> list[Any]:
    """The clips that were asked for, by the names they have on the way and with those they shall have; all others go."""
    found = {}
    for action in list(bpy.data.actions):
        own = next((name for name in sorted(names, key=len, reverse=True) if action.name.startswith(name)), None)
        if own is None or own in found:
            bpy.data.actions.remove(action)
        else:
            found[own] = action
    for armature in armatures:
        data = armature.animation_data_create()
        for track in list(data.nla_tracks):
            data.nla_tracks.remove(track)
        data.action = None
    for name, action in found.items():
        action.name = names[name]
    return [found[name] for name in names if name in found]


def to_centimetres() -> None:
    """Hundredfold lengths in a scene whose unit is a centimetre: the space of most FBX files. Metres would be written with a
    scale of a hundred on every object, or be taken for centimetres by tools that look at no unit."""
    bpy.context.scene.unit_settings.scale_length = 0.01
    larger = mathutils.Matrix.Scale(100.0, 4)
    for each in bpy.data.objects:
        each.location *= 100.0
        each.matrix_parent_inverse.translation *= 100.0
        for bone in each.pose.bones if each.pose else ():
            bone.location *= 100.0
    for armature in bpy.data.armatures:
        armature.transform(larger)
    for mesh in bpy.data.meshes:
        mesh.transform(larger, shape_keys=True)
    for action in bpy.data.actions:
        for curve in curves(action):
            if curve.data_path.rsplit(".", 1)[-1] == "location":
                for key in curve.keyframe_points:
                    for point in (key.co, key.handle_left, key.handle_right):
                        point[1] *= 100.0


def to_y_up() -> None:
    """Data with +Y up under objects that turn it to Blender's +Z: what the exporter turns back then has no rotation of a
    quarter on every object. Objects that are animated themselves keep it."""
    if any(not curve.data_path.startswith("pose.bones") for action in bpy.data.actions for curve in curves(action)):
        return
    turn = mathutils.Matrix.Rotation(-math.pi / 2.0, 4, "X")
    back = turn.inverted()
    for each in bpy.data.objects:
        local = each.matrix_basis.copy()
        if each.parent is None or each.parent_type == "BONE":  # bones turn with their armature's data
            each.matrix_basis = local @ back
        else:
            each.matrix_parent_inverse = turn @ each.matrix_parent_inverse @ back
            each.matrix_basis = turn @ local @ back
    for armature in bpy.data.armatures:
        armature.transform(turn)
    for mesh in bpy.data.meshes:
        mesh.transform(turn, shape_keys=True)


def curves(action: Any) -> Iterator[Any]:
    for layer in action.layers:
        for strip in layer.strips:
            for bag in strip.channelbags:
                yield from bag.fcurves


def add_root(armature: Any, name: str) -> None:
    """A bone at the ground that carries the skeleton, where its root is no such bone already."""
    roots = [bone.name for bone in armature.data.bones if bone.parent is None]
    if name.lower() in {each.lower() for each in roots}:
        return
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    root = armature.data.edit_bones.new(name)
    root.head, root.tail = (0.0, 0.0, 0.0), (0.0, 10.0, 0.0)
    for each in roots:
        armature.data.edit_bones[each].parent = root
    bpy.ops.object.mode_set(mode="OBJECT")


def put_on(armatures: list[Any], action: Any) -> None:
    for armature in armatures:
        armature.animation_data.action = action
        slot = next((slot for slot in action.slots if slot.target_id_type == "OBJECT"), None)
        if slot is not None:
            armature.animation_data.action_slot = slot


def same_every_time() -> None:
    """Textures by their own names in place of this machine's paths, and no time of day: equal input gives equal files."""
    from io_scene_fbx import export_fbx_bin

    for image in bpy.data.images:
        ending = ENDINGS.get(image.file_format, "")
        if image.packed_file is not None and not image.name.lower().endswith(ending):
            image.name += ending

    export_fbx_bin._gen_vid_path = lambda image, scene: (image.name, image.name)
    still = types.SimpleNamespace(now=lambda: datetime.datetime(1970, 1, 1, 10))
    export_fbx_bin.datetime = types.SimpleNamespace(datetime=still)


def write_fbx(job: dict[str, Any], armatures: list[Any], actions: list[Any]) -> None:
    to_centimetres()
    to_y_up()
    for armature in armatures:
        if job["root"]:
            add_root(armature, job["root"])
        # Engines that look for a root joint pass over an object of this name.
        armature.name = "Armature"
    if actions:
        put_on(armatures, actions[0])
    same_every_time()
    bpy.ops.export_scene.fbx(
        filepath=job["output"],
        object_types={"ARMATURE", "MESH", "EMPTY"},
        axis_forward="-Z",
        axis_up="Y",
        apply_unit_scale=True,
        apply_scale_options="FBX_SCALE_ALL",
        add_leaf_bones=False,
        primary_bone_axis="Y",
        secondary_bone_axis="X",
        use_armature_deform_only=False,
        bake_anim=bool(actions),
        bake_anim_use_all_bones=True,
        bake_anim_use_nla_strips=False,
        bake_anim_use_all_actions=True,
        bake_anim_force_startend_keying=True,
        bake_anim_step=1.0,
        bake_anim_simplify_factor=0.0,
        mesh_smooth_type="FACE",
        path_mode="COPY",
        embed_textures=True,
    )


def write_alembic(job: dict[str, Any], armatures: list[Any], actions: list[Any]) -> None:
    if actions:
        put_on(armatures, actions[0])
    bpy.ops.wm.alembic_export(
        filepath=job["output"],
        start=bpy.context.scene.frame_start,
        end=bpy.context.scene.frame_end,
        selected=False,
        flatten=False,
        uvs=True,
        normals=True,
        evaluation_mode="RENDER",
        as_background_job=False,
    )


WRITERS = {"fbx": write_fbx, "abc": write_alembic}


try:
    main()
except BaseException as error:  # the parent tells the user one line
    sys.stderr.write(f"\n{type(error).__name__}: {' '.join(str(error).split())}\n")
    sys.stderr.flush()
    os._exit(3)
sys.stdout.flush()
os._exit(0)
