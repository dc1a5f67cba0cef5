"""Contacts: they begin and end where touch does, say whether pose or girth made them, and follow the body anywhere."""

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from made_bodies import ARMS_AT_WORK, box_figure, joined, pose, with_piece
from made_motions import actor, body, cast_by_names, with_vertices_permuted

from retarget.body import rotations as rot
from retarget.body.skinning import rest_vertices
from retarget.character import Character
from retarget.contact.collide import Collider, SurfacePairs, prepare_collider
from retarget.contact.detect import AT_REST, LEAVE, SHORTEST, THRESHOLD, Contacts, hands_placed, prepare_contacts
from retarget.contact.parts import PARTS
from retarget.contact.slim import THIN_GIRTH, girths, slim_bodies
from retarget.errors import RetargetError
from retarget.evaluate.cases import arms_turned

HANDS_ON_BELLY = ARMS_AT_WORK | {"leftUpperArm": [0.5, 0, -0.2]}


@cache
def detector(preset):
    return prepare_contacts(actor(preset).character, actor(preset).humanoid)


def moving(character, amounts, turns):
    """World poses of a body that does a share of the turns in each frame."""
    share = np.asarray(amounts, float)[:, None]
    return pose(character, {name: share * turn for name, turn in turns.items()}, len(share))


def between(contacts, own, part):
    """Which tracks run from one part to another."""
    return (contacts.tracks.own_part == PARTS.index(own)) & (contacts.tracks.part == PARTS.index(part))


def check(contacts, detector):
    """What is true of all contacts: rows and tracks tell one story."""
    rows, tracks = contacts, contacts.tracks
    keys = list(zip(rows.frame.tolist(), rows.vertex.tolist(), rows.part.tolist()))
    assert keys == sorted(set(keys)), "one row a frame, vertex and part, in order"
    assert (rows.distance < LEAVE * detector.threshold).all()
    for number in range(len(tracks.vertex)):
        own = rows.track == number
        assert own.any() and np.array_equal(np.unique(rows.vertex[own]), tracks.vertex[[number]])
        assert np.array_equal(np.unique(rows.part[own]), tracks.part[[number]])
        frames, distance = rows.frame[own], rows.distance[own]
        assert (frames[0], frames[-1] + 1) == (tracks.start[number], tracks.stop[number])
        assert distance[0] < detector.threshold, "begins with a touch"
        closest = distance.argmin()
        assert tracks.anchor_frame[number] == frames[closest]
        assert tracks.face[number] == rows.face[own][closest]
        assert np.array_equal(tracks.barycentric[number], rows.barycentric[own][closest])
    assert np.array_equal(tracks.own_part, detector.collider.parts.vertex_parts[tracks.vertex])
    assert (tracks.own_part != tracks.part).all()
    assert np.isfinite(tracks.pose_probability).all()
    assert ((tracks.pose_probability >= 0) & (tracks.pose_probability <= 1)).all()


@pytest.mark.parametrize("preset", ["heavy", "toddler"])
def test_hands_brought_to_the_belly_touch_it_and_leave_it(preset):
    found_by = detector(preset)
    amounts = np.concatenate([np.zeros(4), np.linspace(0, 1, 9), np.ones(5), np.linspace(1, 0, 9), np.zeros(4)])
    rotations, positions = moving(actor(preset).character, amounts, HANDS_ON_BELLY)
    contacts = found_by.clip(rotations, positions, 30.0)
    check(contacts, found_by)
    for side in ("left", "right"):
        on_belly = between(contacts, f"{side}Hand", "abdomen")
        assert on_belly.sum() > 20
        assert contacts.tracks.start[on_belly].min() > 4 and contacts.tracks.stop[on_belly].max() < len(amounts) - 4
        assert contacts.tracks.pose_probability[on_belly].mean() > 0.9, "a hand was put there"
    back = between(contacts, "abdomen", "leftHand") | between(contacts, "abdomen", "rightHand")
    assert back.any(), "the belly touches the hands"
    for number in (0, 11, 15, len(amounts) - 1):  # `frame` finds what the clip found
        vertices = found_by.skinner.vertices(rotations[[number]], positions[[number]])[0]
        touching = found_by.frame(vertices)
        rows = (contacts.frame == number) & (contacts.distance < found_by.threshold)
        assert set(zip(contacts.vertex[rows], contacts.part[rows])) <= set(zip(touching.vertex, touching.part))


