"""VRM: the humanoid comes from the file, whatever its joints are called, and all that the file holds is kept."""

import json
import random
from dataclasses import replace

import numpy as np
import pytest
from file_faults import mutated
from gltf_maker import pack
from made_motions import body, walk
from typer.testing import CliRunner
from vrm_maker import old_name, split, vrm

from retarget import cli, commands_run
from retarget.body.kinematics import world_pose
from retarget.casting import Hints, cast
from retarget.correspond.joints import HUMANOID_JOINTS, REQUIRED_JOINTS
from retarget.errors import FileError, RetargetError
from retarget.io import load, save
from retarget.io.vrm import BONES
from retarget.retargeting import prepare, retarget

VERSIONS = ("1.0", "0.x", "animation")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("vrm")
    save(folder / "walk.bvh", body(), [walk()])
    vrm(folder / "new.vrm")
    vrm(folder / "old.vrm", "0.x")
    vrm(folder / "walk.vrma", "animation", motions=[walk()])
    return folder


def test_the_bones_of_vrm_are_our_humanoid_joints():
    assert set(HUMANOID_JOINTS) == BONES


@pytest.mark.parametrize("version", VERSIONS)
def test_the_humanoid_is_read_from_the_file(tmp_path, version):
    suffix = ".vrma" if version == "animation" else ".vrm"
    asset = load(vrm(tmp_path / f"a{suffix}", version, motions=[walk()]))
    humanoid = cast(asset).humanoid
    assert asset.kind == ("motion" if version == "animation" else "character")
    assert set(asset.humanoid) == set(body().skeleton.names) & BONES and humanoid.evidence == "the file"
    # Which joint is which is told by where it stands in the tree of the body that the file was made of.
    places, own = world_pose(asset.motion())[1], world_pose(walk())[1]
    if version == "0.x":
        own = own * [-1, 1, -1]
    for name, joint in humanoid.joints.items():
        assert places[:, joint] == pytest.approx(own[:, body().skeleton.index(name)], abs=1e-5), name
    assert any("is the one that the file names" in note for note in asset.notes)


def test_an_old_avatar_faces_the_other_way_and_its_thumbs_have_other_names(files):
    new, old = cast(files / "new.vrm"), cast(files / "old.vrm")
    assert new.humanoid.axes[2] @ old.humanoid.axes[2] < -0.99
    assert load(files / "old.vrm").convention.forward == "-z" and load(files / "new.vrm").convention.forward == "+z"
    assert old_name("leftThumbMetacarpal") == "leftThumbProximal"
    thumbs = [name for name in new.humanoid.joints if "Thumb" in name]
    assert len(thumbs) == 6 and all(old.humanoid.joints[name] == new.humanoid.joints[name] for name in thumbs)


def test_the_file_is_believed_against_what_shape_tells(tmp_path):
    """Two fingers change places in the file's map only."""

    def change(document):
        bones = document["extensions"]["VRMC_vrm"]["humanoid"]["humanBones"]
        bones["leftIndexProximal"], bones["leftMiddleProximal"] = (
            bones["leftMiddleProximal"],
            bones["leftIndexProximal"],
        )

    straight, crossed = cast(vrm(tmp_path / "a.vrm")), cast(vrm(tmp_path / "b.vrm", change=change))
    assert crossed.humanoid.joints["leftIndexProximal"] == straight.humanoid.joints["leftMiddleProximal"]


def test_a_map_of_the_user_wins(files):
    asset = load(files / "new.vrm")
    told = {**asset.humanoid}
    del told["leftToes"]
    actor = cast(asset, Hints(joints=told))
    assert actor.humanoid.evidence == "map" and "leftToes" not in actor.humanoid.joints


@pytest.mark.parametrize("avatar", ["new.vrm", "old.vrm"])
@pytest.mark.parametrize("output", ["out.vrm", "out.glb"])
@pytest.mark.parametrize("source", ["walk.bvh", "walk.vrma"])
def test_a_written_avatar_keeps_all_that_the_file_holds(files, tmp_path, avatar, output, source):
    arguments = [
        "run",
        str(files / source),
        str(files / avatar),
        "-o",
        str(tmp_path / output),
        "--method",
        "copy-rotations",
    ]
    done = CliRunner().invoke(cli.app, arguments)
    assert done.exit_code == 0, done.output
    (old, held), (new, kept) = split(files / avatar), split(tmp_path / output)
    for key, value in old.items():
        if key not in ("asset", "buffers", "accessors", "bufferViews"):
            assert new[key] == value, key
    size = old["buffers"][0]["byteLength"]
    assert kept[:size] == held[:size] and len(new["animations"]) == 1
    again = load(tmp_path / output)
    assert again.humanoid == load(files / avatar).humanoid


