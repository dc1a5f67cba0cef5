"""What of a body's skin rests on the ground, in poses made by hand."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_motions import actor, body, poses, scaled, stand, walk

from retarget.body import rotations as rot
from retarget.body.kinematics import local_rotations, world_pose
from retarget.body.skinning import prepare_skinning
from retarget.character import Motion
from retarget.contact.ground_surface import lowest_skin, resting_parts, resting_parts_of_clip
from retarget.contact.parts import PARTS, BodyParts, body_parts

FPS, FRAMES = 30.0, 20
RIGHT_ANGLE = np.pi / 2


@cache
def parts():
    return body_parts(body(), actor().humanoid)


def height():
    return actor().height


def posed(turns, whole=(0.0, 0.0, 0.0), frames=FRAMES):
    """Vertices of the embedded human with named joints turned, the whole body turned, its lowest point on the floor."""
    skeleton = body().skeleton
    world = rot.multiply(rot.from_rotation_vector(np.array(whole)), poses(frames, turns))
    motion = Motion(skeleton, local_rotations(skeleton.parents, world), np.zeros((frames, 1, 3)), FPS)
    vertices = prepare_skinning(body()).vertices(*world_pose(motion)).astype(np.float64)
    vertices[..., 1] -= vertices[..., 1].min()
    return vertices


def names(found, share=0.9):
    """Parts that rest on most frames."""
    return {name for name, on in zip(PARTS, found.touching.mean(axis=0) > share) if on}


def test_who_stands_stands_on_the_feet():
    motion = stand()
    found = resting_parts_of_clip(prepare_skinning(body()), parts(), *world_pose(motion), motion.fps, height(), 0.0)
    assert names(found) == {"leftFoot", "rightFoot"} and not found.touching[:, PARTS.index("leftShin")].any()
    assert (found.support == 0).all() and found.heights[:, PARTS.index("leftFoot")].max() < 0.01


def test_who_walks_stands_on_one_foot_and_then_on_the_other():
    motion = walk()
    found = resting_parts_of_clip(prepare_skinning(body()), parts(), *world_pose(motion), motion.fps, height(), 0.0)
    left, right = (found.touching[:, PARTS.index(name)] for name in ("leftFoot", "rightFoot"))
    assert (left | right).all() and 0.4 < left.mean() < 0.9 and 0.4 < right.mean() < 0.9
    swinging = found.heights[:, PARTS.index("leftFoot")] > 0.06
    assert swinging.any() and not (left & swinging).any()


def test_who_lies_on_the_back_rests_on_all_that_is_behind():
    found = names(resting_parts(posed({}, whole=(-RIGHT_ANGLE, 0, 0)), parts(), FPS, height(), 0.0))
    assert {"head", "pelvis", "chest"} & found and not {"leftHand", "rightHand"} & found
    arms = {"leftUpperArm": [0.6, 0, 0], "rightUpperArm": [0.6, 0, 0]}
    prone = names(resting_parts(posed(arms, whole=(RIGHT_ANGLE, 0, 0)), parts(), FPS, height(), 0.0))
    assert {"leftFoot", "rightFoot"} <= prone and "pelvis" not in prone, "on the toes"


def test_who_sits_on_the_floor_rests_on_the_seat_and_the_heels():
    legs = {f"{side}UpperLeg": [-RIGHT_ANGLE, 0, 0] for side in ("left", "right")}
    found = names(resting_parts(posed(legs), parts(), FPS, height(), 0.0))
    assert {"pelvis", "leftThigh", "rightThigh"} <= found and not {"head", "chest", "leftHand"} & found


def test_who_kneels_rests_on_the_shins():
    legs = {f"{side}{part}": [RIGHT_ANGLE, 0, 0] for side in ("left", "right") for part in ("LowerLeg", "Foot")}
    found = names(resting_parts(posed(legs), parts(), FPS, height(), 0.0))
    assert {"leftShin", "rightShin"} <= found and not {"pelvis", "leftHand"} & found


def cartwheel(slip):
    """The star-shaped body turns over its left hand, which stays where it is on the floor, or slips along."""
    arms = {"leftUpperArm": [0, 0, 0.9], "rightUpperArm": [0, 0, -0.9]}
    vertices = posed(arms, whole=(0, 0, -2.2), frames=1)[0]
    pivot = vertices[vertices[:, 1].argmin()] * [1, 0, 1]
    angles = np.linspace(0.6, -0.6, 31)
    turn = rot.from_rotation_vector(angles[:, None] * [0.0, 0.0, 1.0])
    turned = rot.rotate(turn[:, None], vertices - pivot) + pivot
    turned[..., 0] += slip * np.arange(31)[:, None] / FPS
    return turned - [0, turned[15, :, 1].min(), 0]


def test_a_hand_carries_a_cartwheel_until_another_part_does():
    found = resting_parts(cartwheel(slip=0.0), parts(), FPS, height(), 0.0)
    hand = found.touching[:, PARTS.index("leftHand")]
    assert hand[10:20].all(), "in the middle of it"
    assert not found.touching[:, [PARTS.index(name) for name in ("leftFoot", "rightFoot", "head")]][10:20].any()
    assert not resting_parts(cartwheel(slip=1.0), parts(), FPS, height(), 0.0).touching[10:20].any(), "slipping"


def wheel(slip, speed=0.8, radius=0.12):
    """A trunk as a wheel that rolls; `slip` 1 slides without turning."""
    around = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    moved = speed * np.arange(30) / FPS
    angle = around + (moved[:, None] / radius) * (1 - slip)
    vertices = np.stack([0 * angle, radius - radius * np.cos(angle), moved[:, None] - radius * np.sin(angle)], axis=-1)
    faces = np.stack([np.arange(118), np.arange(118) + 1, np.arange(118) + 2], axis=1)
    part = np.full(120, PARTS.index("chest"))
    return vertices, BodyParts(PARTS, part, part[:118], np.arange(120), np.zeros(118, dtype=np.int64), ("body",), faces)


@pytest.mark.parametrize("slip, rests", [(0.0, True), (1.0, False), (0.5, False)])
def test_a_back_that_rolls_without_slipping_rests(slip, rests):
    vertices, trunk = wheel(slip)
    found = resting_parts(vertices, trunk, FPS, 1.7, 0.0).touching[:, PARTS.index("chest")]
    assert found[2:-2].all() if rests else not found.any()


def test_parts_that_the_body_does_not_have_rest_on_nothing():
    vertices, trunk = wheel(0.0)
    found = resting_parts(vertices, trunk, FPS, 1.7, 0.0)
    others = [part for part in range(len(PARTS)) if PARTS[part] != "chest"]
    assert not found.touching[:, others].any() and np.isinf(found.heights[:, others]).all()


def test_on_a_box_the_feet_rest_on_the_box():
    vertices = posed({}) + [0, 0.5, 0]
    found = resting_parts(vertices, parts(), FPS, height(), 0.0)
    assert names(found) == {"leftFoot", "rightFoot"}
    assert np.allclose(found.support[:, PARTS.index("leftFoot")], 0.5, atol=0.01)
    assert (found.support[:, PARTS.index("head")] == 0).all()


def test_in_the_air_and_deep_in_the_ground_nothing_rests():
    falling = posed({}) + np.linspace(3, 1, FRAMES)[:, None, None] * [0, 1, 0]
    assert not resting_parts(falling, parts(), FPS, height(), 0.0).touching.any()
    sunk = posed({}) - [0, 0.3, 0]
    found = resting_parts(sunk, parts(), FPS, height(), 0.0)
    assert not found.touching[:, PARTS.index("leftFoot")].any()


def test_what_rests_is_let_go_later_than_it_is_taken():
    """Feet that rise at 10 cm/s leave at 4 cm; feet that sink as slowly arrive there as well; none begins there."""
    rise = np.linspace(0.0, 0.1, 31)[:, None, None] * [0, 1, 0]
    vertices = posed({}, frames=31)
    up = resting_parts(vertices + rise, parts(), FPS, height(), 0.0).touching[:, PARTS.index("leftFoot")]
    assert 10 <= up.sum() <= 13 and up[:10].all()
    over = resting_parts(vertices + rise + [0, 0.03, 0], parts(), FPS, height(), 0.0).touching
    assert not over.any()


@pytest.mark.parametrize("factor", [0.1, 4.0])
def test_sizes_are_judged_alike(factor):
    vertices = cartwheel(slip=0.1) + [0, 0.018, 0]
    plain = resting_parts(vertices, parts(), FPS, height(), 0.0)
    large = resting_parts(factor * vertices, parts(), FPS, factor * height(), 0.0)
    assert np.array_equal(plain.touching, large.touching) and plain.touching.any()
    assert np.allclose(factor * plain.heights, large.heights)


def test_a_clip_in_chunks_reads_like_the_whole(monkeypatch):
    from retarget.contact import ground_surface

    motion, skinner = walk(), prepare_skinning(body())
    whole = lowest_skin(skinner.vertices(*world_pose(motion)), parts(), motion.fps, height())
    monkeypatch.setattr(ground_surface, "CHUNK", 7)
    chunked = resting_parts_of_clip(skinner, parts(), *world_pose(motion), motion.fps, height(), 0.0)
    plain = resting_parts(skinner.vertices(*world_pose(motion)), parts(), motion.fps, height(), 0.0)
    assert np.array_equal(chunked.touching, plain.touching) and np.allclose(chunked.heights, whole[0])


def test_one_frame_and_none():
    vertices = posed({})
    assert names(resting_parts(vertices[:1], parts(), FPS, height(), 0.0)) == {"leftFoot", "rightFoot"}
    motion = replace(stand(), rotations=stand().rotations[:0], translations=stand().translations[:0])
    found = resting_parts_of_clip(prepare_skinning(body()), parts(), *world_pose(motion), FPS, height(), 0.0)
    assert found.touching.shape == (0, len(PARTS))


def test_a_scaled_body_rests_on_the_same_parts():
    giant = scaled(body(), 3.0)
    vertices = 3.0 * posed({"leftUpperLeg": [-RIGHT_ANGLE, 0, 0], "rightUpperLeg": [-RIGHT_ANGLE, 0, 0]})
    found = resting_parts(vertices, body_parts(giant, actor().humanoid), FPS, 3 * height(), 0.0)
    assert {"pelvis", "leftThigh", "rightThigh"} <= names(found)
