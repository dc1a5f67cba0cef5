"""Matching: whatever the names, order, units, axes and rest pose, the same body gives the same joints."""

import time
from dataclasses import replace

import numpy as np
import pytest
from humanoid_rigs import (
    PLACES,
    POSES,
    RIGS,
    child_places,
    mirrored,
    moved,
    posed,
    renamed,
    reordered,
    rig,
    skeleton_of,
    with_helper,
    without,
)
from other_rigs import THINGS, quadruped, random_tree

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose
from retarget.correspond.joints import (
    HUMANOID_JOINTS,
    REQUIRED_JOINTS,
    humanoid_from_names,
    match_humanoid,
    scrambled,
)
from retarget.errors import MatchError, RetargetError


def named(skeleton, humanoid, originals=None):
    """Canonical name to joint name, in the words of the skeleton before it was scrambled or renamed."""
    names = originals or skeleton.names
    return {canonical: names[joint] for canonical, joint in humanoid.joints.items()}


def required(truth):
    return {canonical: name for canonical, name in truth.items() if canonical in REQUIRED_JOINTS}


def assert_required(skeleton, truth, originals=None):
    got = named(skeleton, match_humanoid(skeleton), originals)
    assert {canonical: got.get(canonical) for canonical in required(truth)} == required(truth)


def other_side(canonical):
    return canonical.replace("left", "?").replace("right", "left").replace("?", "right")


def test_canonical_names_are_those_of_vrm():
    assert len(HUMANOID_JOINTS) == len(set(HUMANOID_JOINTS)) == 55
    assert len(REQUIRED_JOINTS) == 15 and set(REQUIRED_JOINTS) <= set(HUMANOID_JOINTS)


# --- people's rigs ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", RIGS)
def test_every_joint_of_a_known_rig_is_found(name):
    skeleton, truth = rig(name)
    human = match_humanoid(skeleton)
    assert named(skeleton, human) | truth == named(skeleton, human)
    assert set(human.confidence) == set(human.joints)
    assert all(0.0 < each <= 1.0 for each in human.confidence.values())
    assert not set(human.twists) & set(human.joints.values())


@pytest.mark.parametrize("name", RIGS)
def test_scrambled_names_leave_the_shape(name):
    skeleton, truth = rig(name)
    for pose in list(POSES)[len(name) % 4 :: 4]:
        turned = posed(skeleton, {joint: turn for joint, turn in POSES[pose].items() if joint in truth}, truth)
        assert_required(scrambled(turned, seed=len(name)), truth, skeleton.names)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("name", ["unreal 5", "kinect"])
def test_any_rest_pose_will_do(name, pose):
    skeleton, truth = rig(name)
    skeleton = posed(skeleton, {joint: turn for joint, turn in POSES[pose].items() if joint in truth}, truth)
    assert_required(skeleton, truth)
    assert_required(scrambled(skeleton, seed=5), truth, skeleton.names)


@pytest.mark.parametrize("legs, arms, head", [(0.75, 0.85, 1.4), (0.4, 0.6, 2.0), (1.3, 1.1, 0.9), (0.8, 1.35, 1.0)])
def test_proportions_of_children_and_cartoons(legs, arms, head):
    for name in ("mixamo", "vroid", "german"):
        skeleton, truth = rig(name, child_places(legs, arms, head))
        assert_required(skeleton, truth)
        assert_required(scrambled(skeleton, seed=2), truth, skeleton.names)


def test_twist_joints_share_their_segment():
    skeleton, _ = rig("unreal 5")
    twists = {skeleton.names[joint]: part for joint, part in match_humanoid(skeleton).twists.items()}
    assert twists["upperarm_twist_01_l"] == twists["upperarm_twist_02_l"] == "leftUpperArm"
    assert twists["lowerarm_twist_01_r"] == "rightLowerArm"
    assert twists["thigh_twist_01_l"] == "leftUpperLeg" and twists["calf_twist_01_r"] == "rightLowerLeg"
    assert not any("ik_" in name or "finger" in name for name in twists)


def test_split_limbs_and_inline_twists():
    for name, joint in (("rigify deform", "DEF-forearm.L.001"), ("daz genesis 8", "lForearmTwist")):
        skeleton, _ = rig(name)
        assert match_humanoid(skeleton).twists[skeleton.index(joint)] == "leftLowerArm"


def test_a_second_pelvis_is_no_spine():
    low = dict(PLACES) | {"spine": (0.0, 0.8, 0.03)}
    skeleton, _ = rig("mixamo", low)
    human = match_humanoid(replace(skeleton, names=tuple(n.replace("Spine", "Trunk") for n in skeleton.names)))
    got = [skeleton.names[human.joints[name]] for name in ("hips", "spine", "chest")]
    assert got == ["mixamorig:Hips", "mixamorig:Spine1", "mixamorig:Spine2"] and "upperChest" not in human.joints
    assert named(skeleton, match_humanoid(skeleton))["spine"] == "mixamorig:Spine"  # what is called so is one


