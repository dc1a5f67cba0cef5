"""Musoni 2021's way back to rest: the skeleton is turned onto the target's joints, then the turns are undone (section 4.2).

The template's skeleton gets the target's bone lengths ("rescaling the bones to share the same length"). First the translation
alone is solved for, E_rigid (equation 11), then turns with it, E_pose = |J_s(theta) + t - J_t| + weight sum |theta_i|
(equation 12), the weight none, fixed or growing. The paper gives neither weights nor steps nor solver: ours are `GROWING`,
`FIXED` and L-BFGS with the analytic gradient. Beside them ours in closed form, without an optimisation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot

Array = np.ndarray

GROWING = (0.0, 1e-4, 1e-3, 1e-2)
"""Weights of a radian against metres, one after the other, each from where the last one led."""
FIXED = (1e-2,)
NONE = (0.0,)
STEPS = 200
"""L-BFGS steps for all weights of a row together."""
SOFT = 1e-4
"""Metres and radians below which the two norms are rounded off: at nought they have no gradient."""
LEAST_DETERMINANT = 0.2
"""A blend of turns that shrinks volume more has no way back; the heaviest joint's turn stands in."""


@dataclass(frozen=True, eq=False)
class FoundPose:
    """How the skeleton stands in the target."""

    turns: Float[Array, "joints 3 3"]
    """World rotations from rest."""
    posed: Float[Array, "joints 3"]
    """Joints in the pose."""
    rest: Float[Array, "joints 3"]
    """Joints at rest, bones as long as the target's."""
    energy: float
    """What E_pose's first term came to, metres."""


def with_lengths(
    rest: Float[Array, "joints 3"], parents: Int[Array, "joints"], joints: Float[Array, "joints 3"]
) -> Float[Array, "joints 3"]:
    """The skeleton at rest with bones as long as those between other joints, in its own directions."""
    found = rest.copy()
    for joint in range(1, len(rest)):
        bone, wanted = rest[joint] - rest[parents[joint]], joints[joint] - joints[parents[joint]]
        found[joint] = found[parents[joint]] + bone * np.linalg.norm(wanted) / max(float(np.linalg.norm(bone)), 1e-12)
    return found


