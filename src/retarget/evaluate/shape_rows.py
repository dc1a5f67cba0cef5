"""Every row of a shape-transfer case: who gives the source's pose to the target, how good it is and what it takes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import world_pose
from retarget.body.skinning import prepare_skinning, rest_vertices
from retarget.evaluate import metrics
from retarget.evaluate.metrics.basis import at_reference_height
from retarget.evaluate.metrics.interaction import DEEPER_THAN
from retarget.evaluate.reference.contact_terms import SourceContacts
from retarget.evaluate.reference.shape_transfer import (
    ReferenceSettings,
    ShapeTransferReference,
    prepare_reference,
)
from retarget.evaluate.shape_cases import ShapeCase, foreign_body, performance, shape_case
from retarget.evaluate.shape_judge import judge_pose, judged_shape, kept_contacts
from retarget.evaluate.touch import SourceTouch
from retarget.methods import CopyRotations, ShapeTransfer
from retarget.methods.shape_transfer.retargeter import PreparedShapeTransfer
from retarget.motion.align import Actor
from retarget.motion.deformation_transfer import prepare_deformation_transfer
from retarget.motion.joint_frames import prepare_frames
from retarget.motion.touch.mend import frames_of
from retarget.retargeting import prepare

Array = np.ndarray

COPY, DEFORMATION, REFERENCE, OURS = "copy-rotations", "deformation transfer", "Basset 2019", "ours"
ABLATIONS = {
    "Basset 2019, no repulsion": ReferenceSettings(repulsion=False),
    "Basset 2019, no attraction": ReferenceSettings(attraction=False),
    "Basset 2019, no volume": ReferenceSettings(volume="none"),
    "Basset 2019, one volume": ReferenceSettings(volume="body"),
}
ITERATIONS = 100
"""Of the reference, in the ratios of time."""
LONG = 1000
"""Iterations after which its drift is looked at."""
REPEATS = 3


@dataclass(frozen=True, eq=False)
class Ready:
    """A pair of bodies, prepared for every method."""

    ours: PreparedShapeTransfer
    reference: ShapeTransferReference


@lru_cache(maxsize=2)
def ready(source: Actor, target: Actor) -> Ready:
    """Prepared once for the poses of a pair."""
    return Ready(ShapeTransfer().prepare(source, target), _reference(source, target, ReferenceSettings()))


def _reference(source: Actor, target: Actor, settings: ReferenceSettings) -> ShapeTransferReference:
    parts = judged_shape(target).collider.parts
    return prepare_reference(
        rest_vertices(source.character), rest_vertices(target.character), target.character.mesh.faces, parts, settings
    )


def rows_of(case: ShapeCase) -> Iterator[tuple[dict[str, Any], Float[Array, "vertices 3"]]]:
    """Figures and surface of every method on one case."""
    made = ready(case.source, case.target)
    contacts = made.reference.contacts(case.posed)
    placed = without_girth(case, contacts)

    def judged(method: str, vertices: Array, **more: Any) -> tuple[dict[str, Any], Array]:
        energy = {f"energy_{term}": value for term, value in made.reference.energy(vertices, contacts).items()}
        energy["energy_placed"] = made.reference.energy(vertices, placed)["total"]
        return {"method": method} | judge_pose(case, vertices) | energy | more, vertices

    copied = prepare(case.source, case.target, CopyRotations())(case.motion).motion
    yield judged(COPY, prepare_skinning(case.target.character).vertices(*world_pose(copied))[0].astype(np.float64))
    transfer = prepare_deformation_transfer(
        made.reference.source_rest, rest_vertices(case.target.character), case.target.character.mesh.faces
    )
    yield judged(DEFORMATION, transfer.frames(case.posed[None])[0])
    found = made.reference.run(case.posed)
    yield judged(
        REFERENCE, found.vertices, status=found.status, iterations=found.iterations, cpu_ms=1000 * found.cpu_seconds
    )
    result = made.ours(case.motion)
    yield judged(
        OURS,
        result.surface.vertices[0].astype(np.float64),
        status=result.status,
        skin_rms_mm=result.stats["skin_rms_mm"],
    )


def without_girth(case: ShapeCase, contacts: SourceContacts) -> SourceContacts:
    """The reference's contacts but those between parts that nothing of the pose brings together: an idle hand that brushes a
    broad thigh is not asked to do so on a slim body."""
    found, touch = case.touch.contacts, case.touch
    rows = touch.pose_rows()
    rows = rows[found.frame[rows] == case.frame]
    own = touch.parts.vertex_parts
    meant = {tuple(sorted(pair)) for pair in zip(own[found.vertex[rows]].tolist(), found.part[rows].tolist())}
    pairs = zip(own[contacts.first].tolist(), contacts.part.tolist())
    kept = np.array([tuple(sorted(pair)) in meant for pair in pairs], dtype=bool)
    return replace(contacts, first=contacts.first[kept], second=contacts.second[kept], part=contacts.part[kept])


def ablations(case: ShapeCase) -> Iterator[dict[str, Any]]:
    """The reference without one of its terms (the paper's figures 4 and 5), and run long."""
    made = ready(case.source, case.target)
    contacts = made.reference.contacts(case.posed)
    for method, settings in ABLATIONS.items():
        found = _reference(case.source, case.target, settings).run(case.posed)
        yield {"method": method, "status": found.status} | judge_pose(case, found.vertices) | {
            f"energy_{term}": value for term, value in made.reference.energy(found.vertices, contacts).items()
        }  # fmt: skip
    without = ShapeTransfer(flesh=False).prepare(case.source, case.target)(case.motion)
    yield {"method": "ours, skin does not give way"} | judge_pose(case, without.surface.vertices[0].astype(np.float64))
    free = ShapeTransfer(volumes=False).prepare(case.source, case.target)(case.motion)
    yield {"method": "ours, no volumes"} | judge_pose(case, free.surface.vertices[0].astype(np.float64))


def curves(case: ShapeCase) -> dict[str, list[float]]:
    """Every term of the reference over `LONG` iterations, and what its largest turn is after 100 and after all of them."""
    reference = ready(case.source, case.target).reference
    short, long = reference.run(case.posed, iterations=ITERATIONS), reference.run(case.posed, iterations=LONG)
    found = {term: [float(f"{value:.6g}") for value in values] for term, values in long.energies.items()}
    for name, result in (("drift_degrees_100", short), ("drift_degrees_1000", long)):
        traces = np.clip((np.trace(result.turns, axis1=1, axis2=2) - 1) / 2, -1, 1)
        found[name] = [float(np.degrees(np.arccos(traces)).max())]
    return found


def costs(case: ShapeCase) -> dict[str, Any]:
    """Milliseconds of ours, cold and on the frames that follow, against the reference's; and the kind of the case."""
    made = ready(case.source, case.target)
    last = len(case.touch.motion) - 1
    poses = [case.touch.motion.pose(min(case.frame + ahead, last)) for ahead in range(REPEATS + 1)]
    cold, warm = [], []
    for turn in range(REPEATS):
        made.ours.forget()
        for number, pose in enumerate(poses):
            wall, cpu = time.perf_counter(), time.process_time()
            made.ours.step_surface(pose)
            spent = 1000 * (time.perf_counter() - wall), 1000 * (time.process_time() - cpu)
            if turn:  # the first turn meets everything for the first time
                (warm if number else cold).append(spent)
    made.ours.forget()
    reference = made.reference.run(case.posed, iterations=ITERATIONS)
    ours_cold, ours_warm = np.min(cold, axis=0), np.median(warm, axis=0)
    whole = 1000 * reference.cpu_seconds * ITERATIONS / max(reference.iterations, 1)
    return {
        "cold_ms": float(ours_cold[0]), "warm_ms": float(ours_warm[0]), "reference_100_cpu_ms": whole,
        "speed_ratio_cold": whole / float(ours_cold[1]), "speed_ratio_warm": whole / float(ours_warm[1]),
        "kind": kind_of(case, made),
    }  # fmt: skip


def kind_of(case: ShapeCase, made: Ready) -> str:
    """The paper's four kinds (section 7.1)."""
    rows = case.touch.pose_rows()
    touches = bool((case.touch.contacts.frame[rows] == case.frame).any())
    shape = made.ours.shape.posed(case.posed).surface.vertices
    collides = bool((judged_shape(case.target).collider.depths(shape[None]) > DEEPER_THAN).any())
    return {(False, False): "none", (False, True): "collisions", (True, False): "contacts", (True, True): "both"}[
        (touches, collides)
    ]


def sequence_row(motion: str, source: str, target: Actor) -> dict[str, Any]:
    """A clip: contacts over all of it, shake, slide of what rests, against copied rotations."""
    touch = performance(source, motion)
    surface = _clip(touch, target)
    frames = np.arange(len(touch.motion))
    kept, counted = kept_contacts(touch, target, surface.vertices.astype(np.float64), frames)
    limb = judged_shape(target).collider.parts.limb_vertices
    depth = judged_shape(target).collider.depths(surface.vertices.astype(np.float64))
    source_percent = metrics.penetration_percent(touch.depth, touch.parts.limb_vertices)
    excess = metrics.excess_penetration_percent(metrics.penetration_percent(depth, limb), source_percent)
    return {
        "method": OURS, "motion": motion, "frames": len(frames), "contacts_kept": kept, "contacts_counted": counted,
        "excess_penetration_percent": float(excess.mean()), **_shake_and_slide(touch, target, surface.vertices),
    }  # fmt: skip


def _clip(touch: SourceTouch, target: Actor):
    return ShapeTransfer().prepare(touch.actor, target)(touch.motion).surface


def _shake_and_slide(
    touch: SourceTouch, target: Actor, vertices: Float[Array, "frames vertices 3"]
) -> dict[str, float]:
    """Jerk of the surface against the source's, vertices everywhere; slide of sole vertices over the source's contacts."""
    from retarget.contact.ground_surface import resting_parts
    from retarget.contact.support import leg_length
    from retarget.evaluate.metrics.skeletal import foot_slide_cm, jerk

    posed, fps = touch.detector.skinner.vertices(*world_pose(touch.motion)), touch.motion.fps
    legs = [leg_length(actor.skeleton, actor.humanoid) for actor in (touch.actor, target)]
    shakes = [jerk(each.astype(np.float64)[:, ::5], fps, leg) for each, leg in zip((posed, vertices), legs)]
    parts = touch.parts
    rests = resting_parts(posed, parts, fps, touch.actor.height, 0.0)
    slides = []
    for name in ("leftFoot", "rightFoot"):
        part = parts.index(name)
        own = np.flatnonzero(parts.body_vertices & (parts.vertex_parts == part))
        rest = rest_vertices(touch.actor.character)[own, 1]
        sole = own[rest < rest.min() + 0.01 * touch.actor.height]
        touching = np.repeat(rests.touching[:, part, None], len(sole), axis=1)
        if touching.any():
            slides += [_steady(foot_slide_cm(each[:, sole].astype(np.float64), touching, height)) for each, height in
                       ((vertices, target.height), (posed, touch.actor.height))]  # fmt: skip
    return {
        "jerk_ratio": shakes[1] / max(shakes[0], 1e-9),
        "foot_slide_cm": float(np.mean(slides[::2])) if slides else 0.0,
        "source_foot_slide_cm": float(np.mean(slides[1::2])) if slides else 0.0,
    }


def _steady(slides: Float[Array, "contacts"]) -> float:
    """Of the vertices of a sole the steadiest quarter: a foot that rolls from heel to ball rests on one of them at a time."""
    return float(np.mean(np.sort(slides)[: max(1, len(slides) // 4)])) if len(slides) else 0.0


def foreign_row(pose: str, source: str, target: Actor) -> dict[str, Any]:
    """The same pose by a body with other triangles; contacts are carried to the target by where these lie on its own."""
    whole = shape_case(pose, (source, source))
    actor, _ = foreign_body(source)
    motion = replace(frames_of(whole.touch.motion, np.array([whole.frame])), skeleton=actor.skeleton)
    result = ShapeTransfer().prepare(actor, target)(motion)
    posed = result.surface.vertices[0].astype(np.float64)
    kept, counted = kept_contacts(whole.touch, target, posed[None], np.array([whole.frame]))
    return {"method": OURS, "pose": pose, "source": source, "contacts_kept": kept, "contacts_counted": counted}


def resolution_row(pose: str, names: tuple[str, str]) -> dict[str, Any]:
    """Joints of the result with 6.9k and with 13k vertices, mm at 1.7 m."""
    places = []
    for finer in (False, True):
        case = shape_case(pose, names, finer)
        result = ready(case.source, case.target).ours(case.motion)
        _, at = prepare_frames(case.target.character).of(result.surface.vertices[0].astype(np.float64))
        places.append(at)
    joints = list(case.target.humanoid.joints.values())
    away = np.linalg.norm(places[0][joints] - places[1][joints], axis=1)
    return {"pose": pose, "gap_mm": 1000 * float(at_reference_height(float(away.mean()), case.target.height))}
