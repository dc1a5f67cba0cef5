"""What `retarget simulate-scan` does: a character performs a motion, and a virtual scanner captures it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import world_pose
from retarget.body.skinning import prepare_skinning
from retarget.casting import cast
from retarget.character import Character, Mesh, Motion, PointMotion
from retarget.errors import FileError, MatchError, RetargetError
from retarget.geometry.capture import Scanner, prepare_studio
from retarget.io import check_sequence_output, load, point_folder, save_sequence
from retarget.io.asset import Asset
from retarget.io.point_folder import LARGEST
from retarget.motion.align import AXES, Similarity, infer_unit, same_skeleton
from retarget.motion.filter import resample
from retarget.progress import progress_line
from retarget.retargeting import retarget

Array = np.ndarray
log = logging.getLogger("retarget")

TOGETHER = 32
"""Frames whose surface is in memory at once."""
LOOKED_AT = 64
"""Frames, evenly spread, that tell where the cameras must stand."""


@dataclass(frozen=True)
class CaptureOrder:
    """What `retarget simulate-scan` was asked for."""

    motion: Path
    character: Path
    output: Path
    """A folder to make, or an .npz file."""
    scanner: Scanner = field(default_factory=Scanner)
    seed: int = 0
    fps: float | None = None
    clip: str | None = None
    form: str | None = None
    """'ply' or 'pcd': of the frames in a folder."""


@dataclass(frozen=True, eq=False)
class Performance:
    """A surface that moves, metres, +Y up."""

    mesh: Mesh
    frames: int
    fps: float
    how: str
    """How the character came to the motion."""
    vertices: Any
    """Called with frame numbers: (frames, vertices, 3)."""


def simulate_scan(order: CaptureOrder, progress: bool = False) -> dict[str, Any]:
    """Capture a performance and write it. Raises `RetargetError` for what cannot be done; then nothing is written."""
    _expect_possible(order)
    with progress_line(progress) as tell:
        tell("reading", 0)
        performing = _performance(order)
        per_frame = order.scanner.points or 0
        if 12 * per_frame * performing.frames > LARGEST:
            raise FileError(
                order.output,
                f"{performing.frames} frames of {per_frame} points are more than is kept in memory at once",
            )
        try:
            clouds = tuple(_scanned(performing, order, tell))
        except FileError:
            raise
        except RetargetError as error:
            raise FileError(order.character, str(error)) from None
        tell(f"writing {order.output.name}", 0)
        capture = PointMotion(clouds, performing.fps, order.output.stem)
        if order.output.suffix:
            save_sequence(order.output, capture)
        else:
            point_folder.save(order.output, capture, f".{order.form or 'ply'}")
    return _report(order, performing, clouds)


def _expect_possible(order: CaptureOrder) -> None:
    """Refuse, before any work, what would come to nothing or cost the user a file."""
    check_sequence_output(order.output, points=True)
    if order.form not in (None, "ply", "pcd"):
        raise RetargetError(f"frames are written as ply or pcd, received {order.form!r}")
    if order.form is not None and order.output.suffix:
        raise FileError(order.output, "is an archive: --format does not apply")
    if order.seed < 0:
        raise RetargetError(f"a seed is not negative, received {order.seed}")
    if order.fps is not None and not 0 < order.fps < np.inf:
        raise RetargetError(f"--fps must be positive, received {order.fps:g}")
    for read in (order.motion, order.character):
        if order.output.resolve() == read.resolve():
            raise FileError(order.output, "is read, as motion or character, and would be replaced; name another file")


def _performance(order: CaptureOrder) -> Performance:
    """The character in motion: a surface of its own, a clip of its own rig, or retargeted as `run` does."""
    asset = load(order.motion)
    own = asset if order.motion.resolve() == order.character.resolve() else load(order.character)
    for note in dict.fromkeys((*asset.notes, *own.notes)):
        log.info("%s", note)
    if asset.sequence is not None:
        if order.clip is not None:
            raise FileError(asset.path, "holds one mesh sequence: --clip does not apply")
        moving = asset.sequence if order.fps is None else replace(asset.sequence, fps=order.fps)
        if own is asset:
            return _of_sequence(replace(asset, sequence=moving))
        return _retargeted(replace(asset, sequence=moving), own)
    if asset.clips and len(asset.clips) > 1 and order.clip is None:
        log.warning(
            "%s holds %d clips; taking the first, %r (--clip to choose)",
            asset.path,
            len(asset.clips),
            asset.clips[0].name,
        )
    motion = asset.motion(order.clip)
    motion = motion if order.fps is None else resample(motion, order.fps)
    if own.character is not None and own.character.skin is not None and (own is asset or _fits(motion, own.character)):
        return _played(own, replace(motion, skeleton=own.character.skeleton))
    return _retargeted(asset, own, motion)


def _fits(motion: Motion, character: Character) -> bool:
    """Whether a motion can be played by a character as it is: the same joints, at rest alike in every frame of them."""
    ours, theirs = character.skeleton, motion.skeleton
    if ours.names != theirs.names or not same_skeleton(ours, theirs):
        return False
    turned = np.abs((ours.rest_rotations * theirs.rest_rotations).sum(axis=1))
    return bool((turned > 1.0 - 1e-6).all())


def _played(own: Asset, motion: Motion) -> Performance:
    try:
        actor = cast(own, motion=motion)
        return _of_motion(actor.character, actor.house_from_file.motion(motion), "played as it is")
    except MatchError:  # a dog has no canonical joints, and needs none
        space = _space(own, prepare_skinning(own.character).vertices(*world_pose(motion))[:1].astype(np.float64))
        return _of_motion(space.character(own.character), space.motion(motion), "played as it is")


def _retargeted(asset: Asset, own: Asset, motion: Motion | None = None) -> Performance:
    result = retarget(asset if motion is None else motion, own, **({} if motion is None else {"source": asset}))
    for note in result.stats["notes"]:
        log.info("%s", note)
    how = "retargeted" if result.status == "ok" else f"retargeted ({result.status})"
    if result.surface is not None:
        surface = result.surface
        return Performance(surface.mesh, len(surface), surface.fps, how, lambda frames: surface.vertices[frames])
    if result.target.character.skin is None:
        raise FileError(own.path, "has no surface that a scanner could see")
    return _of_motion(result.target.character, result.motion, how)


def _of_motion(character: Character, motion: Motion, how: str) -> Performance:
    skinner = prepare_skinning(character)
    rotations, positions = world_pose(motion)
    return Performance(
        character.mesh,
        len(motion),
        motion.fps,
        how,
        lambda frames: skinner.vertices(rotations[frames], positions[frames]),
    )


def _of_sequence(asset: Asset) -> Performance:
    moving = asset.sequence
    space = _space(asset, moving.vertices[:1].astype(np.float64))
    return Performance(
        moving.mesh, len(moving), moving.fps, "played as it is",
        lambda frames: space.points(moving.vertices[frames].astype(np.float64)),
    )  # fmt: skip


def _space(asset: Asset, vertices: Float[Array, "frames vertices 3"]) -> Similarity:
    """From the file's space to metres with +Y up, where nobody is recognised: as it states, else as its height
    shows."""
    turn = rot.swing_between(AXES[asset.convention.up or "+y"], AXES["+y"])
    height = float(np.ptp(rot.rotate(turn, vertices)[..., 1])) if vertices.size else 0.0
    unit = asset.convention.metres_per_unit
    if unit is None:
        unit, note = infer_unit(height) if height > 0 else (1.0, "")
        log.info("%s: %s", asset.path, note)
    return Similarity(turn, float(unit))


def _scanned(performing: Performance, order: CaptureOrder, tell: Any) -> Iterator[Array]:
    """A cloud a frame. The cameras stand, and every frame has a seed of its own."""
    faces, count = performing.mesh.faces, performing.frames
    if not count:
        raise FileError(order.motion, "holds no frames")
    seen = np.unique(np.linspace(0, count - 1, LOOKED_AT).round().astype(int))
    studio = prepare_studio(order.scanner, performing.vertices(seen), faces, (order.seed, 0))
    for start in range(0, count, TOGETHER):
        tell(f"scanning frame {start} of {count}", 0)
        frames = np.arange(start, min(start + TOGETHER, count))
        for frame, vertices in zip(frames.tolist(), performing.vertices(frames)):
            yield studio.scan(vertices, faces, (order.seed, 1 + frame))


def _report(order: CaptureOrder, performing: Performance, clouds: tuple[Array, ...]) -> dict[str, Any]:
    counts = [len(cloud) for cloud in clouds]
    told = {
        "output": str(order.output), "frames": len(clouds), "fps": performing.fps, "points": [min(counts), max(counts)],
        "cameras": order.scanner.cameras, "seed": order.seed, "motion": performing.how,
    }  # fmt: skip
    points = f"{min(counts)} points" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)} points"
    cameras = "1 camera" if order.scanner.cameras == 1 else f"{order.scanner.cameras} cameras"
    seen = f"{len(clouds)} frames at {performing.fps:g} fps, {points}, {cameras}, seed {order.seed}"
    line = f"{order.output}: {seen}; {performing.how}"
    return told | {"lines": [line]}
