"""Performances that the interaction network learns from: clips of the seen half and of others' recordings, and what is made of them.

Clips are few and most touch nothing, so nearly half of the stretches get arms that reach from place to place on the body
(`train/reaching.py`), and a quarter get a trunk and legs that bend: crouches, bows, a knee that comes up, legs that cross.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.body.human import human
from retarget.body.kinematics import world_pose
from retarget.character import Motion
from retarget.contact.part_field import PAIRS, PartField
from retarget.errors import RetargetError
from retarget.evaluate.contact_cases import CAPTURED, SEEN_MOTIONS
from retarget.evaluate.scan_split import VALIDATION
from retarget.motion.align import Actor
from retarget.motion.library import embedded_motion
from retarget.motion.touch.mend import frames_of
from retarget.train.poses import ARMS, FPS, LEGS, copied_clips, other_side
from retarget.train.reaching import SIDES, figures_of_pairs, reaching_arms

Array = np.ndarray

FILES = (
    "motions/cmu_daz/*.bvh", "motions/animated_drawings/*.bvh", "motions/makehuman/*.bvh", "characters/kaykit/Knight.glb",
    "characters/kaykit_mannequin/*.glb", "characters/quaternius/Male_Casual.fbx", "characters/quaternius/Animated_Woman.fbx",
)  # fmt: skip
"""Recorded and animated clips below the folder of data."""
HELD_BACK = ("01_01", "06_01", "10_04", "11_01", "fair1_dab")
"""Files for validation."""
LONGEST, STRIDE = 8.0, 5
"""Seconds that are taken of a clip, and of how many frames one: neighbours have little to teach."""
SHORTEST = 15
"""Frames of a clip at least."""
REACHING, BENDING = 0.5, 0.3
"""Shares of stretches with made-up arms, and with made-up legs and trunk."""
CROSSED = 0.35
"""Share of made-up legs that are crossed."""
TOUCHING = 0.35
"""Share of stretches with made-up legs in which, in every pose, shins or feet touch the other leg."""
LEGS_TRIED, CLOSE, DEEPEST = 600, 0.15, 0.025
"""Legs that are drawn for such a pose; how close they are (`part_field_kernels`: one where surfaces meet), and no deeper in each other, in
shares of the height: mending takes it out."""
LEG_PAIRS = [number for number, (own, other) in enumerate(PAIRS) if own.endswith(("Leg", "Foot")) and other.endswith(("Leg", "Foot"))]
LOW = [number for number in LEG_PAIRS if not all(part.endswith("UpperLeg") for part in PAIRS[number])]
TRUNK = (1, 2, 3)
"""Spine, chest, upper chest."""
FEET = (12, 13, 20, 21)


@lru_cache(maxsize=4)
def clips_of(which: str, data: Path | None) -> tuple[Motion, ...]:
    """Clips of a set on the embedded human, 30 frames a second (nearly). Without `data` validation has the seen embedded clips too: its
    bodies are others."""
    held_back = which == VALIDATION
    found = [] if held_back and data is not None else [replace(embedded_motion(name), name=name) for name in SEEN_MOTIONS]
    unseen = {name for name, half in CAPTURED.items() if half == "u"}
    for pattern in FILES if data is not None else ():
        for path in sorted(data.glob(pattern)):
            if path.stem not in unseen and (path.stem in HELD_BACK) == held_back:
                found += copied_clips(path, human())
    found = [clip for clip in found if len(clip) >= SHORTEST]
    if not found:
        raise RetargetError(f"no recorded motions for {which} below {data}")
    return tuple(found)


def drawn_performance(
    clips: tuple[Motion, ...], source: Actor, field: PartField, draw: np.random.Generator
) -> Motion:
    """A stretch of a clip by an embedded body, as it is or with what is made of it; `field` is the body's own."""
    clip = _stretch(clips[_likely(clips, draw)], draw)
    motion = _performed(_mirrored(clip) if draw.random() < 0.5 else clip, source)
    if draw.random() < BENDING:
        motion = _bending(motion, field if draw.random() < TOUCHING else None, draw)
    return _reaching(motion, field, draw) if draw.random() < REACHING else motion


def _likely(clips: tuple[Motion, ...], draw: np.random.Generator) -> int:
    """A clip; those of the embedded library, which touch most, are drawn as often as all others."""
    embedded = sum(clip.name in SEEN_MOTIONS for clip in clips)
    if embedded and (draw.random() < 0.5 or len(clips) == embedded):
        return int(draw.integers(embedded))
    return int(draw.integers(embedded, len(clips)))


def _stretch(clip: Motion, draw: np.random.Generator) -> Motion:
    longest = round(LONGEST * FPS)
    start = int(draw.integers(max(1, len(clip) - longest + 1)))
    return frames_of(replace(clip, fps=FPS / STRIDE), np.arange(start, min(len(clip), start + longest), STRIDE))


def _performed(clip: Motion, source: Actor) -> Motion:
    """A clip by another embedded body: equal rotations, the path by the height of its hips."""
    scale = source.skeleton.offsets[0, 1] / clip.skeleton.offsets[0, 1]
    return replace(clip, skeleton=source.skeleton, translations=clip.translations * scale)


def _mirrored(motion: Motion) -> Motion:
    flip = np.array([1.0, -1.0, -1.0, 1.0])
    return replace(
        motion, rotations=motion.rotations[:, other_side()] * flip, translations=motion.translations * [-1.0, 1.0, 1.0]
    )


