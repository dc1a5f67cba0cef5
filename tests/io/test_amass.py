"""Motions of the SMPL family: every spelling is the same motion, the body stands the right way up, faults are told."""

import itertools

import numpy as np
import pytest
from smpl_maker import amass, angles, model_arrays, z_up

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose, world_pose
from retarget.casting import cast
from retarget.correspond.joints import match_humanoid
from retarget.errors import FileError
from retarget.io import amass as reader
from retarget.io import load
from retarget.io.smpl_joints import CANONICAL, FAMILIES
from retarget.io.smpl_stand_in import stand_in

FRAMES = 7
ROOT, BODY, HANDS = slice(0, 3), slice(3, 66), slice(66, 156)


def moving(joints, seed=1):
    """Small random rotations and a path, standing along +Z."""
    random = np.random.default_rng(seed)
    poses = 0.2 * random.normal(size=(FRAMES, joints, 3))
    poses[:, 0] = z_up(FRAMES, 0.3)
    return poses, random.normal(size=(FRAMES, 3))


def same_motion(a, b):
    assert a.skeleton.names == b.skeleton.names and a.fps == b.fps
    assert np.abs(rot.angle_between(a.rotations, b.rotations)).max() < 1e-6
    assert np.allclose(a.translations, b.translations)


# --- the skeletons ------------------------------------------------------------------------------------------------


