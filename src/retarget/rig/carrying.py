"""What a mesh gets from the template laid onto it: places on it, weights from there, and the way back to rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.errors import RetargetError
from retarget.geometry.closest import Places
from retarget.geometry.resample import Surface
from retarget.rig.fit import LIKE_NORMALS
from retarget.rig.fit_model import pose_body
from retarget.rig.laying import LaidOn
from retarget.rig.reading import Hints, Reading, doubtful
from retarget.rig.rest import rest_from_pose
from retarget.rig.shares import bare_parts
from retarget.rig.stretch import fill_stretched
from retarget.rig.template import Template
from retarget.rig.weights import HELD_AWAY, finer_places, places_on_template, rigid_pieces, sparse_weights

Array = np.ndarray

LIKE_NORMALS_OF_PIECES = 0.3 * LIKE_NORMALS
"""How far apart opposite normals put two places on bodies put together of pieces, whose surfaces turn every way."""
RINGS_OF_PIECES = 2
"""Vertices around stretched edges whose weights are filled in too on such bodies, whose places are less sure."""


@dataclass(frozen=True, eq=False)
class Carried:
    """In metres of a body about `fit.HEIGHT` tall."""

    places: Places
    """Where each vertex of the mesh lies on the template."""
    rest: Float[Array, "vertices 3"]
    """The mesh at rest, facing and standing as the template."""
    columns: Int[Array, "vertices influences"]
    """Joints of the template's skeleton that move each vertex."""
    weights: Float[Array, "vertices influences"]
    floor: float
    """Height of the lowest vertex of the body itself; vertices of no face are none of it."""
    top: float
    bare: tuple[str, ...]
    """Parts of the template that have next to nothing of the mesh."""


def carry(template: Template, laid: LaidOn, reading: Reading, mesh: Surface, hints: Hints) -> Carried:
    """Carry weights and rest pose over to a mesh (in the reading's metres and place) that the template was laid onto.

    Raises `RetargetError` where a limb or the head has nothing of the mesh and the user said nothing.
    """
    model, fused = template.model, reading.working.fused
    like_normals = LIKE_NORMALS_OF_PIECES if fused else LIKE_NORMALS
    places = places_on_template(mesh, laid.registered, template.faces, model.points, like_normals)
    if hints.surface_map is not None:
        places = finer_places(hints.surface_map, places, model.points)
    bare = bare_parts(template, pose_body(model, laid.state).points, mesh, places) if template.human else {}
    lost = {name: share for name, share in bare.items() if not name.endswith("Hand")}  # a fist may lie in an armpit
    if lost and not hints:
        doubt = f"nothing of it is left for {', '.join(lost)}"
        seen = Surface(reading.target.outside(mesh.vertices), mesh.faces)
        raise RetargetError(doubtful(seen, reading.working, doubt, reading.confidence * min(lost.values())))
    away = np.linalg.norm(places.of(laid.registered.vertices) - mesh.vertices, axis=1)
    filling = fill_stretched(mesh, places.of(model.points), RINGS_OF_PIECES if fused else 0)
    turned = rigid_pieces(mesh, filling.of(places.of(model.weights)), away)
    rest = rest_from_pose(model, laid.state, turned, mesh.vertices)
    columns, weights = sparse_weights(rigid_pieces(mesh, filling.of(places.of(template.weights)), away))
    used = np.unique(mesh.faces)
    body = rest[used[away[used] < max(HELD_AWAY, float(np.median(away[used])))], 1]
    return Carried(places, rest, columns, weights, float(body.min()), float(body.max()), tuple(bare))
