"""Run by an interpreter that has bpy: small scenes as Alembic files.

    python blender_makes_abc.py FOLDER

moves.abc     two triangles, one carried by its object and one by its parent, beside a curve and a camera; frames 12 to 18 at 24
grows.abc     a mesh that gets a face more at frame 3
other.abc     a mesh whose faces turn around at frame 3, with the vertices that it had
lines.abc     a curve, and no mesh
"""

import os
import sys

import bpy

folder = sys.argv[1]
TRIANGLE = [(0, 0, 0), (1, 0, 0), (0, 0, 1)]


def begin():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps, bpy.context.scene.render.fps_base = 24, 1.0


def put(name, data):
    each = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(each)
    return each


def triangle(name, faces=((0, 1, 2),), points=TRIANGLE):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], faces)
    return put(name, mesh)


def move(each, frames):
    for frame, place in frames:
        each.location = place
        each.keyframe_insert("location", frame=frame)
    for curve in each.animation_data.action.layers[0].strips[0].channelbags[0].fcurves:
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"


def curve():
    data = bpy.data.curves.new("line", "CURVE")
    data.splines.new("POLY").points.add(1)
    return put("line", data)


def write(name, first, last):
    bpy.ops.wm.alembic_export(filepath=os.path.join(folder, name), start=first, end=last, as_background_job=False)


def switching(name, faces):
    """A mesh that is another from frame 3 on: a switch between two in a modifier's group."""
    begin()
    one = triangle("plate")
    other = bpy.data.meshes.new("other")
    other.from_pydata([*TRIANGLE, (1, 0, 1)][: 3 + (len(faces) > 1)], [], faces)
    kept = put("kept", other)
    group = bpy.data.node_groups.new("switch", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes, links = group.nodes, group.links
    start, end, switch = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput"), nodes.new("GeometryNodeSwitch")
    time, late, info = nodes.new("GeometryNodeInputSceneTime"), nodes.new("ShaderNodeMath"), nodes.new("GeometryNodeObjectInfo")
    late.operation, late.inputs[1].default_value, info.inputs["Object"].default_value = "GREATER_THAN", 2.5, kept
    links.new(time.outputs["Frame"], late.inputs[0])
    links.new(late.outputs[0], switch.inputs["Switch"])
    links.new(start.outputs[0], switch.inputs["False"])
    links.new(info.outputs["Geometry"], switch.inputs["True"])
    links.new(switch.outputs[0], end.inputs[0])
    one.modifiers.new("switch", "NODES").node_group = group
    kept.hide_render = True
    bpy.context.scene.collection.objects.unlink(kept)
    write(name, 1, 5)


begin()
triangle("b")
carrier = put("carrier", None)
bpy.data.objects["b"].parent = carrier
move(carrier, [(12, (0, 0, 0)), (18, (6, 0, 0))])
move(triangle("a"), [(12, (0, 0, 0)), (18, (0, 0, 3))])
curve()
put("camera", bpy.data.cameras.new("camera"))
write("moves.abc", 12, 18)
switching("grows.abc", [(0, 1, 2), (1, 3, 2)])
switching("other.abc", [(2, 1, 0)])
begin()
move(curve(), [(1, (0, 0, 0)), (5, (1, 0, 0))])
write("lines.abc", 1, 5)
sys.stdout.flush()
os._exit(0)
