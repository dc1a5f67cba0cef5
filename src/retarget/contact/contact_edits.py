"""What a contacts file asks for, applied: a weight for each contact that was found, and contacts that were not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.contact.contact_file import ContactEdit, ContactEdits
from retarget.contact.detect import ContactDetector, Contacts
from retarget.contact.parts import PARTS
from retarget.errors import RetargetError

Array = np.ndarray

SLACK = 1.0 / 30.0
"""Seconds around an entry that still belong to it: the list is made at 30 frames a second, and contacts found at a
higher rate begin and end between its frames."""
UNLIKELY, LIKELY = 0.25, 0.6
"""Probabilities that the pose means a contact, below and above which that is settled."""
BAND = 2.0
"""Contact thresholds above the least distance within which points of an added contact lie."""
MOST = 64
"""Points of an added contact in each direction."""


@dataclass(frozen=True, eq=False)
class AddedContacts:
    """Contacts that a file asks for, one row a frame and point, by entry, frame and vertex."""

    frame: Int[Array, "rows"]
    vertex: Int[Array, "rows"]
    face: Int[Array, "rows"]
    """Face with the point that the vertex shall touch."""
    barycentric: Float[Array, "rows 3"]
    gap: Float[Array, "rows"]
    """Metres to keep between both."""
    weight: Float[Array, "rows"]


def apply_edits(
    contacts: Contacts,
    edits: ContactEdits,
    fps: float,
    start: float = 0.0,
    girth: Float[Array, "parts parts"] | None = None,
) -> Float[Array, "rows"]:
    """A weight for every row of `contacts`. Without edits p, the probability that the pose means it, `sharpened`; with `girth`,
    what contacts of girth between two parts weigh as long as no edit says so, p + (1 - p) girth.

    'auto' is p pose + (1 - p) girth with the strengths of these kinds (1 and 0 unless given), 'keep' is 1, 'release' 0;
    the last entry that speaks of a row counts. The entry's strength multiplies, and so does, once, each line of
    [strength] in which one of the two parts takes part. `start` is the time of the first frame, seconds.
    """
    probability = sharpened(contacts.tracks.pose_probability)[contacts.track]
    own = contacts.tracks.own_part[contacts.track]
    of_girth = _of_girth(edits, own, contacts.part, girth)
    auto = probability * edits.kind("pose") + (1.0 - probability) * of_girth
    weight = auto.copy()
    for edit in edits.edits:
        if edit.does == "add":
            continue
        chosen = _spoken_of(edit, contacts, fps, start)
        weight[chosen] = edit.strength * {"auto": auto[chosen], "keep": 1.0, "release": 0.0}[edit.does]
    strength = np.array([[edits.of_pair((one, other)) for other in PARTS] for one in PARTS])
    return weight * strength[own, contacts.part]


def let_go(contacts: Contacts, edits: ContactEdits, girth: Float[Array, "parts parts"] | None) -> int:
    """How many of the tracked contacts belong to the performer's girth and are not kept (by half, or more); what single
    entries of `edits` say does not count."""
    tracks = contacts.tracks
    kept = _of_girth(edits, tracks.own_part, tracks.part, girth)
    return int(((tracks.pose_probability < 0.5) & (kept < 0.5)).sum())


def _of_girth(edits: ContactEdits, own: Array, other: Array, girth: Array | None) -> Float[Array, "rows"]:
    """What a contact of girth weighs, for each pair of parts."""
    given = girth is None or edits.speaks_of("girth")
    return np.full(len(own), edits.kind("girth")) if given else girth[own, other]


def sharpened(probability: Float[Array, "*rows"]) -> Float[Array, "*rows"]:
    """A probability taken as a decision: 0 up to `UNLIKELY`, 1 from `LIKELY` on. A few points that hardly are meant would
    pull a limb as far as many that are, only slower."""
    return np.clip((probability - UNLIKELY) / (LIKELY - UNLIKELY), 0.0, 1.0)


def added_contacts(
    edits: ContactEdits,
    detector: ContactDetector,
    world_rotations: Float[Array, "frames joints 4"],
    world_positions: Float[Array, "frames joints 3"],
    fps: float,
) -> AddedContacts:
    """The rows of all entries 'add'.

    An entry joins the same points on all its frames: the nearest of both parts, both ways, at the moment when the parts
    are closest, by their vertices. Frames within half a frame of its time belong to it, so that no entry falls between two.
    The strengths of parts multiply it, those of kinds do not. Raises `RetargetError` for a part that the body lacks.
    """
    asked = [edit for edit in edits.edits if edit.does == "add"]
    found = [_added(edit, edits, detector, world_rotations, world_positions, fps) for edit in asked]
    whole = np.zeros(0, dtype=np.int64)
    empty = (whole, whole, whole, np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    return AddedContacts(*(np.concatenate(column) for column in zip(empty, *found)))


def _added(
    edit: ContactEdit, edits: ContactEdits, detector: ContactDetector, rotations: Array, positions: Array, fps: float
) -> tuple[Array, ...]:
    from scipy.spatial import cKDTree

    parts = detector.collider.parts
    faces = detector.skinner.character.mesh.faces
    face_of, corner_of = np.full(len(parts.welded), -1), np.zeros(len(parts.welded), dtype=np.int64)
    good = np.flatnonzero(parts.face_pieces >= 0)
    corners = parts.welded[faces[good]]
    face_of[corners.ravel()], corner_of[corners.ravel()] = np.repeat(good, 3), np.tile(np.arange(3), len(good))
    sides = []
    for name in edit.parts:
        usable = parts.body_vertices & (parts.vertex_parts == PARTS.index(name)) & (face_of >= 0)
        sides.append(np.flatnonzero(usable & (parts.welded == np.arange(len(usable)))))
        if len(sides[-1]) == 0:
            raise RetargetError(f"contacts {edit.parts[0]}-{edit.parts[1]} cannot be added: the body has no {name}")
    frames = np.flatnonzero(_during(edit, np.arange(len(rotations)) / fps, 0.5 / fps + 1e-6))
    nearest = (np.inf, None)
    for frame in frames:
        posed = detector.skinner.vertices(rotations[frame : frame + 1], positions[frame : frame + 1])[0]
        least = float(cKDTree(posed[sides[1]]).query(posed[sides[0]])[0].min())
        if least < nearest[0]:
            nearest = (least, posed)
    if nearest[1] is None:
        return (frames, frames, frames, np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    vertex, touched = [], []
    for own, other in (sides, sides[::-1]):
        distance, place = cKDTree(nearest[1][other]).query(nearest[1][own])
        close = np.argsort(distance, kind="stable")[:MOST]
        close = np.sort(close[distance[close] <= nearest[0] + BAND * detector.threshold])
        vertex.append(own[close])
        touched.append(other[place[close]])
    own, other = np.concatenate(vertex), np.concatenate(touched)
    order = np.argsort(own)
    own, other = own[order], other[order]
    weight = edit.strength * edits.of_pair(edit.parts)
    rows = len(frames) * len(own)
    return (
        np.repeat(frames, len(own)), np.tile(own, len(frames)), np.tile(face_of[other], len(frames)),
        np.tile(np.eye(3)[corner_of[other]], (len(frames), 1)), np.full(rows, edit.gap), np.full(rows, weight),
    )  # fmt: skip


def without_effect(contacts: Contacts, edits: ContactEdits, fps: float, frames: int) -> list[str]:
    """Entries that change nothing in a clip, by their parts and times: no frame of it lies within, or nothing touches."""
    names = []
    for edit in edits.edits:
        if edit.does == "add":
            speaks = _during(edit, np.arange(frames) / fps, 0.5 / fps + 1e-6).any()
        else:
            speaks = _spoken_of(edit, contacts, fps).any()
        if not speaks:
            until = "the end" if edit.end is None else f"{edit.end:g} s"
            names.append(f"{edit.does} {'-'.join(edit.parts)} from {edit.start or 0.0:g} s to {until}")
    return names


def _spoken_of(edit: ContactEdit, contacts: Contacts, fps: float, start: float = 0.0) -> Bool[Array, "rows"]:
    """The contacts that an entry is about: of its parts, within its time."""
    own, (a, b) = contacts.tracks.own_part[contacts.track], (PARTS.index(part) for part in edit.parts)
    pair = ((own == a) & (contacts.part == b)) | ((own == b) & (contacts.part == a))
    return pair & _during(edit, start + contacts.frame / fps, SLACK)


def _during(edit: ContactEdit, seconds: Float[Array, "rows"], slack: float) -> Bool[Array, "rows"]:
    """What lies within an entry's time."""
    start = -np.inf if edit.start is None else edit.start
    end = np.inf if edit.end is None else edit.end
    return (seconds >= start - slack) & (seconds <= end + slack)
