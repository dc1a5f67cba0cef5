"""Basset 2019's contact energy: repulsion, attraction and ground, with their derivative by the vertices (section 4.3).

E_C = E_r + E_a (equations 5 to 8; the weights gamma_r and gamma_a, printed both in equation 5 and inside 6 and 7, count
once). What the paper leaves open is ours: the threshold of contact is 1.2 % of the source's height, and pairs that lie
within three thresholds of each other at rest are no contact but one fold of skin. Inside tests and distances are those of
`contact.collide`, by rays like the paper's, so that times compare.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.contact.collide import Collider

Array = np.ndarray

THRESHOLD = 0.012
"""Share of the source's height within which skin touches."""
FOLD = 3.0
"""Thresholds within which a pair at rest is one fold."""
GROUND = 0.1
"""Weight of both ground terms (the paper's gamma_rg and gamma_ag)."""
UP = 1


@dataclass(frozen=True, eq=False)
class SourceContacts:
    """What a source's pose touches; `source_contacts` makes one."""

    threshold: float
    """Metres."""
    first: Int[Array, "contacts"]
    second: Int[Array, "contacts"]
    """Couples: a vertex, and the vertex of the other part that is nearest to it."""
    part: Int[Array, "contacts"]
    """The other part."""
    floor: float
    """Height of the ground, metres."""
    ground: Int[Array, "grounded"]
    """Vertices at ground level."""
    held: Int[Array, "held"]
    """Rows of `ground` that were there on the frame before, too (section 6)."""
    held_at: Float[Array, "held 3"]
    """Where that frame's result had them, metres."""


def source_contacts(
    collider: Collider,
    faces: Int[Array, "faces 3"],
    rest: Float[Array, "vertices 3"],
    posed: Float[Array, "vertices 3"],
    threshold: float,
    floor: float,
    before: tuple[Int[Array, "_"], Float[Array, "vertices 3"]] | None = None,
) -> SourceContacts:
    """Contacts of a posed source (metres; up is +Y). A couple's second vertex is the nearest one of the surface that was found
    near, which is any corner of the other part's faces: at a seam those that its neighbour owns, too. `before` are the
    vertices at ground level on the frame before and where that frame's result has all vertices: what stays at ground level
    is then held in its place."""
    from scipy.spatial import cKDTree

    pairs, parts = collider.pairs(posed, threshold), collider.parts
    touching = np.abs(pairs.distance) <= threshold
    first, part = pairs.vertex[touching], pairs.part[touching]
    second = np.full(len(first), -1)
    for other in np.unique(part):
        own = np.unique(parts.welded[faces[(parts.face_parts == other) & parts.body_faces]])
        second[part == other] = own[cKDTree(posed[own]).query(posed[first[part == other]])[1]]
    apart = np.linalg.norm(rest[first] - rest[second], axis=1) >= FOLD * threshold
    ground = np.flatnonzero((np.abs(posed[:, UP] - floor) <= threshold) & parts.body_vertices)
    stayed, places = (np.zeros(0, dtype=np.int64), posed) if before is None else before
    held = np.flatnonzero(np.isin(ground, stayed))
    return SourceContacts(threshold, first[apart], second[apart], part[apart], floor, ground, held, places[ground[held]])


def repulsion(
    collider: Collider, faces: Int[Array, "faces 3"], vertices: Float[Array, "vertices 3"], floor: float
) -> tuple[float, Float[Array, "vertices 3"]]:
    """Equation 6 and its derivative: squared depths inside other parts and below the ground, square metres.

    The derivative by the vertices is exact where the nearest point of the skin is one: that point's own motion within the
    skin does not change the distance.
    """
    pairs = collider.pairs(vertices)
    out = vertices[pairs.vertex] - pairs.point
    below = np.minimum(vertices[:, UP] - floor, 0.0)
    if below.any():
        below = below * collider.parts.body_vertices
    gradient = np.zeros_like(vertices)
    gradient[:, UP] = 2.0 * GROUND * below
    np.add.at(gradient, pairs.vertex, 2.0 * out)
    np.add.at(gradient, collider.parts.welded[faces[pairs.face]], -2.0 * pairs.barycentric[..., None] * out[:, None])
    return float((pairs.distance**2).sum() + GROUND * (below**2).sum()), gradient


def attraction(
    contacts: SourceContacts, vertices: Float[Array, "vertices 3"]
) -> tuple[float, Float[Array, "vertices 3"]]:
    """Equation 7 and its derivative: squared gaps, beyond the threshold, of what touches in the source (square metres).

    Ground contacts that last are measured from where they were on the frame before (section 6), others from the ground.
    """
    gradient = np.zeros_like(vertices)
    away, gap = _gaps(vertices[contacts.first] - vertices[contacts.second], contacts.threshold)
    np.add.at(gradient, contacts.first, 2.0 * away)
    np.add.at(gradient, contacts.second, -2.0 * away)
    over = np.zeros((len(contacts.ground), 3))
    over[:, UP] = vertices[contacts.ground, UP] - contacts.floor
    over[contacts.held] = vertices[contacts.ground[contacts.held]] - contacts.held_at
    away, ground_gap = _gaps(over, contacts.threshold)
    gradient[contacts.ground] += 2.0 * GROUND * away
    return float((gap**2).sum() + GROUND * (ground_gap**2).sum()), gradient


def _gaps(between: Float[Array, "pairs 3"], threshold: float) -> tuple[Float[Array, "pairs 3"], Float[Array, "pairs"]]:
    """How far beyond the threshold the ends lie, and the same as vectors."""
    distance = np.linalg.norm(between, axis=1)
    gap = np.maximum(distance - threshold, 0.0)
    return between * (gap / np.maximum(distance, 1e-300))[:, None], gap