def optimised_pose(
    rest: Float[Array, "joints 3"],
    parents: Int[Array, "joints"],
    joints: Float[Array, "joints 3"],
    weights: Sequence[float],
    steps: int = STEPS,
) -> FoundPose:
    """The pose of least energy, the regularisation's weights taken one after the other (metres throughout)."""
    from scipy.optimize import minimize

    scaled = with_lengths(rest, parents, joints)
    start = np.concatenate([(joints - scaled).mean(axis=0), np.zeros(3 * len(rest))])  # E_rigid's minimum, no turns
    for weight in weights:
        done = minimize(
            energy_and_gradient, start, (scaled, parents, joints, weight), "L-BFGS-B", True,
            options={"maxiter": max(steps // len(weights), 1)},
        )  # fmt: skip
        start = done.x
    posed, turns = _posed(scaled, parents, start[3:].reshape(-1, 3))
    posed = posed + start[:3]
    return FoundPose(turns, posed, scaled, float(np.linalg.norm(posed - joints)))


def energy_and_gradient(
    parameters: Float[Array, "parameters"],
    rest: Float[Array, "joints 3"],
    parents: Int[Array, "joints"],
    joints: Float[Array, "joints 3"],
    weight: float,
) -> tuple[float, Float[Array, "parameters"]]:
    """E_pose (equation 12) and its derivative by the translation and each joint's rotation vector."""
    move, theta = parameters[:3], parameters[3:].reshape(-1, 3)
    posed, turns = _posed(rest, parents, theta)
    away = posed + move - joints
    size = float(np.sqrt((away**2).sum() + SOFT**2))
    pull = away / size
    bent = np.sqrt((theta**2).sum(axis=1) + SOFT**2)
    gradient = np.empty_like(parameters)
    gradient[:3] = pull.sum(axis=0)
    below = pull.copy()  # summed over each joint's subtree: its pull, and its moment about the origin
    moment = np.cross(posed, pull)
    for joint in range(len(rest) - 1, 0, -1):
        below[parents[joint]] += below[joint]
        moment[parents[joint]] += moment[joint]
    about = moment - np.cross(posed, below)
    for joint, parent in enumerate(parents):
        above = turns[parent] if parent >= 0 else np.eye(3)
        gradient[3 + 3 * joint : 6 + 3 * joint] = _left_jacobian(theta[joint]).T @ (above.T @ about[joint])
    gradient[3:] += weight * (theta / bent[:, None]).ravel()
    return size + weight * float(bent.sum()), gradient


def closed_form_pose(
    rest: Float[Array, "joints 3"], parents: Int[Array, "joints"], joints: Float[Array, "joints 3"]
) -> FoundPose:
    """Ours: each joint's least turn that lays its bone on the target's, on top of its parent's; at branches the turn that
    fits all bones best (Kabsch 1976). No optimisation, no twist either."""
    scaled = with_lengths(rest, parents, joints)
    turns = np.tile(np.eye(3), (len(rest), 1, 1))
    for joint, parent in enumerate(parents):
        above = turns[parent] if parent >= 0 else np.eye(3)
        children = np.flatnonzero(parents == joint)
        bones, wanted = (rest[children] - rest[joint]) @ above.T, joints[children] - joints[joint]
        turns[joint] = _turn_onto(bones, wanted) @ above if len(children) else above
    posed = joints.copy()
    for joint in range(1, len(rest)):
        posed[joint] = posed[parents[joint]] + turns[parents[joint]] @ (scaled[joint] - scaled[parents[joint]])
    posed = posed + (joints - posed).mean(axis=0)
    return FoundPose(turns, posed, scaled, float(np.linalg.norm(posed - joints)))


def rest_vertices(
    pose: FoundPose, weights: Float[Array, "vertices joints"], vertices: Float[Array, "vertices 3"]
) -> Float[Array, "vertices 3"]:
    """Vertices taken back to rest: linear blend skinning (equation 6) solved for the vertex."""
    moves = pose.posed - np.einsum("jab,jb->ja", pose.turns, pose.rest)
    blended, moved = np.tensordot(weights, pose.turns, axes=1), weights @ moves
    folded = np.linalg.det(blended) < LEAST_DETERMINANT
    heaviest = weights[folded].argmax(axis=1)
    blended[folded], moved[folded] = pose.turns[heaviest], moves[heaviest]
    return np.linalg.solve(blended, (vertices - moved)[..., None])[..., 0]


def _posed(
    rest: Float[Array, "joints 3"], parents: Int[Array, "joints"], theta: Float[Array, "joints 3"]
) -> tuple[Float[Array, "joints 3"], Float[Array, "joints 3 3"]]:
    turns, posed = rot.to_matrix(rot.from_rotation_vector(theta)), rest.copy()
    for joint in range(1, len(rest)):
        parent = parents[joint]
        turns[joint] = turns[parent] @ turns[joint]
        posed[joint] = posed[parent] + turns[parent] @ (rest[joint] - rest[parent])
    return posed, turns


def _left_jacobian(theta: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """How the rotation of a rotation vector turns, in the world, as the vector changes."""
    angle = float(np.linalg.norm(theta))
    cross = np.array([[0, -theta[2], theta[1]], [theta[2], 0, -theta[0]], [-theta[1], theta[0], 0]])
    if angle < 1e-4:
        return np.eye(3) + cross / 2 + cross @ cross / 6
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * (cross @ cross)


def _turn_onto(bones: Float[Array, "bones 3"], wanted: Float[Array, "bones 3"]) -> Float[Array, "3 3"]:
    """The least turn for one bone, the best for several."""
    if len(bones) == 1:
        a, b = (each / max(float(np.linalg.norm(each)), 1e-12) for each in (bones[0], wanted[0]))
        axis, cosine = np.cross(a, b), float(a @ b)
        sine = float(np.linalg.norm(axis))
        if sine < 1e-9:
            axis, sine = np.cross(a, np.eye(3)[int(np.abs(a).argmin())]), 1.0
            axis = axis * (0.0 if cosine > 0 else np.pi) / np.linalg.norm(axis)
        else:
            axis = axis / sine * np.arctan2(sine, cosine)
        return rot.to_matrix(rot.from_rotation_vector(axis))
    u, _, vt = np.linalg.svd(bones.T @ wanted)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    return vt.T @ (sign[:, None] * u.T)
