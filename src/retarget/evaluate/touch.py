"""How a result touches itself against how its source did: contacts kept, contact error, penetration.

Contacts are carried from the source to the target by `contact.carried`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body.kinematics import world_pose
from retarget.body.skinning import Skinner, prepare_skinning
from retarget.character import Motion
from retarget.contact.carried import CarriedVertices, carry_vertices
from retarget.contact.collide import Collider, prepare_collider
from retarget.contact.detect import LEAVE, ContactDetector, Contacts, prepare_contacts
from retarget.contact.near_sensors import hand_pairs
from retarget.contact.parts import PARTS, BodyParts
from retarget.contact.sensors import Sensors, place_sensors, pose_sensors
from retarget.contact.slim import arm_radius
from retarget.evaluate import metrics
from retarget.evaluate.placement import kept_together
from retarget.motion.align import Actor

Array = np.ndarray

OF_THE_POSE = 0.5
"""Probability from which on a contact counts as one of the pose."""


@dataclass(frozen=True, eq=False)
class SourceTouch:
    """What a performance touches, found once for all targets."""

    actor: Actor
    detector: ContactDetector
    motion: Motion
    contacts: Contacts
    depth: Float[Array, "frames vertices"]

    @property
    def parts(self) -> BodyParts:
        return self.detector.collider.parts

    def pose_rows(self, countable: Bool[Array, "tracks"] | None = None) -> Int[Array, "_"]:
        """Rows of the contacts that belong to the pose and are not buried in the source itself; of `countable` tracks."""
        contacts, tracks = self.contacts, self.contacts.tracks
        chosen = tracks.pose_probability >= OF_THE_POSE
        if countable is not None:
            chosen = chosen & countable
        clean = np.abs(contacts.distance) <= LEAVE * self.detector.threshold
        return np.flatnonzero(chosen[contacts.track] & clean) if len(contacts.track) else contacts.track


def observe(actor: Actor, motion: Motion, detector: ContactDetector | None = None) -> SourceTouch:
    """Contacts and penetration of a performance. Raises `RetargetError` for a performer without a surface."""
    detector = detector or prepare_contacts(actor.character, actor.humanoid)
    pose = world_pose(motion)
    depth = judged_body(actor).collider.depths(detector.skinner.vertices(*pose))
    return SourceTouch(actor, detector, motion, detector.clip(*pose, motion.fps), depth)


@dataclass(frozen=True, eq=False)
class TouchJudge:
    """Judges results on one target against one source body; `prepare_judge` makes one."""

    target: Actor
    skinner: Skinner
    collider: Collider
    threshold: float
    """Metres within which the target's skin touches: the source's threshold by the ratio of heights."""
    carried: CarriedVertices
    """Where the source's vertices lie on the target."""
    sensors: tuple[Sensors, Sensors]
    """The paper's 288 on source and target."""
    radii: tuple[float, float]
    """Of the arms of source and target, metres."""

    def __call__(
        self, touch: SourceTouch, motion: Motion, countable: Bool[Array, "tracks"] | None = None
    ) -> dict[str, float | None]:
        """Figures of one result, frame by frame beside the source's. `countable` names the tracks that can be kept on this
        target at all (None: every one)."""
        posed = self.skinner.vertices(*world_pose(motion))
        depth = self.collider.depths(posed)
        limb, height = self.collider.parts.limb_vertices, self.target.height
        percent = metrics.penetration_percent(depth, limb)
        in_source = metrics.penetration_percent(touch.depth, touch.parts.limb_vertices)
        kept, counted = self._kept(touch, posed, countable)
        error, two_sided = self._contact_errors(touch, motion)
        figures: dict[str, float | None] = {
            "contacts_kept": kept,
            "contacts_counted": counted,
            "contact_error": error,
            "two_sided_contact_error": two_sided,
            "penetration_percent": float(percent.mean()),
            "source_penetration_percent": float(in_source.mean()),
            "excess_penetration_percent": float(metrics.excess_penetration_percent(percent, in_source).mean()),
            "new_penetration_percent": None,
            "depth_mean_mm": metrics.depth_mean_mm(depth, limb, height),
            "depth_p95_mm": metrics.depth_p95_mm(depth, limb, height),
        }
        if self.carried.by_sensors is None:
            new = metrics.new_penetration_percent(depth, touch.depth, limb)
            figures["new_penetration_percent"] = float(new.mean())
        return figures

    def _kept(
        self, touch: SourceTouch, posed: Float[Array, "frames vertices 3"], countable: Bool[Array, "tracks"] | None
    ) -> tuple[float | None, int]:
        """Share of the source's contacts kept, and how many (points times frames) were counted."""
        first, second, frame = self._carried_contacts(touch, posed, countable)
        if len(frame) == 0:
            return None, 0
        everywhere = np.ones((1, len(frame)), dtype=bool)
        return metrics.contacts_kept(first[None], second[None], everywhere, self.threshold), len(frame)

    def lost(
        self, touch: SourceTouch, motion: Motion, countable: Bool[Array, "tracks"] | None
    ) -> tuple[Bool[Array, "rows"], Int[Array, "rows"]]:
        """Which of the counted contacts are not kept, and the frame of each."""
        first, second, frame = self._carried_contacts(touch, self.skinner.vertices(*world_pose(motion)), countable)
        return np.linalg.norm(first - second, axis=1) > metrics.SLACK * self.threshold, frame

    def keepable_together(
        self, touch: SourceTouch, motion: Motion, countable: Bool[Array, "tracks"] | None, every: int, seed: int
    ) -> float | None:
        """The share of the counted contacts that are kept where the patches which touch are laid on each other as well as
        they can be (`keepable.kept_together`), each part on each by itself: what patches of other shapes and
        sizes leave to keep. One frame in `every` is looked at. Any motion of the target serves, parts hardly change their shape."""
        first, second, frame = self._carried_contacts(touch, self.skinner.vertices(*world_pose(motion)), countable)
        contacts, rows = touch.contacts, self._carried_rows(touch, countable)
        pairs = (frame * len(PARTS) + contacts.tracks.own_part[contacts.track[rows]]) * len(PARTS) + contacts.part[rows]
        looked_at = np.flatnonzero(np.isin(frame, np.unique(frame)[::every]))
        if len(looked_at) == 0:
            return None
        limit = metrics.SLACK * self.threshold
        own = [looked_at[pairs[looked_at] == pair] for pair in np.unique(pairs[looked_at])]
        return sum(kept_together(first[rows], second[rows], limit, seed) for rows in own) / len(looked_at)

    def touching_parts(
        self, touch: SourceTouch, motion: Motion, countable: Bool[Array, "tracks"] | None
    ) -> dict[str, float | None]:
        """Which parts touch, wherever on them: `parts_kept`, the share of the parts (times frames) joined by the source's
        counted contacts that touch on the result; and `parts_gained_percent`, per cent of the result's contacts between parts
        that do not touch on the source's frame: what its girth, or the method, adds."""
        found = self._detector.clip(*world_pose(motion), motion.fps)
        of_source, of_result = _part_pairs(touch.contacts), _part_pairs(found)
        meant = np.unique(of_source[touch.pose_rows(countable)])
        return {
            "parts_kept": float(np.isin(meant, of_result).mean()) if len(meant) else None,
            "parts_gained_percent": 100.0 * float((~np.isin(of_result, of_source)).mean()) if len(of_result) else 0.0,
        }

    @cached_property
    def _detector(self) -> ContactDetector:
        return prepare_contacts(self.target.character, self.target.humanoid, self.threshold)

    def _carried_contacts(
        self, touch: SourceTouch, posed: Float[Array, "frames vertices 3"], countable: Bool[Array, "tracks"] | None
    ) -> tuple[Float[Array, "rows 3"], Float[Array, "rows 3"], Int[Array, "rows"]]:
        """Both places of the source's contacts on the target, metres, and their frames."""
        contacts, rows = touch.contacts, self._carried_rows(touch, countable)
        corners = touch.actor.character.mesh.faces[contacts.face[rows]]
        vertices = np.concatenate([contacts.vertex[rows][:, None], corners], axis=1)
        places = self.carried.places(posed, contacts.frame[rows], vertices)
        touched = (contacts.barycentric[rows][:, :, None] * places[:, 1:]).sum(axis=1)
        return places[:, 0], touched, contacts.frame[rows]

    def _carried_rows(self, touch: SourceTouch, countable: Bool[Array, "tracks"] | None) -> Int[Array, "rows"]:
        """The counted contacts whose places the target has."""
        contacts, rows = touch.contacts, touch.pose_rows(countable)
        corners = touch.actor.character.mesh.faces[contacts.face[rows]]
        return rows[self.carried.trusted(contacts.vertex[rows]) & self.carried.trusted(corners).all(axis=1)]

    def _contact_errors(self, touch: SourceTouch, motion: Motion) -> tuple[float | None, float | None]:
        """As the paper charges it, and to both sides."""
        distances = []
        first, second = hand_pairs(*self.sensors)
        for sensors, moving in zip(self.sensors, (touch.motion, motion)):
            places, _ = pose_sensors(sensors, moving)
            distances.append(np.linalg.norm(places[:, first] - places[:, second], axis=-1).astype(np.float64))
        errors = (metrics.contact_error(*distances, *self.radii, two_sided=both) for both in (False, True))
        return tuple(None if np.isnan(error) else error for error in errors)


