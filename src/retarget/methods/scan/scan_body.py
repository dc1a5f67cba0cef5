"""The embedded human as a tracker sees it: rest surface and joints that depend linearly on a few shape coefficients.

`rig.fit_model.FitModel` is the same body with dense derivatives; here everything lies as compiled loops want it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from retarget.body.human import human, human_model
from retarget.character import Character, Mesh, Skeleton, Skin
from retarget.geometry.geodesic import farthest_points
from retarget.rig.fit import HEIGHT
from retarget.rig.human_shapes import shape_components

Array = np.ndarray

BODY = 22
"""Joints of the embedded human that are tracked; fingers follow their hands."""
COMPONENTS = 28
"""Principal components of embedded bodies: random bodies are met to 2.0 mm on average (16 components: 4.6, 48: 1.1)."""
POINTS = 3000
"""Points of the skin that a cloud is compared with, about 2 cm apart, so that any first ones are spread evenly too."""
SIZE_SPREAD = 0.15
"""How far a body's size is expected to be off 1.7 m, as a share: one standard deviation."""
HELD = 10.0
"""How many times a standard deviation of a shape counts."""
FINGER_SAY = 0.3
"""Weight of the skin of fingers, which lie in the cloud as they please."""


@dataclass(frozen=True, eq=False)
class ScanBody:
    """What never changes of the body that is fitted; `scan_body()` makes it.

    The last shape coefficient is the body's size as a share of `fit.HEIGHT`, less one; the others are standard deviations of the
    principal components of `rig.human_shapes`.
    """

    parents: Int[Array, "joints"]
    vertices: Float[Array, "vertices 3"]
    """The mean body at rest, metres: feet on y = 0, hips at x = z = 0."""
    faces: Int[Array, "faces 3"]
    basis: Float[Array, "shapes vertices 3"]
    """How vertices move with each coefficient."""
    joints: Float[Array, "joints 3"]
    joint_basis: Float[Array, "shapes joints 3"]
    columns: Int[Array, "vertices 4"]
    """Joints that move each vertex, those of fingers given to their hands."""
    weights: Float[Array, "vertices 4"]
    spread: Float[Array, "shapes"]
    """One standard deviation of each coefficient."""
    chosen: Int[Array, "points"]
    """Vertices that a cloud is compared with, spread evenly."""
    point_rest: Float[Array, "points 3"]
    """These in the mean body."""
    point_columns: Int[Array, "points 4"]
    point_weights: Float[Array, "points 4"]
    joint_shapes: Float[Array, "joints 3 shapes"]
    """`joint_basis`, shapes last."""
    point_basis: Float[Array, "points 3 shapes"]
    """The basis at these, shapes last."""
    say: Float[Array, "points"]
    """How much each of these counts: less on fingers."""

    @property
    def shapes(self) -> int:
        """How many coefficients there are."""
        return len(self.basis)

    @property
    def usual_shape(self) -> Float[Array, "shapes shapes"]:
        """What a shape is worth, as a precision: `HELD` times that of people, since points of a cloud err together."""
        return np.diag(HELD * self.spread**-2.0)

    def rest(self, shape: Float[Array, "shapes"]) -> Float[Array, "vertices 3"]:
        """Vertices at rest in a shape, metres."""
        return self.vertices + np.tensordot(shape, self.basis, axes=1)

    def rest_joints(self, shape: Float[Array, "shapes"]) -> Float[Array, "joints 3"]:
        """The 22 joints at rest in a shape, metres."""
        return self.joints + np.tensordot(shape, self.joint_basis, axes=1)

    def shaped(self, shape: Float[Array, "shapes"]) -> ShapedBody:
        """The chosen points in a shape, with the normals of that shape."""
        from retarget.geometry import turn_kernels

        vertices = self.rest(shape)
        normals = np.empty_like(vertices)
        turn_kernels.normals(vertices, self.faces, normals)
        return ShapedBody(vertices[self.chosen], normals[self.chosen], self.rest_joints(shape))

    def reshaped(self, shaped: ShapedBody, shape: Float[Array, "shapes"]) -> ShapedBody:
        """The chosen points in another shape near by, whose normals are taken to be the same."""
        return ShapedBody(self.point_rest + self.point_basis @ shape, shaped.normals, self.rest_joints(shape))

    def character(self, shape: Float[Array, "shapes"], name: str = "the actor") -> Character:
        """The embedded human in that shape, all 52 joints of it, with its skin; it stands as `body.human.human` does."""
        model, vertices = human_model(), self.rest(shape)
        joints = model.joints(vertices)
        vertices = vertices - [joints[0, 0], vertices[:, 1].min(), joints[0, 2]]
        joints = model.joints(vertices)
        offsets = joints - np.where(model.parents[:, None] >= 0, joints[model.parents], 0.0)
        binds = np.broadcast_to(np.eye(4), (len(joints), 4, 4)).copy()
        binds[:, :3, 3] = -joints
        identity = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(joints), 4))
        skeleton = Skeleton(model.joint_names, model.parents, offsets, identity)
        mesh = Mesh(vertices, model.faces, materials=model.materials, face_materials=model.face_materials)
        skin = Skin(np.arange(len(joints)), binds, model.skin_columns, model.skin_weights)
        return Character(skeleton, mesh, skin, name)


@dataclass(frozen=True, eq=False)
class ShapedBody:
    """The chosen points in one shape, at rest."""

    points: Float[Array, "points 3"]
    normals: Float[Array, "points 3"]
    joints: Float[Array, "joints 3"]


@lru_cache(maxsize=1)
def scan_body() -> ScanBody:
    """The embedded human and how its bodies differ; takes a second, once."""
    model = human_model()
    vertices = human(height=HEIGHT).mesh.vertices
    components = shape_components()[:COMPONENTS]
    basis = np.concatenate([components, vertices[None]])
    regressor = model.shape.regressor[:BODY]
    columns, weights = _folded(model.parents, model.skin_columns, model.skin_weights)
    chosen = farthest_points(vertices, POINTS)
    fingers = (model.skin_weights * (model.skin_columns >= BODY)).sum(axis=1)
    return ScanBody(
        model.parents[:BODY].copy(), vertices, model.faces, basis, regressor @ vertices,
        np.einsum("jv,kvx->kjx", regressor, basis), columns, weights,
        np.concatenate([np.ones(len(components)), [SIZE_SPREAD]]), chosen, vertices[chosen], columns[chosen], weights[chosen],
        np.ascontiguousarray(np.einsum("jv,kvx->jxk", regressor, basis)),
        np.ascontiguousarray(basis[:, chosen].transpose(1, 2, 0)), 1.0 - (1.0 - FINGER_SAY) * fingers[chosen],
    )  # fmt: skip


def _folded(parents: Array, columns: Array, weights: Array) -> tuple[Array, Array]:
    """Weights with fingers given to their hands, heaviest first; what is left over has weight 0."""
    body = np.arange(len(parents))
    for joint in range(BODY, len(parents)):
        body[joint] = body[parents[joint]]
    dense = np.zeros((len(columns), BODY))
    np.add.at(dense, (np.arange(len(columns))[:, None], body[columns]), weights)
    order = np.argsort(-dense, axis=1, kind="stable")[:, :4]
    kept = np.take_along_axis(dense, order, axis=1)
    return order.astype(np.int64), kept / kept.sum(axis=1, keepdims=True)
