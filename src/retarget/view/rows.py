"""Rows of a picture sheet from files: animated characters, bare motions, still characters, meshes, points."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from retarget.body.kinematics import rest_pose, still_motion, world_pose
from retarget.body.skinning import prepare_skinning
from retarget.casting import cast
from retarget.character import Character, Motion
from retarget.contact.support import support_limbs, support_points
from retarget.errors import FileError, MatchError
from retarget.io import load
from retarget.io.asset import Asset
from retarget.view.dots import dots_row
from retarget.view.picture import Row, choose_frames, skeleton_mesh


def file_row(path: Path, columns: int, clip: str | None = None, smpl_model: Path | None = None) -> Row:
    """One row for a file: its frames spread evenly over the clip; if none is named that which the file plays, else
    the last, since appended animations stand last. Files in other units or axes are shown upright and in metres where the body is recognised."""
    asset = load(path, smpl_model=smpl_model)
    if asset.mesh is not None:
        return Row(path.stem, asset.mesh, asset.mesh.vertices[None])
    if asset.sequence is not None:
        moving = asset.sequence
        chosen = np.unique(choose_frames(len(moving), columns))
        captions = tuple(f"{frame / moving.fps:.2f} s" for frame in chosen)
        return Row(path.stem, moving.mesh, moving.vertices[chosen].astype(np.float64), captions)
    if asset.points is not None:
        return dots_row(path.stem, [asset.points.points])
    if asset.clouds is not None:
        chosen = np.unique(choose_frames(len(asset.clouds), columns))
        captions = tuple(f"{frame / asset.clouds.fps:.2f} s" for frame in chosen)
        return dots_row(path.stem, [asset.clouds.clouds[frame] for frame in chosen], captions)
    if asset.character is None:
        raise FileError(path, f"holds {asset.kind}; a picture needs a surface, points or a skeleton")
    motion = (
        asset.motion(clip if clip is not None else len(asset.clips) - 1 if asset.plays is None else asset.plays)
        if asset.clips
        else still_motion(asset.character.skeleton)
    )
    character, motion, floor = _upright(asset, motion)
    label = path.stem if len(asset.clips) < 2 else f"{path.stem}\n{motion.name}"
    return motion_row(label, character, motion, columns, floor)


def motion_row(label: str, character: Character, motion: Motion, columns: int, floor: float | None = None) -> Row:
    """A character's frames spread evenly over a motion; bones where it has no surface."""
    chosen = np.unique(choose_frames(len(motion), columns))
    rotations, positions = (values[chosen] for values in world_pose(motion))
    captions = tuple(f"{frame / motion.fps:.2f} s" for frame in chosen)
    if character.skin is None:
        mesh, vertices = skeleton_mesh(character.skeleton, positions, rotations)
    else:
        mesh, vertices = character.mesh, prepare_skinning(character).vertices(rotations, positions).astype(np.float64)
    return Row(label, mesh, vertices, captions, floor)


def _upright(asset: Asset, motion: Motion) -> tuple[Character, Motion, float | None]:
    """Character and motion in metres with +Y up where the body is recognised, with the ground it stands on at rest
    (what it wears or carries may hang below)."""
    try:
        actor = cast(asset, motion=motion)
    except MatchError:
        return asset.character, motion, None
    legs = support_limbs(actor.character, actor.humanoid)[:2]
    rotations, positions = rest_pose(actor.skeleton)
    sole = min(points[..., 1].min() for points in support_points(legs, rotations[None], positions[None]))
    standing = abs(sole) < 0.1 * actor.height and asset.character.skin is not None
    return actor.character, actor.house_from_file.motion(motion), 0.0 if standing else None