def prepare_judge(touch: SourceTouch, target: Actor, by_sensors: bool = False) -> TouchJudge:
    """Match a source and a target for judging; `by_sensors` as in `carry_vertices`. Raises `RetargetError` for a target
    without a surface."""
    source, body, own = touch.actor, judged_body(target), judged_body(touch.actor)
    return TouchJudge(
        target,
        body.skinner,
        body.collider,
        touch.detector.threshold * target.height / source.height,
        carry_vertices(source.character, source.humanoid, target.character, target.humanoid, by_sensors),
        (own.sensors, body.sensors),
        (own.arm_radius, body.arm_radius),
    )


def _part_pairs(contacts: Contacts) -> Int[Array, "rows"]:
    """A number for the frame and the two parts of every row."""
    own, other = contacts.tracks.own_part[contacts.track], contacts.part
    low, high = np.minimum(own, other), np.maximum(own, other)
    return (contacts.frame * len(PARTS) + low) * len(PARTS) + high


@dataclass(frozen=True, eq=False)
class JudgedBody:
    """What judging needs of one body, whoever's motion it performs."""

    skinner: Skinner
    collider: Collider
    sensors: Sensors
    arm_radius: float


@lru_cache(maxsize=16)
def judged_body(actor: Actor) -> JudgedBody:
    """Prepared once for each actor. Raises `RetargetError` for one without a surface."""
    character, humanoid = actor.character, actor.humanoid
    collider = prepare_collider(character, humanoid)
    sensors = place_sensors(character, humanoid)
    return JudgedBody(prepare_skinning(character), collider, sensors, arm_radius(character, humanoid, collider.parts))
