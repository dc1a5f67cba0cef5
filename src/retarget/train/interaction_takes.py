"""Pairs that the interaction network learns from: performances, other bodies, and what the solver makes of them there.

A take is one performer, a few clips, a few targets. Clips are of the seen half of the open set (`evaluate/contact_cases.py`, which
was written down before anything was trained) and of recordings in neither half; nearly half of them get arms that wander from
place to place on the body, and some get other legs: clips with self-contact are few. Performances are first mended on the
performer, so that nothing is inside anything. Bodies are drawn by the seeds of `evaluate/scan_split.py`; half of the performers
are the embedded `thin`. Every take is a function of its number.

Kept of each frame are both poses, the solver's correction, and the matrix of the problem there: how much each way of missing the
correction matters (the trap is a network that misses contacts by little everywhere; see `train/interaction.py`).
"""

from __future__ import annotations

import logging
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.human import PRESETS, human
from retarget.body.kinematics import local_positions, world_pose
from retarget.casting import cast
from retarget.character import Motion
from retarget.contact.part_field import FIGURES, PAIRS, PartField
from retarget.errors import RetargetError
from retarget.evaluate.contact_cases import CAPTURED, SEEN_MOTIONS, STAND_IN
from retarget.evaluate.scan_split import TRAINING, VALIDATION, drawn_shape
from retarget.methods.interaction.looker import prepare_looker
from retarget.methods.interaction.method import Interaction
from retarget.motion.align import Actor
from retarget.motion.library import embedded_motion
from retarget.motion.touch.faults import needs
from retarget.motion.touch.mend import frames_of, solve_clip
from retarget.motion.touch.solve import CALM, PRIOR
from retarget.train.poses import ARMS, FPS, LEGS, copied_clips, drawn_arms, other_side

Array = np.ndarray
log = logging.getLogger("retarget")

FOLDERS = ("motions/cmu_daz", "motions/animated_drawings", "motions/makehuman")
HELD_BACK = ("01_01", "06_01", "10_04", "11_01", "fair1_dab")
"""Recordings for validation."""
CLIPS, TARGETS = 10, 3
"""Of a take."""
LONGEST, STRIDE = 8.0, 5
"""Seconds that are taken of a clip, and of how many frames one: neighbours have little to teach."""
SHORTEST = 30
"""Frames of a clip at least."""
WANDERING, KICKING = 0.45, 0.12
"""Shares of clips with made-up arms, and legs."""
CLOSE, DEEPEST = 0.15, 0.06
"""A made-up hand is so close to some other part, mostly (`part_field_kernels`: one where surfaces meet), and no arm deeper in
anything, in shares of the height: the mending takes it out."""
TRIES = 40
"""Arms that are drawn until one touches."""
IDLE = 0.3
"""Share that is kept of the frames on which nothing needs to be mended."""
HANDS = [number for number, (own, _) in enumerate(PAIRS) if own.endswith("Hand")]
ARM_PAIRS = [number for number, (own, _) in enumerate(PAIRS) if "Arm" in own or "Hand" in own]
SEEDS = {TRAINING: (0, 700), VALIDATION: (8000, 8032)}


@dataclass(frozen=True, eq=False)
class Take:
    """Frames of one performer and one target."""

    source_shape: dict[str, float]
    target_shape: dict[str, float]
    performed: Motion
    copied: Motion
    turned: Float[Array, "frames unknowns"]
    """The solver's corrections, as `methods/interaction/unknowns.py` has them."""
    matters: Float[Array, "frames triangle"]
    """The lower triangle of the problem's matrix there, for the same numbers: half precision."""


@lru_cache(maxsize=4)
def clips_of(which: str, data: Path | None) -> tuple[Motion, ...]:
    """Clips of a set on the embedded human, 30 frames a second (nearly). Without `data` validation has the seen embedded clips too: its
    bodies are others."""
    held_back = which == VALIDATION
    found = [] if held_back and data is not None else [replace(embedded_motion(name), name=name) for name in SEEN_MOTIONS]
    unseen = {name for name, half in CAPTURED.items() if half == "u"}
    for folder in FOLDERS if data is not None else ():
        for path in sorted((data / folder).glob("*.bvh")):
            if path.stem not in unseen and (path.stem in HELD_BACK) == held_back:
                found += copied_clips(path, human())
    found = [clip for clip in found if len(clip) >= SHORTEST]
    if not found:
        raise RetargetError(f"no recorded motions for {which} below {data}")
    return tuple(found)


