"""The list of contacts: rows of many points become few events, in one order."""

import numpy as np

from retarget.contact.contact_list import contact_events, ordered_parts
from retarget.contact.detect import Contacts, ContactTracks
from retarget.contact.parts import PARTS


def made_contacts(*rows):
    """Contacts from (frame, vertex, own part, touched part, distance, probability)."""
    rows = sorted(rows)
    frame, vertex, own, part, distance, probability = (np.array(column) for column in zip(*rows))
    own, part = (np.array([PARTS.index(name) for name in names]) for names in (own, part))
    each, weights = np.arange(len(rows)), np.tile([1.0, 0.0, 0.0], (len(rows), 1))
    tracks = ContactTracks(vertex, own, part, frame, frame + 1, frame, each * 0, weights, probability.astype(float))
    return Contacts(frame, vertex, part, each * 0, weights, distance.astype(float), each, tracks)


def test_both_directions_of_a_pair_are_one_event_and_short_gaps_are_bridged():
    contacts = made_contacts(
        (0, 5, "leftHand", "abdomen", 0.01, 1.0),
        (8, 9, "abdomen", "leftHand", -0.02, 0.5),  # seven frames without, .23 s
        (17, 5, "leftHand", "abdomen", 0.01, 0.0),  # eight, .27 s
    )
    first, second = contact_events(contacts, 30.0)
    assert first.parts == ("leftHand", "abdomen") == second.parts
    assert (first.start, first.end, first.points, first.distance) == (0.0, 8 / 30, 2, -0.02)
    assert (first.probability, first.decides) == (0.75, "pose")
    assert (second.start, second.end, second.points, second.decides) == (17 / 30, 17 / 30, 1, "girth")


def test_events_come_by_time_then_pair():
    contacts = made_contacts(
        (3, 1, "head", "rightHand", 0.0, 1.0),
        (3, 2, "leftHand", "chest", 0.0, 1.0),
        (1, 3, "rightThigh", "leftThigh", 0.0, 1.0),
        (6, 3, "rightThigh", "leftThigh", 0.0, 1.0),
    )
    assert [event.parts for event in contact_events(contacts, 30.0)] == [
        ("rightThigh", "leftThigh"), ("leftHand", "chest"), ("rightHand", "head"),
    ]  # fmt: skip


def test_a_pair_has_one_order():
    for one in PARTS:
        for other in PARTS:
            assert ordered_parts(one, other) == ordered_parts(other, one)
    assert ordered_parts("rightThigh", "leftHand") == ("leftHand", "rightThigh")
