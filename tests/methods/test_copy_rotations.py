"""The whole method on made motions: feet hold, jumps jump, stairs climb, limits ease."""

from dataclasses import replace

import numpy as np
import pytest
from made_motions import actor, body, cast_by_names, poses, prepared, ramp, stand, turned, walk

from retarget.body import rotations as rot
from retarget.body.kinematics import local_rotations, still_motion, world_pose
from retarget.character import Motion, Pose
from retarget.contact.ground import ground_contacts
from retarget.contact.support import leg_length, support_limbs, support_points
from retarget.errors import RetargetError
from retarget.evaluate.metrics import floor_error_cm, foot_slide_cm
from retarget.methods import CopyRotations


def prepare(source, target, **settings):
    return prepared(source, target, CopyRotations(**settings))


def feet(person, motion):
    """Heels and balls of both feet over a motion."""
    limbs = support_limbs(person.character, person.humanoid)[:2]
    return np.concatenate(support_points(limbs, *world_pose(motion)), axis=1)


def contacts(person, motion):
    return ground_contacts(feet(person, motion), motion.fps, leg_length(person.skeleton, person.humanoid))


@pytest.mark.parametrize("preset", ["heavy", "child", "muscular", "toddler"])
def test_feet_that_stand_in_the_source_stand_in_the_result(preset):
    target = actor(preset)
    result = prepare(actor(), target)(walk())
    touching, points = contacts(actor(), walk()).touching, feet(target, result.motion)
    assert foot_slide_cm(points, touching, target.height).mean() < 0.3
    support = np.full(touching.shape, result.stats["target_floor_m"])
    assert floor_error_cm(points, touching, support, target.height).mean() < 0.5
    assert points[..., 1].min() > result.stats["target_floor_m"] - 0.01 * target.height


def test_stairs_stay_stairs():
    motion, target = walk(climb=0.15), actor("child")
    result = prepare(actor(), target)(motion)
    found, points = contacts(actor(), motion), feet(target, result.motion)
    support = (found.support - found.floor) * result.stats["scale"] + result.stats["target_floor_m"]
    assert support.max() > 0.3 * result.stats["scale"]
    assert floor_error_cm(points, found.touching, support, target.height).mean() < 1.0


def jump(height=0.4):
    """Up and down again with a stand before and after."""
    motion = still_motion(body().skeleton, 60, 30.0, name="jump")
    flight = np.clip((np.arange(60) / 30.0 - 0.6) / 0.6, 0, 1)
    return replace(
        motion, translations=motion.translations + (4 * height * flight * (1 - flight))[:, None, None] * [0, 1, 0]
    )


def test_jumps_stay_jumps():
    result = prepare(actor(), actor("child"))(jump())
    points = feet(actor("child"), result.motion)[..., 1]
    floor = result.stats["target_floor_m"]
    assert points.max() - floor == pytest.approx(0.4 * result.stats["scale"], rel=0.1)
    assert np.abs(points[[0, -1]] - floor).max() < 0.01


def test_no_pop_where_contacts_begin_and_end():
    target = actor("child")
    held, free = (prepare(actor(), target, foot_lock=lock)(walk()).motion for lock in (True, False))

    def sharpest(motion):
        return np.linalg.norm(np.diff(world_pose(motion)[1], n=2, axis=0), axis=-1).max()

    assert sharpest(held) < 1.5 * sharpest(free)


def test_in_place_keeps_the_height_and_drops_the_path():
    free, stuck = (prepare(actor(), actor("heavy"), in_place=each)(walk()).motion for each in (False, True))
    hips, other = world_pose(free)[1][:, 0], world_pose(stuck)[1][:, 0]
    assert np.abs(other[:, [0, 2]] - hips[0, [0, 2]]).max() < 1e-9
    assert np.allclose(other[:, 1], hips[:, 1])
    assert np.array_equal(free.rotations, stuck.rotations)


@pytest.mark.parametrize("frames", [1, 2, 3, 5])
@pytest.mark.parametrize("fps", [0.5, 30.0, 240.0])
def test_the_shortest_clips(frames, fps):
    motion = replace(stand(), rotations=stand().rotations[:frames], translations=stand().translations[:frames], fps=fps)
    result = prepare(actor(), actor("child"))(motion).motion
    assert len(result) == frames and result.fps == fps
    assert np.isfinite(result.rotations).all() and np.isfinite(result.translations).all()


