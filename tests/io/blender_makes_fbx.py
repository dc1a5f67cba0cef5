"""Run by an interpreter that has bpy: an FBX file with a picture on it and shapes that change, and where Blender sees them.

    python blender_makes_fbx.py PICTURE OUT.fbx SEEN.npz HOW

HOW lists what the file has: `bone` (an armature that moves the box), `embed` (the picture in the file, else beside it). The
box has a seam in its coordinates, and the shapes `Wide` and `Tall`. SEEN holds 'vertices' (frames, vertices, 3), turned
from Blender's Z-up to Y-up, 'weights' (frames, 2), 'corners' (the vertex at each corner) and 'uvs' (of each corner).
"""

import os
import sys

import bpy
import numpy as np

FRAMES = 25


def make(picture, how):
    bpy.ops.mesh.primitive_cube_add(size=1.0)  # its coordinates unfold the box: seams at most edges
    box = bpy.context.object
    box.name = box.data.name = "Box"
    box.shape_key_add(name="Basis")
    for name, axis in (("Wide", 0), ("Tall", 2)):
        key = box.shape_key_add(name=name)
        for vertex in range(4 if name == "Wide" else 8):
            key.data[vertex].co[axis] *= 2.0
    for name, values in (("Wide", (0.0, 1.0)), ("Tall", (0.5, 0.25))):
        block = box.data.shape_keys.key_blocks[name]
        for frame, value in zip((1, FRAMES), values):
            block.value = value
            block.keyframe_insert("value", frame=frame)
    material = bpy.data.materials.new("Paint")
    material.use_nodes = True
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    image = material.node_tree.nodes.new("ShaderNodeTexImage")
    image.image = bpy.data.images.load(picture)
    material.node_tree.links.new(image.outputs["Color"], shader.inputs["Base Color"])
    box.data.materials.append(material)
    if "bone" in how:
        bpy.ops.object.armature_add(location=(0, 0, 0))
        rig = bpy.context.object
        box.vertex_groups.new(name="Bone").add(range(8), 1.0, "REPLACE")
        box.modifiers.new("Armature", "ARMATURE").object = rig
        box.parent = rig
        bone = rig.pose.bones["Bone"]
        for frame, place in ((1, 0.0), (FRAMES, 1.0)):
            bone.location = (place, 0, 0)
            bone.keyframe_insert("location", frame=frame)
    return box


def main(picture, out, seen, how):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start, scene.frame_end = 24, 1, FRAMES
    box = make(picture, how)
    vertices, weights = [], []
    for frame in range(1, FRAMES + 1):
        scene.frame_set(frame)
        posed = box.evaluated_get(bpy.context.evaluated_depsgraph_get())
        vertices.append([(posed.matrix_world @ vertex.co)[:] for vertex in posed.data.vertices])
        weights.append([box.data.shape_keys.key_blocks[name].value for name in ("Wide", "Tall")])
    x, y, z = np.moveaxis(np.array(vertices), -1, 0)
    layer = box.data.uv_layers[0].data
    np.savez(
        seen, vertices=np.stack([x, z, -y], axis=-1), weights=np.array(weights),
        corners=np.array([loop.vertex_index for loop in box.data.loops]), uvs=np.array([each.uv[:] for each in layer]),
    )  # fmt: skip
    scene.frame_set(1)
    bpy.ops.export_scene.fbx(
        filepath=out, path_mode="COPY" if "embed" in how else "RELATIVE", embed_textures="embed" in how, bake_anim=True,
        bake_anim_use_all_actions=False, bake_anim_use_nla_strips=False, add_leaf_bones=False, bake_anim_simplify_factor=0.0,
    )  # fmt: skip


main(*sys.argv[1:4], sys.argv[4:])
sys.stdout.flush()
os._exit(0)  # leaving normally, bpy may crash on its way out
