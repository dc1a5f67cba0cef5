"""The scene of a report as one JSON text: arrays in base64, in the smallest types that keep a hundredth of a millimetre."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

from retarget.view.stage import StageBody, camera_path, drawn_bones, facing, layout, part_colors, same_sizes, strongest

Array = np.ndarray

INFLUENCES = 8
"""Joints a vertex, the strongest; the page's shader reads so many."""
CLAY = ((196, 182, 168), (150, 166, 184), (170, 184, 160), (184, 160, 178))
"""sRGB of the bodies without their materials: the result warm, sources cool."""
KINDS = {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"}


def scene_json(bodies: Sequence[StageBody]) -> str:
    """What `player.js` plays; safe inside a script element. Bodies are of one frame rate and length, the result first."""
    sizes = same_sizes(bodies)
    moves = [
        layout(bodies, overlaid, each) for each in (None, sizes) for overlaid in (False, True)
    ]  # as page.html lists
    forward = facing(bodies[0])
    scene = {
        "fps": bodies[0].take.fps,
        "frames": bodies[0].frames,
        "yaw": round(math.atan2(forward[0], forward[2]) - math.radians(20), 5),
        "bodies": [
            _body(body, [each[number] for each in moves], CLAY[number % len(CLAY)]) | {"size": round(sizes[number], 5)}
            for number, body in enumerate(bodies)
        ],
    }
    return json.dumps(scene, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _body(body: StageBody, moves: list[Float[Array, "3"]], clay: tuple[int, int, int]) -> dict[str, Any]:
    mesh, skin, skeleton = body.character.mesh, body.character.skin, body.character.skeleton
    none = np.array([[170, 170, 170]], dtype=np.uint8)
    normals = np.zeros((len(mesh.vertices), 4), dtype=np.int8)
    normals[:, :3] = np.round(127 * body.normals)
    packed = {
        "faces": _indices(mesh.faces, len(mesh.vertices)),
        "normals": _packed(normals),
        "colors": _packed(body.colors),
        "part_colors": _packed(np.concatenate([part_colors(), none])[body.parts]),
        "starts": _packed(body.spots.starts.astype(np.int32)),
        "spot_vertex": _indices(body.spots.vertex, len(mesh.vertices)),
        "spot_code": _packed(body.spots.code),
        "rotations": _packed(body.take.rotations.astype(np.float32)),
        "positions": _packed(body.take.positions.astype(np.float32)),
        "bones": _packed(drawn_bones(body).astype(np.int16)),
        "parents": _packed(skeleton.parents.astype(np.int16)),
        "joints": _indices(skin.joints, len(skeleton)),
        "binds": _packed(skin.inverse_binds[:, :3].astype(np.float32)),
        "path": _packed(camera_path(body).astype(np.float32)),
        "skin": _skin(mesh.vertices, skin.columns, skin.weights, len(skin.joints)),
    }
    if body.sensors is not None:
        packed["sensors"] = _sensor_skin(body)
    return packed | {
        "label": body.label, "height": round(body.take.actor.height, 4), "clay": clay,
        "moves": [np.round(move, 5).tolist() for move in moves],
    }  # fmt: skip


def _skin(vertices: Array, columns: Array, weights: Array, count: int) -> dict[str, Any]:
    columns, weights = strongest(columns, weights, INFLUENCES)
    return {
        "vertices": _packed(vertices.astype(np.float32)) | {"count": len(vertices)},
        "columns": _packed(columns.astype(np.uint8 if count <= 256 else np.uint16)),
        "weights": _packed(np.round(65535 * weights).astype(np.uint16)),
    }


def _sensor_skin(body: StageBody) -> dict[str, Any]:
    """Sensors as points of the skin with the weights of their face's corners, blended."""
    skin, sensors = body.character.skin, body.sensors
    faces, shares = sensors.faces[sensors.valid], sensors.barycentrics[sensors.valid]
    corners = body.character.mesh.faces[faces]
    places = np.einsum("sc,sci->si", shares, body.character.mesh.vertices[corners])
    blended = np.zeros((len(corners), len(skin.joints)))
    weights = skin.weights[corners] * shares[:, :, None]
    np.add.at(blended, (np.arange(len(corners))[:, None, None], skin.columns[corners]), weights)
    columns = np.broadcast_to(np.arange(len(skin.joints)), blended.shape)
    return _skin(places, columns, blended, len(skin.joints))


def _indices(values: Int[Array, "*shape"], count: int) -> dict[str, str]:
    return _packed(values.astype(np.uint16 if count <= 65536 else np.uint32))


def _packed(values: Shaped[Array, "*shape"]) -> dict[str, str]:
    data = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    return {"kind": KINDS[values.dtype.name], "data": base64.b64encode(data.tobytes()).decode()}
