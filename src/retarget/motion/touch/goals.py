"""What the target should do on every frame: the source's contacts on its own skin, and what stays as it was copied."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from retarget.body import rotations as rot
from retarget.body.kinematics import world_pose
from retarget.character import Motion
from retarget.contact.carried import CarriedVertices
from retarget.contact.contact_edits import added_contacts, apply_edits
from retarget.contact.contact_file import ContactEdits
from retarget.contact.detect import ContactDetector, Contacts, hands_placed
from retarget.contact.ground import intervals
from retarget.contact.parts import PARTS
from retarget.contact.sensor_bones import BONES
from retarget.contact.sensors import SensorSkinner
from retarget.contact.support import support_points
from retarget.errors import RetargetError

if TYPE_CHECKING:
    from retarget.motion.touch.equations import PoseEquations

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class FrameSurface:
    """The target's surface on one frame, where it is not the skin at rest that joints move."""

    vertices: Shaped[Array, "vertices 3"]
    """Posed, metres; clips keep theirs in single precision."""
    binds: Float[Array, "columns 3 4"]
    """Joint-from-world, of the joint of every column of the skin, in the pose that these vertices are in."""

    @property
    def doubles(self) -> tuple[Float[Array, "columns 3 4"], Float[Array, "vertices 3"]]:
        """Binds and vertices in double precision, as loops over them want."""
        return self.binds, self.vertices.astype(np.float64, copy=False)


@dataclass(frozen=True, eq=False)
class FrameGoals:
    """The goals of one frame."""

    first: Int[Array, "contacts corners"]
    """What touches: a point between these vertices of the target."""
    first_shares: Float[Array, "contacts corners"]
    second: Int[Array, "contacts others"]
    """What is touched, likewise."""
    second_shares: Float[Array, "contacts others"]
    faces: Int[Array, "contacts 3"]
    """Corners of the face whose normal is the contact's."""
    gap: Float[Array, "contacts"]
    """How far apart along it, metres."""
    weight: Float[Array, "contacts"]
    """From 0 to 1, more where a contacts file asks for it."""
    count: Float[Array, "contacts"]
    """How many points of the performer's skin each stands for."""
    sunk: Int[Array, "sunk"]
    """Vertices that may stay inside other parts, because the source's are."""
    depth: Float[Array, "sunk"]
    """How deep, metres."""
    near: tuple[Int[Array, "pairs"], Int[Array, "pairs"]]
    """Pairs of sensors that are near each other on the source."""
    apart: Float[Array, "pairs *axes"]
    """How far apart they should be, metres; where a reference compares fields, as vectors."""
    closeness: Float[Array, "pairs"]
    """What each pair weighs."""
    support: Float[Array, "points 3"]
    """Where heels, balls and palms are copied to, metres."""
    resting: Float[Array, "points"]
    """How much each of them rests on the ground, 0 to 1."""
    effectors: Float[Array, "effectors 4"]
    """World rotations of the end effectors as copied."""
    allowed: Float[Array, "limits 3"]
    """How far limited joints may swing, twist and turn about their hinges, radians."""
    surface: FrameSurface | None = None
    """None for the skin at rest."""

    def weakened(self, share: float) -> FrameGoals:
        """The same goals with contacts and nearness at a share of their weight."""
        return replace(self, weight=share * self.weight, closeness=share * self.closeness) if share < 1.0 else self


@dataclass(frozen=True, eq=False)
class ContactRows:
    """Contacts of many frames on the target's skin, in the order of the frames; fields as in `FrameGoals`."""

    bounds: Int[Array, "_"]
    """First row of each frame, and the end."""
    first: Int[Array, "rows corners"]
    first_shares: Float[Array, "rows corners"]
    second: Int[Array, "rows others"]
    second_shares: Float[Array, "rows others"]
    faces: Int[Array, "rows 3"]
    gap: Float[Array, "rows"]
    weight: Float[Array, "rows"]
    count: Float[Array, "rows"]


