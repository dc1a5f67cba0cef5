"""Runs in a process of its own: one USD file, from what `usd_write.py` orders."""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np

from retarget.io.child import Refused
from retarget.io.glb import PROVENANCE_KEY
from retarget.io.usd_assets import Assets, write_package
from retarget.io.usd_layers import check_layers, in_plain_words
from retarget.io.usd_points import make_sequence
from retarget.io.usd_stage import make_stage
from retarget.io.usd_transforms import placement


def work(folder: str, output: str) -> dict[str, Any]:
    """Write `output` as the files in `folder` order."""
    return in_plain_words(lambda: write(folder, output))


def write(folder: str, output: str) -> dict[str, Any]:
    with open(os.path.join(folder, "order.json")) as file:
        order = json.load(file)
    with np.load(os.path.join(folder, "arrays.npz"), allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    packed = order["suffix"] == ".usdz"
    assets = Assets(packed, order["folder"])
    if "frames" in arrays:
        stage = make_sequence(order, arrays, assets)
    else:
        stage = _kept(order, assets) if "source" in order else make_stage(order, arrays, assets)
        skeleton = _skeleton(stage, order["skeleton"])
        add_clips(stage, skeleton, order, arrays)
        _extend(stage, skeleton, order["clips"])
    layer = stage.GetRootLayer()
    kind = "usda" if order["suffix"] == ".usda" else "usdc"
    place = os.path.join(folder, f"{order['stem']}.{kind}")
    if not layer.Export(place):
        raise Refused("cannot be written: usd-core refuses to export the stage")
    if packed:
        write_package(output, place, assets.files)
    else:
        os.replace(place, output)
    return {}


def _kept(order: dict[str, Any], assets: Assets) -> Any:
    """The stage of the source in one layer without a file: its own layer, flattened only if it is made of several."""
    from pxr import Sdf, Usd

    source = order["source"]
    _, composed = check_layers(source)
    root = Sdf.Layer.FindOrOpen(source)
    if composed:
        layer = Usd.Stage.Open(source, Usd.Stage.LoadAll).Flatten(addSourceFileComment=False)
    else:
        layer = Sdf.Layer.CreateAnonymous(".usda")
        layer.TransferContent(root)
    assets.move(layer, root, source)
    return Usd.Stage.Open(layer, Usd.Stage.LoadAll)


def _skeleton(stage: Any, path: str) -> Any:
    """The skeleton's prim, taken out of instances, in which nothing can be changed."""
    from pxr import Sdf

    for prefix in Sdf.Path(path).GetPrefixes():
        prim = stage.GetPrimAtPath(prefix)
        if prim and prim.IsInstance():
            prim.SetInstanceable(False)
    prim = stage.GetPrimAtPath(path)
    if not prim:
        raise Refused(f"the stage has no {path} any more")
    return prim


def add_clips(stage: Any, skeleton: Any, order: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """A SkelAnimation for each clip; the skeleton follows the first, and the stage plays it from end to end."""
    from pxr import Sdf, UsdSkel

    earlier = [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Animation)]
    clips = order["clips"]
    if not clips:
        return
    moving = ("rotations", "translations")
    sampled = any(prim.GetAttribute(name).GetNumTimeSamples() for prim in earlier for name in moving)
    alone = not (sampled or stage.HasAuthoredTimeCodeRange())
    if not order.get("keep_clips", True):
        for prim in earlier:
            stage.RemovePrim(prim.GetPath())
        alone = not any(each.GetNumTimeSamples() for prim in stage.Traverse() for each in prim.GetAttributes())
    if alone:  # nothing else in the stage counts on its clock
        stage.SetTimeCodesPerSecond(clips[0]["fps"])
        stage.SetFramesPerSecond(clips[0]["fps"])
    if order.get("settle"):
        _settle(skeleton)
    rate = stage.GetTimeCodesPerSecond()
    paths = []
    for number, clip in enumerate(clips):
        path, free, count = skeleton.GetPath(), clip["prim"], 2
        while stage.GetPrimAtPath(path.AppendChild(free)):
            free, count = f"{clip['prim']}_{count}", count + 1
        animation = UsdSkel.Animation.Define(stage, path.AppendChild(free))
        if clip["name"] != free:
            animation.GetPrim().SetDisplayName(clip["name"])
        if "made_from" in clip:
            animation.GetPrim().SetCustomDataByKey(PROVENANCE_KEY, clip["made_from"])
        values = (arrays[f"{name}_{number}"] for name in ("translations", "rotations", "scales"))
        _fill(animation, order["tokens"], *values, rate / clip["fps"])
        paths.append(animation.GetPath())
    binding = UsdSkel.BindingAPI.Apply(skeleton)
    binding.CreateAnimationSourceRel().SetTargets([Sdf.Path(paths[0])])
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode((len(arrays["rotations_0"]) - 1) * rate / clips[0]["fps"])


def _fill(
    animation: Any, tokens: list[str], translations: np.ndarray, rotations: np.ndarray, scales: np.ndarray, step: float
) -> None:
    """Frame n at time code n * step. Translations that never change are written once."""
    from pxr import Vt

    animation.CreateJointsAttr(Vt.TokenArray(tokens))
    animation.CreateScalesAttr(Vt.Vec3hArray.FromNumpy(scales))
    turning, moving = animation.CreateRotationsAttr(), animation.CreateTranslationsAttr()
    still = bool((translations == translations[0]).all())
    if still:
        moving.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(translations[0])))
    for frame in range(len(rotations)):
        turning.Set(Vt.QuatfArray.FromNumpy(np.ascontiguousarray(rotations[frame])), frame * step)
        if not still:
            moving.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(translations[frame])), frame * step)


def _settle(skeleton: Any) -> None:
    """Keep the skeleton's prim where it first stands: what it did is in the animation's joints."""
    from pxr import Gf, UsdGeom

    matrix, shape = placement(skeleton), UsdGeom.Xformable(skeleton)
    shape.SetXformOpOrder([], False)
    held = shape.AddTransformOp(opSuffix="held")
    held.Set(Gf.Matrix4d(matrix.T.tolist()))
    shape.SetXformOpOrder([held], True)


def _extend(stage: Any, skeleton: Any, clips: list[dict[str, Any]]) -> None:
    """Bounds of the skeleton's root over the clip that plays, as UsdSkel computes them from the joints."""
    from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

    root = UsdSkel.Root.Find(skeleton)
    if not root:
        return
    codes = [Usd.TimeCode.Default()]
    if clips:
        step = stage.GetTimeCodesPerSecond() / clips[0]["fps"]
        codes = [Usd.TimeCode(n * step) for n in range(round(stage.GetEndTimeCode() / step) + 1)]
    found = [UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(root.GetPrim()), code) for code in codes]
    corners = np.array([np.array(extent) for extent in found if extent is not None and len(extent) == 2])
    if len(corners) and np.isfinite(corners).all():
        extent = np.stack([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)]).astype(np.float32)
        attribute = UsdGeom.Boundable(root.GetPrim()).CreateExtentAttr()
        stage.GetRootLayer().GetAttributeAtPath(Sdf.Path(attribute.GetPath())).ClearInfo("timeSamples")
        attribute.Set(Vt.Vec3fArray.FromNumpy(extent))
