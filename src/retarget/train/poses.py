"""Poses that networks learn from: frames of real and embedded motions on the embedded human's skeleton, and what is made of them.

Half of the frames are mirrored; legs of one may meet the trunk of another; joints wobble; arms reach where no clip
takes them. One in twelve is a T or an A, or stands with its arms down. All face anywhere, and some fall.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.body.human import human, human_model
from retarget.character import Character, Motion
from retarget.errors import RetargetError
from retarget.evaluate.scan_split import EMBEDDED, set_of_clip
from retarget.io import load
from retarget.io.asset import Asset
from retarget.motion.library import embedded_motion
from retarget.retargeting import retarget

Array = np.ndarray
log = logging.getLogger("retarget")

FOLDERS = (
    "motions/cmu_daz", "motions/animated_drawings", "motions/makehuman", "characters/kaykit", "characters/quaternius",
)  # fmt: skip
"""Where recorded and animated motions lie below the folder of data."""
FORMATS = (".bvh", ".glb", ".fbx")
TWICE = ("Barbarian",)
"""Files whose clips another file has too."""
FPS = 30.0
STILL, MIXED, REACHING, FREE = 0.08, 0.17, 0.13, 0.08
"""Shares of T and A poses and their kin; of legs and trunk from two frames; of arms anywhere; and of joints turned at random."""
FALLEN, TILT = 0.07, np.radians(120.0)
"""Share that is tilted any way, and by how much at most."""
WOBBLE = np.radians(4.0)
"""Standard deviation of every joint's rotation vector about each axis, in all but still poses, where it is half of it."""
LEGS, ARMS = (10, 11, 12, 13, 18, 19, 20, 21), (6, 7, 8, 9, 14, 15, 16, 17)
FINGERS = slice(22, 52)
STRAIGHT_ELBOW = np.array([0.55, 0.5, -0.03])
"""Rotation vector of the left elbow that lays the forearm in line with the upper arm; at rest it is bent forward."""
_FREE = np.radians([15.0, 12, 10, 10, 15, 20, 8, 50, 45, 25, 35, 35, 20, 12, 8, 50, 45, 25, 35, 35, 20, 12])
"""Standard deviation of each body joint in poses that are made up."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Frames to draw from."""

    rotations: Float[Array, "frames joints 4"]
    """Local rotations of the embedded human's joints."""
    clips: Int[Array, "frames"]
    """Which clip each frame is of."""
    embedded: int
    """So many first frames are of embedded motions, in which fingers move."""
    names: tuple[str, ...]
    """Of the clips."""


def gather_poses(which: str, data: Path | None = None) -> Poses:
    """All frames (30 a second) of one of the sets of `scan_split`: embedded motions, and clips below `data` where given.

    Clips that cannot be put on the embedded human are left out, with a line in the log.
    """
    motions = gather_motions(which, data)
    numbers = np.repeat(np.arange(len(motions)), [len(motion) for motion in motions])
    embedded = sum(len(motion) for motion in motions[: len(EMBEDDED[which])])
    rotations = np.concatenate([motion.rotations for motion in motions]).astype(np.float32)
    return Poses(rotations, numbers, embedded, tuple(motion.name for motion in motions))


def gather_motions(which: str, data: Path | None = None) -> list[Motion]:
    """The motions of a set on the embedded human's skeleton, the embedded ones first, 30 frames a second (nearly)."""
    motions = [replace(embedded_motion(name), name=f"embedded/{name}") for name in EMBEDDED[which]]
    body = human()
    for path in _files(which, data):
        motions += copied_clips(path, body)
    return motions


def copied_clips(path: Path, body: Character) -> list[Motion]:
    """The clips of a file on an embedded human, 30 frames a second (nearly); those that cannot be put on it are left out, with a
    line in the log."""
    asset, motions = load(path), []
    for clip in asset.clips:
        try:
            copied = _copied(asset, clip.name, body)
        except RetargetError as error:
            log.warning("%s, clip %r: %s", path, clip.name, error)
            continue
        motions.append(replace(copied, name=f"{path.parent.name}/{path.stem}/{clip.name}"))
    return motions


def _files(which: str, data: Path | None) -> list[Path]:
    """Recorded and animated files of a set."""
    if data is None:
        return []
    found = [path for folder in FOLDERS for path in sorted((data / folder).glob("*")) if path.suffix in FORMATS]
    return [path for path in found if path.stem not in TWICE and set_of_clip(path.parent.name, path.stem) == which]


def _copied(asset: Asset, clip: str, body: Character) -> Motion:
    """A clip, copied to the embedded human and thinned to 30 frames a second."""
    motion = retarget(asset, body, clip=clip, method="copy-rotations", foot_lock=False, steady=False).motion
    step = max(1, round(motion.fps / FPS))
    return replace(motion, rotations=motion.rotations[::step], translations=motion.translations[::step], fps=motion.fps / step)


def drawn_poses(
    poses: Poses, count: int, draw: np.random.Generator, made_up: bool = True
) -> Float[Array, "count joints 4"]:
    """Local rotations of so many poses, the hips' turned any way about the vertical; frames as they are, or with what is made
    of them."""
    rotations = _frames(poses, count, draw)
    around = draw.uniform(0.0, 2.0 * np.pi, count)
    turn = rot.from_rotation_vector(around[:, None] * np.array([0.0, 1.0, 0.0]))
    if made_up:
        _make_up(poses, rotations, draw)
        turn = rot.multiply(_fall(count, draw), turn)
    rotations[:, 0] = rot.multiply(turn, rotations[:, 0])
    return rotations