@pytest.mark.parametrize("preset", ["average", "heavy", "very_heavy", "toddler"])
def test_what_is_close_at_rest_is_no_contact(preset):
    found_by, rest = detector(preset), rest_vertices(actor(preset).character)
    assert len(found_by.frame(rest).vertex) == 0
    near = AT_REST * found_by.threshold
    assert len(found_by.collider.pairs(rest, near).vertex) == 0
    if preset == "very_heavy":  # its arms lie beside its flanks
        assert len(prepare_collider(actor(preset).character, actor(preset).humanoid).pairs(rest, near).vertex) > 10


def test_girth_makes_contacts_that_vanish_on_slimmer_bodies():
    """Arms that hang against the flanks of a heavy body, and hands on its belly."""
    found_by = detector("very_heavy")
    assert len(found_by.slim) == 3
    hanging = found_by.clip(*moving(actor("very_heavy").character, np.ones(4), arms_turned(25.0)), 30.0)
    check(hanging, found_by)
    flank = between(hanging, "leftUpperArm", "abdomen") | between(hanging, "leftUpperArm", "chest")
    assert flank.any() and hanging.tracks.pose_probability[flank].mean() < 0.35
    working = found_by.clip(*moving(actor("very_heavy").character, np.ones(4), HANDS_ON_BELLY), 30.0)
    check(working, found_by)
    assert working.tracks.pose_probability[between(working, "leftHand", "abdomen")].mean() > 0.9


def test_thin_bodies_have_no_slimmer_ones_and_all_their_contacts_are_the_poses():
    person = actor("thin")
    parts = detector("thin").collider.parts
    own = girths(person.character, person.humanoid, parts)
    for part, girth in own.items():
        assert girth == pytest.approx(THIN_GIRTH[part.removeprefix("left").removeprefix("right")], rel=0.02)
    crossed = {"leftUpperLeg": [0, 0, -0.3], "rightUpperLeg": [0, 0, 0.3]}
    contacts = detector("thin").clip(*moving(person.character, np.ones(3), crossed), 30.0)
    assert len(contacts.tracks.vertex) and contacts.tracks.pose_probability.min() > 0.6


def test_slim_bodies_shrink_towards_their_bones_and_keep_hands_and_head():
    person, parts = actor("very_heavy"), detector("very_heavy").collider.parts
    bodies = [person.character, *slim_bodies(person.character, person.humanoid, parts)]
    assert len(bodies) == 4
    for thicker, thinner in zip(bodies, bodies[1:]):
        before, after = (girths(each, person.humanoid, parts) for each in (thicker, thinner))
        assert all(after[part] <= before[part] + 1e-9 for part in before)
        assert np.array_equal(thinner.mesh.faces, thicker.mesh.faces) and thinner.skin is thicker.skin
    last = girths(bodies[-1], person.humanoid, parts)
    assert last["abdomen"] == pytest.approx(THIN_GIRTH["abdomen"], rel=0.25)
    moved = np.linalg.norm(rest_vertices(bodies[-1]) - rest_vertices(bodies[0]), axis=1)
    tips = np.isin(parts.vertex_parts, [PARTS.index("head"), PARTS.index("leftHand")])
    assert np.median(moved[tips]) < 1e-3 < 0.05 < np.median(moved[parts.vertex_parts == PARTS.index("abdomen")])


def test_a_placed_hand_is_told_from_a_hanging_one():
    character, humanoid = actor("heavy").character, actor("heavy").humanoid
    turns = {
        "hanging": arms_turned(30.0),
        "on the belly": HANDS_ON_BELLY,
        "raised": arms_turned(-120.0),
        "hanging while bent over": arms_turned(30.0) | {"spine": [0.9, 0, 0]},
    }
    sure = {}
    for name, turn in turns.items():
        placed = hands_placed(humanoid, pose(character, turn)[1])[0]
        assert placed[[PARTS.index("chest"), PARTS.index("leftForearm")]].max() == 0
        sure[name] = placed[PARTS.index("leftHand")]
    assert sure["hanging"] < 0.2 and sure["on the belly"] == 1 and sure["raised"] == 1
    assert sure["hanging while bent over"] < 0.4 < sure["on the belly"]


# Tracking, on touches made by hand: one vertex of a box figure, its distances given frame by frame.


@cache
def tracker():
    figure = cast_by_names(box_figure(), {name: name for name in box_figure().skeleton.names})
    return figure, prepare_contacts(figure.character, figure.humanoid, threshold=0.01)