def test_fingers_of_a_nameless_hand():
    skeleton, truth = rig("smpl-x")
    got = named(skeleton, match_humanoid(scrambled(skeleton, 1)), skeleton.names)
    hands = {canonical: name for canonical, name in truth.items() if canonical.endswith(("Proximal", "Distal"))}
    assert len(hands) == 20
    assert {canonical: got.get(canonical) for canonical in hands} == hands


# --- laws ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["mixamo", "hungarian", "no spine, no clavicles, no toes"])
def test_turned_scaled_and_moved_worlds_change_only_the_axes(name, seed):
    rng = np.random.default_rng(seed)
    skeleton, _ = rig(name)
    turn = rot.normalise(rng.normal(size=4))
    elsewhere = moved(skeleton, turn, 10.0 ** rng.uniform(-3, 3), rng.normal(size=3) * 10)
    here, there = match_humanoid(skeleton), match_humanoid(elsewhere)
    assert here.joints == there.joints and here.twists == there.twists
    np.testing.assert_allclose(there.axes, rot.rotate(turn, here.axes), atol=1e-9)


def test_axes_are_left_up_and_forward():
    for name, pose in (("mixamo", "T"), ("mixamo", "guard"), ("smpl", "sitting"), ("biped", "I")):
        skeleton, truth = rig(name)
        axes = match_humanoid(posed(skeleton, POSES[pose], truth)).axes
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) > 0
        assert (np.diag(axes) > np.cos(np.radians(20))).all(), (name, pose, axes)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["unreal 5", "vroid"])
def test_joint_order_does_not_matter(name, seed):
    skeleton, truth = rig(name)
    again = reordered(skeleton, seed)
    assert again.names != skeleton.names
    assert named(again, match_humanoid(again)) == named(skeleton, match_humanoid(skeleton))


@pytest.mark.parametrize("name", ["mixamo", "rigify deform", "xsens", "smpl"])
def test_a_mirrored_body_exchanges_its_sides(name):
    skeleton, truth = rig(name)
    swapped = {other_side(canonical): joint for canonical, joint in truth.items()}
    image = mirrored(skeleton)
    assert_required(scrambled(image, 1), swapped, image.names)
    assert_required(image, swapped)  # clear toes outweigh the words left and right


def test_matching_is_deterministic():
    skeleton, _ = rig("vroid")
    first, second = match_humanoid(skeleton), match_humanoid(skeleton)
    assert first.joints == second.joints and first.confidence == second.confidence


