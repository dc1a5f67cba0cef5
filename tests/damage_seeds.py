"""Small valid files of every format that is read, to be damaged: small, so that most of their bytes say what the rest means.

    python tests/damage_seeds.py FOLDER [REAL ...]

makes FOLDER/<kind>/n.<suffix>; real files are copied to those of their suffix. Prints the kinds.
"""

import json
import shutil
import sys
import warnings
from pathlib import Path

import numpy as np
from draco_maker import compressed
from fbx_maker import Picture, Shapes
from fbx_maker import document as fbx
from gltf_maker import PNG, pack, turn, worm
from pcd_maker import pcd_of
from smpl_maker import amass, angles
from usd_maker import LOOK, animation, skeleton, stage, tube_mesh
from vrm_maker import split, vrm

from retarget.character import Mesh, MeshMotion, PointMotion
from retarget.io import load, save_sequence
from retarget.io.bvh import save as save_bvh
from retarget.io.obj_ply import save as save_surface
from retarget.io.smpl_joints import FAMILIES

HERE = Path(__file__).parent
POINT_CACHE = """#usda 1.0
(
metersPerUnit = 1
)
def Mesh "M" {
int[] faceVertexCounts = [3]
int[] faceVertexIndices = [0, 1, 2]
point3f[] points.timeSamples = {0: [(0,0,0), (1,0,0), (0,1,0)], 1: [(0,0,1), (1,0,0), (0,1,0)]}
}
"""
BVH = """HIERARCHY
ROOT hips
{
OFFSET 0 0 0
CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
JOINT spine
{
OFFSET 0 10 0
CHANNELS 3 Zrotation Xrotation Yrotation
JOINT head
{
OFFSET 0 10 0
CHANNELS 4 Xposition Yrotation Xrotation Zrotation
End Site
{
OFFSET 0 5 0
}
}
}
}
MOTION
Frames: 3
Frame Time: 0.0333333
"""
PLY = """ply
format ascii 1.0
comment made by hand
element vertex 4
property float x
property float y
property double z
property uchar red
property uchar green
property uchar blue
element face 2
property list uchar int vertex_indices
property float quality
element edge 1
property int vertex1
property int vertex2
end_header
0 0 0 255 0 0
1 0 0 0 255 0
1 1 0 0 0 255
0 1 0 9 9 9
4 0 1 2 3 0.5
3 0 1 2 0.5
0 1
"""
OBJ = """mtllib none.mtl
o body
v 0 0 0
v 1 0 0 0.5 0.5 0.5
v 1 1 0
v 0 1 0
vt 0 0
vt 1 1
vn 0 0 1
g part
usemtl skin
s 1
f 1/1/1 2/2/1 3/1/1 4/2/1
f -4//1 -3//1 -2//1
f 1 2 \\
3
"""


def main(folder, real=()):
    """Write them all; the kinds that this installation can read."""
    warnings.simplefilter("ignore")
    kinds = {
        "bvh": _bvh, "gltf": _gltf, "glb": _glb, "vrm": _vrm, "draco": _draco, "meshopt": _meshopt, "morph": _morph, "amass": _amass,
        "smpl": _smpl, "sequence": _sequence, "clouds": _clouds, "pcd": _pcd, "obj": _obj, "ply": _ply, "fbx": _fbx, "usda": _usda, "usdc": _usdc, "usdz": _usdz,
    }  # fmt: skip
    for kind, make in kinds.items():
        (folder / kind).mkdir(parents=True)
        try:
            make(folder / kind)
        except ModuleNotFoundError:  # an extra that is not installed
            shutil.rmtree(folder / kind)
    for path in real:
        own = folder / path.suffix[1:].lower()
        if own.is_dir():
            shutil.copyfile(path, own / f"real_{path.stem}{path.suffix.lower()}")
    return sorted(path.name for path in folder.iterdir())


def _bvh(own):
    rows = [" ".join(f"{(7 * row + column) % 90 - 30}.5" for column in range(13)) for row in range(3)]
    (own / "0.bvh").write_text(BVH + "\n".join(rows) + "\n")
    save_bvh(own / "1.bvh", load(own / "0.bvh").motion(0))


def _rich(**more):
    return worm(armature={"rotation": turn("x", 90), "scale": [0.01] * 3}, prop=True, clips=2, texture=True, between=True, **more)


def _gltf(own):
    worm(clips=2).gltf(own / "0.gltf")
    _rich(sparse=True).gltf(own / "1.gltf", "beside.bin")


def _glb(own):
    _rich().glb(own / "0.glb")
    worm(sparse=True, sets=2, weights_as="u1", turns_as="i2", mode="CUBICSPLINE", stretchy=True).glb(own / "1.glb")
    worm(stride=24, as_matrix=True, skins=2, joints_as="u2", mode="STEP").glb(own / "2.glb")


