"""Every row of a scan case: who makes the target do what the capture shows, and how far that is from the truth."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.human import human_model
from retarget.body.kinematics import local_rotations, still_motion, world_pose
from retarget.body.skinning import prepare_skinning, rest_vertices, skin_motion
from retarget.casting import cast
from retarget.character import Character, Mesh, Motion, PointMotion
from retarget.errors import RetargetError
from retarget.evaluate import metrics
from retarget.evaluate.scan_cases import ScanCase
from retarget.live import LiveRetargeter
from retarget.methods import CopyRotations
from retarget.methods.scan.regressor import load_regressor
from retarget.methods.scan.scan_body import BODY, scan_body
from retarget.methods.scan.tracker import ready
from retarget.motion.align import Actor
from retarget.motion.deformation_transfer import prepare_deformation_transfer
from retarget.motion.joint_frames import prepare_frames
from retarget.performing import cast_scan
from retarget.retargeting import prepare

Array = np.ndarray

WEIGHTS = "RETARGET_REFERENCE_WEIGHTS"
"""Variable of the environment that names the folder of the paper's networks' weights, where they have been trained."""
CONTEXTS = (5, 10, 15, 30, 60)
"""Frames after which all is forgotten, in rows of their own (the paper's table 3)."""
WATCHED = 25
"""Frames between looks at the memory."""
COPIED = CopyRotations(one_rig=True, foot_lock=False, steady=False)
"""What the truth is made by: the pose alone. Feet that are held, and contacts, are another row."""
COPY, DEFORMATION = "copy of true rotations", "deformation transfer, true map"
REGRESSED, ONLINE, OURS, CONTACTS, BARE = (
    "ours, no fitting", "ours, online", "ours", "ours, contacts repaired", "ours, target without a rig",
)  # fmt: skip
PUBLISHED = "Rekik 2023, trained here"


@dataclass(frozen=True, eq=False)
class Shown:
    """What a row makes of a case: joints of the body and vertices of the target."""

    joints: Float[Array, "frames joints 3"]
    vertices: Float[Array, "frames vertices 3"]


def rows_of(case: ScanCase, bare: bool = False, contexts: bool = False) -> Iterator[tuple[dict[str, Any], Shown]]:
    """Figures and what was made, by every row; `bare` adds the target whose rig is found first, `contexts` rows that forget."""
    truth = shown(case.target, case.truth)
    source, target = cast(case.source), cast(case.target)

    def judged(method: str, made: Shown, seconds: float | None = None, **more: Any) -> tuple[dict[str, Any], Shown]:
        return {"method": method, "seconds": seconds} | errors(made, truth) | more, made

    copied = prepare(source, target, COPIED)(case.performed).motion
    yield judged(COPY, shown(case.target, copied))
    yield judged(DEFORMATION, _by_deformation(case))
    began = time.perf_counter()
    regressed = regressed_motion(case.capture)
    made = prepare(cast(regressed[0]), target, COPIED)(regressed[1]).motion
    yield judged(REGRESSED, shown(case.target, made), time.perf_counter() - began)
    for variant, networks in _published().items():
        began = time.perf_counter()
        made = Shown(*networks.retargeted(case.capture, case.target, truth.joints[0, 0]))
        hours = sum(networks.seconds.values()) / 3600
        spent = time.perf_counter() - began
        yield judged(f"{PUBLISHED}{variant and ': '}{variant}", made, spent, hours_trained=hours)
    for frames in (*CONTEXTS, len(case.capture)) if contexts else ():
        told = frames if frames in CONTEXTS else "all"
        yield judged(f"{ONLINE}, {told} frames", _forgetful(case, target, frames))
    seen = None
    for method, causal in ((ONLINE, True), (OURS, False)):
        began = time.perf_counter()
        try:
            seen = cast_scan(case.capture, causal=causal)
        except RetargetError as error:
            yield judged(method, stands_still(case), refused=str(error))
            continue
        made = prepare(seen.actor, target, COPIED)(seen.motion).motion
        spent = time.perf_counter() - began
        yield judged(
            method, shown(case.target, made), spent, flips_percent=flips_percent(seen.motion, case.performed),
            shown_percent=100 * float(seen.shown.mean()), actor_mpjpe=actor_error(seen.motion, case.performed),
        )  # fmt: skip
    if seen is None:
        return
    yield judged(CONTACTS, shown(case.target, prepare(seen, target)(seen.motion).motion))
    if bare:
        rigged = rigged_target(case.target)
        made = prepare(seen.actor, rigged, COPIED)(seen.motion).motion
        yield judged(BARE, shown(rigged.character, made, rigged))


def _forgetful(case: ScanCase, target: Actor, frames: int) -> Shown:
    """Online, with everything forgotten every so many frames, the actor's shape too."""
    parts = []
    for first in range(0, len(case.capture), frames):
        clouds = case.capture.clouds[first : first + frames]
        try:
            seen = cast_scan(replace(case.capture, clouds=clouds), causal=True)
            parts.append(shown(case.target, prepare(seen.actor, target, COPIED)(seen.motion).motion))
        except RetargetError:  # nobody found
            still = stands_still(case)
            parts.append(Shown(still.joints[: len(clouds)], still.vertices[: len(clouds)]))
    return Shown(np.concatenate([each.joints for each in parts]), np.concatenate([each.vertices for each in parts]))


@lru_cache(maxsize=1)
def _published() -> Mapping[str, Any]:
    """The paper's networks by variant, where `WEIGHTS` says that they are."""
    folder = os.environ.get(WEIGHTS)
    if not folder:
        return {}
    from retarget.evaluate.reference.scan_pipeline import load_published

    return load_published(Path(folder))


def stands_still(case: ScanCase) -> Shown:
    """What a refusal counts as: the target at rest, where it first stands."""
    still = still_motion(case.target.skeleton, len(case.truth), case.truth.fps)
    return shown(case.target, replace(still, translations=np.broadcast_to(case.truth.translations[:1], still.translations.shape)))


def shown(character: Character, motion: Motion, actor: Actor | None = None) -> Shown:
    """Joints and skin of a character in motion; `actor` names the joints of one that is not an embedded human."""
    names = human_model().joint_names[:BODY]
    joints = (actor or cast(character)).humanoid.joints
    return Shown(world_pose(motion)[1][:, [joints[name] for name in names]], skin_motion(character, motion))


def errors(made: Shown, truth: Shown) -> dict[str, float]:
    """The columns of the paper's table 4, metres."""
    return {
        "mpjpe": metrics.mpjpe(made.joints, truth.joints),
        "pa_mpjpe": metrics.pa_mpjpe(made.joints, truth.joints),
        "acc": metrics.acc(made.joints, truth.joints),
        "pa_acc": metrics.pa_acc(made.joints, truth.joints),
        "mpvd": metrics.mpvd(made.vertices, truth.vertices),
        "pa_mpvd": metrics.pa_mpvd(made.vertices, truth.vertices),
        "mdel": metrics.mdel(made.vertices[::5], truth.vertices[::5]),
    }


def _by_deformation(case: ScanCase) -> Shown:
    target = case.target
    transfer = prepare_deformation_transfer(
        rest_vertices(case.source), rest_vertices(target), target.mesh.faces
    )
    vertices = transfer.frames(skin_motion(case.source, case.performed).astype(np.float64))
    frames = prepare_frames(target)
    return Shown(np.stack([frames.of(each)[1][:BODY] for each in vertices]), vertices)


def regressed_motion(capture: PointMotion) -> tuple[Character, Motion]:
    """What the regressor says of every frame by itself, over an embedded human of the mean shape and the size it sees."""
    body, regressor = scan_body(), load_regressor()
    found = [regressor(ready(cloud)) for cloud in capture.clouds]
    places = np.stack([each.places for each in found])
    child, above = np.arange(1, BODY), body.parents[1:]
    lengths = [np.linalg.norm(each[..., child, :] - each[..., above, :], axis=-1).sum(axis=-1) for each in (places, body.joints)]
    shape = np.zeros(body.shapes)
    shape[-1] = np.clip(np.median(lengths[0]) / lengths[1], 0.3, 1.6) - 1.0
    character = body.character(shape)
    turns = np.tile(rot.IDENTITY, (len(found), len(character.skeleton), 1))
    turns[:, :BODY] = np.stack([each.turns for each in found])
    for joint in range(BODY, len(character.skeleton)):  # fingers go with their hands
        turns[:, joint] = turns[:, character.skeleton.parents[joint]]
    rotations = rot.continuous(local_rotations(character.skeleton.parents, turns))
    return character, Motion(character.skeleton, rotations, places[:, :1], capture.fps)


@lru_cache(maxsize=8)
def rigged_target(target: Character) -> Actor:
    """A target given as a bare mesh."""
    return cast(Mesh(target.mesh.vertices, target.mesh.faces))


def flips_percent(found: Motion, truth: Motion) -> float:
    """Per cent of frames on which the hips face the other way, or left and right are exchanged."""
    names = human_model().joint_names
    sides = [names.index(name) for name in ("leftUpperLeg", "rightUpperLeg", "leftUpperArm", "rightUpperArm")]
    across = [world_pose(motion)[1][:, sides] for motion in (found, truth)]
    agree = [
        ((across[0][:, a] - across[0][:, b]) * (across[1][:, a] - across[1][:, b])).sum(axis=1) > 0
        for a, b in ((0, 1), (2, 3))
    ]
    return 100 * float(1.0 - np.mean(agree[0] & agree[1]))


def actor_error(found: Motion, truth: Motion) -> float:
    """Mean distance of the followed actor's joints from the performer's, metres: before any retargeting."""
    return metrics.mpjpe(world_pose(found)[1][:, :BODY], world_pose(truth)[1][:, :BODY])


def online_cost(case: ScanCase, frames: int) -> dict[str, float]:
    """Milliseconds a frame from a cloud to the target's vertices; processor time of the second half over that of the first, which
    other work on the machine hardly changes; and memory gained: by the highest of the last third over the highest of the first,
    for what is resident swings by tens of MB with the collection of garbage."""
    live, skinner = LiveRetargeter(cast(case.target)), prepare_skinning(case.target)
    spent, worked, resident = [], [], []
    for number in range(frames):
        cloud = case.capture.clouds[_to_and_fro(number, len(case.capture))]
        began, busy = time.perf_counter(), time.process_time()
        made = live.step(cloud)
        if made.motion is not None:
            skinner.vertices(*world_pose(made.motion))
        spent.append(1000 * (time.perf_counter() - began))
        worked.append(time.process_time() - busy)
        if number % min(WATCHED, max(1, frames // 6)) == 0:
            resident.append(_resident_mb())
    settled, worked = (np.array(each[min(30, frames // 2) :]) for each in (spent, worked))
    third = max(1, len(resident) // 3)
    halves = np.median(worked[: len(worked) // 2]), np.median(worked[len(worked) // 2 :])
    return {
        "fps": 1000 / float(settled.mean()),
        "latency_ms_p50": float(np.percentile(settled, 50)),
        "latency_ms_p99": float(np.percentile(settled, 99)),
        "first_frame_ms": spent[0],
        "later_over_earlier": float(halves[1] / halves[0]),
        "memory_growth_mb": max(resident[-third:]) - max(resident[:third]),
    }


def _to_and_fro(number: int, count: int) -> int:
    """Frames forwards and backwards, so that a short capture is a long one without leaps."""
    place = number % max(2 * count - 2, 1)
    return min(place, 2 * count - 2 - place)


def _resident_mb() -> float:
    """Memory of this process, MB; 0 where the system does not tell."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * 4096 / 1e6
    except (OSError, ValueError):
        return 0.0
