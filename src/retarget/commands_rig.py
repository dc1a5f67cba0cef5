"""What `retarget rig` does: a bare mesh in, a rigged character out."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.casting import cast
from retarget.character import Character, Mesh, PointCloud
from retarget.errors import FileError, MatchError, RetargetError
from retarget.io import check_output, load, save
from retarget.io.asset import Asset
from retarget.motion.align import AXES, Similarity
from retarget.progress import progress_line
from retarget.rig.free_templates import free_template, stands_like_a_human
from retarget.rig.map_file import read_surface_map
from retarget.rig.rigging import Rigged, rig
from retarget.rig.template import Template
from retarget.rig.templates import character_template, human_template

Array = np.ndarray

log = logging.getLogger("retarget")


@dataclass(frozen=True)
class RigOrder:
    """What `retarget rig` was asked for."""

    mesh: Path
    output: Path
    template: Path | None = None
    """A rigged character; None is the embedded human."""
    landmarks: str | None = None
    surface_map: Path | None = None
    unit: float | None = None


def rig_file(order: RigOrder, progress: bool = False) -> dict[str, Any]:
    """Rig a mesh and write it. Raises `RetargetError` for what cannot be done; then nothing is written."""
    check_output(order.output)
    if order.output.suffix.lower() == ".bvh":
        raise FileError(order.output, "a BVH file holds no surface; use .glb, .usdc or .fbx")
    landmarks = parse_landmarks(order.landmarks) if order.landmarks else {}
    asset = load(order.mesh)
    body = bare_body(asset)
    with progress_line(progress) as tell:
        tell("preparing the template", 0)
        template = human_template() if order.template is None else template_of_file(order.template)
        known = None if order.surface_map is None else read_surface_map(order.surface_map, len(template.file_vertices))
        unit = asset.convention.metres_per_unit if order.unit is None else order.unit
        try:
            found = rig(body, template, landmarks, known, unit, tell)
        except RetargetError as error:
            raise FileError(order.mesh, str(error)) from None
        tell("writing", 1)
        save(order.output, replace(found.character, name=order.mesh.stem), [])
    return _account(order, found)


def bare_body(asset: Asset) -> Mesh | PointCloud:
    """The surface or the points of a file; the surface alone of one that is rigged already. Raises `FileError`."""
    if asset.mesh is not None:
        return asset.mesh
    if asset.points is not None:
        return asset.points
    if asset.character is not None and asset.character.mesh is not None:
        from retarget.body.skinning import rest_vertices

        return replace(asset.character.mesh, vertices=rest_vertices(asset.character))
    raise FileError(asset.path, f"holds a {asset.kind} without surface; a mesh or a cloud of points is needed")


def template_of_file(path: Path) -> Template:
    """The template that a file holds: a human where its joints match one's and it stands like one, else of its own structure.

    Raises `FileError`.
    """
    asset = load(path)
    asset.expect_joints()
    try:
        try:
            actor = cast(asset)
        except MatchError as error:
            log.info("%s is taken as of its own structure: %s", path, error)
            return free_template(in_house(asset))
        if stands_like_a_human(actor.character.skeleton, actor.humanoid):
            return character_template(actor.character, actor.humanoid)
        return free_template(in_house(asset))
    except RetargetError as error:
        raise FileError(path, str(error)) from None


def in_house(asset: Asset) -> Character:
    """The character of a file in metres with +Y up, as far as the file says what it is in."""
    turn = rot.swing_between(AXES.get(asset.convention.up, AXES["+y"]), AXES["+y"])
    return Similarity(turn, asset.convention.metres_per_unit or 1.0).character(asset.character)


def parse_landmarks(text: str) -> dict[str, int | Float[Array, "3"]]:
    """`head=123,left_hand=0.7:1.4:0.1` as names, which the template must know, and vertices or places.

    Raises `RetargetError` for what is neither.
    """
    found: dict[str, int | Float[Array, "3"]] = {}
    for part in text.split(","):
        name, equals, where = (each.strip() for each in part.rpartition("="))
        numbers = where.split(":")
        try:
            value = int(where) if len(numbers) == 1 else np.array([float(number) for number in numbers])
        except ValueError:
            value = None
        if not equals or not name or value is None or np.ndim(value) and (len(value) != 3 or not np.isfinite(value).all()):
            raise RetargetError(
                f"--landmarks takes NAME=VERTEX or NAME=X:Y:Z, separated by commas; received {part.strip()!r}"
            )
        if name in found:
            raise RetargetError(f"landmark {name!r} is given twice")
        found[name] = value
    return found


def _account(order: RigOrder, found: Rigged) -> dict[str, Any]:
    character = found.character
    mesh = character.mesh
    tall = float(np.ptp(mesh.vertices[mesh.faces, 1]))  # vertices of no face are no body
    line = (
        f"{order.output}: {len(mesh.vertices)} vertices, {len(character.skeleton)} joints, {tall:.2f} m tall, "
        f"confidence {found.confidence:.2f}"
    )
    told: Mapping[str, Any] = {
        "output": str(order.output),
        "confidence": round(found.confidence, 4),
        "metres_per_unit": found.unit,
        "height_m": round(tall, 4),
        "joints": list(character.skeleton.names),
        "notes": list(found.notes),
    }
    return {**told, "lines": [line, *(f"  {note}" for note in found.notes)]}
