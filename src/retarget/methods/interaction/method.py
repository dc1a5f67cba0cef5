"""Dense interaction: what touches in the source touches in the result, and nothing sinks into anything (after Ye 2024)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import local_positions, world_pose
from retarget.body.skinning import prepare_skinning
from retarget.character import Motion, Pose
from retarget.contact.carried import CarriedVertices, carry_vertices
from retarget.contact.collide import prepare_collider
from retarget.contact.detect import ContactDetector, Contacts, prepare_contacts
from retarget.contact.skin_levers import prepare_levers
from retarget.contact.slim import arm_radius
from retarget.errors import RetargetError
from retarget.methods.base import Method, Result, Retargeter
from retarget.methods.interaction.solve import FrameContacts, PoseSolver
from retarget.motion.align import Actor
from retarget.motion.copy_clip import Copier, CopySettings, prepare_copier
from retarget.motion.filter import gaussian

Array = np.ndarray

RAMP = 0.13
"""Seconds over which a contact's pull grows after it began and fades before it ends."""
COLD = 5
"""Times that the first frame is solved over again: nothing has warmed it."""
SMOOTH = 0.035
"""Seconds: standard deviation of the low-pass on the turns, which takes the jumps of nearest points out."""


@dataclass(frozen=True)
class Interaction(CopySettings, Method):
    """Copied rotations, corrected where the body would sink into itself or lose a contact of the source's pose.

    Hips and legs stay as copied, so feet stand as they do there; the trunk, the head and the arms give way. Needs a
    source with a surface. Stepping online sees contacts without their future. Not yet the default: `docs/architecture.md`
    says what is missing.
    """

    laws: ClassVar[frozenset[str]] = frozenset({"equal results for equal input"})
    """The nearest points of surfaces hop from vertex to vertex, so that turning the world changes results by up to a
    millimetre; of the other laws, those about paths and joints are the copied pose's."""

    def prepare(self, source: Actor, target: Actor) -> PreparedInteraction:
        """Match the bodies. Raises `RetargetError` where one of them has no surface."""
        for actor, role in ((source, "source"), (target, "target")):
            if actor.character.skin is None:
                raise RetargetError(f"the {role} has no surface; the method 'interaction' needs one on both sides")
        detector = prepare_contacts(source.character, source.humanoid)
        collider = prepare_collider(target.character, target.humanoid)
        solver = PoseSolver(
            target.skeleton, target.character.mesh.faces, prepare_skinning(target.character), collider,
            prepare_levers(target.character, target.humanoid), target.height,
            detector.threshold * target.height / source.height,
        )  # fmt: skip
        carried = carry_vertices(source.character, source.humanoid, target.character, target.humanoid)
        ratio = arm_radius(target.character, target.humanoid, collider.parts) / arm_radius(
            source.character, source.humanoid, detector.collider.parts
        )
        return PreparedInteraction(prepare_copier(self, source, target), detector, solver, carried, ratio)


@dataclass(frozen=True, eq=False)
class PreparedInteraction(Retargeter):
    """A matched pair of bodies."""

    copier: Copier
    detector: ContactDetector
    solver: PoseSolver
    carried: CarriedVertices
    """The source's vertices on the target."""
    ratio: float
    """Arm radius of the target over the source's: what gaps are scaled by."""
    before: list[Float[Array, "turning 3"]] = field(default_factory=list)
    """The turns of the last online frame."""

    def __call__(self, motion: Motion) -> Result:
        """Retarget a clip. Raises `RetargetError` as `Copier.clip` does."""
        copied = self.copier.clip(motion)
        contacts = self.detector.clip(*world_pose(motion), motion.fps)
        frames = self._frames(contacts, len(motion), motion.fps)
        offsets = local_positions(copied.motion.skeleton, copied.motion.translations, copied.motion.moved)
        turns = np.zeros((len(motion), len(self.solver.levers.turning), 3))
        for frame in [0] * COLD + list(range(len(motion))):
            last = turns[max(frame - 1, 0)]
            turns[frame] = self.solver.frame(copied.motion.rotations[frame], offsets[frame], frames[frame], last)
        turns = gaussian(turns, SMOOTH * motion.fps)
        mended = replace(copied.motion, rotations=self.solver.turned(copied.motion.rotations, turns))
        largest = np.degrees(np.linalg.norm(turns, axis=-1))
        stats = copied.stats | {
            "contacts_of_the_source": len(contacts.tracks.vertex),
            "corrected_frames": int((largest.max(axis=1) > 0.5).sum()),
            "largest_correction_degrees": float(largest.max(initial=0.0)),
        }
        return Result(self.copier.target, mended, stats=stats)

    def step(self, pose: Pose) -> Pose:
        """The next pose online, from the copied one; starts where the last frame's solution was."""
        copied = self.copier.step(pose)
        source, skeleton = self.copier.source.skeleton, self.copier.target.skeleton
        one = Motion(source, pose.rotations[None], pose.translations[None], 30.0, pose.moved)
        contacts = self.detector.clip(*world_pose(one), 30.0)
        offsets = local_positions(skeleton, copied.translations[None], copied.moved)[0]
        last = self.before[0] if self.before else np.zeros((len(self.solver.levers.turning), 3))
        turns = self.solver.frame(copied.rotations, offsets, self._frames(contacts, 1, 30.0, ramped=False)[0], last)
        self.before[:] = [turns]
        return replace(copied, rotations=self.solver.turned(copied.rotations, turns))

    def _frames(self, contacts: Contacts, frames: int, fps: float, ramped: bool = True) -> list[FrameContacts]:
        """The source's contacts on the target's vertices, frame by frame, weighted by how likely they belong to the pose,
        by their closeness, and by how long they have been and will be."""
        tracks, track = contacts.tracks, contacts.track
        closeness = np.clip(1.0 - np.abs(contacts.distance) / (2.0 * self.detector.threshold), 0.0, 1.0) ** 2
        weight = tracks.pose_probability[track] * closeness
        if ramped:
            since, until = contacts.frame - tracks.start[track] + 1, tracks.stop[track] - contacts.frame
            weight = weight * np.clip(np.minimum(since, until) / max(RAMP * fps, 1.0), 0.0, 1.0)
        first, second, shares, trusted = self.carried.pairs(
            contacts.vertex, self.detector.skinner.character.mesh.faces[contacts.face], contacts.barycentric
        )
        gap = np.maximum(contacts.distance, 0.0) * self.ratio
        bounds = np.searchsorted(contacts.frame, np.arange(frames + 1))
        found = []
        for start, stop in zip(bounds, bounds[1:]):
            rows = np.arange(start, stop)[trusted[start:stop] & (weight[start:stop] > 0)]
            found.append(FrameContacts(first[rows], second[rows], shares[rows], gap[rows], weight[rows]))
        return found