def _make_up(poses: Poses, rotations: Float[Array, "count joints 4"], draw: np.random.Generator) -> None:
    """Mix, replace and shake frames, in place."""
    count = len(rotations)
    sort = draw.random(count)
    mixed = sort < MIXED
    rotations[np.ix_(mixed, LEGS)] = _frames(poses, int(mixed.sum()), draw)[:, LEGS]
    reaching = (sort >= MIXED) & (sort < MIXED + REACHING)
    rotations[np.ix_(reaching, ARMS)] = drawn_arms(int(reaching.sum()), draw)
    free = (sort >= MIXED + REACHING) & (sort < MIXED + REACHING + FREE)
    rotations[free, :22] = rot.from_rotation_vector(draw.normal(size=(free.sum(), 22, 3)) * _FREE[:, None])
    still = sort >= 1.0 - STILL
    rotations[still] = still_poses(int(still.sum()), draw)
    wobble = draw.normal(size=(count, 22, 3)) * WOBBLE * np.where(still, 0.5, 1.0)[:, None, None]
    wobble[:, 0] *= 0.5
    rotations[:, :22] = rot.multiply(rotations[:, :22], rot.from_rotation_vector(wobble))
    rotations[:, FINGERS] = _fingers(poses, count, draw)


def _fall(count: int, draw: np.random.Generator) -> Float[Array, "count 4"]:
    """Tilts any way for some, none for most."""
    tilt = np.where(draw.random(count) < FALLEN, draw.uniform(0.0, TILT, count), 0.0)
    toward = draw.uniform(0.0, 2.0 * np.pi, count)
    return rot.from_rotation_vector(tilt[:, None] * np.stack([np.cos(toward), 0 * toward, np.sin(toward)], axis=1))


def _frames(poses: Poses, count: int, draw: np.random.Generator) -> Float[Array, "count joints 4"]:
    """Frames, long clips less than their length makes likely; half of them mirrored."""
    weights = 1.0 / np.sqrt(np.bincount(poses.clips))
    chances = np.cumsum(weights[poses.clips])
    chosen = np.searchsorted(chances, draw.uniform(0.0, chances[-1], count))
    rotations = poses.rotations[np.minimum(chosen, len(chances) - 1)].astype(np.float64)
    mirrored = draw.random(count) < 0.5
    rotations[mirrored] = rotations[mirrored][:, other_side()] * [1.0, -1.0, -1.0, 1.0]
    return rotations


def other_side() -> Int[Array, "joints"]:
    """The joint on the other side of each of the embedded human's joints."""
    names = human_model().joint_names
    swapped = [
        name.replace("left", "right") if name.startswith("left") else name.replace("right", "left") for name in names
    ]
    return np.array([names.index(name) for name in swapped])


def drawn_arms(count: int, draw: np.random.Generator) -> Float[Array, "count arms 4"]:
    """Arms anywhere: upper arms around the body, elbows from straight to folded, forearms twisted."""
    turns = np.tile(rot.IDENTITY, (count, len(ARMS), 1))
    for side, first in ((1.0, 0), (-1.0, 4)):
        shoulder = draw.normal(size=(count, 3)) * np.radians(8.0)
        lift = draw.uniform(np.radians(-50.0), np.radians(130.0), count) * side
        ahead = -draw.uniform(np.radians(-40.0), np.radians(120.0), count) * side
        twist = draw.normal(size=count) * np.radians(35.0)
        upper = rot.multiply(_about(ahead, 1), _about(lift, 2))
        turns[:, first] = rot.from_rotation_vector(shoulder)
        turns[:, first + 1] = rot.multiply(upper, _about(twist, 0))
        bend = -draw.beta(1.2, 1.5, count) * np.radians(150.0) * side
        turns[:, first + 2] = rot.multiply(_about(bend, 1), _about(draw.normal(size=count) * np.radians(25.0), 0))
        turns[:, first + 3] = rot.from_rotation_vector(draw.normal(size=(count, 3)) * np.radians(22.0))
    return turns


def _about(angles: Float[Array, "count"], axis: int) -> Float[Array, "count 4"]:
    return rot.from_rotation_vector(angles[:, None] * np.eye(3)[axis])


def still_poses(
    count: int, draw: np.random.Generator, lifts: tuple[float, ...] = (48.0, 20.0, 0.0, -20.0, -38.0)
) -> Float[Array, "count joints 4"]:
    """T, A and arms down (by how many degrees arms are lifted from the rest pose), legs a little apart or together."""
    rotations = np.tile(rot.IDENTITY, (count, 52, 1))
    lift = np.radians(draw.choice(lifts, size=count) + draw.normal(size=count) * 5.0)
    apart = draw.uniform(np.radians(-6.0), np.radians(16.0), count)
    straight = draw.uniform(0.0, 1.1, count)[:, None]
    for side, arm, leg in ((1.0, 7, 10), (-1.0, 15, 18)):
        rotations[:, arm] = _about(side * lift, 2)
        rotations[:, arm + 1] = rot.from_rotation_vector(straight * STRAIGHT_ELBOW * [1.0, side, side])
        rotations[:, leg] = _about(side * apart, 2)
    return rotations


def _fingers(poses: Poses, count: int, draw: np.random.Generator) -> Float[Array, "count fingers 4"]:
    """Fingers as some embedded motion has them, opened or closed further."""
    chosen = draw.integers(0, poses.embedded, count)
    vectors = rot.to_rotation_vector(poses.rotations[chosen, FINGERS].astype(np.float64))
    return rot.from_rotation_vector(vectors * draw.uniform(-0.2, 1.5, count)[:, None, None])
