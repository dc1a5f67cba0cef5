"""Chains of different joint counts share one rotation."""

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.body.kinematics import world_pose
from retarget.casting import Hints, cast
from retarget.character import Character, Motion, Skeleton
from retarget.motion.chains import Chain, chain_between, path_up, share, trunk_and_neck
from retarget.retargeting import prepare

LIMBS = {
    "UpperLeg": ("hips", (0.1, -0.05, 0)), "LowerLeg": ("UpperLeg", (0, -0.42, 0)), "Foot": ("LowerLeg", (0, -0.42, 0)), "Toes": ("Foot", (0, -0.06, 0.14)),
    "UpperArm": ("chest", (0.2, 0.1, 0)), "LowerArm": ("UpperArm", (0.28, 0, 0)), "Hand": ("LowerArm", (0.26, 0, 0)),
}  # fmt: skip


def person(spine=1, neck=True):
    """A T-posed stick figure of 52 cm trunk with `spine` joints between hips and chest."""
    rows = [("hips", None, (0, 0.95, 0))]
    for number in range(spine):
        rows.append((f"spine{number}", rows[-1][0], (0, 0.4 / (spine + 1), 0)))
    rows.append(("chest", rows[-1][0], (0, 0.4 / (spine + 1), 0)))
    if neck:
        rows.append(("neck", "chest", (0, 0.14, 0)))
    rows.append(("head", rows[-1][0], (0, 0.1 if neck else 0.24, 0)))
    for side, sign in (("left", 1), ("right", -1)):
        for part, (above, offset) in LIMBS.items():
            rows.append(
                (side + part, above if above in ("hips", "chest") else side + above, np.array(offset) * [sign, 1, 1])
            )
    names = tuple(row[0] for row in rows)
    parents = np.array([-1 if above is None else names.index(above) for _, above, _ in rows])
    return Skeleton(names, parents, np.array([row[2] for row in rows], float), np.tile(rot.IDENTITY, (len(rows), 1)))


def actor_of(skeleton):
    joints = {name: name for name in skeleton.names if not name.startswith("spine")}
    if "spine0" in skeleton.names:
        joints["spine"] = "spine0"
    return cast(Character(skeleton), Hints(joints=joints))


def bending(skeleton, angle, frames=3):
    """The chest ends up turned by `angle` about x and y; every spine joint takes its equal part."""
    bent = [j for j, name in enumerate(skeleton.names) if name.startswith("spine") or name == "chest"]
    rotations = np.tile(rot.IDENTITY, (frames, len(skeleton), 1))
    rotations[:, bent] = rot.from_rotation_vector(np.array([angle, 0.0, 0.0]) / len(bent))
    return Motion(skeleton, rotations, np.tile(skeleton.offsets[0], (frames, 1, 1)), 30.0)


@pytest.mark.parametrize("source_spine, target_spine", [(3, 1), (1, 3), (0, 2), (2, 0), (4, 4)])
def test_spines_of_different_counts_bend_alike(source_spine, target_spine):
    source, target = person(source_spine), person(target_spine)
    result = prepare(actor_of(source), actor_of(target), foot_lock=False)(bending(source, 0.8)).motion
    rotations, places = world_pose(result)
    chest, head = target.index("chest"), target.index("head")
    turn = rot.from_rotation_vector(np.array([0.8, 0, 0]))
    assert rot.angle_between(rotations[:, chest], turn).max() < 1e-6, "the chest is turned as the source's"
    assert rot.angle_between(rotations[:, head], turn).max() < 1e-6
    spine = [rot.to_rotation_vector(rotations[0, j])[0] for j in range(chest + 1)]
    assert np.all(np.diff(spine) >= -1e-9), "and the bend rises steadily from the hips on"
    assert spine[0] == pytest.approx(0, abs=1e-9)


def test_equal_spines_are_copied_joint_by_joint():
    skeleton = person(3)
    motion = bending(skeleton, 0.9)
    result = prepare(actor_of(skeleton), actor_of(skeleton), foot_lock=False)(motion).motion
    assert rot.angle_between(result.rotations, motion.rotations).max() < 1e-7


@pytest.mark.parametrize("source_neck, target_neck", [(True, False), (False, True)])
def test_a_missing_neck_does_not_turn_the_head(source_neck, target_neck):
    source, target = person(2, source_neck), person(2, target_neck)
    motion = bending(source, 0.4)
    motion.rotations[:, source.index("head")] = rot.from_rotation_vector(np.array([0, 0.6, 0]))
    rotations, _ = world_pose(prepare(actor_of(source), actor_of(target), foot_lock=False)(motion).motion)
    expected, _ = world_pose(motion)
    assert rot.angle_between(rotations[:, target.index("head")], expected[:, source.index("head")]).max() < 1e-6
    if target_neck:
        neck = rot.angle_between(rotations[:, target.index("neck")], rotations[:, target.index("chest")])
        assert 0.0 <= neck.max() < 0.6, "a neck that only the target has takes a share at most"


def test_places_along_a_chain():
    skeleton = person(1)
    chain = chain_between(skeleton, skeleton.index("hips"), skeleton.index("chest"))
    assert [skeleton.names[j] for j in chain.joints] == ["hips", "spine0", "chest"]
    assert np.allclose(chain.place, [0, 0.5, 1])
    trunk, neck = trunk_and_neck(skeleton, actor_of(skeleton).humanoid)
    assert trunk.joints == chain.joints and [skeleton.names[j] for j in neck.joints] == ["chest", "neck", "head"]
    assert path_up(skeleton, skeleton.index("head"))[-1] == 0


def test_shares():
    chain = Chain((4, 5, 6), np.array([0.0, 0.25, 1.0]))
    assert share(0.0, chain) == (4, 5, 0.0)
    assert share(0.25, chain) == (5, 6, 0.0)
    first, second, weight = share(0.625, chain)
    assert (first, second) == (5, 6) and weight == pytest.approx(0.5)
    assert share(1.0, chain) == (5, 6, 1.0)
    assert share(0.7, Chain((9,), np.array([0.0]))) == (9, 9, 0.0)
