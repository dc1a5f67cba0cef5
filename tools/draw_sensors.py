"""Draw dense sensors, coloured by their semantic coordinate, over very different bodies: docs/pictures/sensors.png.

    python tools/draw_sensors.py [--data FOLDER] [OUTPUT]

Hue is the angle about the bone, light and dark bands its quarters: equal colours are equal coordinates. Bodies from files are drawn where FOLDER holds them (KayKit, CC0).
"""

from __future__ import annotations

import argparse
import colorsys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from retarget.body.human import PRESETS, human
from retarget.casting import cast
from retarget.character import Character, Material, Mesh
from retarget.contact.sensors import Sensors, bone_index, dense_layout, place_sensors
from retarget.view.picture import Camera, render, save_png
from retarget.view.surface import prepare_surface

FILES = {"KayKit Knight": "kaykit/Knight.glb", "KayKit mannequin": "kaykit_mannequin/manny_med_mod.gltf"}
VIEWS = {"front": 0.0, "from the left": 100.0, "back": 205.0}
COVER, LIFT = 0.85, 0.002
"""Side of a drawn square in distances to the nearest sensor; how far it stands off the skin, in heights."""
BINS = 36
WIDTH, HEIGHT, TITLE = 460, 560, 54
AWAY = 5.0


def bodies(data: Path) -> dict[str, Character | Path]:
    found = {name: human(**PRESETS[name]) for name in ("thin", "heavy", "toddler")}
    return found | {name: data / path for name, path in FILES.items() if (data / path).exists()}


def marked(sensors: Sensors) -> Mesh:
    """The body in grey with a coloured square on every valid sensor."""
    from scipy.spatial import cKDTree

    stance, mesh = sensors.stance, sensors.character.mesh
    which = np.flatnonzero(sensors.valid)
    frames, centres = sensors.frames[which], sensors.positions[which]
    apart = cKDTree(centres).query(centres, k=3)[0][:, 1:].mean(axis=1)
    hands = np.isin(sensors.layout.bones[which], [bone_index("leftHand"), bone_index("rightHand")])
    side = COVER * np.minimum(apart, np.where(hands, 0.008, 0.03) * stance.height)
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    corners = centres[:, None] + side[:, None, None] * np.einsum("sik,ck->sci", frames[:, :, :2], square)
    corners += LIFT * stance.height * frames[:, None, :, 2]
    first = len(stance.rest) + 4 * np.arange(len(which))
    squares = first[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    layout = sensors.layout
    around = np.floor(layout.around[which] / (2 * np.pi) * BINS).astype(int) % BINS
    dark = (np.floor((layout.along[which] + 1) * 4).astype(int) + layout.bones[which]) % 2
    materials = (Material(base_color=(0.5, 0.5, 0.5, 1.0)),) + tuple(
        Material(base_color=(*_colour(hue, dark), 1.0)) for hue in range(BINS) for dark in range(2)
    )
    return Mesh(
        np.concatenate([stance.rest, corners.reshape(-1, 3)]),
        np.concatenate([mesh.faces, squares.reshape(-1, 3)]),
        materials=materials,
        face_materials=np.concatenate([np.zeros(len(mesh.faces), int), np.repeat(1 + 2 * around + dark, 2)]),
    )


def _colour(hue: int, dark: int) -> tuple[float, float, float]:
    red, green, blue = colorsys.hsv_to_rgb(hue / BINS, 0.85, 0.6 if dark else 0.95)
    return red**2.2, green**2.2, blue**2.2


def column(name: str, subject: Character | Path) -> np.ndarray:
    """One body from all sides, drawn at one height whatever its own, under its name."""
    actor = cast(subject)
    sensors = place_sensors(actor.character, actor.humanoid, dense_layout())
    print(f"{name}: {sensors.valid.sum()} of {len(sensors)} sensors")
    mesh = marked(sensors)
    scale, middle = 1.7 / actor.height, sensors.stance.rest.mean(axis=0)
    vertices = (mesh.vertices - [middle[0], sensors.stance.rest[:, 1].min(), middle[2]]) * scale
    facing = float(np.degrees(np.arctan2(actor.humanoid.axes[2][0], actor.humanoid.axes[2][2])))
    surface = prepare_surface(mesh)
    cells = []
    for angle in VIEWS.values():
        camera = Camera((0.0, 0.0, 0.0), angle + facing, distance=AWAY, span=2.1, shift=0.85)
        cells.append(render(surface, vertices[surface.kept], camera, WIDTH, HEIGHT, 0.0, 3))
    return _titled(np.concatenate(cells), name)


def _titled(picture: np.ndarray, title: str) -> np.ndarray:
    page = Image.new("RGB", (picture.shape[1], picture.shape[0] + TITLE), (244, 244, 242))
    page.paste(Image.fromarray(picture), (0, TITLE))
    font = ImageFont.load_default(26)
    ImageDraw.Draw(page).text((picture.shape[1] // 2, 12), title, fill=(38, 41, 46), font=font, anchor="ma")
    return np.array(page)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("output", nargs="?", type=Path, default=Path("docs/pictures/sensors.png"))
    arguments.add_argument("--data", type=Path, default=Path("../shared/data/characters"))
    given = arguments.parse_args()
    columns = [column(name, subject) for name, subject in bodies(given.data).items()]
    save_png(given.output, np.concatenate(columns, axis=1))


if __name__ == "__main__":
    main()
