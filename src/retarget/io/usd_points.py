"""Point caches of USD: meshes that no skeleton moves, with points or places that are sampled over time. Runs in the child.

All shown meshes are one: their points follow one another in the stage's order, in the world, in metres with +Y up.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from retarget.io.child import Refused
from retarget.io.glb import Glb
from retarget.io.timeline import timeline
from retarget.io.usd_assets import Assets
from retarget.io.usd_clips import moving_codes, take_of
from retarget.io.usd_looks import Looks
from retarget.io.usd_stage import add_surface
from retarget.io.usd_surface import add_still_mesh
from retarget.io.usd_transforms import placement

LARGEST = 1 << 30
"""Bytes of points that are written at most; a child may write two of these."""
TOPOLOGY = ("faceVertexCounts", "faceVertexIndices", "holeIndices")


def add_meshes(glb: Glb, stage: Any, prims: list[Any], looks: Looks, output: str) -> dict[str, Any] | None:
    """All shown meshes of a stage without skeleton, as they stand first; where they move, every frame of their points goes
    into `output` (float32, frames after one another), and what it holds is told.

    Raises `Refused` for faces or a number of points that change, and for more than is kept in memory.
    """
    counts = {prim: len(points) for prim in prims if (points := add_still_mesh(glb, prim, looks)) is not None}
    samples = np.unique(np.concatenate([[], *(_codes(prim) for prim in counts)]))
    if len(samples) < 2:
        return None
    take = take_of(stage, next(iter(counts)).GetName(), samples, True)
    grid = timeline(take.codes / take.rate) if len(take.codes) > 1 else None
    if grid is None:  # the stage plays one of the frames
        return None
    even = bool((np.diff(take.codes) == 1).all())  # then a time code is a frame, whatever their rate
    fps, frames = (take.rate, len(take.codes)) if even else (grid.fps, grid.frames)
    total = sum(counts.values())
    if 12 * total * frames > LARGEST:
        raise Refused(f"holds {frames} frames of {total} points, more than is kept in memory at once")
    _refuse_other_faces(counts)
    T_world_stage = _metres(glb)
    with open(output, "wb") as file:
        for frame in range(frames):
            code = float(take.codes[0] + frame * take.rate / fps)
            for prim, count in counts.items():
                _points(prim, count, code, T_world_stage).tofile(file)
    held = [prim.GetName() for prim in counts]
    return {"frames": frames, "points": total, "fps": fps, "name": _name(stage, held), "meshes": len(held)}


def _name(stage: Any, meshes: list[str]) -> str:
    """What the performance is called: the stage's default prim, by the name that people see; else the first mesh."""
    prim = stage.GetDefaultPrim()
    return (prim.GetDisplayName() or prim.GetName()) if prim else meshes[0]


def _codes(prim: Any) -> np.ndarray:
    """Time codes at which a mesh has other points or another place; faces count too, so that changing ones are met."""
    own = [prim.GetAttribute(name).GetTimeSamples() for name in ("points", *TOPOLOGY)]
    return np.concatenate([moving_codes(prim), *(np.array(codes, dtype=np.float64) for codes in own)])


def _refuse_other_faces(prims: Any) -> None:
    for prim in prims:
        for name in TOPOLOGY:
            attribute = prim.GetAttribute(name)
            codes = attribute.GetTimeSamples()
            first = np.array(attribute.Get(codes[0]) or ()) if codes else None
            for code in codes[1:]:
                if not np.array_equal(np.array(attribute.Get(code) or ()), first):
                    raise Refused(
                        f"the faces of {prim.GetPath()} change at time code {code:g}: the frames of a mesh sequence are one "
                        "mesh; export it with the faces that it has first, or as still surfaces"
                    )


def _points(prim: Any, count: int, code: float, T_world_stage: np.ndarray) -> np.ndarray:
    """(points, 3) float32, in the world."""
    value = prim.GetAttribute("points").Get(code)
    points = np.array(value if value is not None else (), dtype=np.float64).reshape(-1, 3)
    if len(points) != count:
        raise Refused(
            f"{prim.GetPath()} has {len(points)} points at time code {code:g} and {count} at first: the frames of a mesh "
            "sequence are one mesh"
        )
    matrix = T_world_stage @ placement(prim, code)
    placed = (points @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
    if not np.isfinite(placed).all():
        raise Refused(f"{prim.GetPath()} has points that are not numbers at time code {code:g}")
    return placed


def _metres(glb: Glb) -> np.ndarray:
    """World-from-stage (4, 4): what the GLB's first node does."""
    root = glb.json["nodes"][0]
    matrix = np.diag([*root["scale"], 1.0])
    if "rotation" in root:  # +Z up becomes +Y up
        matrix = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]) @ matrix
    return matrix


def make_sequence(order: dict[str, Any], arrays: dict[str, np.ndarray], assets: Assets) -> Any:
    """A new stage with one mesh whose points are sampled at every time code from 0, in metres with +Y up."""
    from pxr import Usd, UsdGeom, Vt

    stage = Usd.Stage.CreateInMemory(".usda")
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    frames = arrays["frames"]
    stage.SetTimeCodesPerSecond(order["fps"])
    stage.SetFramesPerSecond(order["fps"])
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(len(frames) - 1)
    root = UsdGeom.Xform.Define(stage, f"/{order['name']}")
    root.GetPrim().SetDisplayName(order["title"])
    Usd.ModelAPI(root.GetPrim()).SetKind("component")
    stage.SetDefaultPrim(root.GetPrim())
    mesh = add_surface(stage, root, "Surface", order, arrays, assets)
    points, extent = mesh.GetPointsAttr(), mesh.GetExtentAttr()
    if len(frames) > 1:
        points.Clear()
        extent.Clear()
        for number, places in enumerate(frames):
            points.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(places)), number)
            extent.Set(Vt.Vec3fArray.FromNumpy(np.stack([places.min(axis=0), places.max(axis=0)])), number)
    return stage
