"""Which contacts of the source came along: its touching points carried to the result's skin, and how far apart they are there.

Carried by `contact.carried`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.contact.carried import CarriedVertices, carry_vertices
from retarget.contact.carry_error import carrying_error
from retarget.contact.detect import LEAVE
from retarget.contact.parts import PARTS
from retarget.evaluate import metrics
from retarget.evaluate.metrics.interaction import SLACK
from retarget.evaluate.problems import Problem, cm, episodes, problem, when
from retarget.evaluate.report_surface import CHUNK, OF_POSE, SurfaceTrack, subject_and_other

Array = np.ndarray

LASTING = 0.1
"""Seconds that a contact is missing before it is told."""
MISSING = 0.01
"""Metres at 1.7 m: what a gap is measured by to rank it among other findings."""


@dataclass(frozen=True, eq=False)
class CarriedContacts:
    """The source's contacts of the pose on the result, one row a frame, vertex and part."""

    frame: Int[Array, "rows"]
    pair: Int[Array, "rows 2"]
    """The two parts that touch, the lower index first."""
    first: Float[Array, "rows 3"]
    second: Float[Array, "rows 3"]
    """Where the two places are on the result's posed skin, metres."""
    threshold: float
    """Metres within which the result's skin touches: the source's by the ratio of heights."""
    note: str = ""
    """How they were carried and what that errs by; empty for the true correspondence."""

    @property
    def kept(self) -> float | None:
        """Share of them within 1.5 thresholds; None where there is none."""
        if len(self.frame) == 0:
            return None
        everywhere = np.ones((1, len(self.frame)), dtype=bool)
        return metrics.contacts_kept(self.first[None], self.second[None], everywhere, self.threshold)

    def gaps(self) -> dict[tuple[int, int], Float[Array, "frames"]]:
        """Smallest gap between each pair of parts on each frame, metres; nan where the source does not touch there."""
        gap = np.linalg.norm(self.first - self.second, axis=1)
        frames = int(self.frame.max()) + 1 if len(self.frame) else 0
        found = {}
        for pair in np.unique(self.pair, axis=0).tolist():
            chosen = (self.pair == pair).all(axis=1)
            least = np.full(frames, np.inf)
            np.minimum.at(least, self.frame[chosen], gap[chosen])
            found[tuple(pair)] = np.where(np.isfinite(least), least, np.nan)
        return found


def carried_contacts(source: SurfaceTrack, result: SurfaceTrack) -> CarriedContacts:
    """Carry the contacts that belong to the source's pose and are not buried in the source itself.

    Raises `RetargetError` for bodies that share too few sensors.
    """
    contacts, threshold = source.contacts, source.threshold
    rows = np.flatnonzero(
        (contacts.tracks.pose_probability[contacts.track] >= OF_POSE) & (np.abs(contacts.distance) <= LEAVE * threshold)
    )
    actors = source.take.actor, result.take.actor
    corners = actors[0].character.mesh.faces[contacts.face[rows]]
    vertices = np.concatenate([contacts.vertex[rows][:, None], corners], axis=1)
    carried = carry_vertices(*(each for actor in actors for each in (actor.character, actor.humanoid)))
    note = f"contacts by sensors: {carrying_error(*carried.sensors, points=1000)}" if carried.sensors else ""
    trusted = carried.trusted(vertices).all(axis=1)
    rows, vertices = rows[trusted], vertices[trusted]
    places = _places(result, carried, contacts.frame[rows], vertices)
    touched = (contacts.barycentric[rows][:, :, None] * places[:, 1:]).sum(axis=1)
    pair = np.stack([source.parts.vertex_parts[contacts.vertex[rows]], contacts.part[rows]], axis=1)
    larger = threshold * actors[1].height / actors[0].height
    return CarriedContacts(contacts.frame[rows], np.sort(pair, axis=1), places[:, 0], touched, larger, note)


def _places(
    result: SurfaceTrack, carried: CarriedVertices, frame: Int[Array, "rows"], vertices: Int[Array, "rows corners"]
) -> Float[Array, "rows corners 3"]:
    """Where the source's vertices lie on the result's posed skin, a few frames at a time."""
    places, take = np.zeros((*vertices.shape, 3)), result.take
    for start in range(0, len(take), CHUNK):
        rows = np.flatnonzero((frame >= start) & (frame < start + CHUNK))
        if len(rows):
            part = slice(start, start + CHUNK)
            posed = result.skinner.vertices(take.rotations[part], take.positions[part])
            places[rows] = carried.places(posed, frame[rows] - start, vertices[rows])
    return places


def lost_contacts(carried: CarriedContacts, result: SurfaceTrack) -> Iterator[Problem]:
    """A sentence for every pair of parts that touch in the source and not, or elsewhere, in the result."""
    fps, tolerable = result.take.fps, SLACK * carried.threshold
    meeting = result.meeting(of_pose=False)
    for pair, gap in carried.gaps().items():
        lost = np.nan_to_num(gap, nan=0.0) > tolerable
        for episode in episodes(np.nan_to_num(gap, nan=0.0), lost, fps):
            if episode.stop - episode.start < LASTING * fps:
                continue
            inner = slice(episode.start, episode.stop)
            subject, other = subject_and_other(pair)
            middle = float(np.median(gap[inner][lost[inner]]))
            elsewhere = pair in meeting and meeting[pair][inner].mean() > 0.5
            text = (
                f"{subject} touches {other} {cm(middle)} from where the source's does {when(episode, fps)}"
                if elsewhere
                else f"{subject} misses {other} by {cm(middle)} {when(episode, fps)}, where the source's touches"
            )
            names = (PARTS[pair[0]], PARTS[pair[1]])
            yield problem(
                text,
                middle / result.take.own_size(MISSING) * (0.5 if elsewhere else 1.0),
                episode,
                fps,
                "contact",
                *names,
            )
