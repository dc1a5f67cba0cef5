"""What a result does otherwise than copied joint angles."""

from dataclasses import replace

import numpy as np
from made_motions import actor, walk

from retarget.body import rotations as rot
from retarget.evaluate.corrected import MOST, copied_take, turned_joints
from retarget.evaluate.take import Take


def turned_by(motion, joint, degrees, frames):
    half = np.radians(degrees) / 2
    rotations = motion.rotations.copy()
    rotations[frames, joint] = rot.multiply(rotations[frames, joint], np.array([np.sin(half), 0, 0, np.cos(half)]))
    return replace(motion, rotations=rotations)


def test_a_turned_joint_is_told_with_its_times_and_its_angle():
    motion, humanoid = walk(), actor().humanoid
    other = turned_by(motion, humanoid.joints["leftLowerArm"], 20.0, slice(30, 46))
    assert list(turned_joints(motion, other, humanoid)) == ["leftLowerArm turned by up to 20.0 degrees: 1.00 to 1.50 s"]
    assert list(turned_joints(motion, motion, humanoid)) == []
    slight = turned_by(motion, humanoid.joints["leftLowerArm"], 2.0, slice(30, 46))
    assert list(turned_joints(motion, slight, humanoid)) == []


def test_the_farthest_come_first_and_no_more_than_can_be_read():
    motion, humanoid = walk(), actor().humanoid
    other = motion
    for number, name in enumerate(list(humanoid.joints)[:20]):
        other = turned_by(other, humanoid.joints[name], 5.0 + number, slice(0, 10))
    told = list(turned_joints(motion, other, humanoid))
    assert len(told) == MOST and told[0].startswith(list(humanoid.joints)[19])


def test_many_spells_are_counted():
    motion, humanoid = walk(), actor().humanoid
    other = motion
    for start in range(0, 70, 10):
        other = turned_by(other, humanoid.joints["head"], 9.0, slice(start, start + 3))
    (sentence,) = turned_joints(motion, other, humanoid)
    assert sentence.endswith("and 3 more times")


def test_a_copy_onto_the_same_body_is_the_motion():
    take = Take(actor(), walk())
    copied = copied_take(take, take)
    assert len(copied) == len(take) and np.abs(copied.positions - take.positions).max() < 0.02
