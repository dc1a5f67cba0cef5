"""Judging a result by its touch: perfect on itself, honest about floating hands and buried ones."""

from dataclasses import replace
from functools import cache

import numpy as np
from made_motions import actor, with_vertices_permuted

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose
from retarget.casting import cast
from retarget.contact.carried import carry_vertices, same_topology
from retarget.contact.near_sensors import hand_pairs
from retarget.contact.slim import arm_radius
from retarget.evaluate.keepable import search
from retarget.evaluate.touch import observe, prepare_judge
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion
from retarget.retargeting import prepare


@cache
def hands_on_hips():
    return cut(embedded_motion("hands_on_hips"), 1.8, 2.4)


@cache
def touch():
    return observe(actor(), hands_on_hips())


def turned_arm(motion, degrees):
    """Both upper arms lifted sideways: the hands leave the hips."""
    skeleton, rotations = motion.skeleton, motion.rotations.copy()
    for name, sign in (("leftUpperArm", 1), ("rightUpperArm", -1)):
        joint = skeleton.index(name)
        lift = rot.from_rotation_vector(np.array([0.0, 0.0, sign * np.radians(degrees)]))
        rotations[:, joint] = rot.multiply(rotations[:, joint], lift)
    return replace(motion, rotations=rotations)


def test_a_performance_keeps_its_own_contacts_and_adds_no_penetration():
    figures = prepare_judge(touch(), actor())(touch(), hands_on_hips())
    assert figures["contacts_kept"] == 1.0
    assert figures["contact_error"] == 0.0
    assert figures["excess_penetration_percent"] == figures["new_penetration_percent"] == 0.0


def test_hands_that_leave_lose_their_contacts_and_hands_that_sink_penetrate():
    judge = prepare_judge(touch(), actor())
    away, inside = (judge(touch(), turned_arm(hands_on_hips(), degrees)) for degrees in (12, -6))
    assert away["contacts_kept"] < 0.2 and away["contact_error"] > 0.1 and away["new_penetration_percent"] == 0
    assert inside["new_penetration_percent"] > 1 and inside["depth_p95_mm"] > 10


def test_a_heavier_body_is_judged_by_the_true_correspondence():
    heavy = actor("heavy")
    judge = prepare_judge(touch(), heavy)
    assert same_topology(actor().character, heavy.character) and judge.carried.by_sensors is None
    figures = judge(touch(), prepare(actor(), heavy, "copy-rotations").retargeter(hands_on_hips()).motion)
    assert 0.5 < figures["contacts_kept"] < 1.0
    assert figures["excess_penetration_percent"] > 5  # copied hands sink into the belly


def test_a_body_of_another_topology_is_judged_through_sensors_and_reads_alike():
    mixed, _ = with_vertices_permuted(actor().character, seed=2)
    target = cast(mixed)
    judge = prepare_judge(touch(), target)
    assert judge.carried.by_sensors.valid.mean() > 0.9
    figures = judge(touch(), hands_on_hips())
    assert figures["contacts_kept"] > 0.8
    assert figures["new_penetration_percent"] is None
    assert figures["excess_penetration_percent"] < 0.05


def test_only_countable_tracks_count():
    judge = prepare_judge(touch(), actor())
    none = np.zeros(len(touch().contacts.tracks.vertex), dtype=bool)
    assert judge(touch(), hands_on_hips(), none)["contacts_kept"] is None


def test_hand_pairs_join_a_hand_to_everything_but_its_own_arm():
    judge = prepare_judge(touch(), actor())
    first, second = hand_pairs(*judge.sensors)
    assert len(first) == len(second) > 1000
    from retarget.contact.sensor_bones import BONES

    names = np.array(BONES)[judge.sensors[0].layout.bones]
    assert set(names[first]) == {"leftHand", "rightHand"}
    assert not any("Arm" in b and a[:4] == b[:4] for a, b in zip(names[first], names[second]))


def test_the_arm_radius_follows_the_arm():
    thin, heavy = (arm_radius(each.character, each.humanoid, observe_parts(each)) for each in (actor(), actor("heavy")))
    assert 0.02 < thin < heavy < 0.09


def observe_parts(person):
    from retarget.contact.parts import body_parts

    return body_parts(person.character, person.humanoid)


def test_a_reachable_contact_is_found_and_one_beyond_all_reach_is_not():
    tracks = touch().contacts.tracks
    chosen = np.flatnonzero(tracks.own_part == touch().parts.index("leftHand"))[:20]
    on_hips = _rows(tracks, chosen)
    mesh = actor().character.mesh
    crown = np.argsort(-mesh.vertices[mesh.faces, 1].mean(axis=1))[:20]
    for tracks, least, most in ((on_hips, 1.0, 1.0), (replace(on_hips, face=crown), 0.0, 0.3)):
        asked = replace(touch(), contacts=replace(touch().contacts, tracks=tracks))
        short = _short_armed()
        same = carry_vertices(short.character, short.humanoid, short.character, short.humanoid)
        found = search(asked, short, same, hands_on_hips(), 0.02, seed=0)
        assert least <= found.mean() <= most, "arms of a tenth of their length reach the waist and hardly the crown"


def _rows(tracks, which):
    return replace(tracks, **{name: value[which] for name, value in vars(tracks).items()})


def _short_armed():
    person = actor()
    skeleton, offsets = person.skeleton, person.skeleton.offsets.copy()
    arms = [skeleton.index(f"{side}{part}") for side in ("left", "right") for part in ("LowerArm", "Hand")]
    offsets[arms] *= 0.1
    short = replace(skeleton, offsets=offsets)
    _, rest = rest_pose(short)
    binds = person.character.skin.inverse_binds.copy()
    binds[:, :3, 3] = -rest  # the skin stays; only the bones of the arms shrink
    skin = replace(person.character.skin, inverse_binds=binds)
    vertices = person.character.mesh.vertices + _carried(person, rest)
    mesh = replace(person.character.mesh, vertices=vertices)
    return replace(person, character=replace(person.character, skeleton=short, mesh=mesh, skin=skin))


def _carried(person, rest):
    """How far each vertex moves with its joints when the bones shrink."""
    _, before = rest_pose(person.skeleton)
    skin = person.character.skin
    return (skin.weights[..., None] * (rest - before)[skin.joints[skin.columns]]).sum(axis=1)
