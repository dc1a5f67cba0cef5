"""What the bench of shape transfer runs on: poses of self-contact, given to bodies of other shape.

The poses are the embedded ones, performed by the source's body through `interaction` where it is not their own performer, on
the frame on which most of the pose touches. `PAIRS` were looked at while building; `HELD_OUT` were written down before
anything was measured on them, and are only reported.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float

from retarget.body.human import PRESETS, human
from retarget.body.kinematics import world_pose
from retarget.casting import cast
from retarget.character import Motion
from retarget.evaluate.contact_cases import embedded_actor
from retarget.evaluate.keepable import keepable_tracks
from retarget.evaluate.remeshed import clustered, collapsed
from retarget.evaluate.remeshed_body import remeshed_body
from retarget.evaluate.touch import SourceTouch, observe
from retarget.geometry.closest import Places
from retarget.geometry.resample import Surface
from retarget.motion.align import Actor
from retarget.motion.library import PERFORMER, embedded_motion
from retarget.motion.touch.mend import frames_of
from retarget.retargeting import prepare

POSES = (
    "hands_on_hips", "hand_on_belly", "arms_crossed", "hand_to_shoulder", "hands_behind_head", "clap", "legs_crossed",
    "squat_hands_on_knees",
)  # fmt: skip
APART = ("run", "walk")
"""Motions of no self-contact, timed only: on the first pair of bodies nothing touches, and the target collides in the second alone."""
PAIRS = (
    ("thin", "heavy"), ("thin", "very_heavy"), ("heavy", "thin"), ("average", "child"), ("average", "toddler"),
    ("man", "woman"),
)  # fmt: skip
HELD_OUT = (("average", "elderly"), ("muscular", "short"), ("tall", "heavy"))
SEQUENCES = (
    ("hands_on_hips", "thin", "heavy"), ("arms_crossed", "thin", "heavy"), ("squat_hands_on_knees", "average", "child"),
    ("walk", "thin", "very_heavy"),
)  # fmt: skip
FOREIGN = (("thin", "heavy"), ("average", "child"), ("man", "woman"))
"""Pairs whose source gets other triangles."""
QUICK_POSES, QUICK_PAIRS = ("hands_on_hips", "hand_to_shoulder"), (("thin", "heavy"), ("average", "toddler"))
FINER = 13_000
FOREIGN_VERTICES = 6_000
SEED = 7


@dataclass(frozen=True, eq=False)
class ShapeCase:
    """A posed source and the body that gets its pose."""

    pose: str
    source: Actor
    target: Actor
    names: tuple[str, str]
    touch: SourceTouch
    """Of the whole motion."""
    frame: int
    countable: Bool[np.ndarray, "tracks"] | None
    """Contact tracks that the target can keep at all, where that is known."""

    @property
    def motion(self) -> Motion:
        """The one frame."""
        return frames_of(self.touch.motion, np.array([self.frame]))

    @property
    def posed(self) -> Float[np.ndarray, "vertices 3"]:
        """The source's vertices, metres."""
        return self.touch.detector.skinner.vertices(*world_pose(self.motion))[0].astype(np.float64)


@lru_cache(maxsize=24)
def body(name: str, finer: bool = False) -> Actor:
    """An embedded body, with 6.9k vertices or `FINER`."""
    if not finer:
        return embedded_actor(name)
    surface, places = _finer()
    return cast(remeshed_body(human(name=name, **PRESETS[name]), surface.faces, places))


@lru_cache(maxsize=8)
def foreign_body(name: str) -> tuple[Actor, Places]:
    """The same body with triangles of its own, and where its vertices lie on the embedded one's."""
    surface, places = clustered(_mean(), FOREIGN_VERTICES, np.random.default_rng(SEED))
    return cast(remeshed_body(human(name=name, **PRESETS[name]), surface.faces, places)), places


@lru_cache(maxsize=1)
def _finer() -> tuple[Surface, Places]:
    return collapsed(_mean(), FINER, np.random.default_rng(SEED))


def _mean() -> Surface:
    mesh = human().mesh
    return Surface(mesh.vertices, mesh.faces)


@lru_cache(maxsize=64)
def performance(name: str, motion: str, finer: bool = False) -> SourceTouch:
    """An embedded motion on a body, and what it touches."""
    moving = embedded_motion(motion)
    if name != PERFORMER:
        moving = prepare(embedded_actor(PERFORMER), embedded_actor(name), "interaction")(moving).motion
    return observe(body(name, finer), moving)


def shape_case(pose: str, names: tuple[str, str], finer: bool = False) -> ShapeCase:
    """One case. The frame is the same whatever the mesh."""
    coarse = performance(names[0], pose)
    rows = coarse.pose_rows()
    frames = np.bincount(coarse.contacts.frame[rows], minlength=len(coarse.motion))
    touch = performance(names[0], pose, True) if finer else coarse
    countable = keepable_tracks(touch, pose, names[1]) if names[0] == PERFORMER and not finer else None
    return ShapeCase(pose, body(names[0], finer), body(names[1], finer), names, touch, int(frames.argmax()), countable)


def shape_cases(quick: bool) -> Iterator[tuple[str, str, ShapeCase]]:
    """Split ('seen', 'unseen'), mesh ('6k9', '13k') and case."""
    if quick:
        yield from (("seen", "6k9", shape_case(pose, pair)) for pair in QUICK_PAIRS for pose in QUICK_POSES)
        return
    for split, pairs in (("seen", PAIRS), ("unseen", HELD_OUT)):
        yield from ((split, "6k9", shape_case(pose, pair)) for pair in pairs for pose in POSES)
    yield from (("seen", "13k", shape_case(pose, pair, True)) for pair in PAIRS for pose in POSES)