@pytest.mark.parametrize("avatar", ["new.vrm", "old.vrm"])
def test_joints_of_the_written_motion_stand_where_they_were_put(files, tmp_path, avatar):
    result = retarget(files / "walk.bvh", files / avatar, method="copy-rotations")
    result.save(tmp_path / "out.vrm")
    found = world_pose(load(tmp_path / "out.vrm").motion())[1]
    assert 1000 * np.abs(found - world_pose(result.motion)[1]).max() <= 0.1  # millimetres


def test_an_avatar_that_faces_the_other_way_at_rest_performs_the_same(files):
    """Both avatars are one body, so in the world every joint goes the same way."""
    source, places = cast(files / "walk.bvh"), []
    for name in ("new.vrm", "old.vrm"):
        target = cast(files / name)
        found = world_pose(prepare(source, target, "copy-rotations")(load(files / "walk.bvh").motion()).motion)[1]
        places.append(found[:, [target.humanoid.joints[each] for each in REQUIRED_JOINTS]])
    assert np.ptp(places[0][:, 0], axis=0).max() > 0.5 and np.abs(places[0] - places[1]).max() < 1e-3


def test_a_vrm_needs_a_vrm(files, tmp_path):
    source = cast(files / "walk.bvh")
    motion = load(files / "walk.bvh").motion()
    with pytest.raises(FileError, match="came from no VRM"):
        save(tmp_path / "out.vrm", body(), [walk()])
    result = prepare(source, cast(files / "new.vrm"), "copy-rotations")(motion)
    with pytest.raises(FileError, match="animation alone is no VRM; write a .glb"):
        result.save(tmp_path / "out.vrm", animation_only=True)
    with pytest.raises(FileError, match="cannot write '.vrma'"):
        result.save(tmp_path / "out.vrma")
    assert not list(tmp_path.iterdir())


def test_the_command_line_refuses_a_vrm_before_it_works(files, tmp_path, monkeypatch):
    save(tmp_path / "plain.glb", body(), [])
    monkeypatch.setattr(commands_run, "prepare", None)  # nothing comes that far
    order = commands_run.Order((files / "walk.bvh",), tmp_path / "plain.glb", tmp_path / "a.vrm")
    with pytest.raises(FileError, match="came from no VRM"):
        commands_run.run_order(order)
    with pytest.raises(FileError, match="animation alone is no VRM"):
        commands_run.run_order(replace(order, target=files / "new.vrm", animation_only=True))


def test_animation_alone_goes_into_a_folder_as_glb(files, tmp_path):
    arguments = [
        "run",
        str(files / "walk.bvh"),
        str(files / "new.vrm"),
        "-o",
        str(tmp_path / "out"),
        "--animation-only",
    ]
    assert CliRunner().invoke(cli.app, [*arguments, "--method", "copy-rotations"]).exit_code == 0
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["walk_new.glb"]


def test_what_is_no_glb_is_refused(tmp_path):
    (tmp_path / "a.vrm").write_text("{}")
    with pytest.raises(FileError, match="is not a GLB file"):
        load(tmp_path / "a.vrm")


def bones_of(document):
    return document["extensions"]["VRMC_vrm"]["humanoid"]["humanBones"]


def far_node(document):
    bones_of(document)["jaw"] = {"node": 9999}


def text_node(document):
    bones_of(document)["leftEye"] = {"node": "3"}


def unknown_bone(document):
    bones_of(document)["tail"] = {"node": 3}


def same_node(document):
    bones_of(document)["jaw"] = {"node": bones_of(document)["head"]["node"]}


def lost_node(document):
    document["nodes"].append({"name": "elsewhere"})
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)
    bones_of(document)["jaw"] = {"node": len(document["nodes"]) - 1}


@pytest.mark.parametrize(
    ("change", "note"),
    [
        (far_node, "'jaw' is left out: there is no node 9999"),
        (text_node, "'leftEye' is left out: there is no node '3'"),
        (unknown_bone, "'tail' is left out: there is no such bone"),
        (same_node, "'jaw' is left out: node"),
        (lost_node, "bones jaw are left out: their nodes are no part of the skeleton"),
    ],
)
def test_faulty_entries_are_left_out_and_told(tmp_path, change, note):
    asset = load(vrm(tmp_path / "a.vrm", change=change))
    assert any(note in each for each in asset.notes), asset.notes
    humanoid = cast(asset).humanoid
    assert humanoid.evidence == "the file" and set(REQUIRED_JOINTS) <= set(humanoid.joints)