@dataclass(frozen=True, eq=False)
class SunkRows:
    """Vertices of the target that the source has inside other parts, in the order of the frames."""

    bounds: Int[Array, "_"]
    """First row of each frame, and the end."""
    vertex: Int[Array, "rows"]
    depth: Float[Array, "rows"]
    """Metres, on the target."""


@dataclass(frozen=True, eq=False)
class NearRows:
    """Pairs of sensors that are near each other on the source, in the order of the frames; fields as in `FrameGoals`."""

    bounds: Int[Array, "_"]
    first: Int[Array, "rows"]
    second: Int[Array, "rows"]
    apart: Float[Array, "rows *axes"]
    closeness: Float[Array, "rows"]


@dataclass(frozen=True, eq=False)
class ClipGoals:
    """The goals of a clip."""

    contacts: ContactRows
    sunk: SunkRows
    near: NearRows
    support: Float[Array, "frames points 3"]
    resting: Float[Array, "frames points"]
    effectors: Float[Array, "frames effectors 4"]
    allowed: Float[Array, "frames limits 3"]
    surfaces: tuple[FrameSurface, ...] | None = None
    """One a frame; None for the skin at rest."""

    def frame(self, number: int) -> FrameGoals:
        """The goals of one frame."""
        rows = slice(self.contacts.bounds[number], self.contacts.bounds[number + 1])
        sunk = slice(self.sunk.bounds[number], self.sunk.bounds[number + 1])
        near = slice(self.near.bounds[number], self.near.bounds[number + 1])
        own = self.contacts
        return FrameGoals(
            own.first[rows], own.first_shares[rows], own.second[rows], own.second_shares[rows], own.faces[rows],
            own.gap[rows], own.weight[rows], own.count[rows], self.sunk.vertex[sunk], self.sunk.depth[sunk],
            (self.near.first[near], self.near.second[near]), self.near.apart[near], self.near.closeness[near],
            self.support[number], self.resting[number], self.effectors[number], self.allowed[number],
            None if self.surfaces is None else self.surfaces[number],
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class GoalMaker:
    """Finds the goals of a matched pair of bodies."""

    detector: ContactDetector
    """Of who performs: the source, or the body that stands in for it."""
    carried: CarriedVertices
    """The performer's vertices on the target."""
    back: Int[Array, "vertices"]
    """The performer's vertex for each of the target's, -1 for none: whose depth is allowed there."""
    stood_for: bool
    """Whether the performer only stands in for a source without a surface."""
    may_sink: bool
    """Whether the target may be inside itself as far as the performer is."""
    sensors: SensorSkinner
    """The performer's."""
    pairs: tuple[Int[Array, "pairs"], Int[Array, "pairs"]]
    """Pairs of sensors whose distance is looked at."""
    radii: tuple[float, float]
    """Arm radius of performer and target, metres."""
    size: float
    """Height of the target over the performer's."""
    edits: ContactEdits
    girth_kept: Float[Array, "parts parts"] | None = None
    """What contacts of the performer's girth weigh between two parts, where `edits` do not say; None for nothing."""

    @cached_property
    def girth(self) -> float:
        """Arm radius of the target over the performer's; the ratio of heights where an arm has no surface."""
        return self.radii[1] / self.radii[0] if min(self.radii) > 0 else self.size

    def clip(
        self, performed: Motion, copied: Motion, equations: PoseEquations, touching: Bool[Array, "frames points"] | None
    ) -> tuple[Contacts, ClipGoals]:
        """The goals of a clip, and the contacts that were found; of the entries of a contacts file, those for all clips and
        for the one of the performed motion's name. Contacts that were found pull from their first frame to their last: the
        solver's curvature leads the pose there and back. Added ones, whose points may be far apart, take `RAMP` seconds
        to come and go. `touching` are the ground contacts of the target's support points, where known."""
        pose, fps, frames = world_pose(performed), performed.fps, len(performed)
        contacts, edits = self.detector.clip(*pose, fps), self.edits.of_clip(performed.name)
        distances = self._distances(contacts)
        weight = apply_edits(contacts, edits, fps, girth=self.girth_kept)
        weight *= self._closeness(distances) * self._meant(contacts, pose[1])
        count = self.detector.thinned.stands_for[contacts.vertex]
        rows = [contacts.frame, contacts.vertex, contacts.face, contacts.barycentric, self._gap(distances), weight, count]
        added = added_contacts(edits, self.detector, *pose, fps)
        if len(added.frame):
            fade = _fade(added.frame, frames, RAMP * fps)
            more = (added.frame, added.vertex, added.face, added.barycentric, added.gap * self.size, fade * added.weight, np.ones(len(fade)))
            order = np.argsort(np.concatenate([rows[0], more[0]]), kind="stable")
            rows = [np.concatenate(pair)[order] for pair in zip(rows, more)]
        near = self._near(performed, self._busy_hands(frames, rows[0], rows[1], rows[2], rows[5] * rows[6]))
        goals = self._goals(self._rows(frames, *rows), self._sunk(contacts, pose), near, copied, equations, touching)
        return contacts, goals

    def online(
        self, performed: Motion, copied: Motion, equations: PoseEquations, seconds: float, floor: float
    ) -> ClipGoals:
        """The goals of one frame, without past or future: a contact pulls the more the closer it is, and not at all at the
        threshold, so that none comes or goes at once; what is near the target's `floor` (metres) rests on it likewise.
        `seconds` is the frame's time. Raises `RetargetError` for edits that add contacts, which join points that come
        closest over a whole clip."""
        edits = self.edits.of_clip("")
        if any(edit.does == "add" for edit in edits.edits):
            raise RetargetError("contacts can only be added where the whole clip is known, not online")
        pose = world_pose(performed)
        contacts = self.detector.clip(*pose, performed.fps)
        distances = self._distances(contacts)
        closeness = np.clip(1.0 - np.abs(distances) / self.detector.threshold, 0.0, 1.0) ** 2
        weight = apply_edits(contacts, edits, performed.fps, seconds, self.girth_kept)
        weight *= closeness * self._meant(contacts, pose[1])
        count = self.detector.thinned.stands_for[contacts.vertex]
        rows = self._rows(
            1, contacts.frame, contacts.vertex, contacts.face, contacts.barycentric, self._gap(distances), weight, count
        )
        near = self._near(performed, self._busy_hands(1, contacts.frame, contacts.vertex, contacts.face, weight * count))
        return self._goals(rows, self._sunk(contacts, pose), near, copied, equations, None, floor)

    def _near(self, performed: Motion, busy: Float[Array, "frames 2"]) -> NearRows:
        """Sensors of hands and what is near them, as far as the hand is `busy` touching something: a hand that only passes
        by is left alone."""
        if len(self.pairs[0]) == 0:
            none = np.zeros(0)
            return NearRows(np.zeros(len(performed) + 1, dtype=np.int64), *self.pairs, none, none)
        places, _ = self.sensors.pose(*world_pose(performed))
        reach, ratio = 2.0 * self.radii[0], self.girth
        side = np.char.startswith(np.array(BONES)[self.sensors.sensors.layout.bones[self.pairs[0]]], "right").astype(int)
        return near_rows(places, self.pairs, reach, ratio, busy[:, side])

    def _busy_hands(self, frames: int, frame: Array, vertex: Array, face: Array, weight: Array) -> Float[Array, "frames 2"]:
        """From 0 to 1, how much the left and the right hand touch: by the weights of their contacts."""
        parts = self.detector.collider.parts
        busy = np.zeros((frames, 2))
        for number, side in enumerate(("left", "right")):
            hand = parts.index(f"{side}Hand")
            own = (parts.vertex_parts[vertex] == hand) | (parts.face_parts[face] == hand)
            busy[:, number] = np.bincount(frame[own], weight[own], minlength=frames)
        busy = np.minimum(1.0, busy / BUSY)
        return IDLE + (1.0 - IDLE) * busy

    def _goals(
        self, rows, sunk, near, copied: Motion, equations: PoseEquations, touching, floor: float | None = None
    ) -> ClipGoals:
        rotations, positions = world_pose(copied)
        support = np.concatenate(support_points(equations.limbs, rotations, positions), axis=1)
        if touching is not None:
            resting = touching.astype(np.float64)
        elif floor is not None:
            resting = np.clip(1.0 - (support[..., 1] - floor) / (LIFTED * equations.actor.height), 0.0, 1.0)
        else:
            resting = np.zeros(support.shape[:2])
        return ClipGoals(
            rows, sunk, near, support, resting, np.ascontiguousarray(rotations[:, equations.effectors]),
            equations.limits.allowed(rotations),
        )  # fmt: skip

    def _meant(self, contacts: Contacts, positions: Float[Array, "frames joints 3"]) -> Float[Array, "rows"]:
        """How much a contact says of the performer: the arms of a body that stands in brush its flanks while they hang,
        which is its girth and not the performance. 1 for all others."""
        meant = np.ones(len(contacts.frame))
        if not self.stood_for:
            return meant
        placed = hands_placed(self.detector.humanoid, positions)
        own, other = contacts.tracks.own_part[contacts.track], contacts.part
        for side in ("left", "right"):
            arm = [PARTS.index(f"{side}{part}") for part in ("UpperArm", "Forearm")]
            brushes = (np.isin(own, arm) & np.isin(other, TRUNK)) | (np.isin(other, arm) & np.isin(own, TRUNK))
            meant[brushes] = placed[contacts.frame[brushes], PARTS.index(f"{side}Hand")]
        return meant

    def _distances(self, contacts: Contacts) -> Float[Array, "rows"]:
        """How far apart touching points are, metres. Where nothing may stay inside anything, what has sunk in is taken as
        moved out as a whole: the deepest point of two parts touches, the others are as much farther as they were less deep."""
        if self.may_sink or len(contacts.frame) == 0:
            return contacts.distance
        own, other = contacts.tracks.own_part[contacts.track], contacts.part
        pair = (contacts.frame * len(PARTS) + np.minimum(own, other)) * len(PARTS) + np.maximum(own, other)
        _, number = np.unique(pair, return_inverse=True)
        deepest = np.zeros(int(number.max()) + 1)
        np.maximum.at(deepest, number, -contacts.distance)
        return contacts.distance + deepest[number]

    def _closeness(self, distances: Float[Array, "rows"]) -> Float[Array, "rows"]:
        """1 within the threshold, falling to 0 at three; what a performer has deep inside itself is no contact."""
        return np.clip(1.5 - np.abs(distances) / (2.0 * self.detector.threshold), 0.0, 1.0)

    def _gap(self, distances: Float[Array, "rows"]) -> Float[Array, "rows"]:
        """How far apart touching points should be on the target: in radii of the arm, but never farther for its size. What
        the source has inside itself may stay inside."""
        return distances * min(self.size, self.girth)

    def _rows(
        self,
        frames: int,
        frame: Int[Array, "rows"],
        vertex: Int[Array, "rows"],
        face: Int[Array, "rows"],
        shares: Float[Array, "rows 3"],
        gap: Float[Array, "rows"],
        weight: Float[Array, "rows"],
        count: Float[Array, "rows"],
    ) -> ContactRows:
        """Contacts of the performer, a vertex at a point of a face each, on the target's skin. Rows come by frame; those
        without weight, or with a place that the target has none for, are left out."""
        corners = self.detector.skinner.character.mesh.faces[face]
        kept = np.flatnonzero((weight > 0) & self.carried.trusted(vertex) & self.carried.trusted(corners).all(axis=1))
        first, first_shares = self.carried.points(vertex[kept, None], np.ones((len(kept), 1)))
        second, second_shares = self.carried.points(corners[kept], shares[kept])
        main = shares[kept].argmax(axis=1) if second.shape[1] > 3 else np.zeros(len(kept), dtype=np.int64)
        faces = np.take_along_axis(second.reshape(len(kept), second.shape[1] // 3, 3), main[:, None, None], axis=1)[:, 0]
        return ContactRows(
            np.searchsorted(frame[kept], np.arange(frames + 1)), first, first_shares, second, second_shares,
            np.ascontiguousarray(faces), gap[kept], weight[kept], count[kept],
        )  # fmt: skip

    def _sunk(self, contacts: Contacts, pose: tuple[Array, Array]) -> SunkRows:
        """Where the performer is inside itself, on the target: as deep as its tested vertices around tell."""
        skinner, thinned, frames = self.detector.skinner, self.detector.thinned, len(pose[0])
        found = [(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))]
        inside = contacts.frame[contacts.distance < 0] if self.may_sink else contacts.frame[:0]
        for number in np.unique(inside).tolist():
            rows = np.arange(*np.searchsorted(contacts.frame, [number, number + 1]))
            rows = rows[np.argsort(-contacts.distance[rows], kind="stable")]  # the deepest of a vertex is written last
            posed = skinner.vertices(*(each[number : number + 1] for each in pose))[0].astype(np.float64)
            a, b, c = posed[skinner.character.mesh.faces[contacts.face[rows]]].transpose(1, 0, 2)
            depth, normals = np.full(len(posed), -np.inf), np.zeros((len(posed), 3))
            depth[contacts.vertex[rows]] = -contacts.distance[rows]
            normals[contacts.vertex[rows]] = rot.unit(np.cross(b - a, c - a))
            on_target = np.where(self.back >= 0, thinned.depths(depth, normals, posed)[self.back], 0.0)
            here = np.flatnonzero(on_target > 0)
            found.append((np.full(len(here), number), here, self.size * on_target[here]))
        frame, vertex, depth = (np.concatenate(column) for column in zip(*found))
        return SunkRows(np.searchsorted(frame, np.arange(frames + 1)), vertex, depth)


RAMP = 0.13
"""Seconds over which the pull of an added contact grows after it began and fades before it ends."""


TRUNK = [PARTS.index(part) for part in ("chest", "abdomen", "pelvis")]
LIFTED = 0.03
"""Share of the height: what is above the floor by this much rests no more, where no later frame tells."""
BUSY = 5.0
"""The sum of the weights of a hand's contacts from which on it counts as touching in full."""


IDLE = 20.0
"""What a hand that touches nothing counts as: no contact says where it should be, so that what is near says more."""


def _fade(frame: Int[Array, "rows"], frames: int, ramp: float) -> Float[Array, "rows"]:
    """From 0 to 1 at the start of every stretch of frames that have rows, and back at its end; at the clip's ends none."""
    share = np.zeros(frames)
    present = np.bincount(frame, minlength=frames) > 0
    for start, stop in intervals(present):
        place = np.arange(start, stop)
        since = np.inf if start == 0 else place - start + 1
        until = np.inf if stop == frames else stop - place
        share[start:stop] = np.clip(np.minimum(since, until) / max(ramp, 1.0), 0.0, 1.0)
    return share[frame]


def near_rows(
    places: Float[Array, "frames sensors 3"],
    pairs: tuple[Int[Array, "pairs"], Int[Array, "pairs"]],
    reach: float,
    ratio: float,
    share: Float[Array, "frames pairs"],
) -> NearRows:
    """Pairs of the source's sensors within `reach` metres of each other; on the target they should be as far apart by the
    `ratio`. A pair weighs less the farther it is, and nothing at the reach, so that none comes or goes at once; its `share`
    multiplies."""
    distance = np.linalg.norm(places[:, pairs[0]] - places[:, pairs[1]], axis=-1)
    frame, pair = np.nonzero((distance < reach) & (share > 0))
    own = distance[frame, pair].astype(np.float64)
    return NearRows(
        np.searchsorted(frame, np.arange(len(places) + 1)), pairs[0][pair], pairs[1][pair], ratio * own,
        share[frame, pair] * (1.0 - own / reach) ** 2,
    )  # fmt: skip