def test_joints_are_in_the_published_order():
    names = FAMILIES[55].names
    places = {"spine3": 9, "neck": 12, "left_collar": 13, "head": 15, "left_shoulder": 16, "right_wrist": 21, "jaw": 22,
              "left_index1": 25, "left_pinky1": 31, "left_ring1": 34, "left_thumb3": 39, "right_index1": 40, "right_thumb3": 54}  # fmt: skip
    assert {name: names.index(name) for name in places} == places
    assert FAMILIES[24].parents == (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
    assert FAMILIES[52].names == names[:22] + names[25:] and FAMILIES[24].names[22:] == ("left_hand", "right_hand")
    assert FAMILIES[55].parents[22:25] == (15, 15, 15) and FAMILIES[52].parents[22::15] == (20, 21)


@pytest.mark.parametrize(("joints", "gender"), list(itertools.product(FAMILIES, (None, "male", "female"))))
def test_the_stand_in_is_matched_joint_by_joint(joints, gender):
    skeleton = stand_in(FAMILIES[joints], gender, "SMPL").skeleton
    humanoid = match_humanoid(skeleton)
    found = {skeleton.names[joint]: name for name, joint in humanoid.joints.items()}
    face = {"jaw": "jaw", "left_eye_smplhf": "leftEye", "right_eye_smplhf": "rightEye"}
    assert found == {name: (CANONICAL | face)[name] for name in FAMILIES[joints].names if name in CANONICAL | face}
    assert np.allclose(humanoid.axes, np.eye(3), atol=0.1)


def test_the_stand_in_stands_in_a_t():
    skeleton = stand_in(FAMILIES[52], None, "SMPL").skeleton
    rotations, positions = rest_pose(skeleton)
    at = dict(zip(skeleton.names, positions))
    assert np.allclose(rotations, rot.IDENTITY)
    for side, out in (("left", 1), ("right", -1)):
        for start, end in (("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "middle1"), ("index1", "index3")):
            bone = rot.unit(at[f"{side}_{end}"] - at[f"{side}_{start}"])
            assert bone[0] * out > np.cos(np.radians(8)), (side, start)
        assert at[f"{side}_index1"][2] > at[f"{side}_pinky1"][2] + 0.03, "palms down: the index finger is in front"
        assert abs(at[f"{side}_index1"][1] - at[f"{side}_pinky1"][1]) < 0.02
        assert at[f"{side}_hip"][1] > at[f"{side}_knee"][1] > at[f"{side}_ankle"][1] > at[f"{side}_foot"][1]
        assert at[f"{side}_foot"][2] > at[f"{side}_ankle"][2] + 0.05, "toes point forward"
    mirrored = {
        name: at[name.replace("left", "right") if "left" in name else name.replace("right", "left")] for name in at
    }
    assert all(np.allclose(at[name], mirrored[name] * [-1, 1, 1], atol=1e-6) for name in at)


def test_gender_chooses_the_stand_in(tmp_path):
    poses, trans = moving(22)
    height = {}
    for gender in ("male", "female", "neutral"):
        asset = load(amass(tmp_path / "a.npz", poses, trans, gender=gender))
        height[gender] = cast(asset, motion=asset.motion()).height
        assert any(gender in note and "stands in" in note for note in asset.notes)
    assert height["female"] < height["neutral"] < height["male"]


# --- spellings ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("joints", "rate"), list(itertools.product(FAMILIES, ("mocap_framerate", "mocap_frame_rate"))))
def test_whole_poses_of_every_family(tmp_path, joints, rate):
    poses, trans = moving(joints)
    asset = load(amass(tmp_path / "dance.npz", poses, trans, fps=59.94, rate=rate))
    motion = asset.motion("dance")
    assert asset.kind == "motion" and asset.clips[0].frames == FRAMES and motion.fps == 59.94
    assert motion.skeleton.names == FAMILIES[joints].names
    assert (asset.convention.metres_per_unit, asset.convention.up) == (1.0, "+z")
    assert np.allclose(rot.to_rotation_vector(motion.rotations), poses)


def test_flat_and_by_joint_are_the_same(tmp_path):
    poses, trans = moving(52)
    np.savez(tmp_path / "a.npz", poses=poses, trans=trans, mocap_framerate=30.0)
    same_motion(load(tmp_path / "a.npz").motion(), load(amass(tmp_path / "b.npz", poses, trans, 30.0)).motion())


@pytest.mark.parametrize("amass_names", [True, False])
def test_parts_are_the_whole(tmp_path, amass_names):
    poses, trans = moving(55)
    whole = load(amass(tmp_path / "whole.npz", poses, trans, 30.0)).motion()
    flat = poses.reshape(FRAMES, -1)
    if amass_names:
        names = {
            "root_orient": (0, 3),
            "pose_body": (3, 66),
            "pose_jaw": (66, 69),
            "pose_eye": (69, 75),
            "pose_hand": (75, 165),
        }
    else:
        names = {"global_orient": (0, 3), "body_pose": (3, 66), "jaw_pose": (66, 69), "leye_pose": (69, 72),
                 "reye_pose": (72, 75), "left_hand_pose": (75, 120), "right_hand_pose": (120, 165)}  # fmt: skip
    parts = {name: flat[:, start:stop] for name, (start, stop) in names.items()}
    path = {"trans" if amass_names else "transl": trans}
    np.savez(tmp_path / "parts.npz", **parts, **path, mocap_frame_rate=30.0)
    same_motion(load(tmp_path / "parts.npz").motion(), whole)


def test_parts_make_the_smallest_body_that_holds_them(tmp_path):
    flat = moving(55)[0].reshape(FRAMES, -1)
    parts = {"global_orient": flat[:, :3], "body_pose": flat[:, 3:66]}
    hands = {"left_hand_pose": flat[:, 75:120]}

    def joints(**arrays):
        np.savez(tmp_path / "a.npz", fps=30, **arrays)
        return len(load(tmp_path / "a.npz").motion().skeleton)

    assert joints(**parts) == 22
    assert joints(**parts | {"body_pose": flat[:, 3:72]}) == 24
    assert joints(**parts, **hands) == 52
    assert joints(**parts, jaw_pose=flat[:, :3]) == 55
    assert joints(**parts | {"body_pose": flat[:, 3:72]}, **hands) == 55


def test_components_of_hand_poses_are_no_angles(tmp_path):
    flat = moving(55)[0].reshape(FRAMES, -1)
    np.savez(
        tmp_path / "a.npz", global_orient=flat[:, :3], body_pose=flat[:, 3:66], left_hand_pose=flat[:, :12], fps=30
    )
    asset = load(tmp_path / "a.npz")
    assert len(asset.motion().skeleton) == 22 and any("12 components" in note for note in asset.notes)


def test_what_the_file_leaves_out_is_said(tmp_path):
    poses, _ = moving(22)
    np.savez(tmp_path / "a.npz", poses=poses)
    asset = load(tmp_path / "a.npz")
    assert asset.motion().fps == 30.0 and any("no frame rate" in note for note in asset.notes)
    assert np.ptp(asset.motion().translations) == np.ptp(asset.motion().skeleton.offsets[0])
    assert any("no path" in note for note in asset.notes)


def test_the_path_moves_the_model_not_the_pelvis(tmp_path):
    poses, trans = moving(22)
    smpl = load(amass(tmp_path / "a.npz", poses, trans))
    smplx = load(amass(tmp_path / "b.npz", poses, trans, surface_model_type=np.array("smplx_locked_head")))
    assert np.allclose(smpl.motion().translations[:, 0] - trans, [0, -0.22, 0.03])
    assert np.allclose(smplx.motion().translations[:, 0] - trans, [0, -0.35, 0.01])


# --- which way is up ----------------------------------------------------------------------------------------------


def cast_of(path):
    asset = load(path)
    motion = asset.motion()
    actor = cast(asset, motion=motion)
    return asset, actor, world_pose(actor.house_from_file.motion(motion))


def heads_up(positions, skeleton):
    up = positions[:, skeleton.index("head")] - positions[:, 0]
    return rot.unit(up)[:, 1].min()


def test_amass_stands_up_and_rests_standing(tmp_path):
    poses = angles(40, 22)
    poses[:, 0] = z_up(40, 0.5)
    asset, actor, (_, positions) = cast_of(amass(tmp_path / "a.npz", poses, np.zeros((40, 3))))
    assert asset.convention.up == "+z" and actor.notes == () and heads_up(positions, actor.skeleton) > 0.98
    assert np.allclose(actor.humanoid.axes[1], [0, 1, 0], atol=0.1)


def test_amass_that_lies_from_first_to_last_has_z_up(tmp_path):
    for turn in ([0.0, 0.0, 0.0], [np.pi, 0.0, 0.0], [0.0, np.pi / 2, 0.0]):
        poses = angles(40, 22, pelvis=turn)  # the body's own up lies along y: on its back, on its face, on a side
        trans = np.zeros((40, 3))
        trans[:, 1], trans[:, 2] = 1.5, 0.1
        _, actor, (_, positions) = cast_of(amass(tmp_path / "a.npz", poses, trans))
        assert abs(heads_up(positions, actor.skeleton)) < 0.2, turn
        assert np.ptp(positions[:, 0, 1]) < 1e-6, "the path is level"


def test_amass_that_crawls_from_first_to_last_has_z_up(tmp_path):
    poses = angles(40, 22, left_hip=[-1.5, 0, 0], right_hip=[-1.5, 0, 0], left_knee=[1.5, 0, 0], right_knee=[1.5, 0, 0])
    poses[:, 0] = [0.0, np.pi, 0.0]
    trans = np.zeros((40, 3))
    trans[:, 1], trans[:, 2] = np.linspace(-1, 1, 40), 0.4
    asset, actor, (_, positions) = cast_of(amass(tmp_path / "a.npz", poses, trans))
    assert asset.convention.up == "+z" and abs(heads_up(positions, actor.skeleton)) < 0.2
    assert (positions[:, 4, 1] < positions[:, 1, 1] - 0.2).all(), "knees are below hips"


def test_others_use_the_rate_key_with_y_up(tmp_path):
    poses, trans = angles(40, 55), np.zeros((40, 3))
    trans[:, 0] = np.linspace(0, 2, 40)
    trans[:, 1] = 1.3
    asset, actor, (_, positions) = cast_of(amass(tmp_path / "a.npz", poses, trans))
    assert asset.convention.up == "+y" and any("+z up" in note for note in asset.notes)
    assert heads_up(positions, actor.skeleton) > 0.98


@pytest.mark.parametrize(("root", "up"), [([0, 0, 0], "+y"), ([np.pi, 0, 0], "-y"), ([np.pi / 2, 0, 0], "+z")])
def test_without_the_key_the_motion_decides(tmp_path, root, up):
    poses = angles(40, 22, pelvis=root)
    axis = {"+y": [0, 1.2, 0], "-y": [0, -0.7, 0], "+z": [0, 0, 0.9]}[up]
    np.savez(tmp_path / "a.npz", global_orient=poses[:, 0], body_pose=poses[:, 1:].reshape(40, -1), fps=30,
             transl=np.broadcast_to(axis, (40, 3)))  # fmt: skip
    asset, actor, (_, positions) = cast_of(tmp_path / "a.npz")
    assert asset.convention.up is None and heads_up(positions, actor.skeleton) > 0.98


# --- faults -------------------------------------------------------------------------------------------------------


def told(path, **arrays):
    np.savez(path / "bad.npz", **{name: np.asarray(value) for name, value in arrays.items()})
    with pytest.raises(FileError) as error:
        load(path / "bad.npz")
    assert "bad.npz" in str(error.value) and "\n" not in str(error.value)
    return error.value


GOOD = {"poses": np.zeros((4, 66)), "trans": np.zeros((4, 3)), "mocap_framerate": 60.0}
PARTS = {"root_orient": np.zeros((4, 3)), "pose_body": np.zeros((4, 63)), "fps": 60.0}


@pytest.mark.parametrize(
    ("change", "place", "problem"),
    [
        ({"poses": np.zeros((4, 69))}, "poses", "69 values a frame"),
        ({"poses": np.zeros((4, 23, 3))}, "poses", "69 values a frame"),
        ({"poses": np.zeros((4, 65))}, "poses", "axis times angle"),
        ({"poses": np.zeros((4, 22, 3, 3))}, "poses", "axis times angle"),
        ({"poses": np.zeros(66)}, "poses", "axis times angle"),
        ({"poses": np.zeros((0, 66))}, "poses", "no frames"),
        ({"poses": np.full((4, 66), np.nan)}, "poses", "not finite"),
        ({"poses": np.array([None])}, "poses", "run code"),
        ({"trans": np.zeros((3, 3))}, "trans", "(4, 3)"),
        ({"trans": np.full((4, 3), np.inf)}, "trans", "not finite"),
        ({"mocap_framerate": 0.0}, "mocap_framerate", "from 0.1 to 10000"),
        ({"mocap_framerate": -30.0}, "mocap_framerate", "from 0.1 to 10000"),
        ({"mocap_framerate": np.nan}, "mocap_framerate", "not finite"),
        ({"mocap_framerate": [30.0, 60.0]}, "mocap_framerate", "one number"),
        ({"mocap_framerate": "60"}, "mocap_framerate", "must hold numbers"),
    ],
)
def test_faults_of_whole_poses(tmp_path, change, place, problem):
    error = told(tmp_path, **GOOD | change)
    assert error.place == place and problem in error.problem


@pytest.mark.parametrize(
    ("change", "place", "problem"),
    [
        ({"pose_body": np.zeros((4, 60))}, "pose_body", "60 values a frame; 63 are needed"),
        ({"pose_body": np.zeros((5, 63))}, "pose_body", "has 5 frames, the root has 4"),
        ({"pose_hand": np.zeros((4, 93))}, "pose_hand", "93 values a frame; 90 are needed"),
        ({"pose_jaw": np.zeros((4, 6))}, "pose_jaw", "6 values a frame; 3 are needed"),
        ({"pose_eye": np.array([None])}, "pose_eye", "run code"),
    ],
)
def test_faults_of_parts(tmp_path, change, place, problem):
    error = told(tmp_path, **PARTS | change)
    assert error.place == place and problem in error.problem


def test_motions_without_end_are_refused_before_they_are_read(tmp_path, monkeypatch):
    monkeypatch.setattr(reader, "LONGEST", 200)
    assert "cut it" in told(tmp_path, **GOOD).problem


def test_an_archive_of_neither_kind_says_what_it_holds_and_what_is_needed(tmp_path):
    message = told(tmp_path, betas=np.zeros(3), root_orient=np.zeros((4, 3))).problem
    assert all(word in message for word in ("betas", "root_orient", "poses", "pose_body", "v_template"))
    with open(tmp_path / "bad.npz", "wb") as file:
        np.savez(file)
    with pytest.raises(FileError, match="holds no arrays"):
        load(tmp_path / "bad.npz")


# --- on the user's model ------------------------------------------------------------------------------------------


def with_model(tmp_path, joints, motion_joints=None, model=None, **more):
    poses, trans = moving(motion_joints or joints)
    np.savez(tmp_path / "model.npz", **(model or model_arrays(joints)))
    amass(tmp_path / "a.npz", poses, trans, **more)
    return load(tmp_path / "a.npz", smpl_model=tmp_path / "model.npz"), poses, trans


@pytest.mark.parametrize("joints", [24, 52, 55])
def test_the_model_gives_joints_and_surface(tmp_path, joints):
    betas = np.array([1.5, -0.7, 0.4])
    asset, poses, trans = with_model(tmp_path, joints, betas=betas)
    arrays = model_arrays(joints)
    shaped = arrays["v_template"] + arrays["shapedirs"][:, :, :3] @ betas
    places = arrays["J_regressor"] @ shaped
    assert asset.kind == "character" and asset.convention.up == "+z"
    motion, skeleton = asset.motion(), asset.character.skeleton
    assert np.allclose(skeleton.offsets[1:], (places - places[list(FAMILIES[joints].parents)])[1:])
    assert np.allclose(motion.translations[:, 0], trans + places[0])
    assert np.allclose(rot.to_rotation_vector(motion.rotations), poses)
    # SMPL's own formula: linear blend skinning of the shaped template about its joints, then moved by trans
    world, at = world_pose(motion)
    frame, vertex = 3, 1234
    expected = sum(
        weight * (rot.rotate(world[frame, joint], shaped[vertex] - places[joint]) + at[frame, joint])
        for joint, weight in enumerate(arrays["weights"][vertex])
    )
    from retarget.body.skinning import rest_vertices, skin_motion

    assert np.allclose(skin_motion(asset.character, motion)[frame, vertex], expected, atol=1e-5)
    stood = shaped[:, [0, 2, 1]] * [1, -1, 1]
    assert np.allclose(rest_vertices(asset.character), stood, atol=1e-5), "at rest it stands along +Z"


def test_a_motion_on_a_model_of_another_family(tmp_path):
    asset, poses, trans = with_model(tmp_path, 24, 52, betas=np.ones(4))
    assert any("30 joints" in note for note in asset.notes) and len(asset.motion().skeleton) == 24
    mean = model_arrays(24)["J_regressor"] @ model_arrays(24)["v_template"]
    assert not np.allclose(asset.motion().translations[:, 0], trans + mean[0]), "SMPL and SMPL+H share shapes"
    asset, poses, trans = with_model(tmp_path, 55, 52, betas=np.ones(4))
    assert any("shape is one of SMPL" in note for note in asset.notes)
    places = model_arrays(55)["J_regressor"] @ model_arrays(55)["v_template"]
    assert np.allclose(asset.character.skeleton.offsets[1], rot.rotate(rot.IDENTITY, places[1] - places[0]))
    assert np.allclose(asset.motion().translations[:, 0], trans + [0, -0.22, 0.03])
    assert np.allclose(rot.to_rotation_vector(asset.motion().rotations[:, 25:]), poses[:, 22:])


def test_betas_of_any_length(tmp_path):
    first, *_ = with_model(tmp_path, 24, betas=np.array([1.0]))
    more, *_ = with_model(tmp_path, 24, betas=np.r_[1.0, np.zeros(15)])
    assert np.allclose(first.character.mesh.vertices, more.character.mesh.vertices)
    assert any("10 of the motion's 16" in note for note in more.notes)
    each, *_ = with_model(tmp_path, 24, betas=np.ones((FRAMES, 1)))
    assert np.allclose(first.character.mesh.vertices, each.character.mesh.vertices)
    none, *_ = with_model(tmp_path, 24, betas=np.zeros(0))
    assert np.allclose(none.character.mesh.vertices[:, 2], model_arrays(24)["v_template"][:, 1])
    changing, *_ = with_model(tmp_path, 24, betas=np.arange(2.0)[:, None])
    assert any("their mean" in note for note in changing.notes)
    for bad, problem in (
        (np.ones((1, 1, 1)), "row of numbers"),
        (np.zeros((0, 3)), "row of numbers"),
        (np.array([np.nan]), "finite"),
    ):
        with pytest.raises(FileError, match=problem):
            with_model(tmp_path, 24, betas=bad)


def test_a_motion_without_betas_has_the_mean_body(tmp_path):
    poses, trans = moving(24)
    np.savez(tmp_path / "model.npz", **model_arrays(24))
    np.savez(tmp_path / "a.npz", poses=poses, trans=trans, fps=30)
    asset = load(tmp_path / "a.npz", smpl_model=tmp_path / "model.npz")
    assert any("mean body" in note for note in asset.notes)
    assert np.allclose(asset.character.mesh.vertices, model_arrays(24)["v_template"])
