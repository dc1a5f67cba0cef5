"""The tree of rigid parts: what hangs on what, what it turns about, and what a turn does."""

from dataclasses import replace

import numpy as np
import pytest
from made_motions import actor

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices
from retarget.contact.parts import PARTS, body_parts
from retarget.errors import RetargetError
from retarget.evaluate.reference.part_tree import closed_parts, part_tree
from retarget.evaluate.reference.shape_terms import part_volumes

BODY = actor("thin").character
FACES = BODY.mesh.faces
REST = rest_vertices(BODY)
PARTS_OF_BODY = body_parts(BODY, actor("thin").humanoid)
TREE = part_tree(FACES, PARTS_OF_BODY)


def test_limbs_hang_as_a_human_s_do():
    assert sorted(TREE.names) == sorted(PARTS)
    above = {name: TREE.names[parent] for name, parent in zip(TREE.names, TREE.parents) if parent >= 0}
    assert TREE.names[0] == "pelvis" and "pelvis" not in above
    assert (above["head"], above["neck"], above["chest"], above["abdomen"]) == ("neck", "chest", "abdomen", "pelvis")
    for side in ("left", "right"):
        arm = [above[f"{side}{part}"] for part in ("Hand", "Forearm", "UpperArm")]
        leg = [above[f"{side}{part}"] for part in ("Foot", "Shin", "Thigh")]
        assert arm == [f"{side}Forearm", f"{side}UpperArm", "chest"] and leg == [
            f"{side}Shin",
            f"{side}Thigh",
            "pelvis",
        ]


def test_the_longest_seams_hold_where_parts_touch_all_round():
    """A hip's face that counts as belly makes belly and thigh touch: the thigh still hangs on the pelvis."""
    parts, hip = PARTS_OF_BODY.face_parts.copy(), PARTS.index("pelvis")
    seam = np.intersect1d(FACES[parts == hip], FACES[parts == PARTS.index("leftThigh")])
    bordering = np.flatnonzero((parts == hip) & (np.isin(FACES, seam).sum(axis=1) == 2))
    parts[bordering[:3]] = PARTS.index("abdomen")
    tree = part_tree(FACES, replace(PARTS_OF_BODY, face_parts=parts))
    assert tree.names[tree.parents[tree.names.index("leftThigh")]] == "pelvis"
    assert (tree.names, tree.parents.tolist()) == (TREE.names, TREE.parents.tolist())


def test_joints_are_the_centroids_of_seams_close_to_those_of_the_skeleton():
    joints = dict(zip(TREE.names, TREE.joints(REST)))
    _, positions = rest_pose(BODY.skeleton)
    for part, joint in (("leftForearm", "leftLowerArm"), ("rightShin", "rightLowerLeg"), ("leftHand", "leftHand")):
        place = positions[actor("thin").humanoid.joints[joint]]
        assert np.linalg.norm(joints[part] - place) < 0.05


def test_a_turn_moves_its_part_and_all_below_rigidly_and_nothing_else():
    turns = np.zeros((len(TREE.names), 3))
    elbow = TREE.names.index("leftForearm")
    turns[elbow] = [0.2, -0.4, 0.5]
    moved, world = TREE.turned(REST, turns)
    arm = np.isin(TREE.vertex_parts, np.flatnonzero(TREE.below[elbow]))
    assert {TREE.names[part] for part in np.unique(TREE.vertex_parts[arm])} == {"leftForearm", "leftHand"}
    np.testing.assert_array_equal(moved[~arm], REST[~arm])
    turn, joint = rot.to_matrix(rot.from_rotation_vector(turns[elbow])), TREE.joints(REST)[elbow]
    np.testing.assert_allclose(moved[arm], (REST[arm] - joint) @ turn.T + joint, atol=1e-12)
    np.testing.assert_allclose(world[TREE.names.index("leftHand")], turn, atol=1e-12)


def test_turns_of_a_chain_add_up():
    turns = np.zeros((len(TREE.names), 3))
    shoulder, hand = TREE.names.index("leftUpperArm"), TREE.names.index("leftHand")
    turns[shoulder], turns[hand] = [0, 0, 0.7], [0.3, 0, 0]
    moved, world = TREE.turned(REST, turns)
    first = np.zeros_like(turns)
    first[hand] = turns[hand]
    second = np.zeros_like(turns)
    second[shoulder] = turns[shoulder]
    step, _ = TREE.turned(REST, first)
    # The shoulder's seam does not move with the hand, so the turns may be made one after the other.
    np.testing.assert_allclose(TREE.turned(step, second)[0], moved, atol=1e-12)
    each = [rot.to_matrix(rot.from_rotation_vector(turns[part])) for part in (shoulder, hand)]
    np.testing.assert_allclose(world[hand], each[0] @ each[1], atol=1e-12)


def test_the_turn_gradient_is_the_derivative():
    rng = np.random.default_rng(0)
    pull = rng.normal(size=REST.shape)
    energy = lambda turns: float((pull * TREE.turned(REST, turns)[0]).sum())  # noqa: E731
    gradient = TREE.turn_gradient(REST, pull)
    for _ in range(4):
        direction = rng.normal(size=gradient.shape)
        numeric = (energy(1e-5 * direction) - energy(-1e-5 * direction)) / 2e-5
        assert numeric == pytest.approx(float((gradient * direction).sum()), rel=1e-6, abs=1e-6)


def test_closed_parts_fill_the_body():
    solids = closed_parts(PARTS_OF_BODY.welded[FACES], TREE.face_parts, len(TREE.names), len(REST))
    whole = closed_parts(FACES, np.zeros(len(FACES), dtype=np.int64), 1, len(REST))
    volumes = part_volumes(solids, REST)
    assert (volumes > 0).all()
    assert volumes.sum() == pytest.approx(part_volumes(whole, REST)[0], rel=1e-9)
    np.testing.assert_allclose(part_volumes(solids, REST + [3.0, -2.0, 1.0]), volumes, atol=1e-9)


def test_bodies_that_have_no_tree_are_refused():
    headless = PARTS_OF_BODY.face_parts.copy()
    headless[headless == PARTS.index("pelvis")] = PARTS.index("abdomen")
    with pytest.raises(RetargetError, match="no pelvis"):
        part_tree(FACES, replace(PARTS_OF_BODY, face_parts=headless))
    cut = PARTS_OF_BODY.face_parts.copy()
    cut[cut == PARTS.index("leftForearm")] = -1
    with pytest.raises(RetargetError, match="leftHand"):
        part_tree(FACES, replace(PARTS_OF_BODY, face_parts=cut))
    turned_over = FACES.copy()
    turned_over[100] = turned_over[100, ::-1]
    with pytest.raises(RetargetError, match="oriented"):
        part_tree(turned_over, PARTS_OF_BODY)
