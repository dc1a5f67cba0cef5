"""Animations of a UsdSkel skeleton as animations of a GLB: the one it is bound to first, then all others that know its
joints. Runs in the child.

Where all samples lie on whole time codes, and a code is a plausible frame, every code of the clip becomes a key; else
the samples themselves do. USD interpolates between samples as glTF does (linearly, rotations on the sphere).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from retarget.io.child import Refused
from retarget.io.glb import FLOAT, MOST_KEYS, PROVENANCE_KEY, STILL, Glb
from retarget.io.usd_transforms import placement, split

FRAME_RATES = (10.0, 240.0)
"""Time codes a second that can be frames a second."""
PARTS = (("translations", "translation", "VEC3"), ("rotations", "rotation", "VEC4"), ("scales", "scale", "VEC3"))


@dataclass
class Take:
    """One animation in the making: what is set at which time."""

    name: str
    rate: float
    codes: np.ndarray
    made_from: dict[str, Any] | None = None
    """What it says it was made from; see `provenance.py`."""
    channels: list[tuple[int, str, str, np.ndarray]] = field(default_factory=list)
    """Node, path, kind of accessor, and the values of all codes."""


def add_clips(glb: Glb, stage: Any, bones: Any, prims: list[Any], notes: list[str]) -> str | None:
    """All animations of the skeleton `bones`; returns the name of the one it is bound to, which comes first.

    Raises `Refused` for values that are no transforms, or more than anyone made.
    """
    bound = bound_animation(bones.prim)
    carried = moving_codes(bones.prim)
    names: set[str] = set()
    keys, plays = 0, None
    for prim in _animations(prims, bound, bones):
        own = prim.GetPath() == bound
        record = prim.GetCustomDataByKey(PROVENANCE_KEY)
        samples = [_samples(prim, name) for name, _, _ in PARTS] + ([carried] if own else [])
        name = _free(prim.GetDisplayName() or prim.GetName(), names)
        take = take_of(stage, name, np.unique(np.concatenate(samples)), own)
        take.made_from = _plain(record) if isinstance(record, dict) else None
        keys += _checked_keys(take, bones, keys)
        _add_joints(take, prim, bones, glb, notes)
        plays = take.name if own else plays
        if own and len(carried):
            _add_carried(take, bones)
        _write(glb, take)
    if bound is None and len(carried):  # a still skeleton that its prim carries about
        take = take_of(stage, _free(bones.prim.GetName(), names), carried, True)
        _checked_keys(take, bones, keys)
        _add_carried(take, bones)
        _write(glb, take)
        plays = take.name
    return plays


def bound_animation(skeleton: Any) -> Any:
    """Path of the animation that moves a skeleton; None where none does."""
    from pxr import UsdSkel

    prim = UsdSkel.BindingAPI(skeleton).GetInheritedAnimationSource()
    return prim.GetPath() if prim and prim.IsA(UsdSkel.Animation) else None


def _animations(prims: list[Any], bound: Any, bones: Any) -> list[Any]:
    from pxr import UsdSkel

    known = set(bones.tokens)
    found = [prim for prim in prims if prim.IsA(UsdSkel.Animation) and not known.isdisjoint(_tokens(prim))]
    return sorted(found, key=lambda prim: prim.GetPath() != bound)


def _tokens(animation: Any) -> list[str]:
    return [str(token) for token in animation.GetAttribute("joints").Get() or ()]


def _samples(prim: Any, name: str) -> np.ndarray:
    return np.array(prim.GetAttribute(name).GetTimeSamples(), dtype=np.float64)


def moving_codes(prim: Any) -> np.ndarray:
    """Time codes at which the prim or any above it is placed anew; none for one that stays."""
    from pxr import UsdGeom

    codes: list[float] = []
    while prim and not prim.IsPseudoRoot():
        if prim.IsA(UsdGeom.Xformable):
            shape = UsdGeom.Xformable(prim)
            codes += shape.GetTimeSamples() if shape.TransformMightBeTimeVarying() else []
            if shape.GetResetXformStack():
                break
        prim = prim.GetParent()
    return np.unique(np.array(codes, dtype=np.float64))


def take_of(stage: Any, name: str, samples: np.ndarray, bound: bool) -> Take:
    """The time codes of a take with these samples; `bound`: of the part that the stage plays. Raises `Refused` for too many."""
    rate = float(stage.GetTimeCodesPerSecond())
    if not len(samples):
        return Take(name, rate, np.zeros(1))
    first, last = float(samples[0]), float(samples[-1])
    if bound and stage.HasAuthoredTimeCodeRange():  # what the stage plays of it
        start, end = max(first, stage.GetStartTimeCode()), min(last, stage.GetEndTimeCode())
        first, last = (start, end) if start <= end else (first, last)
    if last - first > MOST_KEYS:
        raise Refused(f"the animation {name!r} spans {last - first:.0f} time codes")
    inside = samples[(samples >= first) & (samples <= last)]
    away = inside - first
    if FRAME_RATES[0] <= rate <= FRAME_RATES[1] and np.abs(away - np.round(away)).max(initial=0) < 1e-3:
        return Take(name, rate, first + np.arange(int(round(last - first)) + 1))
    return Take(name, rate, np.unique(np.concatenate([[first], inside, [last]])))


def _checked_keys(take: Take, bones: Any, before: int) -> int:
    keys = len(take.codes) * len(bones.tokens)
    if before + keys > MOST_KEYS:
        raise Refused(f"its animations have more than {MOST_KEYS} transforms; this is no animation")
    return keys


def _add_joints(take: Take, prim: Any, bones: Any, glb: Glb, notes: list[str]) -> None:
    tokens = _tokens(prim)
    if prim.GetAttribute("blendShapes").Get():
        notes.append("blend shapes are left out")
    place = {token: number for number, token in enumerate(bones.tokens)}
    for name, path, kind in PARTS:
        attribute = prim.GetAttribute(name)
        if not attribute.HasAuthoredValue():
            continue
        rows = [attribute.Get(code) for code in (take.codes if attribute.GetNumTimeSamples() else take.codes[:1])]
        if any(row is None or len(row) != len(tokens) for row in rows):
            notes.append(f"{name} of the animation {take.name!r} are not as many as its joints, and are left out")
            continue
        values = np.array([np.array(row, dtype=np.float64) for row in rows])  # quaternions come as xyzw
        if not np.isfinite(values).all() or np.abs(values).max() > 1e12:
            raise Refused(f"{prim.GetPath()} has {name} that are no numbers")
        if path == "rotation":
            length = np.linalg.norm(values, axis=-1, keepdims=True)
            if length.min() < 1e-6:
                raise Refused(f"{prim.GetPath()} has a rotation of length zero")
            values = values / length
        for column, token in enumerate(tokens):
            joint = place.get(token)
            if joint is None:
                continue
            node = bones.nodes[joint]
            rest = glb.json["nodes"][node].get(path)
            still = path != "rotation" and rest is not None and np.abs(values[:, column] - rest).max() < STILL
            if not still:
                whole = np.broadcast_to(values[:, column], (len(take.codes), values.shape[2]))
                take.channels.append((node, path, kind, whole))


def _add_carried(take: Take, bones: Any) -> None:
    """The skeleton's own node, where its prim or one above moves."""
    matrices = np.stack([placement(bones.prim, code) for code in take.codes.tolist()])
    for values, (_, path, kind) in zip(split(matrices)[:3], PARTS):
        take.channels.append((bones.node, path, kind, values))


def _write(glb: Glb, take: Take) -> None:
    if not take.channels:
        return
    clock = glb.add(((take.codes - take.codes[0]) / take.rate).astype(np.float32), "SCALAR", FLOAT, bounds=True)
    samplers, channels = [], []
    for node, path, kind, values in take.channels:
        channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
        samplers.append({"input": clock, "output": glb.add(values.astype(np.float32), kind, FLOAT)})
    extras = {} if take.made_from is None else {"extras": {PROVENANCE_KEY: take.made_from}}
    glb.append("animations", {"name": take.name, "samplers": samplers, "channels": channels} | extras)


def _plain(record: dict[str, Any]) -> dict[str, Any]:
    """The values that JSON has a word for; custom data may hold any."""
    return {
        name: value
        for name, value in record.items()
        if isinstance(value, str) or (type(value) in (int, float) and np.isfinite(value))
    }


def _free(name: str, taken: set[str]) -> str:
    free, number = name, 2
    while free in taken:
        free, number = f"{name}_{number}", number + 1
    taken.add(free)
    return free