class Told(Collider):
    """A collider that says what it is told: one vertex at one distance (thresholds) a frame."""

    def pairs(self, vertices, reach=0.0):
        distance = TELL.pop(0)
        near = np.array([]) if distance is None or distance >= LEAVE else np.atleast_1d(distance) * 0.01
        if TWICE and len(near):
            near = np.append(near, near[0] + 0.001)  # another piece of the part, a little further
        count, nowhere = len(near), np.zeros((len(near), 3))
        vertex, part = np.full(count, 70), np.full(count, PARTS.index("chest"))
        return SurfacePairs(vertex, part, near, nowhere, nowhere, np.arange(count), np.tile([1.0, 0, 0], (count, 1)))


TELL, TWICE = [], []


def tracked(distances, fps=30.0, twice=False):
    """Contacts of a vertex whose distances (thresholds; None where it is far) are these, and the spans of its tracks."""
    figure, found_by = tracker()
    TELL[:], TWICE[:] = distances, [True] * twice
    told = Told(**{field.name: getattr(found_by.collider, field.name) for field in fields(Collider)})
    contacts = replace(found_by, collider=told, slim=np.zeros((0, 1, 3))).clip(*pose(figure.character, {}, len(distances)), fps)
    check(contacts, found_by)
    return contacts, [(int(a), int(b)) for a, b in zip(contacts.tracks.start, contacts.tracks.stop)]


FAR = None


@pytest.mark.parametrize(
    "distances, spans",
    [
        ([FAR, 0.5, 0.5, 0.5, FAR], [(1, 4)]),
        ([1.4, 1.2, 0.9, 1.2, 1.4, FAR], [(2, 5)]),  # begins within one threshold, lasts to LEAVE
        ([1.4, 1.2, 1.1, 1.4, 1.1], []),  # near, but never touching
        ([FAR, 0.5, FAR, FAR, FAR], []),  # a flicker
        ([0.5, 0.5, FAR, 0.5, 0.5, FAR], [(0, 5)]),  # a gap
        ([0.5, 0.5, FAR, FAR, FAR, 0.5, 0.5], [(0, 2), (5, 7)]),  # too long a gap
        ([-3.0, -1.0, 0.2], [(0, 3)]),
        ([], []),
        ([FAR] * 70 + [0.3] * 70, [(70, 140)]),
    ],
)
def test_contacts_begin_last_bridge_and_end(distances, spans):
    contacts, found = tracked(distances)
    assert found == spans
    near = [frame for frame, distance in enumerate(distances) if distance is not None and distance < LEAVE]
    assert contacts.frame.tolist() == [frame for frame in near if any(a <= frame < b for a, b in spans)]


def test_short_and_long_are_seconds_not_frames():
    blink = [FAR] * 20 + [0.5] * 6 + [FAR] * 20
    assert tracked(blink, fps=30.0)[1] == [(20, 26)]
    assert tracked(blink, fps=240.0)[1] == [], f"{6 / 240} s is shorter than {SHORTEST} s"
    assert tracked([FAR, 0.5, FAR], fps=10.0)[1] == [(1, 2)], "one frame of a tenth of a second is long enough"
    assert tracked([0.5], fps=30.0)[1] == [(0, 1)], "a still pose"


def test_a_part_of_several_pieces_is_touched_once():
    contacts, spans = tracked([0.5, 0.4, 0.6], twice=True)
    assert spans == [(0, 3)] and contacts.distance == pytest.approx([0.005, 0.004, 0.006])
    assert (contacts.face == 0).all(), "the nearest"


# Invariances.


def working_frames(character):
    return moving(character, [0, 0.6, 0.9, 1, 1, 1], HANDS_ON_BELLY)


def test_moving_and_turning_the_world_changes_nothing():
    found_by = detector("heavy")
    rotations, positions = working_frames(actor("heavy").character)
    turn = rot.from_rotation_vector(np.array([0.4, 2.0, -0.3]))
    here = found_by.clip(rotations, positions, 30.0)
    there = found_by.clip(rot.multiply(turn, rotations), rot.rotate(turn, positions) + [3.0, -1.0, 2.0], 30.0)
    both = [set(zip(each.frame.tolist(), each.vertex.tolist(), each.part.tolist())) for each in (here, there)]
    assert len(both[0]) > 500 and len(both[0] ^ both[1]) <= 2, "but for rounding at the threshold"
    assert there.tracks.pose_probability.mean() == pytest.approx(here.tracks.pose_probability.mean(), abs=1e-3)