def test_a_bone_named_twice_is_told_and_the_first_counts(tmp_path):
    def change(document):
        bones = document["extensions"]["VRM"]["humanoid"]["humanBones"]
        bones.append({"bone": "head", "node": 1})

    asset = load(vrm(tmp_path / "a.vrm", "0.x", change=change))
    assert any("'head' is left out: it is named twice" in each for each in asset.notes)
    assert asset.humanoid == load(vrm(tmp_path / "b.vrm", "0.x")).humanoid


def drop_arm(document):
    del bones_of(document)["leftLowerArm"]


def drop_legs(document):
    for name in list(bones_of(document)):
        if "Leg" in name or "UpperArm" in name:
            del bones_of(document)[name]


@pytest.mark.parametrize(("change", "missing"), [(drop_arm, "lacks leftLowerArm"), (drop_legs, "lacks ")])
def test_a_map_that_lacks_limbs_gives_way_to_matching(tmp_path, change, missing):
    actor = cast(vrm(tmp_path / "a.vrm", change=change))
    assert any(missing in note and "matched by names and shape" in note for note in actor.notes)
    assert actor.humanoid.evidence != "the file" and "leftLowerArm" in actor.humanoid.joints


@pytest.mark.parametrize("held", [3, None, [], {}, {"humanoid": 3}, {"humanoid": {"humanBones": 3}}])
@pytest.mark.parametrize("name", ["VRM", "VRMC_vrm"])
def test_a_humanoid_of_another_form_is_told_and_passed_over(tmp_path, held, name):
    def change(document):
        document["extensions"] = {name: held}

    asset = load(vrm(tmp_path / "a.vrm", change=change))
    assert asset.humanoid is None and any("cannot be read and is passed over" in note for note in asset.notes)
    assert cast(asset).humanoid.evidence == "shape"


@pytest.mark.parametrize("entry", [1, None, {}, {"bone": 3, "node": 1}, {"bone": ["head"], "node": 1}, {"bone": "jaw"}])
@pytest.mark.parametrize("name", ["VRM", "VRMC_vrm"])
def test_entries_of_another_form_are_left_out_one_by_one(tmp_path, entry, name):
    def change(document):
        bones = document["extensions"][name]["humanoid"]["humanBones"]
        if name == "VRM":
            bones.append(entry)
        else:
            bones["jaw"] = entry if not (type(entry) is dict and "node" in entry) else {"node": 1.5}

    asset = load(vrm(tmp_path / "a.vrm", "0.x" if name == "VRM" else "1.0", change=change))
    assert len(asset.humanoid) == 52 and sum("is left out" in note for note in asset.notes) == 1


def test_bones_that_an_avatar_lacks_may_be_listed_without_a_node(tmp_path):
    def change(document):
        document["extensions"]["VRM"]["humanoid"]["humanBones"].append({"bone": "jaw", "node": -1})

    asset = load(vrm(tmp_path / "a.vrm", "0.x", change=change))
    assert "jaw" not in asset.humanoid and not any("jaw" in note for note in asset.notes)


def test_extensions_that_are_no_object_are_nothing(tmp_path):
    def change(document):
        document["extensions"] = [1]

    assert load(vrm(tmp_path / "a.vrm", change=change)).humanoid is None


def test_bones_that_no_skin_names_join_the_skeleton(tmp_path):
    def change(document):
        node = bones_of(document)["leftToes"]["node"]
        document["nodes"].append({"name": "tip", "translation": [0, 0, 0.05]})
        document["nodes"][node].setdefault("children", []).append(len(document["nodes"]) - 1)
        bones_of(document)["leftToes"] = {"node": len(document["nodes"]) - 1}

    asset = load(vrm(tmp_path / "a.vrm", change=change))
    assert asset.humanoid["leftToes"] == "tip"


def test_damaged_files_are_read_or_refused(tmp_path):
    """Faults in the JSON, which alone tells a VRM from other files."""
    document, binary = split(vrm(tmp_path / "a.vrm"))
    document.pop("meshes"), document.pop("materials", None)  # what makes it large is tested elsewhere
    for node in document["nodes"]:
        node.pop("mesh", None), node.pop("skin", None)
    text, rng, path = json.dumps(document).encode(), random.Random(6), tmp_path / "bad.vrm"
    start = text.index(b'"extensions": {"VRMC_vrm"')
    outcomes = {"read": 0, "refused": 0}
    for _ in range(500):
        head, tail = text[:start], text[start:]
        path.write_bytes(pack(head + mutated(tail, rng, [b'"node"', b"{}", b"[]", b"null"]), binary))
        try:
            asset = load(path)
            if asset.character is not None:
                cast(asset)
            outcomes["read"] += 1
        except RetargetError as error:
            assert "\n" not in str(error)
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 13, outcomes
