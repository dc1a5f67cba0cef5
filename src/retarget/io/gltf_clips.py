"""Animations of a glTF document: listed without decoding, sampled on an even time grid on demand.

glTF 2.0 specification, section 3.11 and appendix C (interpolation).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.character import Motion, Skeleton
from retarget.io.asset import Clip
from retarget.io.gltf_document import Document
from retarget.io.gltf_nodes import Rig
from retarget.io.provenance import recorded_provenance
from retarget.io.timeline import Timeline, timeline

Array = np.ndarray

WIDTHS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3"}


def key_times(document: Document, accessor: int) -> Float[Array, "keys"]:
    """Key times of a sampler, seconds. Raises `FileError` if there are none or they run backwards."""
    if accessor in document.key_times:
        return document.key_times[accessor]
    times = document.floats(accessor, ("SCALAR",))[:, 0]
    place = f"accessors[{accessor}]"
    if not len(times):
        raise document.fail("an animation has no keys", place)
    if (np.diff(times) < 0).any() or times[0] < 0:
        raise document.fail("key times must not be negative nor run backwards", place)
    document.key_times[accessor] = times
    return times


def clip_inputs(document: Document, number: int, nodes: set[int]) -> frozenset[int]:
    """Accessors of the key times by which an animation moves the nodes."""
    animation = document.json["animations"][number]
    return frozenset(
        animation["samplers"][channel["sampler"]]["input"]
        for channel in animation["channels"]
        if channel["target"].get("node") in nodes and channel["target"]["path"] in ("translation", "rotation")
    )


def clip_timeline(document: Document, inputs: frozenset[int]) -> Timeline:
    """The grid of all keys in these accessors."""
    return timeline(np.unique(np.concatenate([key_times(document, accessor) for accessor in inputs])))


def list_clips(document: Document, rig: Rig) -> tuple[tuple[Clip, ...], list[int], list[str]]:
    """Clips that move the skeleton, the animation behind each, and notes about those passed over."""
    clips, numbers, notes = [], [], []
    grids: dict[frozenset[int], Timeline] = {}
    nodes = {int(node) for node in rig.nodes}
    for number, animation in enumerate(document.entries("animations")):
        name = animation.get("name") or f"clip_{number}"
        inputs = clip_inputs(document, number, nodes)
        if not inputs:
            notes.append(f"animation {name!r} moves no joint of the skeleton and is left out")
            continue
        if inputs not in grids:
            grids[inputs] = clip_timeline(document, inputs)
        grid = grids[inputs]
        clips.append(Clip(name, grid.frames, grid.fps, recorded_provenance(animation.get("extras"))))
        numbers.append(number)
    return tuple(clips), numbers, notes


def channel_values(
    document: Document, animation: int, channel: int
) -> tuple[int, str, Float[Array, "rows components"]]:
    """Input accessor, interpolation and output rows of one channel, their number checked against the keys."""
    entry = document.json["animations"][animation]
    target = entry["channels"][channel]["target"]["path"]
    sampler = entry["samplers"][entry["channels"][channel]["sampler"]]
    mode = sampler.get("interpolation", "LINEAR")
    values = document.floats(sampler["output"], (WIDTHS[target],))
    wanted = len(key_times(document, sampler["input"])) * (3 if mode == "CUBICSPLINE" else 1)
    if len(values) != wanted:
        place = f"animations[{animation}].channels[{channel}]"
        raise document.fail(f"has {len(values)} values where its keys need {wanted}", place)
    return sampler["input"], mode, values


def moving_nodes(document: Document, candidates: set[int]) -> set[int]:
    """Those of the nodes whose translation or rotation some animation really changes, against their own transform."""
    moving: set[int] = set()
    for number, animation in enumerate(document.entries("animations")):
        for position, channel in enumerate(animation["channels"]):
            node, path = channel["target"].get("node"), channel["target"]["path"]
            if node not in candidates or node in moving or path not in ("translation", "rotation"):
                continue
            entry = document.json["nodes"][node]
            own = np.array(entry.get(path, (0, 0, 0) if path == "translation" else rot.IDENTITY), float)
            _, mode, values = channel_values(document, number, position)
            values = values[1::3] if mode == "CUBICSPLINE" else values
            change = np.abs(values - own).max() if path == "translation" else (1 - np.abs(values @ own)).max()
            if "matrix" in entry or change > 1e-6 * max(1.0, np.abs(own).max()):
                moving.add(node)
    return moving


def scaling_joints(document: Document, rig: Rig) -> list[int]:
    """Joints that some animation scales differently from their node, which rigid joints cannot follow."""
    joint_of = {int(node): joint for joint, node in enumerate(rig.nodes)}
    found: set[int] = set()
    seen: set[tuple[int, int]] = set()
    for number, animation in enumerate(document.entries("animations")):
        for position, channel in enumerate(animation["channels"]):
            joint = joint_of.get(channel["target"].get("node"))
            if channel["target"]["path"] != "scale" or joint is None or joint in found:
                continue
            key = joint, animation["samplers"][channel["sampler"]]["output"]
            if key in seen:
                continue
            seen.add(key)
            own = np.array(document.json["nodes"][channel["target"]["node"]].get("scale", (1, 1, 1)), float)
            _, mode, values = channel_values(document, number, position)
            if mode == "CUBICSPLINE":
                values = values[1::3]
            if np.abs(values - own).max() > 1e-3 * np.abs(own).max():
                found.add(joint)
    return sorted(found)


def read_motion(document: Document, rig: Rig, skeleton: Skeleton, number: int) -> Motion:
    """Sample one animation over the skeleton. Raises `FileError` for channels without their data or absurd lengths."""
    animation = document.json["animations"][number]
    name = animation.get("name") or f"clip_{number}"
    joint_of = {int(node): joint for joint, node in enumerate(rig.nodes)}
    grid = clip_timeline(document, clip_inputs(document, number, set(joint_of)))
    groups: dict[tuple[str, int, str], list[tuple[int, Array]]] = {}
    rows = 0
    for position, channel in enumerate(animation["channels"]):
        joint, path = joint_of.get(channel["target"].get("node")), channel["target"]["path"]
        if joint is None or path not in ("translation", "rotation"):
            continue
        accessor, mode, values = channel_values(document, number, position)
        groups.setdefault((path, accessor, mode), []).append((joint, values))
        rows += len(values)
        if max(rows, grid.frames * len(skeleton)) > document.room:
            problem = f"the clip {name!r} claims {grid.frames / grid.fps:.3g} seconds, more than its data can fill"
            raise document.fail(problem, f"animations[{number}]")
    shape = (grid.frames, len(skeleton))
    translations = np.broadcast_to(rig.translations, (*shape, 3)).copy()
    rotations = np.broadcast_to(rig.rotations, (*shape, 4)).copy()
    for (path, accessor, mode), members in groups.items():
        joints = [joint for joint, _ in members]
        values = np.stack([rows for _, rows in members], axis=1)
        sampled = sample(key_times(document, accessor), values, mode, grid.times, 1e-3 / grid.fps, path == "rotation")
        (rotations if path == "rotation" else translations)[:, joints] = sampled
    positions, rotations = rig.to_skeleton(translations, rotations)
    size = max(float(np.abs(skeleton.offsets).sum(axis=0).max()), 1e-9)
    differs = np.abs(positions - skeleton.offsets).max(axis=(0, 2)) > 5e-6 * size
    differs[0] = True
    moved = np.flatnonzero(differs)
    made_from = recorded_provenance(animation.get("extras"))
    return Motion(skeleton, rotations, positions[:, moved], grid.fps, tuple(moved.tolist()), name, made_from)


def sample(
    times: Float[Array, "keys"],
    values: Float[Array, "rows channels components"],
    mode: str,
    at: Float[Array, "frames"],
    slack: float,
    turn: bool,
) -> Float[Array, "frames channels components"]:
    """Interpolate channels that share their keys, as the specification's appendix C says; held before and after.

    `slack` (seconds): instants this close to a key count as the key. `turn`: the values are quaternions.
    """
    if mode == "CUBICSPLINE":
        incoming, points, outgoing = values[0::3], values[1::3], values[2::3]
    else:
        points = values
    if turn:
        points = rot.normalise(points) if mode != "CUBICSPLINE" else points
    left = np.clip(np.searchsorted(times, at + slack, side="right") - 1, 0, len(times) - 1)
    right = np.minimum(left + 1, len(times) - 1)
    span = times[right] - times[left]
    part = np.clip((at - times[left]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
    part[(np.abs(at - times[left]) <= slack) | (span <= 0)] = 0.0
    between = np.flatnonzero(part > 0)
    result = points[left]
    if mode != "STEP" and len(between):
        low, high, u = left[between], right[between], part[between, None, None]
        if mode == "CUBICSPLINE":
            dt = span[between, None, None]
            result[between] = (
                (2 * u**3 - 3 * u**2 + 1) * points[low] + dt * (u**3 - 2 * u**2 + u) * outgoing[low]
                + (3 * u**2 - 2 * u**3) * points[high] + dt * (u**3 - u**2) * incoming[high]
            )  # fmt: skip
        elif turn:
            result[between] = rot.slerp(points[low], points[high], u[..., 0])
        else:
            result[between] = points[low] + u * (points[high] - points[low])
    return rot.normalise(result) if turn else result
