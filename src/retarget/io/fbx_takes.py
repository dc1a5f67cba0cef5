"""Animation stacks of an FBX file, sampled at its frame rate, as animations of a GLB. Runs in the child."""

from __future__ import annotations

from typing import Any

import numpy as np

from retarget.io.child import Refused
from retarget.io.fbx_scene import hold, items
from retarget.io.fbx_shapes import Morph
from retarget.io.glb import FLOAT, MOST_KEYS, STILL, Glb

Channels = list[tuple[dict[str, Any], str, np.ndarray]]
"""What moves of what, the kind of accessor, and a row of values a frame."""


def add_takes(glb: Glb, stacks: list[Any], nodes: list[Any], morphs: list[Morph], fps: float) -> None:
    """One animation for each stack that moves something. Raises `Refused` for more than anyone made."""
    keys = 0
    for stack in stacks:
        start, end = _span(stack)
        frames = max(round((end - start) * fps) + 1, 1)
        keys += frames * (len(nodes) + sum(len(morph.channels) for morph in morphs))
        if keys > MOST_KEYS:
            raise Refused(f"its takes have {keys} transforms, more than {MOST_KEYS}; this is no animation")
        times, animation = np.arange(frames) / fps, hold(stack.anim)
        channels = _transforms(animation, nodes, start + times) + _weights(animation, morphs, start + times)
        if not channels:
            continue
        clock = glb.add(times.astype(np.float32), "SCALAR", FLOAT, bounds=True)
        outputs = [glb.add(values.astype(np.float32), kind, FLOAT) for _, kind, values in channels]
        glb.append("animations", {
            "name": stack.name, "samplers": [{"input": clock, "output": output} for output in outputs],
            "channels": [{"sampler": number, "target": target} for number, (target, _, _) in enumerate(channels)],
        })  # fmt: skip


def _span(stack: Any) -> tuple[float, float]:
    """First and last second of a take: as it says itself, else those of its keys."""
    start, end = float(stack.time_begin), float(stack.time_end)
    if end > start:
        return start, end
    curves = [
        hold(curve) for layer in items(stack.layers) for value in items(layer.anim_values)
        for curve in hold(value.curves) if curve is not None
    ]  # fmt: skip
    keyed = [curve for curve in curves if len(hold(curve.keyframes))]
    if not keyed:
        return start, start
    return min(float(curve.min_time) for curve in keyed), max(float(curve.max_time) for curve in keyed)


def _transforms(animation: Any, nodes: list[Any], times: np.ndarray) -> Channels:
    """Those parts of the nodes' transforms that some frame changes."""
    import ufbx

    channels: Channels = []
    for place, node in enumerate(nodes):
        if node.is_root:
            continue
        rest = hold(node.local_transform)
        posed = [ufbx.evaluate_transform(animation, node, time) for time in times.tolist()]
        for path, kind in (("translation", "VEC3"), ("rotation", "VEC4"), ("scale", "VEC3")):
            values = np.array([tuple(getattr(transform, path)) for transform in posed])
            if np.abs(values - np.array(tuple(getattr(rest, path)))).max() >= STILL:
                channels.append(({"node": place, "path": path}, kind, values))
    return channels


def _weights(animation: Any, morphs: list[Morph], times: np.ndarray) -> Channels:
    """Weights of the meshes whose shapes some frame changes: of all targets of one frame, then of the next."""
    import ufbx

    channels: Channels = []
    for morph in morphs:
        rows = [
            [ufbx.evaluate_blend_weight(animation, channel.wrapper, time) for channel in morph.channels]
            for time in times.tolist()
        ]
        values = morph.weights(np.array(rows))
        if np.abs(values - morph.rest).max() >= STILL:
            channels.append(({"node": morph.node, "path": "weights"}, "SCALAR", values.reshape(-1, 1)))
    return channels
