"""A contacts file applied: just the rows that it speaks of change, and added contacts join stable points."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from test_contact_list import made_contacts

from retarget.body.kinematics import world_pose
from retarget.casting import cast
from retarget.contact.contact_edits import (
    LIKELY,
    UNLIKELY,
    added_contacts,
    apply_edits,
    let_go,
    sharpened,
    without_effect,
)
from retarget.contact.contact_file import ContactEdit, ContactEdits
from retarget.contact.detect import prepare_contacts
from retarget.contact.parts import PARTS
from retarget.contact.slim import girth_kept
from retarget.errors import RetargetError
from retarget.motion.filter import resample
from retarget.motion.library import embedded_motion, performer

FPS = 10.0


@cache
def hands_on_hips():
    performing = cast(performer())
    detector = prepare_contacts(performing.character, performing.humanoid)
    pose = world_pose(resample(embedded_motion("hands_on_hips"), FPS))
    return detector, pose, detector.clip(*pose, FPS)


def pair(contacts, one, other):
    own = contacts.tracks.own_part[contacts.track]
    one, other = PARTS.index(one), PARTS.index(other)
    return ((own == one) & (contacts.part == other)) | ((own == other) & (contacts.part == one))


def test_without_edits_the_pose_decides():
    _, _, contacts = hands_on_hips()
    weight = apply_edits(contacts, ContactEdits(), FPS)
    assert np.array_equal(weight, sharpened(contacts.tracks.pose_probability)[contacts.track])


def test_releasing_a_pair_for_a_while_removes_just_these_rows():
    _, _, contacts = hands_on_hips()
    before = apply_edits(contacts, ContactEdits(), FPS)
    edit = ContactEdit(("pelvis", "leftHand"), 1.5, 2.5, "release")
    after = apply_edits(contacts, ContactEdits((edit,)), FPS)
    spoken_of = pair(contacts, "leftHand", "pelvis") & (contacts.frame >= 15) & (contacts.frame <= 25)
    assert spoken_of.any() and (before[spoken_of] > 0).all()
    assert (pair(contacts, "leftHand", "pelvis") & ~spoken_of).any()
    assert (after[spoken_of] == 0).all() and np.array_equal(after[~spoken_of], before[~spoken_of])


def test_keep_strengths_and_kinds():
    p = UNLIKELY + 0.25 * (LIKELY - UNLIKELY)  # taken as 0.25
    contacts = made_contacts(
        (0, 1, "leftHand", "leftForearm", 0.0, p), (0, 2, "leftHand", "head", 0.0, p), (0, 3, "chest", "head", 0.0, p)
    )

    def weights(*edits, **strength):
        return pytest.approx(apply_edits(contacts, ContactEdits(edits, tuple(strength.items())), 30.0).tolist())

    head = ("head", "leftHand")
    assert weights(ContactEdit(head, does="keep", strength=2.0)) == [0.25, 2.0, 0.25]
    assert weights(ContactEdit(head, does="release"), ContactEdit(head, strength=3.0)) == [0.25, 0.75, 0.25]
    assert weights(arms=0.5) == [0.125, 0.125, 0.25], "a line counts once, though both parts are in the arm"
    assert weights(arms=0.5, head=2.0) == [0.125, 0.25, 0.5]
    assert weights(pose=0.0, girth=1.0) == [0.75, 0.75, 0.75]


def test_what_is_hardly_meant_does_not_pull_and_what_likely_is_pulls_in_full():
    assert sharpened(np.array([0.0, 0.2, 0.7, 1.0])).tolist() == [0.0, 0.0, 1.0, 1.0]


def test_contacts_of_girth_stay_where_the_target_is_no_slimmer():
    own = {"abdomen": 0.2, "leftThigh": 0.15, "leftUpperArm": 0.16}
    kept = girth_kept(own, own | {"leftThigh": 0.12, "leftUpperArm": 0.20})
    at = {name: PARTS.index(name) for name in ("leftHand", "leftThigh", "abdomen", "leftUpperArm", "head")}
    assert kept[at["leftHand"], at["leftThigh"]] == 0 == kept[at["leftThigh"], at["leftHand"]], "a slimmer thigh"
    assert kept[at["leftHand"], at["abdomen"]] == 1 and kept[at["abdomen"], at["leftUpperArm"]] == 1
    assert kept[at["leftHand"], at["head"]] == 0, "nothing is known of them"

    rows = ("leftHand", "leftThigh", 0.0, 0.0), ("leftHand", "abdomen", 0.0, 0.0), ("leftHand", "abdomen", 0.0, 1.0)
    contacts = made_contacts(*((0, number, *row) for number, row in enumerate(rows)))
    assert apply_edits(contacts, ContactEdits(), FPS, girth=kept).tolist() == [0, 1, 1]
    assert let_go(contacts, ContactEdits(), kept) == 1 and let_go(contacts, ContactEdits(), None) == 2
    said = ContactEdits(strength=(("girth", 0.0),))
    assert apply_edits(contacts, said, FPS, girth=kept).tolist() == [0, 0, 1], "a file's word goes before"
    assert let_go(contacts, said, kept) == 2


def test_an_added_contact_joins_the_same_points_on_every_frame():
    detector, pose, _ = hands_on_hips()
    edit = ContactEdit(("rightHand", "head"), 0.5, 1.0, "add", 2.0, 0.03)
    added = added_contacts(ContactEdits((edit,), (("rightArm", 0.5), ("pose", 3.0))), detector, *pose, FPS)
    assert np.array_equal(np.unique(added.frame), np.arange(5, 11))
    own = detector.collider.parts.vertex_parts[added.vertex]
    faces = detector.skinner.character.mesh.faces[added.face]
    touched = detector.collider.parts.vertex_parts[faces[np.arange(len(faces)), added.barycentric.argmax(axis=1)]]
    ends = {(PARTS[a], PARTS[b]) for a, b in zip(own, touched)}
    assert ends == {("rightHand", "head"), ("head", "rightHand")}
    assert (added.gap == 0.03).all() and (added.weight == 1.0).all()
    first = added.frame == 5
    for frame in range(6, 11):
        assert np.array_equal(added.vertex[added.frame == frame], added.vertex[first])
        assert np.array_equal(added.face[added.frame == frame], added.face[first])


def test_added_points_are_the_nearest():
    detector, pose, _ = hands_on_hips()
    added = added_contacts(ContactEdits((ContactEdit(("rightHand", "head"), 0.5, 0.5, "add"),)), detector, *pose, FPS)
    posed = detector.skinner.vertices(pose[0][5:6], pose[1][5:6])[0]
    parts = detector.collider.parts.vertex_parts
    hand, head = (posed[parts == PARTS.index(name)] for name in ("rightHand", "head"))
    least = np.linalg.norm(hand[:, None] - head[None], axis=2).min()
    corners = posed[detector.skinner.character.mesh.faces[added.face]]
    reach = np.linalg.norm(posed[added.vertex] - (added.barycentric[..., None] * corners).sum(axis=1), axis=1)
    assert reach.min() == pytest.approx(least) and reach.max() <= least + 2 * detector.threshold + 1e-6


def test_nothing_added_gives_empty_rows_and_a_missing_part_is_named():
    detector, pose, _ = hands_on_hips()
    assert len(added_contacts(ContactEdits(), detector, *pose, FPS).frame) == 0
    between = ContactEdit(("rightHand", "head"), 0.52, 0.53, "add")
    assert set(added_contacts(ContactEdits((between,)), detector, *pose, FPS).frame) == {5}
    late = ContactEdit(("rightHand", "head"), 500.0, None, "add")
    assert len(added_contacts(ContactEdits((late,)), detector, *pose, FPS).frame) == 0
    parts = detector.collider.parts
    neckless = np.where(parts.vertex_parts == PARTS.index("neck"), PARTS.index("head"), parts.vertex_parts)
    lacking = replace(detector, collider=replace(detector.collider, parts=replace(parts, vertex_parts=neckless)))
    with pytest.raises(RetargetError, match="leftHand-neck cannot be added: the body has no neck"):
        added_contacts(ContactEdits((ContactEdit(("leftHand", "neck"), does="add"),)), lacking, *pose, FPS)


def test_entries_that_speak_of_nothing_in_the_clip_are_named():
    _, pose, contacts = hands_on_hips()
    edits = ContactEdits((
        ContactEdit(("leftHand", "pelvis"), 1.5, 2.5, "release"),
        ContactEdit(("leftFoot", "head"), does="keep"),
        ContactEdit(("rightHand", "head"), 0.5, 1.0, "add"),
        ContactEdit(("rightHand", "head"), 500.0, None, "add"),
        ContactEdit(("leftHand", "pelvis"), 500.0, 501.0, "release"),
    ))  # fmt: skip
    assert without_effect(contacts, edits, FPS, len(pose[0])) == [
        "keep leftFoot-head from 0 s to the end",
        "add rightHand-head from 500 s to the end",
        "release leftHand-pelvis from 500 s to 501 s",
    ]
