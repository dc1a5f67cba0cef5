"""Pairs that the interaction network learns from: performances, other bodies, and what the solver makes of them there.

A take is one performer, a few clips, a few targets. Clips are of the seen half of the open set (`evaluate/contact_cases.py`, which
was written down before anything was trained) and of recordings in neither half, as they are or with what `train/performances.py`
makes of them. Performances are first mended on the performer, so that little is inside anything. Bodies are drawn by the seeds of
`evaluate/scan_split.py`; half of the performers are the embedded `thin`, and some targets are characters of other makers. Every
take is a function of its number.

Kept of each frame are both poses, the solver's correction, with distances of hands weighed more (`train/interaction_distances.py`), and
the matrix of the problem there: how much each way of missing the correction matters (the trap is a network that misses contacts by
little everywhere; see `train/interaction.py`).
"""

from __future__ import annotations

import logging
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float

from retarget.body.human import PRESETS, human
from retarget.body.kinematics import local_positions, world_pose
from retarget.casting import cast
from retarget.character import Motion
from retarget.evaluate.contact_cases import STAND_IN
from retarget.evaluate.scan_split import TRAINING, VALIDATION, drawn_shape
from retarget.io import load
from retarget.methods.interaction.looker import prepare_looker
from retarget.methods.interaction.method import Interaction
from retarget.motion.align import Actor
from retarget.motion.touch.faults import needs
from retarget.motion.touch.mend import frames_of, solve_clip
from retarget.motion.touch.solve import CALM, PRIOR
from retarget.train.interaction_distances import with_distances
from retarget.train.performances import clips_of, drawn_performance

Array = np.ndarray
log = logging.getLogger("retarget")

CLIPS, TARGETS = 10, 3
"""Of a take."""
STRANGERS = (
    "characters/quaternius/Male_Casual.fbx", "characters/quaternius/Animated_Woman.fbx", "characters/quaternius/Female_Dress.fbx",
    "characters/geno/Geno_bind.fbx", "characters/fbx/maya_kenney_character_7700_binary.fbx",
)  # fmt: skip
"""Characters of other makers that are targets too, below the folder of data; none of those that results are judged on."""
STRANGE = 0.3
"""Their share of the targets."""
IDLE = 0.3
"""Share that is kept of the frames on which nothing needs to be mended."""
SEEDS = {TRAINING: (0, 700), VALIDATION: (8000, 8032)}


Body = dict[str, float | str]
"""An embedded body by its shape, or `{"file": ...}`, a character by its path below the folder of data."""


@dataclass(frozen=True, eq=False)
class Take:
    """Frames of one performer and one target."""

    source: Body
    target: Body
    performed: Motion
    copied: Motion
    turned: Float[Array, "frames unknowns"]
    """The solver's corrections, as `methods/interaction/unknowns.py` has them, with more weight on distances of hands."""
    matters: Float[Array, "frames triangle"]
    """The lower triangle of the problem's matrix there, for the same numbers: half precision."""


def make_takes(which: str, number: int, data: Path | None) -> list[Take]:
    """The takes of a number: `CLIPS` clips for each of `TARGETS` bodies."""
    draw = np.random.default_rng([number, 31, which == VALIDATION])
    performer = _shape(which, draw, 0.5)
    bodies = [_target(which, draw, data) for _ in range(TARGETS)]
    source = body_of(performer, data)
    clips = clips_of(which, data)
    pairs = [_Pair(source, body_of(body, data)) for body in bodies]
    mend = Interaction(keep_depth=False, foot_lock=False).prepare(source, source)
    field, found = prepare_looker(source, source).field, []
    for _ in range(CLIPS):
        motion = mend(drawn_performance(clips, source, field, draw)).motion
        found += [pair.take(motion, performer, body, draw) for body, pair in zip(bodies, pairs)]
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
            stored[f"{name}_{place}"] = np.array(sorted(getattr(take, name).items()), dtype=object).astype(str)
    part = path.with_suffix(".part.npz")
    np.savez(part, **stored)
    part.rename(path)
    return number


class _Pair:
    """A performer and a target, with the solver between them."""

    def __init__(self, source: Actor, target: Actor) -> None:
        self.prepared = Interaction().prepare(source, target)
        self.looker = prepare_looker(source, target)

    def take(self, motion: Motion, source: Body, target: Body, draw: np.random.Generator) -> Take:
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
        unknowns = self.looker.unknowns
        turned, matters = unknowns.from_solver(x[chosen], world), unknowns.matrix(np.stack(matters), world)
        performed, copies = (frames_of(each, chosen) for each in (motion, frames))
        turned, matters = with_distances(self.looker, performed, copies, turned, matters, need[chosen])
        rows, columns = np.tril_indices(matters.shape[1])
        return Take(source, target, performed, copies, turned, matters[:, rows, columns].astype(np.float16))


def body_of(body: Body, data: Path | None) -> Actor:
    """The body itself. Raises `FileError` for a character that is not there."""
    if "file" in body:
        return _character(Path(data or ".") / str(body["file"]))
    return cast(human(**{name: float(value) for name, value in body.items()}))


@lru_cache(maxsize=len(STRANGERS))
def _character(path: Path) -> Actor:
    return cast(load(path))


def _target(which: str, draw: np.random.Generator, data: Path | None) -> Body:
    if draw.random() < STRANGE and data is not None and which == TRAINING:
        return {"file": STRANGERS[int(draw.integers(len(STRANGERS)))]}
    return _shape(which, draw, 0.0)


def _shape(which: str, draw: np.random.Generator, thin: float) -> Body:
    if draw.random() < thin:
        return dict(PRESETS[STAND_IN])
    return drawn_shape(int(draw.integers(*SEEDS[which])))
