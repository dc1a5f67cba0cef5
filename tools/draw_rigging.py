"""Draw bare meshes and what `retarget rig` makes of them: docs/pictures/rigging.png.

    python tools/draw_rigging.py [--data FOLDER] [OUTPUT]

A column a body: as it came, its rig (each colour a joint), a walk, hands on hips. Made bodies are cases of the bench of rig
transfer; the others are drawn where FOLDER holds them, their own rig taken away (Quaternius and KayKit, CC0).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from retarget import embedded_motion, load, retarget, skin_motion
from retarget.character import Mesh
from retarget.commands_rig import bare_body
from retarget.evaluate.rig_cases import rig_case
from retarget.evaluate.rig_pictures import picture_of
from retarget.motion.library import performer
from retarget.rig.rigging import Rigged, rig
from retarget.view.picture import Camera, render, save_png

CASES = {"child, 18,076 vertices, holes": 22, "toddler in shoes, 9,287 vertices": 23, "noise, 15,412 vertices": 16}
FILES = {
    "sitting, 446 vertices": "meshes/quaternius_posed/M_Male_Sitting.fbx",
    "looking out, 446 vertices": "meshes/quaternius_posed/M_Male_Standing_CoveringEyes.fbx",
    "walking, 667 vertices": "meshes/quaternius_posed/F_Female_Running.fbx",
    "toy, 14 pieces": "characters/kaykit_mannequin/manny_med_mod.gltf",
}
ROWS = ("as it came", "its rig, at rest", "walk", "hands on hips")
PERFORMED = (("walk", 0.68), ("hands_on_hips", 0.5))
"""Embedded motions, and the share of each at which it is drawn."""
WIDTH, HEIGHT, TITLE, SIDE = 210, 232, 30, 96
SPAN, AWAY, TALL = 1.95, 5.0, 1.6
PAGE, INK = (244, 244, 242), (38, 41, 46)
COLOURS = 128
"""Of the picture: enough for shades of grey and a score of joints, and a third of the size."""


def bodies(data: Path) -> Iterator[tuple[str, Mesh]]:
    """Made ones, upright, and those that the folder holds."""
    yield from ((name, rig_case(seed).mesh) for name, seed in CASES.items())
    yield from ((name, bare_body(load(data / path))) for name, path in FILES.items() if (data / path).exists())


def column(name: str, mesh: Mesh) -> np.ndarray:
    """One body in all rows, drawn at one height whatever its own, under its name."""
    rigged = rig(mesh)
    print(f"{name}: confidence {rigged.confidence:.2f}")
    picture = picture_of(name, mesh, rigged, "")
    plain = replace(picture.mesh, materials=(), face_materials=None)
    size = TALL / float(np.ptp(picture.vertices[1][:, 1]))
    shown = [(plain, picture.vertices[0]), (picture.mesh, picture.vertices[1])]
    shown += [(picture.mesh, vertices) for vertices in performed(rigged)]
    cells = [render(each, stood(vertices) * size, Camera((0.0, 0.0, 0.0), 30.0, distance=AWAY, span=SPAN, shift=0.8),
                    WIDTH, HEIGHT, 0.0, 3) for each, vertices in shown]  # fmt: skip
    return np.concatenate([titled(name), *cells])


def performed(rigged: Rigged) -> Iterator[np.ndarray]:
    for name, share in PERFORMED:
        result = retarget(embedded_motion(name), rigged.character, source=performer())
        frame = int(share * (len(result.motion) - 1))
        yield skin_motion(rigged.character, result.motion)[frame].astype(np.float64)


def stood(vertices: np.ndarray) -> np.ndarray:
    """On the floor, in the middle."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return vertices - [(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2]


def titled(text: str) -> np.ndarray:
    return _written((WIDTH, TITLE), text, (WIDTH // 2, TITLE // 2), "mm", 12)


def side() -> np.ndarray:
    """The rows' names."""
    return np.concatenate(
        [np.full((TITLE, SIDE, 3), PAGE, np.uint8)]
        + [_written((SIDE, HEIGHT), row, (8, HEIGHT // 2), "lm", 13) for row in ROWS]
    )


def _written(size: tuple[int, int], text: str, place: tuple[int, int], anchor: str, points: int) -> np.ndarray:
    page = Image.new("RGB", size, PAGE)
    ImageDraw.Draw(page).text(place, text, fill=INK, font=ImageFont.load_default(points), anchor=anchor)
    return np.array(page)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("output", nargs="?", type=Path, default=Path("docs/pictures/rigging.png"))
    arguments.add_argument("--data", type=Path, default=Path("../shared/data"))
    given = arguments.parse_args()
    whole = np.concatenate([side(), *(column(name, mesh) for name, mesh in bodies(given.data))], axis=1)
    few = Image.fromarray(whole).quantize(COLOURS, dither=Image.Dither.NONE)
    save_png(given.output, np.array(few.convert("RGB")))


if __name__ == "__main__":
    main()
