"""VRM avatars: their own humanoid map is trusted, and everything that VRM adds stays in the file."""

import json
import struct

import numpy as np
import pytest
from gltf_maker import pack
from made_motions import actor

from retarget.body.kinematics import world_pose
from retarget.character import Motion
from retarget.errors import FileError
from retarget.io import load, save
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion
from retarget.retargeting import Hints, cast, retarget

REQUIRED = ("hips", "spine", "head", *(f"{side}{part}" for side in ("left", "right") for part in (
    "UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand", "ThumbMetacarpal", "ThumbProximal", "ThumbDistal")))  # fmt: skip
META = {"name": "made", "authors": ["nobody"], "licenseUrl": "https://vrm.dev/licenses/1.0/", "allowRedistribution": False}
SPRINGS = {"specVersion": "1.0", "springs": [{"name": "hair", "joints": [{"node": 3, "stiffness": 0.7}]}]}


def parts(path):
    """JSON and binary chunk of a GLB file."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length]), data[20 + length + 8 :]


def avatar(path, version, change=lambda bones: None, scrambled=True):
    """An embedded body as VRM whose joints have names that say nothing; `change` alters the map."""
    body = actor("child").character
    save(path.with_suffix(".glb"), body, [])
    text, binary = parts(path.with_suffix(".glb"))
    nodes = {node["name"]: number for number, node in enumerate(text["nodes"])}
    joints = actor("child").humanoid.joints
    old = {"ThumbMetacarpal": "ThumbProximal", "ThumbProximal": "ThumbIntermediate"}
    bones = {}
    for name in REQUIRED:
        side = next((each for each in ("left", "right") if name.startswith(each)), "")
        said = side + old.get(name[len(side) :], name[len(side) :]) if version == 0 else name
        bones[said] = nodes[body.skeleton.names[joints[name]]]
    change(bones)
    if scrambled:
        for number in range(len(body.skeleton)):
            text["nodes"][number]["name"] = f"J_{number:03d}"
    if version == 0:
        rows = [{"bone": bone, "node": node, "useDefaultValues": True} for bone, node in bones.items()]
        text["extensions"] = {"VRM": {"specVersion": "0.0", "meta": META, "humanoid": {"humanBones": rows}}}
    else:
        rows = {bone: {"node": node} for bone, node in bones.items()}
        text["extensions"] = {
            "VRMC_vrm": {"specVersion": "1.0", "meta": META, "humanoid": {"humanBones": rows}}, "VRMC_springBone": SPRINGS
        }  # fmt: skip
    text["extensionsUsed"] = list(text["extensions"])
    path.write_bytes(pack(json.dumps(text).encode(), binary))
    return path


@pytest.mark.parametrize("version", [0, 1])
def test_the_files_map_is_trusted_over_names_and_shape(tmp_path, version):
    asset = load(avatar(tmp_path / "a.vrm", version))
    assert set(asset.humanoid) == set(REQUIRED)
    found = cast(asset).humanoid
    assert found.evidence == "map"
    truth = actor("child").humanoid.joints
    offsets = {name: asset.character.skeleton.offsets[joint] for name, joint in found.joints.items()}
    for name in REQUIRED:
        if name != "hips":
            assert np.allclose(offsets[name], actor("child").skeleton.offsets[truth[name]], atol=1e-5), name


def test_a_users_map_wins(tmp_path):
    asset = load(avatar(tmp_path / "a.vrm", 1))
    names = dict(asset.humanoid)
    names["spine"] = asset.character.skeleton.names[cast(asset).humanoid.joints["spine"] + 1]
    assert cast(asset, Hints(joints=names)).humanoid.joints["spine"] == cast(asset).humanoid.joints["spine"] + 1


@pytest.mark.parametrize("version", [0, 1])
@pytest.mark.parametrize("suffix", [".vrm", ".glb"])
def test_everything_that_vrm_adds_stays(tmp_path, version, suffix):
    source = avatar(tmp_path / "a.vrm", version)
    result = retarget(cut(embedded_motion("wave"), 0.0, 0.5), source, method="copy-rotations")
    result.save(tmp_path / f"out{suffix}")
    before, after = parts(source)[0], parts(tmp_path / f"out{suffix}")[0]
    assert after["extensions"] == before["extensions"] and after["extensionsUsed"] == before["extensionsUsed"]
    assert after["nodes"] == before["nodes"] and len(after["animations"]) == 1
    back = load(tmp_path / f"out{suffix}")
    here, there = world_pose(result.file_motion)[1], world_pose(back.motion())[1]
    own = [back.character.skeleton.names.index(name) for name in result.file_motion.skeleton.names]
    assert 1000 * np.abs(there[:, own] - here).max() < 0.1, "mm"
    assert back.humanoid == load(source).humanoid


def test_a_map_without_required_bones_is_passed_over(tmp_path):
    asset = load(avatar(tmp_path / "a.vrm", 1, lambda bones: bones.pop("leftFoot"), scrambled=False))
    assert asset.humanoid is None and any("has no leftFoot" in note for note in asset.notes)
    assert cast(asset).humanoid.evidence != "map"


def test_bones_that_move_nothing_are_noted(tmp_path):
    def change(bones):
        bones["jaw"] = len(actor("child").skeleton)  # the mesh's own node

    asset = load(avatar(tmp_path / "a.vrm", 1, change))
    assert "jaw" not in asset.humanoid and any("jaw move no surface" in note for note in asset.notes)


@pytest.mark.parametrize(
    ("version", "change", "said"),
    [
        (1, lambda bones: bones.update(head=999), "'head' is node 999, which does not exist"),
        (0, lambda bones: bones.update(head="x"), "'head' is node x, which does not exist"),
        (1, lambda bones: bones.update(head=bones["hips"]), "is two humanoid bones, 'hips' and 'head'"),
    ],
)
def test_faulty_maps_are_told(tmp_path, version, change, said):
    with pytest.raises(FileError, match=said):
        load(avatar(tmp_path / "a.vrm", version, change))


def test_a_bone_named_twice_is_told(tmp_path):
    path = avatar(tmp_path / "a.vrm", 0)
    text, binary = parts(path)
    rows = text["extensions"]["VRM"]["humanoid"]["humanBones"]
    rows.append({**rows[0], "node": rows[0]["node"] + 1})
    path.write_bytes(pack(json.dumps(text).encode(), binary))
    with pytest.raises(FileError, match="names the humanoid bone 'hips' twice"):
        load(path)


@pytest.mark.parametrize("extensions", [[], {"VRM": 3}, {"VRMC_vrm": {"humanoid": []}}, {"VRM": {"humanoid": {"humanBones": {}}}}])
def test_other_forms_are_no_map(tmp_path, extensions):
    path = avatar(tmp_path / "a.vrm", 1, scrambled=False)
    text, binary = parts(path)
    text["extensions"] = extensions
    path.write_bytes(pack(json.dumps(text).encode(), binary))
    try:
        assert load(path).humanoid is None
    except FileError as error:
        assert extensions == [] and "extensions" in str(error)


def test_only_an_avatar_is_written_as_one(tmp_path):
    with pytest.raises(FileError, match="only a whole character that was read from VRM"):
        save(tmp_path / "out.vrm", actor("child").character, [])
    asset = load(avatar(tmp_path / "a.vrm", 1))
    skeleton = asset.character.skeleton
    still = Motion(skeleton, skeleton.rest_rotations[None], skeleton.offsets[None, :1])
    with pytest.raises(FileError, match="only a whole character"):
        save(tmp_path / "out.vrm", asset.character, [still], animation_only=True)
    with pytest.raises(FileError, match="not a GLB file"):
        (tmp_path / "text.vrm").write_text("{}")
        load(tmp_path / "text.vrm")
