"""Small USD files made as text: a bending tube on three joints, in the disguises that UsdSkel allows."""

import numpy as np
from gltf_maker import tube, turn

TOKENS = ["hips", "hips/spine", "hips/spine/head"]
HEIGHTS = [0.0, 0.7, 1.4]
LOOK = """def Material "Red" { token outputs:surface.connect = </Man/Red/S.outputs:surface>
 color3f inputs:tint = (0.9, 0.1, 0.2)
 def Shader "S" { uniform token info:id = "UsdPreviewSurface"
  color3f inputs:diffuseColor.connect = </Man/Red.inputs:tint>
  float inputs:opacity = 0.5
  token outputs:surface
 }
}
"""


def rows(matrix):
    return "( " + ", ".join("(" + ", ".join(f"{x:.17g}" for x in row) + ")" for row in np.asarray(matrix, float)) + " )"


def tuples(values):
    return "[" + ", ".join("(" + ", ".join(f"{x:.9g}" for x in row) + ")" for row in np.asarray(values, float)) + "]"


def numbers(values):
    return "[" + ", ".join(f"{x:.9g}" for x in np.asarray(values).ravel()) + "]"


def strings(values):
    return "[" + ", ".join(f'"{x}"' for x in values) + "]"


def shift(x, y, z):
    matrix = np.eye(4)
    matrix[3, :3] = x, y, z
    return matrix


def animation(name="bend", degrees=40.0, frames=6, first=0, joints=(1, 2), step=1.0, extra="", scales=True):
    """A SkelAnimation that bends two joints (or those listed) about x and lets the last one slide."""
    turns, moves = [], []
    for frame in range(frames):
        part = frame / max(frames - 1, 1)
        code = f"{first + frame * step:.9g}: "
        spin = [turn("x", degrees * part * (1 + joint)) for joint in joints]
        turns.append(code + tuples([[q[3], *q[:3]] for q in spin]))
        moves.append(code + tuples([[0.02 * part * joint, 0.7 if joint else 0.0, 0.0] for joint in joints]))
    lines = [f"uniform token[] joints = {strings(TOKENS[joint] for joint in joints)}"]
    lines += ["quatf[] rotations.timeSamples = { " + ", ".join(turns) + " }"]
    lines += ["float3[] translations.timeSamples = { " + ", ".join(moves) + " }"]
    lines += [f"half3[] scales = {tuples([[1, 1, 1]] * len(joints))}"] if scales else []
    return f'def SkelAnimation "{name}" {{\n' + "\n".join([*lines, extra]) + "\n}\n"


def tube_mesh(name="Body", binding="", extra="", geometry=None, stored=None, quads=False, influences=True):
    """The tube as a Mesh. `geometry`: geomBindTransform (rows); `stored`: points, if others than the tube's."""
    points, faces, weights = tube()
    points = points if stored is None else stored
    if quads:  # two triangles that share an edge (b, a + corners) are one polygon: a, a + corners, b + corners, b
        pairs = faces.reshape(-1, 2, 3)
        counts, corners = [4] * len(pairs), np.stack([pairs[:, 0, 0], pairs[:, 0, 1], pairs[:, 1, 2], pairs[:, 0, 2]], axis=1)
    else:
        counts, corners = [3] * len(faces), faces
    lines = [
        f"point3f[] points = {tuples(points)}", f"int[] faceVertexCounts = {numbers(counts)}",
        f"int[] faceVertexIndices = {numbers(corners)}", 'uniform token subdivisionScheme = "none"', binding,
    ]  # fmt: skip
    if influences:
        which = np.tile([0, 1, 2], (len(points), 1))
        shape = '( elementSize = 3\n interpolation = "vertex" )'
        lines += [f"int[] primvars:skel:jointIndices = {numbers(which)} {shape}"]
        lines += [f"float[] primvars:skel:jointWeights = {numbers(weights)} {shape}"]
    if geometry is not None:
        lines += [f"matrix4d primvars:skel:geomBindTransform = {rows(geometry)}"]
    api = 'prepend apiSchemas = ["SkelBindingAPI", "MaterialBindingAPI"]'
    return f'def Mesh "{name}" (\n{api}\n) {{\n' + "\n".join([*lines, extra]) + "\n}\n"


def skeleton(name="Skeleton", rest=True, bind=True, posed=None, extra="", tokens=TOKENS, source="</Man/Skeleton/bend>", inside=""):
    """Three joints in a row. `posed`: turn (degrees about z) of the spine at rest, which the binding does not have."""
    bends = np.eye(4)
    if posed:
        c, s = np.cos(np.radians(posed)), np.sin(np.radians(posed))
        bends[:2, :2] = [[c, s], [-s, c]]
    rests = [np.eye(4), bends @ shift(0, 0.7, 0), shift(0, 0.7, 0)]
    lines = [f"uniform token[] joints = {strings(tokens)}"]
    lines += [f"uniform matrix4d[] restTransforms = [{', '.join(map(rows, rests))}]"] if rest else []
    binds = [shift(0, height, 0) for height in HEIGHTS]
    lines += [f"uniform matrix4d[] bindTransforms = [{', '.join(map(rows, binds))}]"] if bind else []
    lines += [f"rel skel:animationSource = {source}"] if source else []
    head = f'def Skeleton "{name}" (\nprepend apiSchemas = ["SkelBindingAPI"]\n) {{\n'
    return head + "\n".join([*lines, extra, inside]) + "\n}\n"


def stage(*content, up="Y", unit="1", rate="30", range_=None, place="", more="", inherited=True, kind="SkelRoot"):
    """The file's text. `place`: xform lines of the root prim; `inherited`: skel:skeleton is given at the root."""
    lines = ['defaultPrim = "Man"', f'upAxis = "{up}"', f"timeCodesPerSecond = {rate}", more]
    lines += [f"metersPerUnit = {unit}"] if unit else []
    lines += [f"startTimeCode = {range_[0]}", f"endTimeCode = {range_[1]}"] if range_ else []
    bound = "rel skel:skeleton = </Man/Skeleton>\n" if inherited else ""
    head = "#usda 1.0\n(\n" + "\n".join(lines) + f'\n)\ndef {kind} "Man" (\nprepend apiSchemas = ["SkelBindingAPI"]\n) {{\n'
    return head + bound + place + "\n" + "\n".join(content) + "\n}\n"


def man(**settings):
    """The usual one: tube, skeleton and one animation of six frames."""
    return stage(skeleton(inside=animation()), tube_mesh(), **settings)