def make_takes(which: str, number: int, data: Path | None) -> list[Take]:
    """The takes of a number: `CLIPS` clips for each of `TARGETS` bodies."""
    draw = np.random.default_rng([number, 31, which == VALIDATION])
    shapes = [_shape(which, draw, 0.5)] + [_shape(which, draw, 0.0) for _ in range(TARGETS)]
    source, *targets = (cast(human(**shape)) for shape in shapes)
    clips = clips_of(which, data)
    prepared = [_Pair(source, target) for target in targets]
    mend = Interaction(keep_depth=False, foot_lock=False).prepare(source, source)
    field, found = prepare_looker(source, source).field, []
    for _ in range(CLIPS):
        clip = _stretch(clips[_likely(clips, draw)], draw)
        motion = _performed(_mirrored(clip) if draw.random() < 0.5 else clip, source)
        motion = mend(_made_up(motion, field, draw)).motion
        for shape, pair in zip(shapes[1:], prepared):
            found.append(pair.take(motion, shapes[0], shape, draw))
    return found


def keep_takes(which: str, count: int, data: Path | None, cache: Path, workers: int) -> list[Path]:
    """Files of the first `count` takes of a set; those that are not there yet are made, side by side."""
    cache.mkdir(parents=True, exist_ok=True)
    paths = [cache / f"takes_{which}_{number:04d}.npz" for number in range(count)]
    missing = [number for number, path in enumerate(paths) if not path.exists()]
    if missing:
        with ProcessPoolExecutor(workers) as pool:
            for number in pool.map(_kept, *zip(*((which, number, data, paths[number]) for number in missing))):
                log.info("takes %d of %d (%s)", number + 1, count, which)
    return paths


def _kept(which: str, number: int, data: Path | None, path: Path) -> int:
    stored = {}
    for place, take in enumerate(make_takes(which, number, data)):
        for name in ("performed", "copied"):
            motion = getattr(take, name)
            stored |= {f"{name}_{place}": motion.rotations.astype(np.float32), f"{name}_path_{place}": motion.translations}
        stored |= {f"turned_{place}": take.turned.astype(np.float32), f"matters_{place}": take.matters}
        for name in ("source", "target"):
            stored[f"{name}_{place}"] = np.array(sorted(getattr(take, f"{name}_shape").items()), dtype=object).astype("U24")
    part = path.with_suffix(".part.npz")
    np.savez(part, **stored)
    part.rename(path)
    return number


class _Pair:
    """A performer and a target, with the solver between them."""

    def __init__(self, source: Actor, target: Actor) -> None:
        self.prepared = Interaction().prepare(source, target)
        self.unknowns = prepare_looker(source, target).unknowns

    def take(self, motion: Motion, source_shape: dict[str, float], target_shape: dict[str, float], draw: np.random.Generator) -> Take:
        """The solver's work on a clip."""
        prepared = self.prepared
        solver, equations = prepared.solver, prepared.solver.equations
        copied = prepared.copier.clip(motion)
        frames = frames_of(copied.motion, np.arange(len(motion)))
        touching = None if copied.contacts is None else copied.contacts.touching
        _, goals = prepared.goals.clip(motion, frames, equations, touching)
        x = solve_clip(solver, frames, goals, motion.fps)
        offsets = local_positions(frames.skeleton, frames.translations, frames.moved)
        need = needs(equations, frames, offsets, goals)
        chosen = np.flatnonzero((need > 0) | (draw.random(len(x)) < IDLE))
        chosen = chosen if len(chosen) else np.zeros(1, dtype=int)
        matters = []
        for f in chosen:
            matrix = np.zeros((len(x[f]), len(x[f])))
            if need[f] > 0:
                matrix = equations.linearise(frames.rotations[f], offsets[f], goals.frame(f).weakened(need[f]), x[f]).matrix
            prior = PRIOR * (solver.stiffness + CALM * (1.0 - need[f]) * solver.inertia)
            matters.append(matrix + np.diag(prior))
        world = world_pose(frames)[0][chosen]
        turned = self.unknowns.from_solver(x[chosen], world)
        matters = self.unknowns.matrix(np.stack(matters), world)
        rows, columns = np.tril_indices(matters.shape[1])
        return Take(
            source_shape, target_shape, frames_of(motion, chosen), frames_of(frames, chosen), turned,
            matters[:, rows, columns].astype(np.float16),
        )  # fmt: skip