def _reaching(motion: Motion, field: PartField, draw: np.random.Generator) -> Motion:
    """Arms, or one of them, from place to place on the body."""
    rotations = motion.rotations.copy()
    arms = ARMS if draw.random() < 0.6 else SIDES[int(draw.integers(2))].joints
    keys = _keys(len(motion), draw)
    wanted = np.stack([reaching_arms(motion, key, field, draw) for key in keys.tolist()])
    rotations[:, list(arms)] = _between(keys, wanted[:, [ARMS.index(arm) for arm in arms]], len(motion))
    return replace(motion, rotations=rotations)


def _bending(motion: Motion, field: PartField | None, draw: np.random.Generator) -> Motion:
    """Legs and trunk from pose to pose; the lowest foot stays as high as it was. With the body's `field` legs touch each other."""
    rotations = motion.rotations.copy()
    keys = _keys(len(motion), draw)
    wanted = _bent(len(keys), draw) if field is None else _touching(motion, keys, field, draw)
    rotations[:, [*TRUNK, *LEGS]] = _between(keys, wanted, len(motion))
    bent = replace(motion, rotations=rotations)
    lifted = [world_pose(each)[1][:, FEET, 1].min(axis=1) for each in (motion, bent)]
    translations = bent.translations.copy()
    translations[:, 0, 1] += lifted[0] - lifted[1]
    return replace(bent, translations=translations)


def _touching(motion: Motion, keys: Int[Array, "keys"], field: PartField, draw: np.random.Generator) -> Float[Array, "keys joints 4"]:
    """Bent poses in which shins or feet touch the other leg, where some of those drawn do; each of these the one most like the pose
    before, so that legs do not pass through each other in between."""
    found: list[Array] = []
    for key in keys.tolist():
        drawn = _bent(LEGS_TRIED, draw, 1.0)
        rotations = np.repeat(motion.rotations[key : key + 1], LEGS_TRIED, axis=0)
        rotations[:, [*TRUNK, *LEGS]] = drawn
        translations = np.repeat(motion.translations[key : key + 1], LEGS_TRIED, axis=0)
        seen = figures_of_pairs(replace(motion, rotations=rotations, translations=translations), field)
        nearest, deepest = seen[:, LOW, 0].max(axis=1), seen[:, LEG_PAIRS, 15].max(axis=1)
        good = np.flatnonzero((nearest > CLOSE) & (deepest < DEEPEST))
        if not len(good):
            found.append(drawn[(nearest - 10.0 * deepest).argmax()])
        elif not found:
            found.append(drawn[good[0]])
        else:
            found.append(drawn[good[np.abs((drawn[good] * found[-1]).sum(axis=2)).sum(axis=1).argmax()]])
    return np.stack(found)


def _bent(count: int, draw: np.random.Generator, crossed: float = CROSSED) -> Float[Array, "count joints 4"]:
    """Spines and legs: both legs alike or not, from straight to a deep crouch, apart or crossed, the trunk mostly with them."""
    vectors = np.zeros((count, len(TRUNK) + len(LEGS), 3))
    alike = draw.random(count) < 0.6
    depth = draw.beta(0.9, 1.1, (count, 2))
    depth[alike, 1] = depth[alike, 0]
    bow = draw.normal(0.25, 0.35, count) + 0.35 * depth.max(axis=1)
    vectors[:, : len(TRUNK), 0] = bow[:, None] / len(TRUNK)
    vectors[:, : len(TRUNK), 1:] = draw.normal(size=(count, 1, 2)) * np.radians([9.0, 6.0])
    apart = np.radians(np.where(draw.random(count) < crossed, draw.normal(-9.0, 6.0, count), draw.normal(10.0, 14.0, count)))
    for place, side in enumerate((1.0, -1.0)):
        thigh, shin, foot, _ = range(len(TRUNK) + 4 * place, len(TRUNK) + 4 * place + 4)
        lift = np.radians(115.0) * depth[:, place] + np.radians(draw.normal(0.0, 8.0, count))
        knee = np.clip(lift * draw.uniform(0.7, 1.5, count) + np.radians(5.0), 0.0, np.radians(150.0))
        vectors[:, thigh, 0] = -lift
        vectors[:, thigh, 1] = side * np.radians(draw.normal(8.0, 14.0, count))
        vectors[:, thigh, 2] = side * apart
        vectors[:, shin, 0] = knee
        vectors[:, foot, 0] = np.clip(lift - knee, -0.5, 0.3)
    return rot.from_rotation_vector(vectors)


def _keys(frames: int, draw: np.random.Generator) -> Int[Array, "keys"]:
    """Frames between which the body goes from pose to pose: about one a second."""
    count = max(2, round(frames * STRIDE / FPS * draw.uniform(0.7, 1.3)) + 1)
    return np.unique(np.round(np.linspace(0, frames - 1, count)).astype(int))


def _between(keys: Array, wanted: Float[Array, "keys joints 4"], frames: int) -> Float[Array, "frames joints 4"]:
    """From key to key with a rest at each."""
    place = np.clip(np.searchsorted(keys, np.arange(frames), side="right") - 1, 0, len(keys) - 2)
    share = (np.arange(frames) - keys[place]) / (keys[place + 1] - keys[place])
    share = np.clip((share - 0.2) / 0.6, 0.0, 1.0)
    share = (share * share * (3.0 - 2.0 * share))[:, None, None]
    turn = rot.to_rotation_vector(rot.multiply(rot.inverse(wanted[place]), wanted[place + 1]))
    return rot.multiply(wanted[place], rot.from_rotation_vector(share * turn))