# --- disturbances -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["mixamo", "unreal 5", "reallusion", "french"])
def test_a_few_new_names_do_no_harm(name):
    skeleton, truth = rig(name)
    rng = np.random.default_rng(len(name))
    for _ in range(3):
        some = rng.choice(len(skeleton), size=len(skeleton) // 4, replace=False)
        changed = renamed(skeleton, {skeleton.names[joint]: f"Object{joint}" for joint in some})
        assert_required(changed, truth, skeleton.names)


@pytest.mark.parametrize("a, b", [("leftUpperLeg", "leftLowerLeg"), ("head", "leftHand"), ("hips", "rightFoot")])
def test_names_that_contradict_the_tree_lose(a, b):
    skeleton, truth = rig("mixamo")
    changed = renamed(skeleton, {truth[a]: truth[b], truth[b]: truth[a]})
    assert_required(changed, truth, skeleton.names)


@pytest.mark.parametrize("joint", ["leftUpperLeg", "rightLowerArm", "head", "leftFoot", "rightHand"])
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_helper_joints_do_no_harm(joint, share):
    for name in ("mixamo", "metarig", "unreal 5"):
        skeleton, truth = rig(name)
        longer = with_helper(skeleton, truth[joint], share, "extra")
        assert_required(longer, truth)
        assert_required(scrambled(longer, 3), truth, longer.names)


@pytest.mark.parametrize("joint", ["spine", "chest", "upperChest", "neck", "leftShoulder"])
def test_missing_joints_do_no_harm(joint):
    for name in ("mixamo", "unreal 5"):
        skeleton, truth = rig(name)
        shorter = without(skeleton, truth[joint])
        left = {canonical: each for canonical, each in truth.items() if canonical not in (joint, "spine")}
        assert_required(shorter, left)
        assert_required(scrambled(shorter, 3), left, shorter.names)


def test_weak_evidence_for_the_sides_shows_in_the_confidence():
    skeleton, truth = rig("xsens")
    flat = skeleton
    for canonical in ("leftToes", "rightToes"):
        flat = without(flat, truth[canonical])
    rotations, positions = rest_pose(flat)
    flat = skeleton_of(list(flat.names), list(flat.parents), positions * [1.0, 1.0, 0.0])
    sure, unsure = match_humanoid(scrambled(skeleton, 1)), match_humanoid(scrambled(flat, 1))
    assert sure.confidence["leftHand"] > 0.8 > 0.6 > unsure.confidence["leftHand"]
    assert unsure.confidence["head"] > 0.6
    assert match_humanoid(flat).confidence["leftHand"] > 0.8  # the names know


def test_evidence_says_what_the_match_rests_on():
    skeleton, truth = rig("mixamo")
    assert match_humanoid(skeleton).evidence == "names and shape"
    assert match_humanoid(scrambled(skeleton, 1)).evidence == "shape"
    assert humanoid_from_names(skeleton, truth).evidence == "map"


def test_well_named_joints_without_a_hierarchy_match_by_name():
    skeleton, truth = rig("unreal 5")
    rotations, positions = rest_pose(skeleton)
    flat = skeleton_of(list(skeleton.names), [-1] + [0] * (len(skeleton) - 1), positions)
    human = match_humanoid(flat)
    assert human.evidence == "names"
    assert named(flat, human) == required(truth)
    with pytest.raises(MatchError):
        match_humanoid(scrambled(flat, 1))


# --- no humans ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("thing", THINGS)
def test_what_is_no_human_is_refused(thing):
    skeleton = THINGS[thing]()
    for each in (skeleton, scrambled(skeleton, 1)):
        with pytest.raises(MatchError):
            match_humanoid(each)


def test_a_cat_with_human_joint_names_is_refused():
    cat = quadruped()
    words = {"spine0": "Bip01 Pelvis", "spine3": "Bip01 Spine2", "neck2": "Bip01 Head", "tail0": "Bip01 Tail"}
    for old, new in (("L_", "Bip01 L "), ("R_", "Bip01 R ")):
        for number, part in enumerate(("Thigh", "Calf", "HorseLink", "Foot", "Toe0")):
            words[f"{old}hindleg{number}"] = new + part
        for number, part in enumerate(("UpperArm", "Forearm", "Hand", "Finger0", "Finger01")):
            words[f"{old}foreleg{number}"] = new + part
    with pytest.raises(MatchError):
        match_humanoid(renamed(cat, words))


def test_random_trees_are_refused():
    for seed in range(40):
        with pytest.raises(MatchError):
            match_humanoid(random_tree(seed))


def test_large_skeletons_do_not_hang():
    start = time.perf_counter()
    with pytest.raises(MatchError):
        match_humanoid(random_tree(1, joints=1500))
    assert time.perf_counter() - start < 10.0


def test_all_joints_in_one_place_are_refused():
    skeleton, _ = rig("mixamo")
    with pytest.raises(MatchError):
        match_humanoid(skeleton_of(list(skeleton.names), list(skeleton.parents), np.zeros((len(skeleton), 3))))


def test_the_refusal_lists_what_is_missing_and_shows_the_line_for_a_map():
    skeleton, truth = rig("mixamo")
    for canonical in ("leftLowerArm", "leftHand", "leftUpperArm", "rightUpperArm", "rightLowerArm", "rightHand"):
        skeleton = without(skeleton, truth[canonical])
    with pytest.raises(MatchError) as caught:
        match_humanoid(skeleton)
    assert set(caught.value.missing) == {name for name in REQUIRED_JOINTS if name.endswith(("Arm", "Hand"))}
    assert 'leftUpperArm = "' in str(caught.value) and "\n" not in str(caught.value)


# --- from a map ---------------------------------------------------------------------------------------------------


def test_a_map_decides_everything():
    skeleton, truth = rig("unreal 5")
    chosen = required(truth) | {"leftHand": "ik_hand_l"}
    human = humanoid_from_names(skeleton, chosen)
    assert named(skeleton, human) == chosen
    np.testing.assert_allclose(human.axes, match_humanoid(skeleton).axes, atol=0.05)
    assert human.twists[skeleton.index("thigh_twist_01_r")] == "rightUpperLeg"


def test_a_map_may_be_partial_but_must_give_the_axes():
    skeleton, truth = rig("mixamo")
    few = ("hips", "head", "leftUpperLeg", "rightUpperLeg")
    human = humanoid_from_names(skeleton, {canonical: truth[canonical] for canonical in few})
    assert set(human.joints) == set(few)
    with pytest.raises(MatchError, match="too few joints"):
        humanoid_from_names(skeleton, {"hips": truth["hips"], "head": truth["head"]})


@pytest.mark.parametrize(
    "change, words",
    [
        ({"leftHand": "LeftHandd"}, "'LeftHandd' is not in the skeleton; nearest: 'LeftHand'"),
        ({"leftPaw": "LeftHand"}, "'leftPaw' is not in VRM"),
        ({"head": "LeftHand"}, "'LeftHand' is mapped twice"),
    ],
)
def test_mistakes_in_a_map_are_named(change, words):
    skeleton, truth = rig("ready player me")
    with pytest.raises(RetargetError, match=words):
        humanoid_from_names(skeleton, required(truth) | change)


# --- scrambling ---------------------------------------------------------------------------------------------------


def test_scrambling_changes_nothing_but_names():
    skeleton, _ = rig("vroid")
    once, again, other = scrambled(skeleton, 1), scrambled(skeleton, 1), scrambled(skeleton, 2)
    assert once.names == again.names != other.names
    assert not set(once.names) & set(skeleton.names) and len(set(once.names)) == len(skeleton)
    np.testing.assert_array_equal(once.parents, skeleton.parents)
    np.testing.assert_array_equal(once.offsets, skeleton.offsets)