def _vrm(own):
    """Bones alone: the body's thousands of vertices are no business of VRM's."""
    document, binary = split(vrm(own / "whole.vrm", version="animation"))
    humanoid = document["extensions"].pop("VRMC_vrm_animation")["humanoid"]
    document["extensions"]["VRMC_vrm"] = {"specVersion": "1.0", "meta": {"name": "Doll", "authors": ["nobody"]}, "humanoid": humanoid}
    document["extensionsUsed"] = ["VRMC_vrm"]
    (own / "0.vrm").write_bytes(pack(json.dumps(document).encode(), binary))
    bones = [{"bone": bone, "node": each["node"]} for bone, each in humanoid["humanBones"].items()]
    document["extensions"] = {"VRM": {"specVersion": "0.0", "humanoid": {"humanBones": bones}}}
    document["extensionsUsed"] = ["VRM"]
    (own / "1.vrm").write_bytes(pack(json.dumps(document).encode(), binary))
    for path in own.glob("whole*"):
        path.unlink()


def _draco(own):
    compressed(worm(), own / "plain.glb").glb(own / "0.glb")
    compressed(worm(weights_as="u1", prop=True, texture=True), own / "plain.glb").glb(own / "1.glb")
    (own / "plain.glb").unlink()


def _meshopt(own):
    for kind in ("ext", "khr"):
        shutil.copyfile(HERE / "data" / f"worm_meshopt_{kind}.glb", own / f"{kind}.glb")


def _waving():
    still = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    moved = still.vertices + np.linspace(0, 1, 5)[:, None, None] * np.array([0, 0, 0.5])
    return MeshMotion(still, moved.astype(np.float32), 24.0, "wave")


def _morph(own):
    save_sequence(own / "0.glb", _waving())


def _sequence(own):
    save_sequence(own / "0.npz", _waving())


def _clouds(own):
    points = np.random.default_rng(0).normal(size=(9, 3))
    save_sequence(own / "0.npz", PointMotion((points[:4], points[:0], points[4:]), 24.0, "three"))
    np.savez(own / "1.npz", points=points)


def _pcd(own):
    """In all three forms, of one point more than nine, colours between the coordinates."""
    points = np.random.default_rng(0).normal(size=(10, 3)).astype(np.float32)
    for number, form in enumerate(("ascii", "binary", "binary_compressed")):
        (own / f"{number}.pcd").write_bytes(pcd_of(points, form))


def _amass(own):
    poses = angles(5, 22, left_knee=[0.4, 0, 0])
    amass(own / "0.npz", poses, np.zeros((5, 3)))
    flat = poses.reshape(5, -1)
    np.savez_compressed(own / "1.npz", root_orient=flat[:, :3], pose_body=flat[:, 3:], transl=np.zeros((5, 3)), fps=30)


def _smpl(own):
    """A model without any sense but with every array a model has."""
    random, joints, vertices = np.random.default_rng(2), 24, 8
    weights = random.random((vertices, joints)) * (random.random((vertices, joints)) < 0.2)
    weights[:, 0] += 0.1
    regressor = random.random((joints, vertices))
    table = np.array([FAMILIES[joints].parents, range(joints)], dtype=np.int64)
    np.savez(
        own / "0.npz", v_template=random.normal(size=(vertices, 3)), f=random.integers(0, vertices, (5, 3)).astype(np.uint32),
        J_regressor=regressor / regressor.sum(axis=1, keepdims=True), weights=weights / weights.sum(axis=1, keepdims=True),
        kintree_table=np.where(table < 0, 2**32 - 1, table), shapedirs=random.normal(size=(vertices, 3, 3)),
    )  # fmt: skip


def _obj(own):
    (own / "0.obj").write_text(OBJ)


def _ply(own):
    (own / "0.ply").write_text(PLY)
    save_surface(own / "1.ply", load(own / "0.ply").mesh)


def _fbx(own):
    import ufbx  # noqa: F401

    shown = {"picture": Picture(PNG), "shapes": Shapes((50.0, 100.0), rest=25.0, end=100.0)}
    (own / "0.fbx").write_text(fbx(takes=(("one", 30.0), ("two", 60.0)), pre_rotation=(0, 90, 0)))
    (own / "1.fbx").write_text(fbx(takes=(("one", 30.0),), **shown))
    (own / "2.fbx").write_text(fbx(bones=False, **shown))


def _usda(own):
    from pxr import Usd  # noqa: F401

    plain = stage(LOOK, skeleton(inside=animation()), tube_mesh(extra="rel material:binding = </Man/Red>"), up="Z", unit="0.01")
    moves = animation() + animation("other", joints=(0, 1, 2))
    rich = stage(skeleton(inside=moves, posed=20), tube_mesh(), tube_mesh("Twin", quads=True))
    for number, text in enumerate((plain, rich, POINT_CACHE)):
        (own / f"{number}.usda").write_text(text)


def _usdc(own):
    from pxr import Sdf

    _usda(own)
    for path in sorted(own.glob("*.usda")):
        Sdf.Layer.FindOrOpen(str(path)).Export(str(path.with_suffix(".usdc")))
        path.unlink()


def _usdz(own):
    from pxr import UsdUtils

    _usdc(own)
    for path in sorted(own.glob("*.usdc")):
        UsdUtils.CreateNewUsdzPackage(str(path), str(path.with_suffix(".usdz")))
        path.unlink()


if __name__ == "__main__":
    for name in main(Path(sys.argv[1]), list(map(Path, sys.argv[2:]))):
        print(name)
