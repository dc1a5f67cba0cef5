"""How a surface that was given another body's pose is judged: what touches, what is inside, whether the shape is the target's."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from retarget.contact.collide import Collider, prepare_collider
from retarget.contact.part_volumes import PartVolumes, prepare_volumes
from retarget.contact.parts import PARTS
from retarget.evaluate import metrics
from retarget.evaluate.metrics.basis import at_reference_height
from retarget.evaluate.shape_cases import ShapeCase
from retarget.evaluate.touch import SourceTouch
from retarget.geometry.topology import unique_pairs
from retarget.motion.align import Actor
from retarget.motion.joint_frames import JointFrames, prepare_frames

Array = np.ndarray

LIMBS = (("UpperArm", "LowerArm"), ("LowerArm", "Hand"), ("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot"))


@dataclass(frozen=True, eq=False)
class JudgedShape:
    """What judging needs of a target."""

    actor: Actor
    collider: Collider
    volumes: PartVolumes
    frames: JointFrames
    edges: Array


@lru_cache(maxsize=24)
def judged_shape(actor: Actor) -> JudgedShape:
    """Prepared once for each actor."""
    character = actor.character
    collider, frames = prepare_collider(character, actor.humanoid), prepare_frames(character)
    faces = character.mesh.faces
    edges, _, _ = unique_pairs(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1))
    return JudgedShape(actor, collider, prepare_volumes(collider, frames.rest, faces), frames, edges)


def judge_pose(case: ShapeCase, vertices: Float[Array, "vertices 3"]) -> dict[str, float | None]:
    """Every figure of one posed surface of the case's target (metres)."""
    target = judged_shape(case.target)
    kept, counted = kept_contacts(case.touch, case.target, vertices[None], np.array([case.frame]), case.countable)
    return {
        "contacts_kept": kept, "contacts_counted": counted,
        **penetration(case, target, vertices), **shape_figures(target, vertices), **new_contacts(case, target, vertices),
    }  # fmt: skip


def kept_contacts(
    touch: SourceTouch,
    target: Actor,
    posed: Float[Array, "chosen vertices 3"],
    frames: Array,
    countable: Array | None = None,
) -> tuple[float | None, int]:
    """Share of the source's pose contacts that are within 1.5 thresholds on the target, vertex for vertex; and their number.
    `frames` are the source's frames that `posed` shows."""
    contacts, rows = touch.contacts, touch.pose_rows(countable)
    place = np.full(len(touch.motion), -1)
    place[frames] = np.arange(len(frames))
    rows = rows[place[contacts.frame[rows]] >= 0]
    if len(rows) == 0:
        return None, 0
    at, corners = place[contacts.frame[rows]], touch.actor.character.mesh.faces[contacts.face[rows]]
    touched = np.einsum("pc,pci->pi", contacts.barycentric[rows], posed[at[:, None], corners])
    threshold = touch.detector.threshold * target.height / touch.actor.height
    near = np.linalg.norm(posed[at, contacts.vertex[rows]] - touched, axis=1) <= metrics.SLACK * threshold
    return float(near.mean()), len(rows)


def penetration(case: ShapeCase, target: JudgedShape, vertices: Float[Array, "vertices 3"]) -> dict[str, float]:
    """Per cent of limb vertices inside other parts beyond the source's share, and how deep."""
    depth, limb = target.collider.depths(vertices[None]), target.collider.parts.limb_vertices
    own = metrics.penetration_percent(depth, limb)
    source = metrics.penetration_percent(case.touch.depth[case.frame][None], case.touch.parts.limb_vertices)
    return {
        "penetration_percent": float(own[0]),
        "excess_penetration_percent": float(metrics.excess_penetration_percent(own, source)[0]),
        "depth_p95_mm": metrics.depth_p95_mm(depth, limb, case.target.height),
    }


def shape_figures(target: JudgedShape, vertices: Float[Array, "vertices 3"]) -> dict[str, float]:
    """How far the surface is from the target's own shape: volumes of parts, lengths of limbs, lengths of edges.

    A joint lies between where the two parts that meet there carry it, each by the rigid move nearest to its skin's; limbs
    that come apart or close up show in it, bent skin does not.
    """
    volumes = 100 * np.abs(target.volumes.of(vertices) / target.volumes.volumes - 1)
    _, places = target.frames.of(vertices)
    joints, rest = target.actor.humanoid.joints, target.frames.places
    limbs = []
    for side in ("left", "right"):
        for above, below in LIMBS:
            a, b = joints[side + above], joints[side + below]
            limbs.append(100 * abs(np.linalg.norm(places[a] - places[b]) / np.linalg.norm(rest[a] - rest[b]) - 1))
    lengths = [
        np.linalg.norm(each[target.edges[:, 0]] - each[target.edges[:, 1]], axis=1)
        for each in (vertices, target.frames.rest)
    ]
    away = float(np.abs(lengths[0] - lengths[1]).mean())
    return {
        "part_volume_error_percent": float(volumes.mean()), "part_volume_error_percent_worst": float(volumes.max()),
        "limb_length_error_percent": float(np.mean(limbs)), "limb_length_error_percent_worst": float(max(limbs)),
        "shape_mdel_mm": 1000 * float(at_reference_height(away, target.actor.height)),
    }  # fmt: skip


def new_contacts(case: ShapeCase, target: JudgedShape, vertices: Float[Array, "vertices 3"]) -> dict[str, int]:
    """Pairs of a vertex and a part that touch on the target and do not in the source: contacts that come with the shape."""
    size = case.target.height / case.source.height
    threshold = case.touch.detector.threshold
    found = []
    for surface, reach in ((case.posed, threshold), (vertices, size * threshold)):
        near = target.collider.pairs(surface, reach)
        found.append(set((near.vertex * len(PARTS) + near.part).tolist()))
    return {"new_morphology_contacts": len(found[1] - found[0])}
