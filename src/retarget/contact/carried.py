"""Places of one body's skin on another's: by the true correspondence where both are one mesh, else by dense sensors.

What methods carry contacts with, and what they are judged with; where both share one mesh that is the truth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body.skinning import rest_vertices
from retarget.character import Character
from retarget.contact.carry import Carried, prepare_carry
from retarget.contact.sensors import Sensors, dense_layout, place_sensors
from retarget.correspond.joints import Humanoid

Array = np.ndarray

NEAR = 0.02
"""Share of a body's size within which a vertex lies where another was carried to."""


@dataclass(frozen=True, eq=False)
class CarriedVertices:
    """Where the vertices of a source lie on a target."""

    target: Character
    by_sensors: Carried | None
    """None where a vertex of the source is the same vertex of the target."""
    sensors: tuple[Sensors, Sensors] | None
    """The dense sensors of source and target they were carried by."""

    def trusted(self, vertices: Int[Array, "*rows"]) -> Bool[Array, "*rows"]:
        """Which of the source's vertices have a place on the target."""
        return np.ones(vertices.shape, bool) if self.by_sensors is None else self.by_sensors.valid[vertices]

    def places(
        self, posed: Float[Array, "frames points 3"], frame: Int[Array, "rows"], vertices: Int[Array, "rows corners"]
    ) -> Float[Array, "rows corners 3"]:
        """Where they are on frames of the target's posed skin, metres."""
        if self.by_sensors is None:
            return posed[frame[:, None], vertices].astype(np.float64)
        corners = self.target.mesh.faces[self.by_sensors.faces[vertices]]
        return (self.by_sensors.barycentrics[vertices][..., None] * posed[frame[:, None, None], corners]).sum(axis=-2)

    def points(
        self, vertices: Int[Array, "rows corners"], shares: Float[Array, "rows corners"]
    ) -> tuple[Int[Array, "rows others"], Float[Array, "rows others"]]:
        """Points between vertices of the source, as points between vertices of the target: three for each of the source's
        where sensors carry them, else the same."""
        if self.by_sensors is None:
            return np.ascontiguousarray(vertices), np.ascontiguousarray(shares)
        corners = self.target.mesh.faces[self.by_sensors.faces[vertices]]
        inside = self.by_sensors.barycentrics[vertices] * shares[..., None]
        return corners.reshape(len(vertices), 3 * vertices.shape[1]), inside.reshape(len(vertices), 3 * vertices.shape[1])

    def backwards(self) -> Int[Array, "vertices"]:
        """The source's vertex whose place is nearest to each vertex of the target at rest; -1 where none is near."""
        if self.by_sensors is None:
            return np.arange(len(self.target.mesh.vertices))
        from scipy.spatial import cKDTree

        rest, known = rest_vertices(self.target), np.flatnonzero(self.by_sensors.valid)
        corners = rest[self.target.mesh.faces[self.by_sensors.faces[known]]]
        places = np.einsum("pk,pki->pi", self.by_sensors.barycentrics[known], corners)
        if len(known) == 0:
            return np.full(len(rest), -1)
        distance, nearest = cKDTree(places).query(rest)
        return np.where(distance < NEAR * np.ptp(rest, axis=0).max(), known[nearest], -1)


def carry_vertices(
    source: Character, source_humanoid: Humanoid, target: Character, target_humanoid: Humanoid, by_sensors: bool = False
) -> CarriedVertices:
    """Carry all vertices of a body. `by_sensors` uses sensors even where the true correspondence is known: what that
    changes is their own error. Raises `RetargetError` for bodies that share too few sensors."""
    if same_topology(source, target) and not by_sensors:
        return CarriedVertices(target, None, None)
    mesh = source.mesh
    face, corner = np.zeros((2, len(mesh.vertices)), dtype=np.int64)  # a vertex without a face takes the first corner
    face[mesh.faces.ravel()] = np.repeat(np.arange(len(mesh.faces)), 3)
    corner[mesh.faces.ravel()] = np.tile(np.arange(3), len(mesh.faces))
    dense = tuple(
        place_sensors(each, humanoid, dense_layout())
        for each, humanoid in ((source, source_humanoid), (target, target_humanoid))
    )
    return CarriedVertices(target, prepare_carry(*dense)(face, np.eye(3)[corner]), dense)


def same_topology(a: Character, b: Character) -> bool:
    """Whether equal vertices of both mean the same place: one list of faces."""
    faces, others = a.mesh.faces, b.mesh.faces
    same_count = len(a.mesh.vertices) == len(b.mesh.vertices)
    return same_count and faces.shape == others.shape and bool((faces == others).all())
