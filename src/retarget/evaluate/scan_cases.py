"""Captures whose true motion is known: unseen bodies that perform unseen motions, sampled or scanned, and who they drive.

The protocol of Rekik 2023 (section 4) on open data: four bodies by four motions naked, four by three clothed; theirs are SMPL
bodies and Mixamo's motions. Ours besides: the same seen by the virtual scanner, with noise, holes and strays. The truth is the
same joint rotations on the body that is driven, and the hips' path in proportion to the length of its legs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from retarget.body.human import human
from retarget.body.skinning import skin_motion
from retarget.character import Character, Motion, PointMotion
from retarget.contact.support import leg_length
from retarget.correspond.joints import match_humanoid
from retarget.evaluate.scan_split import (
    BENCH_BODIES,
    BENCH_CLOTHED,
    BENCH_NAKED,
    BENCH_TARGETS,
    drawn_shape,
)
from retarget.geometry.capture import Scanner, prepare_studio
from retarget.geometry.clothes import dressed
from retarget.geometry.sampling import sample_surface
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion, performer

Array = np.ndarray

NAKED, CLOTHED, SCANNED = "naked", "clothed", "scan"
POINTS = 6890
"""Of every frame: as many as the paper's bodies have vertices."""
SECONDS = 3.0
"""Of every motion."""
SCANNER = Scanner(points=POINTS, noise=0.004, holes=0.4, outliers=0.3, floor=True)
"""Four cameras that see noise, holes, strays and pieces of the floor."""
CLEAN = Scanner(cameras=8, points=POINTS, noise=0.0, steps=0.0)
"""All around and without faults: of clothed bodies, whose skin beneath the clothes nobody sees."""
QUICK_CASES = 2
"""Of each kind in the quick run."""


@dataclass(frozen=True, eq=False)
class ScanCase:
    """A capture, what it is of, and what the body it drives should do."""

    kind: str
    """`NAKED`, `CLOTHED` or `SCANNED`."""
    name: str
    source: Character
    """Who was captured, without clothes."""
    performed: Motion
    """What they did, over their skeleton."""
    target: Character
    truth: Motion
    """The same over the target's."""
    capture: PointMotion


def scan_cases(kind: str, quick: bool = False) -> Iterator[ScanCase]:
    """All cases of a kind; `SCANNED` ones are those of the other two seen by the scanner."""
    worn = (False, True) if kind == SCANNED else (kind == CLOTHED,)
    found = [
        (clothed, body, number)
        for clothed in worn
        for body in range(len(BENCH_BODIES))
        for number in range(len(_motions(clothed)))
    ]
    every = len(found) // QUICK_CASES if quick else 1
    for case in found[::every][: QUICK_CASES if quick else None]:
        yield scan_case(kind, *case)


def _motions(clothed: bool) -> tuple[str, ...]:
    return BENCH_CLOTHED if clothed else BENCH_NAKED


def scan_case(kind: str, clothed: bool, body: int, number: int) -> ScanCase:
    """The capture of one of `BENCH_BODIES` in one of the motions, both by their places there; each motion drives another body."""
    source, motion = unseen_body(BENCH_BODIES[body]), _motions(clothed)[number]
    target = unseen_body(BENCH_TARGETS[(body + number) % len(BENCH_TARGETS)])
    shown = embedded_motion(motion)
    shown = cut(shown, 0.0, min(SECONDS, shown.seconds))
    performed, truth = (performed_by(each, shown) for each in (source, target))
    worn = dressed(source, seed=BENCH_BODIES[body]) if clothed else source
    name = f"{source.name}{', clothed' if clothed else ''}: {motion} to {target.name}"
    surface, faces, seed = skin_motion(worn, performed), worn.mesh.faces, BENCH_BODIES[body]
    if kind == NAKED:
        capture = sampled(surface, faces, shown.fps, seed)
    else:
        capture = scanned(SCANNER if kind == SCANNED else CLEAN, surface, faces, shown.fps, seed)
    return ScanCase(kind, name, source, performed, target, truth, capture)


@lru_cache(maxsize=16)
def unseen_body(seed: int) -> Character:
    """The embedded human of a seed of the split."""
    return human(name=f"body {seed}", **drawn_shape(seed))


def performed_by(body: Character, motion: Motion) -> Motion:
    """An embedded motion's joint rotations on another embedded body: its hips go as far, and as far up and down from where they
    rest, as its legs are longer (metres)."""
    skeletons = body.skeleton, performer().skeleton
    legs = [leg_length(each, match_humanoid(each)) for each in skeletons]
    rests = [np.array([0.0, each.offsets[0, 1], 0.0]) for each in skeletons]
    path = rests[0] + (motion.translations - rests[1]) * (legs[0] / legs[1])
    return replace(motion, skeleton=body.skeleton, translations=path)


def sampled(surface: Float[Array, "frames vertices 3"], faces: Array, fps: float, seed: int) -> PointMotion:
    """`POINTS` points of the surface on each frame, evenly by area, anew every time."""
    clouds = tuple(
        sample_surface(frame, faces, POINTS, seed=(seed, number)).astype(np.float32)
        for number, frame in enumerate(surface.astype(np.float64))
    )
    return PointMotion(clouds, fps)


def scanned(
    scanner: Scanner, surface: Float[Array, "frames vertices 3"], faces: Array, fps: float, seed: int
) -> PointMotion:
    """What a scanner sees of it."""
    studio = prepare_studio(scanner, surface, faces, seed)
    return PointMotion(tuple(studio.scan(frame, faces, (seed, number)) for number, frame in enumerate(surface)), fps)