def test_vertices_in_another_order_permute_the_contacts():
    permuted, order = with_vertices_permuted(body("heavy"), 2)
    person = cast_by_names(permuted)
    other = prepare_contacts(person.character, person.humanoid)
    here = detector("heavy").clip(*working_frames(actor("heavy").character), 30.0)
    there = other.clip(*working_frames(person.character), 30.0)
    both = [
        set(zip(here.frame.tolist(), here.vertex.tolist(), here.part.tolist())),
        set(zip(there.frame.tolist(), order[there.vertex].tolist(), there.part.tolist())),
    ]
    assert len(both[0] ^ both[1]) <= 2


def test_twice_the_same_and_longer_than_one_batch():
    found_by, character = detector("toddler"), actor("toddler").character
    rotations, positions = moving(character, np.ones(70), HANDS_ON_BELLY)  # 64 bodies at a time
    contacts, again = (found_by.clip(rotations, positions, 30.0) for _ in range(2))
    assert set(contacts.tracks.start.tolist()) == {0} and set(contacts.tracks.stop.tolist()) == {70}
    for field in fields(Contacts):
        if field.name != "tracks":
            assert np.array_equal(getattr(contacts, field.name), getattr(again, field.name))


def test_nothing_gives_empty_contacts_of_the_right_kind():
    found_by, character = detector("heavy"), actor("heavy").character
    for frames in (0, 1, 3):
        contacts = found_by.clip(*moving(character, np.zeros(frames), {}), 30.0)
        assert len(contacts.frame) == len(contacts.tracks.vertex) == 0
        assert contacts.barycentric.shape == contacts.tracks.barycentric.shape == (0, 3)


def test_the_threshold_is_a_share_of_the_body_or_a_length():
    person = actor("average")
    tall = np.ptp(rest_vertices(person.character) @ person.humanoid.axes[1])
    assert detector("average").threshold == pytest.approx(THRESHOLD * tall)
    plain = body("average")
    spread = with_piece(plain, joined((np.array([[0, 3.0, 0], [0, 3, 1], [0.1, 3, 0]]), np.array([[0, 1, 2]]))), {"head": 1.0})
    flag = cast_by_names(spread)
    assert prepare_contacts(flag.character, flag.humanoid).threshold == pytest.approx(THRESHOLD * tall, rel=1e-3)


@pytest.mark.parametrize("threshold", [0.0, -0.1, np.nan, np.inf])
def test_a_threshold_that_is_no_length_is_refused(threshold):
    with pytest.raises(RetargetError, match="threshold must be a length"):
        prepare_contacts(actor("thin").character, actor("thin").humanoid, threshold)


def test_bodies_without_a_surface_and_poses_that_are_nowhere_are_refused():
    person = actor("heavy")
    with pytest.raises(RetargetError, match="no surface"):
        prepare_contacts(Character(person.skeleton, name="bones"), person.humanoid)
    rotations, positions = working_frames(person.character)
    positions = positions.copy()
    positions[2, 5] = np.nan
    with pytest.raises(RetargetError, match="nowhere"):
        detector("heavy").clip(rotations, positions, 30.0)


@pytest.mark.parametrize("missing", [("neck",), ("chest", "upperChest"), ("leftToes", "rightToes", "neck")])
def test_a_humanoid_may_lack_joints(missing):
    person = actor("heavy")
    fewer = {name: joint for name, joint in person.humanoid.joints.items() if name not in missing}
    found_by = prepare_contacts(person.character, replace(person.humanoid, joints=fewer))
    contacts = found_by.clip(*working_frames(person.character), 30.0)
    check(contacts, found_by)
    belly = between(contacts, "leftHand", "abdomen") | between(contacts, "leftHand", "chest")
    assert belly.any() and contacts.tracks.pose_probability[belly].mean() > 0.9


def test_a_hand_that_stays_stays_one_contact_while_the_body_walks():
    """The same pose carried through the world: every track lasts from the first frame to the last."""
    found_by, character = detector("heavy"), actor("heavy").character
    rotations, positions = moving(character, np.ones(8), HANDS_ON_BELLY)
    walked = positions + np.linspace(0, 2, 8)[:, None, None] * np.array([1.0, 0, 0.3])
    tracks = found_by.clip(rotations, walked, 30.0).tracks
    lasting = (tracks.start == 0) & (tracks.stop == 8)
    assert len(lasting) > 100 and lasting.mean() > 0.98
