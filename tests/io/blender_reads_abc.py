"""Run by an interpreter that has bpy: where the vertices of an Alembic file are on one of its frames, back with +Y up.

    python blender_reads_abc.py FILE FRAME OUT.npy
"""

import os
import sys

import bpy
import numpy as np

path, frame, out = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 30
bpy.ops.wm.alembic_import(filepath=path, as_background_job=False)
bpy.context.scene.frame_set(int(frame))
graph = bpy.context.evaluated_depsgraph_get()
places = []
for each in bpy.data.objects:
    if each.type == "MESH":
        own = each.evaluated_get(graph)
        places += [(own.matrix_world @ vertex.co)[:] for vertex in own.to_mesh().vertices]
x, y, z = np.array(places).T
np.save(out, np.stack([x, z, -y], axis=-1))
sys.stdout.flush()
os._exit(0)