def test_what_no_body_can_do_is_eased_and_what_it_can_is_not_touched():
    world = poses(30, {"rightLowerLeg": ramp(30, 0, 29)[:, None] * [0, 2.0, 0]})  # a shin twisted by 115 degrees
    skeleton = body().skeleton
    motion = Motion(skeleton, local_rotations(skeleton.parents, world), np.tile(skeleton.offsets[0], (30, 1, 1)), 30.0)
    eased, copied = (prepare(actor(), actor(), foot_lock=False, limits=each)(motion).motion for each in (True, False))
    assert rot.angle_between(copied.rotations, motion.rotations).max() < 1e-6
    gap = rot.angle_between(world_pose(eased)[0], world_pose(motion)[0])
    shin = skeleton.index("rightLowerLeg")
    assert gap[-1, shin] > np.radians(20) and gap[:10].max() < 1e-6
    foot = skeleton.index("rightFoot")
    assert gap[:, foot].max() < 1e-6, "what the joint carries keeps its world rotation"
    for motion in (walk(), stand()):
        kept = prepare(actor(), actor(), foot_lock=False)(motion).motion
        assert rot.angle_between(kept.rotations, motion.rotations).max() < 1e-6


def test_lying_and_crawling_stay_finite():
    """The whole world tipped: the body lies on its back, its limbs in the air."""
    tip = rot.from_rotation_vector(np.array([-np.pi / 2, 0, 0]))
    motion = stand()
    rotations, translations = motion.rotations.copy(), rot.rotate(tip, motion.translations) + [0, 0.15, 0]
    rotations[:, 0] = rot.multiply(tip, rotations[:, 0])
    lying = replace(motion, rotations=rotations, translations=translations)
    result = prepare(actor(), actor("heavy"))(lying).motion
    _, places = world_pose(result)
    assert np.isfinite(places).all() and 0 < places[:, 0, 1].mean() < 0.5
    assert np.abs(places[..., 1]).max() < 1.0, "it still lies"


def test_the_floor_of_the_source_may_be_anywhere():
    raised = replace(walk(), translations=walk().translations + [0, 0.7, 0])
    plain, other = (prepare(actor(), actor("heavy"))(motion).motion for motion in (walk(), raised))
    assert np.abs(world_pose(plain)[1] - world_pose(other)[1]).max() < 1e-6


def test_a_motion_of_another_skeleton_is_refused():
    with pytest.raises(RetargetError, match="another skeleton"):
        prepare(actor(), actor("heavy")).retargeter(still_motion(body("child").skeleton))


def test_a_clip_without_frames_is_refused():
    empty = replace(walk(), rotations=walk().rotations[:0], translations=walk().translations[:0])
    with pytest.raises(RetargetError, match="no frames"):
        prepare(actor(), actor("heavy")).retargeter(empty)


def test_a_clip_of_a_million_frames_a_second_is_refused():
    with pytest.raises(RetargetError, match="frames a second"):
        prepare(actor(), actor("heavy")).retargeter(replace(walk(), fps=1e6))


def test_a_pose_of_another_body_is_refused():
    retargeter = prepare(actor(), actor("heavy")).retargeter
    with pytest.raises(RetargetError, match="joints"):
        retargeter.step(Pose(walk().rotations[0, :5], np.zeros((1, 3))))
    with pytest.raises(RetargetError, match="translations"):
        Pose(walk().rotations[0], np.zeros((3, 3)))


def test_a_body_whose_legs_have_no_length_is_refused():
    skeleton = body().skeleton
    offsets = skeleton.offsets.copy()
    for side in ("left", "right"):
        for part in ("LowerLeg", "Foot"):
            offsets[skeleton.index(side + part)] = 0
    flat = cast_by_names(replace(body(), skeleton=replace(skeleton, offsets=offsets)))
    with pytest.raises(RetargetError, match="leg has no length"):
        CopyRotations().prepare(actor(), flat)


def test_a_body_without_arms_to_speak_of_still_walks():
    skeleton = body().skeleton
    offsets = skeleton.offsets.copy()
    for side in ("left", "right"):
        for part in ("LowerArm", "Hand"):
            offsets[skeleton.index(side + part)] = 0
    stump = cast_by_names(replace(body(), skeleton=replace(skeleton, offsets=offsets)))
    result = prepare(actor(), stump)(walk()).motion
    assert np.isfinite(result.rotations).all()


def test_turning_while_walking_stays_a_walk():
    result = prepare(actor(), actor("heavy"))(turned(walk(), 2.0))
    target = actor("heavy")
    assert foot_slide_cm(feet(target, result.motion), contacts(actor(), walk()).touching, target.height).mean() < 0.3
