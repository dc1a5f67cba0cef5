"""The open benchmark set: who performs what on which body, and what was looked at while building.

The splits are those of Ye 2024: seen or unseen character x seen or unseen motion. They were written down before anything
was measured or trained on them; nothing may be tuned or trained on what is unseen.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

from retarget.body.human import PRESETS, human
from retarget.casting import cast
from retarget.character import Motion
from retarget.errors import RetargetError
from retarget.evaluate.cases import data_folder, real_files
from retarget.io import load
from retarget.motion.align import Actor
from retarget.motion.filter import cut, resample
from retarget.motion.library import PERFORMER, embedded_motion, motion_names
from retarget.retargeting import prepare

log = logging.getLogger("retarget")

SPLITS = ("sc_sm", "sc_um", "uc_sm", "uc_um")
"""Seen (s) or unseen (u) character (c) and motion (m)."""
SEEN_TARGETS = ("heavy", "child", "muscular", "average")
UNSEEN_TARGETS = ("very_heavy", "tall", "toddler", "elderly")
SEEN_MOTIONS = ("demo", "walk", "jump", "wave", "hands_on_hips", "hand_on_belly", "arms_crossed")
UNSEEN_MOTIONS = (
    "run",
    "turn",
    "hand_to_shoulder",
    "hands_behind_head",
    "clap",
    "legs_crossed",
    "squat_hands_on_knees",
)
CAPTURED = {"02_10": "s", "05_06": "s", "05_14": "s", "06_14": "u", "13_07": "u", "13_09": "u", "14_17": "u"}
"""Captured clips with self-contact (CMU), where they are at hand: performed by the embedded human `STAND_IN`, because their
files have no surface."""
STAND_IN = "thin"
LONGEST = 8.0
"""Seconds that are taken of a captured clip, from its middle."""
FOREIGN = ("Barbarian", "Knight", "manny_med_mod", "mannequiny", "riggedMesh")
"""Real characters that results are judged on through sensors; only reported, in no split."""
FPS = 30.0

QUICK_TARGETS = ("heavy", "toddler")
QUICK_MOTIONS = ("hands_on_hips", "hand_to_shoulder")


@dataclass(frozen=True, eq=False)
class Performance:
    """A motion on the body that performs it."""

    name: str
    source: Actor
    motion: Motion
    """In the source actor's space, 30 frames a second."""


@dataclass(frozen=True, eq=False)
class ContactCase:
    """One performance for one body."""

    performance: Performance
    target_name: str
    target: Actor
    split: str


@lru_cache(maxsize=16)
def embedded_actor(preset: str) -> Actor:
    """An embedded body, ready."""
    return cast(human(name=preset, **PRESETS[preset]))


def performances(quick: bool) -> Iterator[Performance]:
    """Embedded motions on their own performer, then captured ones."""
    source = embedded_actor(PERFORMER)
    for name in QUICK_MOTIONS if quick else motion_names():
        yield Performance(name, source, embedded_motion(name))
    if not quick:
        yield from _captured()


def _captured() -> Iterator[Performance]:
    folder = data_folder()
    if folder is None:
        return
    stand_in = embedded_actor(STAND_IN)
    for name in CAPTURED:
        path = folder / "motions" / "cmu_daz" / f"{name}.bvh"
        try:
            asset = load(path)
            motion = asset.motion()
            performer = cast(asset, motion=motion)
        except RetargetError as error:
            log.warning("left out: %s", error)
            continue
        motion = resample(motion, FPS)
        middle = 0.5 * motion.seconds
        motion = cut(motion, max(middle - 0.5 * LONGEST, 0.0), min(middle + 0.5 * LONGEST, motion.seconds))
        on_body = prepare(performer, stand_in, "copy-rotations")(motion).motion
        yield Performance(name, stand_in, replace(on_body, name=name))


def cases_of(performance: Performance, quick: bool) -> Iterator[ContactCase]:
    """The performance for every body of the set but its own."""
    for name in QUICK_TARGETS if quick else SEEN_TARGETS + UNSEEN_TARGETS:
        yield ContactCase(performance, name, embedded_actor(name), split_of(name, performance.name))


def foreign_actors() -> Iterator[tuple[str, Actor]]:
    """Characters of other makers, where they are at hand: other proportions, other topology."""
    for path in real_files(".glb", ".gltf"):
        if path.stem in FOREIGN:
            try:
                yield path.stem, cast(load(path))
            except RetargetError as error:
                log.warning("left out: %s", error)


def split_of(target: str, motion: str) -> str:
    """'sc_um': seen character, unseen motion, and so on."""
    seen_motion = motion in SEEN_MOTIONS or CAPTURED.get(motion) == "s"
    return f"{'s' if target in SEEN_TARGETS else 'u'}c_{'s' if seen_motion else 'u'}m"
