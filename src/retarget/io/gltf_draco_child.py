"""Run in a process of its own by `gltf_draco.py`: Google's Draco decoder over the compressed data of a file."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from retarget.io.child_process import Refused, answer

MOST = 20_000_000
"""Vertices, or corners of faces, of one primitive."""


def main(blob: str, plan: str, found: str, reply: str) -> None:
    """Decode what the plan names in the blob, and write the arrays `number.name` into an archive."""
    answer(reply, lambda: decode(blob, plan, found))


def decode(blob: str, plan: str, found: str) -> dict[str, Any]:
    """Every primitive's attributes by name, and its faces' corners as 'indices'."""
    import DracoPy

    arrays: dict[str, np.ndarray] = {}
    with open(blob, "rb") as file:
        data = file.read()
    with open(plan) as file:
        jobs = json.load(file)
    for number, job in enumerate(jobs):
        mesh = DracoPy.decode(data[job["start"] : job["start"] + job["length"]])
        faces = getattr(mesh, "faces", None)
        if len(mesh.points) > MOST or (faces is not None and faces.size > MOST):
            raise Refused(f"its Draco data hold more than {MOST} vertices or corners")
        if faces is not None:
            arrays[f"{number}.indices"] = np.asarray(faces).ravel()
        own = {attribute["unique_id"]: attribute["data"] for attribute in mesh.attributes}
        for name, key in job["ids"].items():
            if key in own:
                values = np.asarray(own[key])
                arrays[f"{number}.{name}"] = values.reshape(len(values), -1)
    np.savez(found, **arrays)
    return {}