def _shape(which: str, draw: np.random.Generator, thin: float) -> dict[str, float]:
    if draw.random() < thin:
        return dict(PRESETS[STAND_IN])
    return drawn_shape(int(draw.integers(*SEEDS[which])))


def _likely(clips: tuple[Motion, ...], draw: np.random.Generator) -> int:
    """A clip; those of the embedded library, which touch most, are drawn as often as all recordings."""
    embedded = sum(clip.name in SEEN_MOTIONS for clip in clips)
    if embedded and draw.random() < 0.5:
        return int(draw.integers(embedded))
    return int(draw.integers(embedded, len(clips))) if len(clips) > embedded else int(draw.integers(embedded))


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


def _made_up(motion: Motion, field: PartField, draw: np.random.Generator) -> Motion:
    """Some clips with arms from place to place, or other legs."""
    rotations = motion.rotations.copy()
    if draw.random() < WANDERING:
        both = draw.random() < 0.6
        arms = list(ARMS) if both else list(ARMS[:4] if draw.random() < 0.5 else ARMS[4:])
        keys = _keys(len(motion), draw)
        wanted = np.stack([_touching_arms(replace(motion, rotations=rotations), key, field, draw) for key in keys.tolist()])
        rotations[:, arms] = _between(keys, wanted[:, [ARMS.index(arm) for arm in arms]], len(motion))
    if draw.random() < KICKING:
        keys = _keys(len(motion), draw)
        spread = np.radians([25.0, 20.0, 12.0, 5.0] * 2)[:, None] * [1.0, 0.7, 0.7]
        more = _between(keys, rot.from_rotation_vector(draw.normal(size=(len(keys), 8, 3)) * spread), len(motion))
        rotations[:, LEGS] = rot.multiply(rotations[:, LEGS], more)
    return replace(motion, rotations=rotations)


def _keys(frames: int, draw: np.random.Generator) -> Array:
    """Frames between which the body goes from pose to pose: about one a second."""
    count = max(2, round(frames * STRIDE / FPS * draw.uniform(0.7, 1.3)) + 1)
    return np.unique(np.round(np.linspace(0, frames - 1, count)).astype(int))


def _touching_arms(motion: Motion, frame: int, field: PartField, draw: np.random.Generator) -> Float[Array, "arms 4"]:
    """Arms with which a hand, or a forearm, comes near the body in a frame, where some of those drawn do; any arms now and then."""
    arms = drawn_arms(TRIES, draw)
    if draw.random() < 0.2:
        return arms[0]
    tried = np.repeat(motion.rotations[frame : frame + 1], TRIES, axis=0)
    tried[:, ARMS] = arms
    pose = replace(motion, rotations=tried, translations=np.repeat(motion.translations[frame : frame + 1], TRIES, axis=0))
    placed = world_pose(pose)
    seen = field.figures(field.source(*placed), *placed)[:, : len(PAIRS) * FIGURES].reshape(TRIES, len(PAIRS), FIGURES)
    nearest, deepest = seen[:, HANDS, 0].max(axis=1), seen[:, ARM_PAIRS, 15].max(axis=1)
    good = np.flatnonzero((nearest > CLOSE) & (deepest < DEEPEST))
    return arms[good[0]] if len(good) else arms[(nearest - 10.0 * deepest).argmax()]


def _between(keys: Array, wanted: Float[Array, "keys joints 4"], frames: int) -> Float[Array, "frames joints 4"]:
    """From key to key with a rest at each."""
    place = np.clip(np.searchsorted(keys, np.arange(frames), side="right") - 1, 0, len(keys) - 2)
    share = (np.arange(frames) - keys[place]) / (keys[place + 1] - keys[place])
    share = np.clip((share - 0.2) / 0.6, 0.0, 1.0)
    share = (share * share * (3.0 - 2.0 * share))[:, None, None]
    turn = rot.to_rotation_vector(rot.multiply(rot.inverse(wanted[place]), wanted[place + 1]))
    return rot.multiply(wanted[place], rot.from_rotation_vector(share * turn))
