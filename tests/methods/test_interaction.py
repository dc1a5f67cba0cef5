"""The interaction method: hands come out of bellies and stay on them, and nothing else changes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_motions import actor, body, cast_by_names

from retarget.body import rotations as rot
from retarget.body.kinematics import forward
from retarget.body.skinning import prepare_skinning
from retarget.contact.skin_levers import prepare_levers
from retarget.errors import RetargetError
from retarget.evaluate.touch import observe, prepare_judge
from retarget.methods.interaction.method import Interaction
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion
from retarget.retargeting import prepare


@cache
def hands_on_hips():
    return cut(embedded_motion("hands_on_hips"), 1.2, 2.2)


@cache
def solved(preset):
    return prepare(actor(), actor(preset), Interaction()).retargeter(hands_on_hips())


@cache
def touch():
    return observe(actor(), hands_on_hips())


@pytest.mark.parametrize("preset", ["heavy", "child"])
def test_hands_come_out_and_stay_on(preset):
    judge = prepare_judge(touch(), actor(preset))
    copied = prepare(actor(), actor(preset), "copy-rotations").retargeter(hands_on_hips()).motion
    before, after = judge(touch(), copied), judge(touch(), solved(preset).motion)
    assert before["penetration_percent"] > 5
    assert after["penetration_percent"] < 0.1
    assert after["contacts_kept"] > before["contacts_kept"] - 0.05 and after["contacts_kept"] > 0.8


def test_feet_and_legs_stay_as_copied():
    copied = prepare(actor(), actor("heavy"), "copy-rotations").retargeter(hands_on_hips()).motion
    mended = solved("heavy").motion
    legs = [mended.skeleton.index(f"left{part}") for part in ("UpperLeg", "LowerLeg", "Foot", "Toes")]
    assert np.abs(copied.rotations[:, legs] - mended.rotations[:, legs]).max() < 1e-12
    assert np.abs(copied.translations - mended.translations).max() < 1e-12
    assert solved("heavy").stats["corrected_frames"] > 10


def test_where_nothing_is_wrong_nothing_changes():
    motion = cut(embedded_motion("walk"), 1.0, 2.0)
    result = prepare(actor(), actor(), Interaction()).retargeter(motion)
    copied = prepare(actor(), actor(), "copy-rotations").retargeter(motion).motion
    turned = np.degrees(rot.angle_between(result.motion.rotations, copied.rotations))
    assert turned.max() < 0.5
    assert result.stats["corrected_frames"] == 0


def test_online_steps_stay_finite_and_mend_as_well():
    retargeter = prepare(actor(), actor("heavy"), Interaction()).retargeter
    motion = hands_on_hips()
    poses = [retargeter.step(motion.pose(frame)) for frame in range(20)]
    made = replace(
        motion,
        skeleton=actor("heavy").skeleton,
        rotations=np.stack([pose.rotations for pose in poses]),
        translations=np.stack([pose.translations for pose in poses]),
    )
    assert np.isfinite(made.rotations).all()
    judge = prepare_judge(touch(), actor("heavy"))
    vertices = prepare_skinning(actor("heavy").character)
    depth = judge.collider.depths(vertices.vertices(*_world(made))[10:])
    assert depth.max() < 0.01


def _world(motion):
    offsets = np.broadcast_to(motion.skeleton.offsets, (len(motion), *motion.skeleton.offsets.shape)).copy()
    offsets[:, 0] = motion.translations[:, 0]
    return forward(motion.skeleton.parents, motion.rotations, offsets)


def test_a_source_without_surface_is_refused_in_words():
    bare = cast_by_names(replace(body(), mesh=None, skin=None))
    with pytest.raises(RetargetError, match="the source has no surface"):
        prepare(bare, actor("heavy"), Interaction())
    with pytest.raises(RetargetError, match="the target has no surface"):
        prepare(actor(), bare, Interaction())


def test_the_jacobian_is_that_of_skinning():
    """Right-hand sides against central differences of skinned points under turns of every joint."""
    from retarget.contact import pair_kernels

    person = actor("heavy")
    levers, skinner, skeleton = (
        prepare_levers(person.character, person.humanoid),
        prepare_skinning(person.character),
        person.skeleton,
    )
    random = np.random.default_rng(1)
    local = rot.multiply(
        skeleton.rest_rotations, rot.from_rotation_vector(random.normal(scale=0.2, size=(len(skeleton), 3)))
    )
    rotations, positions = forward(skeleton.parents, local, skeleton.offsets)
    # Rigid places: within a blend the vertex's own place stands in for its places in each joint's frame.
    rigid = np.flatnonzero(levers.weights[:, 0] > 0.999)
    first = random.choice(rigid, 30)
    faces = person.character.mesh.faces
    second = random.permutation(faces[np.isin(faces, rigid).all(axis=1)])[:30]
    shares = random.dirichlet(np.ones(3), 30)
    wanted, normals = random.normal(size=(30, 3)), rot.unit(random.normal(size=(30, 3)))

    def apart(turned):
        vertices = skinner.vertices(*(each[None] for each in forward(skeleton.parents, turned, skeleton.offsets)))[0]
        vertices = vertices.astype(np.float64)
        return vertices[first] - (shares[:, :, None] * vertices[second]).sum(axis=1)

    size = 3 * len(levers.turning)
    matrix, right = np.zeros((size, size)), np.zeros(size)
    vertices = skinner.vertices(rotations[None], positions[None])[0].astype(np.float64)
    pair_kernels.add_pairs(
        first, second, shares, normals, wanted, np.ones(30), np.ones(30), vertices, levers.joints, levers.weights,
        positions[levers.turning], levers.parents, matrix, right,
    )  # fmt: skip
    pair_kernels.mirror_lower(matrix)
    assert np.linalg.eigvalsh(matrix).min() > -1e-9
    for number, joint in enumerate(levers.turning):
        for axis in range(3):
            change = []
            for sign in (1e-3, -1e-3):
                turned = local.copy()
                own = rot.rotate(rot.inverse(rotations[joint]), sign * np.eye(3)[axis])
                turned[joint] = rot.multiply(local[joint], rot.from_rotation_vector(own))
                change.append(apart(turned))
            slope = ((change[0] - change[1]) / 2e-3 * wanted).sum()
            assert right[3 * number + axis] == pytest.approx(slope, abs=5e-3)


def test_a_contact_pulls_gradually_after_it_began():
    contacts = touch().contacts
    prepared = prepare(actor(), actor("heavy"), Interaction()).retargeter
    frames = prepared._frames(contacts, len(hands_on_hips()), 30.0)
    sums = np.array([each.weight.sum() for each in frames])
    assert sums.max() > 0
    assert np.abs(np.diff(sums)).max() < 0.5 * sums.max()
