"""Real bodies of other makers for the bench of rig transfer: rigged characters with their rig taken away, and bare meshes.

A character succeeds whose joints lie within `MOST_ERROR` per cent of its height of its own rig's on average, left and right
not exchanged. Makers place the same joint differently (KayKit's head joint sits on the shoulders), so figures of a sound rig
are some per cent; spine joints differ even in number, so limbs, hips and head are told apart as well.

A bare mesh has no truth. It counts as a success where a rig is delivered, template and mesh lie on each other
(`LAID_ON`, `COVERED`), nothing tears on the way to rest (`TORN`), no knee is bent backwards, and, where the same mesh is at hand in other poses, its
vertices lie where those of the others do (`ALIKE`). That can be fooled: pictures are written for the eye.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices
from retarget.casting import NEEDED, cast
from retarget.character import Mesh
from retarget.errors import RetargetError
from retarget.evaluate.cases import data_folder
from retarget.evaluate.rig_judge import torn
from retarget.geometry.closest import SurfaceIndex
from retarget.io import load
from retarget.rig.fit import HEIGHT
from retarget.rig.rigging import Rigged
from retarget.rig.template import MAIN
from retarget.rig.templates import human_template

Array = np.ndarray

SUFFIXES = (".glb", ".gltf", ".fbx", ".usdz")
QUICK = "mannequiny"
MOST_ERROR = 5.0
"""Per cent of the height: mean distance from the joints of a character's own rig."""
MOST_SWAPPED = 0.25
"""Share of paired joints that may lie nearer to the other side's."""
LAID_ON, COVERED = 2.0, 3.0
"""Per cent of the height: mean distance from the laid-on template to the mesh, and back."""
TORN = 1.0
"""Per cent of the edges that may tear (`metrics.torn_percent`). Set on sheets of low-polygon figures: up to here hands crumple
(one edge of a 446-vertex figure is .08 %), beyond, a hand takes a piece of the hip along."""
BACKWARDS = -0.05
"""Of a leg's length: how far a knee may lie behind the line from hip to ankle."""
ALIKE = 5.0
"""Per cent of the height, on the template: mean distance of vertices from where the same vertices lie in other poses."""


@dataclass(frozen=True, eq=False)
class RealBody:
    """A bare mesh of another maker."""

    name: str
    mesh: Mesh
    joints: dict[str, Float[Array, "3"]] | None
    """Canonical joints of its own rig at rest, in the mesh's space; None for a mesh without one."""
    height: float
    """In the mesh's unit."""


def real_bodies(quick: bool) -> Iterator[RealBody]:
    """Characters first, then meshes; none without a data folder. What cannot be read here (an extra is missing) is left out,
    and so is a skeleton without a surface."""
    folder = data_folder()
    if folder is None:
        return
    for kind in ("characters", "meshes"):
        for path in sorted((folder / kind).rglob("*")):
            if path.suffix.lower() in SUFFIXES and (not quick or path.stem == QUICK):
                try:
                    body = _body(path.stem, load(path))
                except RetargetError:
                    continue
                if body is not None:
                    yield body


def _body(name: str, asset: Any) -> RealBody | None:
    if asset.mesh is not None:
        return RealBody(name, asset.mesh, None, _extent(asset.mesh.vertices))
    if asset.character is None or asset.character.mesh is None:
        return None
    try:
        actor = cast(asset)
    except RetargetError:  # a rig that is no humanoid is no truth, but its surface may be a body
        vertices = rest_vertices(asset.character)
        return RealBody(name, replace(asset.character.mesh, vertices=vertices), None, _extent(vertices))
    _, places = rest_pose(actor.skeleton)
    mesh = replace(actor.character.mesh, vertices=rest_vertices(actor.character))
    joints = {joint: places[number] for joint, number in actor.humanoid.joints.items() if joint in MAIN}
    return RealBody(name, mesh, joints, actor.height)


def _extent(vertices: Float[Array, "vertices 3"]) -> float:
    return float(np.ptp(vertices, axis=0).max())


