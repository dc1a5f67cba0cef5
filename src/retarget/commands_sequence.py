"""What `retarget convert` does where surfaces move without a skeleton: mesh sequences, characters baked to them,
point clouds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from retarget.body.skinning import bake
from retarget.character import MeshMotion, PointMotion
from retarget.errors import FileError
from retarget.io import save_sequence
from retarget.io.asset import Asset
from retarget.motion.align import Similarity
from retarget.motion.filter import resample

SEQUENCE_SUFFIXES = ("", ".npz")
"""Outputs that hold nothing but sequences of meshes or points: a folder of frames, and an archive."""


def convert_sequence(
    asset: Asset, output: Path, clip: str | None, fps: float | None, space: Similarity | None
) -> tuple[MeshMotion | PointMotion, str]:
    """Write a mesh or point sequence, or the surface that a character's clip moves; returns it and what it is, in
    words.

    `fps` is the rate of a sequence, which folders do not tell, and the rate at which a clip is sampled. Raises `FileError`
    for what does not move a surface.
    """
    if asset.clouds is not None:
        if clip is not None:
            raise FileError(asset.path, "holds one point sequence: --clip does not apply")
        seen = asset.clouds if fps is None else replace(asset.clouds, fps=fps)
        if space is not None:
            seen = replace(seen, clouds=tuple(space.points(cloud.astype(np.float64)) for cloud in seen.clouds))
        save_sequence(output, seen)
        counts = [len(cloud) for cloud in seen.clouds]
        return seen, f"{min(counts)} to {max(counts)} points"
    if asset.sequence is not None:
        if clip is not None:
            raise FileError(asset.path, "holds one mesh sequence: --clip does not apply")
        moving = asset.sequence if fps is None else replace(asset.sequence, fps=fps)
        if space is not None:
            places = space.points(moving.vertices.reshape(-1, 3).astype(np.float64)).reshape(moving.vertices.shape)
            moving = replace(moving, mesh=replace(moving.mesh, vertices=places[0]), vertices=places)
    else:
        if asset.character is None or asset.character.skin is None or not asset.clips:
            raise FileError(asset.path, f"holds a {asset.kind} whose surface does not move; a mesh sequence needs one that does")
        if clip is None and len(asset.clips) > 1:
            listed = ", ".join(repr(each.name) for each in asset.clips[:3]) + (", ..." if len(asset.clips) > 3 else "")
            raise FileError(
                asset.path, f"holds {len(asset.clips)} clips ({listed}), a mesh sequence one; choose one with --clip NAME"
            )
        motion = asset.motion(clip)
        motion = motion if fps is None else resample(motion, fps)
        character = asset.character
        if space is not None:
            character, motion = space.character(character), space.motion(motion)
        moving = bake(character, motion)
    save_sequence(output, moving)
    return moving, f"{moving.vertices.shape[1]} vertices"
