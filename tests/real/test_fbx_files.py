"""Real FBX files: all are read, quickly; joints stand where Blender puts them, and motions reach another body."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from retarget.body.kinematics import world_pose
from retarget.casting import cast
from retarget.io import load, save
from retarget.retargeting import prepare

ROOT = Path(__file__).resolve().parents[2]
TAKES = {
    "quaternius/Alien.fbx": 14, "quaternius/Animated_Woman.fbx": 10, "quaternius/Female_Dress.fbx": 11,
    "quaternius/Male_Casual.fbx": 11, "quaternius/Skeleton.fbx": 5, "geno/Geno_bind.fbx": 0,
    "fbx/blender_293_barbarian_7400_binary.fbx": 1, "fbx/maya_human_ik_7400_binary.fbx": 0,
    "fbx/maya_kenney_character_7700_binary.fbx": 1,
}  # fmt: skip
"""Takes that move something; the only take of Geno holds its bind pose, that of the HumanIK file moves no bone."""


def at_hand(data, name):
    path = data / "characters" / name
    if not path.exists():
        pytest.skip(f"{name} is not at hand")
    return path


@pytest.mark.parametrize("name", TAKES)
def test_every_take_is_read(data, name):
    path = at_hand(data, name)
    started = time.perf_counter()
    asset = load(path)
    motions = [asset.motion(number) for number in range(len(asset.clips))]
    assert time.perf_counter() - started < 3.0
    assert len(motions) == TAKES[name] and asset.notes[0].startswith("FBX 7.")
    assert all(np.isfinite(motion.rotations).all() and len(motion) > 5 for motion in motions)


def test_bare_meshes_are_read(data):
    folder = data / "meshes" / "quaternius_posed"
    if not folder.is_dir():
        pytest.skip("the posed meshes are not at hand")
    for path in folder.glob("*.fbx"):
        asset = load(path)
        assert asset.kind == "mesh" and len(asset.mesh.faces) > 500


def test_pictures_and_shapes_come_along(data, tmp_path):
    """The barbarian's two pictures are in the file; hair and mouth follow shapes."""
    asset = load(at_hand(data, "fbx/blender_293_barbarian_7400_binary.fbx"))
    save(tmp_path / "out.glb", asset.character, [])
    for held in (asset, load(tmp_path / "out.glb")):
        looks = held.character.mesh.materials
        assert [each.name for each in looks] == ["hair", "body"] and all(each.image[:4] == b"\x89PNG" for each in looks)
        told = held.character.origin.document
        named = [mesh["extras"]["targetNames"] for mesh in told.json["meshes"] if "extras" in mesh]
        assert named == [["Left", "Right"], ["Mouth"]]
        animation = told.json["animations"][0]
        moved = [each for each in animation["channels"] if each["target"]["path"] == "weights"]
        assert len(moved) == 2
        for channel in moved:
            weights = told.floats(animation["samplers"][channel["sampler"]]["output"], ("SCALAR",))
            assert np.ptp(weights) > 0.1 and -0.1 < weights.min() and weights.max() < 1.1


@pytest.mark.parametrize("name", ["quaternius/Alien.fbx", "quaternius/Male_Casual.fbx", "quaternius/Animated_Woman.fbx", "fbx/blender_293_barbarian_7400_binary.fbx", "fbx/maya_kenney_character_7700_binary.fbx"])  # fmt: skip
def test_joints_stand_where_blender_puts_them(data, tmp_path, name):
    path, python = at_hand(data, name), os.environ.get("RETARGET_BPY_PYTHON", sys.executable)
    if subprocess.run([python, "-c", "import importlib.util as u; exit(u.find_spec('bpy') is None)"]).returncode:
        pytest.skip("bpy is not installed (RETARGET_BPY_PYTHON may name an interpreter that has it)")
    subprocess.run([python, ROOT / "tests/io/blender_reads_fbx.py", path, tmp_path / "seen.npz"], check=True, capture_output=True)
    asset = load(path)
    with np.load(tmp_path / "seen.npz") as seen:
        names = seen["names"].tolist()
        for number, take in enumerate(seen["takes"].tolist()):
            motion = asset.motion(take)
            shared = [joint for joint in names if joint in motion.skeleton.names]
            theirs = seen[str(number)][:, [names.index(joint) for joint in shared]]
            ours = world_pose(motion)[1][:, [motion.skeleton.index(joint) for joint in shared]]
            frames = min(len(theirs), len(ours))
            assert len(shared) > 10 and frames > 10
            assert np.linalg.norm(theirs[:frames] - ours[:frames], axis=-1).max() < 1e-3, take


def test_a_take_reaches_another_body_and_a_body_takes_another_motion(data, tmp_path):
    """FBX to FBX, written as GLB with the target as it was, its takes before the new one."""
    source, target = load(at_hand(data, "quaternius/Male_Casual.fbx")), load(at_hand(data, "quaternius/Animated_Woman.fbx"))
    motion = source.motion("HumanArmature|Man_Clapping")
    result = prepare(cast(source, motion=motion), cast(target))(motion)
    save(tmp_path / "out.glb", result.character, [result.motion])
    again = load(tmp_path / "out.glb")
    assert len(again.clips) == len(target.clips) + 1 and np.isfinite(again.motion(again.clips[-1].name).rotations).all()
    assert len(again.character.mesh.faces) == len(target.character.mesh.faces)