def judge_real(body: RealBody, rigged: Rigged) -> dict[str, Any]:
    """What was found of a delivered rig; `success` by the rules above, but for the comparison between poses."""
    joints = dict(zip(human_template().names, rigged.joints))
    figures: dict[str, Any] = {"confidence": rigged.confidence, **_surface_figures(body, rigged)}
    figures["torn_percent"] = torn(body.mesh, rigged, body.height)
    if body.joints is not None:
        return figures | joint_figures(body.joints, joints, body.height)
    figures["knees_forward"] = knees_forward(joints)
    laid = figures["template_to_mesh_percent"] < LAID_ON and figures["mesh_to_template_percent"] < COVERED
    whole = figures["torn_percent"] <= TORN and figures["knees_forward"] > BACKWARDS
    return figures | {"success": bool(laid and whole)}


def joint_figures(
    truth: dict[str, Float[Array, "3"]], result: dict[str, Float[Array, "3"]], height: float
) -> dict[str, Any]:
    """Mean joint errors in per cent of the height, over all joints and over limbs, hips and head; share exchanged."""
    shared = [name for name in truth if name in result]
    errors = {name: 100 * float(np.linalg.norm(result[name] - truth[name])) / height for name in shared}
    swapped = []
    for name in shared:
        other = {"left": "right", "right": "left"}.get(name[: 4 if name.startswith("left") else 5])
        if other is not None and (twin := other + name.removeprefix("left").removeprefix("right")) in truth:
            swapped.append(np.linalg.norm(result[name] - truth[twin]) < np.linalg.norm(result[name] - truth[name]))
    share = float(np.mean(swapped)) if swapped else 0.0
    mean, limbs = (
        float(np.mean([errors[name] for name in names])) for names in (shared, [n for n in shared if n in NEEDED])
    )
    worst = max(errors, key=errors.__getitem__)
    return {
        "joint_error_percent": mean,
        "limb_error_percent": limbs,
        "swapped": share,
        "worst_joint": f"{worst} {errors[worst]:.1f} %",
        "success": mean <= MOST_ERROR and share <= MOST_SWAPPED,
        "success_limbs": limbs <= MOST_ERROR and share <= MOST_SWAPPED,
    }


def knees_forward(joints: dict[str, Float[Array, "3"]]) -> float:
    """How far the less forward knee lies before the line from hip to ankle, on the side that its toes point to, in lengths of
    the leg."""
    knees = []
    for side in ("left", "right"):
        hip, knee, ankle, toe = (joints[side + part] for part in ("UpperLeg", "LowerLeg", "Foot", "Toes"))
        leg = float(np.linalg.norm(ankle - knee) + np.linalg.norm(knee - hip))
        line = (ankle - hip) / max(float(np.linalg.norm(ankle - hip)), 1e-12)
        ahead = toe - ankle - line * float(line @ (toe - ankle))
        knees.append(float((knee - hip) @ ahead) / max(float(np.linalg.norm(ahead)) * leg, 1e-12))
    return min(knees)


def _surface_figures(body: RealBody, rigged: Rigged) -> dict[str, float]:
    to_percent = 100 / body.height
    there = SurfaceIndex(body.mesh.vertices, body.mesh.faces).closest(rigged.posed, candidates=16)
    back = SurfaceIndex(rigged.posed, human_template().faces).closest(body.mesh.vertices, candidates=16)
    return {
        "template_to_mesh_percent": to_percent
        * float(np.linalg.norm(there.of(body.mesh.vertices) - rigged.posed, axis=1).mean()),
        "mesh_to_template_percent": to_percent
        * float(np.linalg.norm(back.of(rigged.posed) - body.mesh.vertices, axis=1).mean()),
    }


def unlike(places: list[Float[Array, "vertices 3"]]) -> list[float]:
    """For the same mesh in several poses, mapped to the template each on its own: mean distance of each pose's vertices from
    the median place over the poses, per cent of the template's height. Raises `RetargetError` for fewer than three poses, of
    which none could be told to be the odd one."""
    if len(places) < 3:
        raise RetargetError(f"three poses of one mesh are needed to tell the odd one; received {len(places)}")
    middle = np.median(np.stack(places), axis=0)
    return [100 * float(np.linalg.norm(each - middle, axis=1).mean()) / HEIGHT for each in places]
