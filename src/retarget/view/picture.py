"""Sheets of pictures: one row a body, frames side by side, as PNG; no display and no graphics card needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped, UInt8

from retarget.character import Mesh
from retarget.errors import RetargetError, unknown_name
from retarget.io.whole_file import written_whole
from retarget.view.bones import skeleton_mesh
from retarget.view.camera import AZIMUTHS, Camera
from retarget.view.ground import BACKGROUND
from retarget.view.shading import render
from retarget.view.surface import check_vertices, prepare_surface, to_srgb

Array = np.ndarray

__all__ = ["Camera", "Row", "choose_frames", "render", "save_png", "sheet", "skeleton_mesh"]

INK, PALE = (38, 41, 46), (112, 116, 122)
NARROWEST, WIDEST = 0.62, 1.8
"""Width of a cell over its height: the first unless a pose needs more, at most the second."""
SHALLOWEST = 0.4
"""Height of a small body's cell over that of the largest."""
MARGIN = 0.05
"""Part of the cell's height that stays free on every side of the body."""
AWAY = 4.5
"""Distance of the camera in sizes of the body: a long lens."""
LARGEST = 200_000_000
"""Pixels a sheet may have."""


@dataclass(frozen=True, eq=False)
class Row:
    """One body of a sheet, its frames already chosen."""

    label: str
    mesh: Mesh
    vertices: Shaped[Array, "frames vertices 3"]
    """Posed vertices, metres, any float type."""
    captions: tuple[str, ...] = ()
    """A line under each frame; none, or one a frame."""
    floor: float | None = None
    """Height of the ground where it is known, metres; None looks for it under the body."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "captions", tuple(self.captions))
        vertices = np.asarray(self.vertices)
        if vertices.ndim != 3 or vertices.shape[2] != 3 or len(vertices) == 0:
            raise RetargetError(f"row {self.label!r} needs (frames, vertices, 3) numbers, received {vertices.shape}")
        object.__setattr__(self, "vertices", vertices.astype(np.float64, copy=False))
        check_vertices(len(self.mesh.vertices), self.vertices, f"row {self.label!r}")
        if self.captions and len(self.captions) != len(vertices):
            raise RetargetError(f"row {self.label!r} has {len(vertices)} frames but {len(self.captions)} captions")


def choose_frames(motion_frames: int, columns: int) -> Int[Array, "chosen"]:
    """Frames spread evenly over a motion, the first and the last among them; all of them where there are fewer."""
    if motion_frames < 1 or columns < 1:
        raise RetargetError(f"at least one frame and one column are needed, received {motion_frames} and {columns}")
    if columns == 1:
        return np.array([(motion_frames - 1) // 2])
    return np.unique(np.round(np.linspace(0, motion_frames - 1, columns)).astype(np.int64))


def sheet(
    rows: Sequence[Row],
    size: int = 512,
    columns: int | None = None,
    view: str | float = "three-quarter",
    title: str = "",
    samples: int = 2,
) -> UInt8[Array, "height width 3"]:
    """A picture with a row for every body and its frames side by side.

    `size` is the height of a cell in pixels (rows of smaller bodies are cut to what they need); all cells share one
    width, as narrow as the poses allow. A row with more frames than `columns` continues on the next line. `view` is
    'three-quarter', 'front', 'side', 'back' or an azimuth in degrees (0 sees the front of a subject that faces +Z, 90
    its left). Every row keeps one scale; rows whose bodies differ by less than three times share it, so that a child
    looks smaller than an adult. The camera follows the body along the ground but not upwards, so that jumps are seen.
    The ground is y = 0, unless a body's lowest point over all its frames lies more than an eighth of its size below
    that or more than its half above: then the ground is drawn at that point and the label says so. Edges are smoothed
    over `samples` x `samples` points a pixel; 3 looks better still and takes half as long again.

    Raises `RetargetError` for an unknown view and for sheets without rows or beyond 200 million pixels.
    """
    if not rows:
        raise RetargetError("a sheet needs at least one row")
    if not 16 <= size <= 4096:
        raise RetargetError(f"a cell is 16 to 4096 pixels high, received {size}")
    if columns is not None and columns < 1:
        raise RetargetError(f"a sheet needs at least one column, received {columns}")
    surfaces = [prepare_surface(row.mesh) for row in rows]
    shown = [row.vertices[:, surface.kept] for row, surface in zip(rows, surfaces, strict=True)]
    frames, aspect = _frame_rows(shown, [row.floor for row in rows], _azimuth(view), size)
    plan = _Layout.of(rows, frames, size, round(aspect * size), columns, title)
    canvas = np.empty((plan.height, plan.width, 3), dtype=np.uint8)
    canvas[:] = to_srgb(BACKGROUND)
    for number, (row, surface, framing) in enumerate(zip(rows, surfaces, frames, strict=True)):
        for k, vertices in enumerate(row.vertices):
            x, y = plan.cell(number, k)
            cell = render(surface, vertices, framing.camera(k), plan.cell_width, framing.height, framing.floor, samples)
            canvas[y : y + framing.height, x : x + plan.cell_width] = cell
    return plan.write(canvas)


def _azimuth(view: str | float) -> float:
    if not isinstance(view, str):
        return float(view)
    if view in AZIMUTHS:
        return AZIMUTHS[view]
    try:
        return float(view)
    except ValueError:
        raise unknown_name("view", view, AZIMUTHS, "the named ones (an azimuth in degrees will do as well)") from None


def save_png(path: str | Path, image: UInt8[Array, "height width 3"]) -> None:
    """Write a picture; the file appears complete or not at all. Raises `FileError` where it cannot be written."""
    from PIL import Image

    with written_whole(path) as file:
        Image.fromarray(image).save(file, format="PNG", compress_level=4)


@dataclass(frozen=True, eq=False)
class _Framing:
    """How one row is looked at."""

    targets: Float[Array, "frames 3"]
    floor: float
    azimuth: float
    distance: float
    span: float
    shift: float
    height: int
    """Of its cells, pixels."""

    def camera(self, frame: int) -> Camera:
        x, y, z = self.targets[frame].tolist()
        return Camera((x, y, z), self.azimuth, distance=self.distance, span=self.span, shift=self.shift)


def _frame_rows(
    shown: Sequence[Float[Array, "_ _ 3"]], known: Sequence[float | None], azimuth: float, pixels: int
) -> tuple[list[_Framing], float]:
    """How each row is looked at, one scale for rows of comparable size, and the cells' width over their height."""
    framings: list[Any] = [None] * len(shown)
    aspect = NARROWEST
    for group in _alike([_spread(each) for each in shown]):
        size = max(_size(shown[k]) for k in group)
        floors = {k: _floor(shown[k], size, known[k]) for k in group}
        targets = {k: _targets(shown[k], floors[k]) for k in group}
        boxes = np.array([_box(shown[k], targets[k], azimuth, size) for k in group])
        half, bottom, top = boxes[:, 0].max(), boxes[:, 1].min(), boxes[:, 2].max()
        span = max((top - bottom) / (1 - 2 * MARGIN), 2 * half / (WIDEST - 2 * MARGIN))
        aspect = max(aspect, min(2 * half / span + 2 * MARGIN, WIDEST))
        low = (top + bottom - span) / 2
        for k, box in zip(group, boxes, strict=True):
            height = round(pixels * max(SHALLOWEST, min(1.0, (box[2] - low) / span + MARGIN)))
            own = float(span) * height / pixels
            framings[k] = _Framing(targets[k], floors[k], azimuth, AWAY * size, own, float(low) + own / 2, height)
    return framings, float(aspect)


def _alike(sizes: Sequence[float]) -> list[list[int]]:
    """Rows that share a scale: from the largest down, those of more than a third of its size."""
    left = sorted(range(len(sizes)), key=lambda k: -sizes[k])
    groups = []
    while left:
        groups.append([k for k in left if 3 * sizes[k] >= sizes[left[0]]])
        left = left[len(groups[-1]) :]
    return groups


def _spread(vertices: Float[Array, "frames seen 3"]) -> float:
    """Largest root mean square distance of a frame's vertices from their mean: a size that turning does not change."""
    return float(np.sqrt(vertices.var(axis=1).sum(axis=1).max())) if vertices.size else 0.5


def _size(vertices: Float[Array, "frames seen 3"]) -> float:
    """The longest side of the frames' bounding boxes, metres; that of a person where there is nothing to measure."""
    return float(np.ptp(vertices, axis=1).max()) or 1.7 if vertices.size else 1.7


def _floor(vertices: Float[Array, "frames seen 3"], size: float, known: float | None) -> float:
    if known is not None:
        return known
    lowest = float(vertices[:, :, 1].min()) if vertices.size else 0.0
    return 0.0 if -size / 8 <= lowest <= size / 2 else lowest


def _targets(vertices: Float[Array, "frames seen 3"], floor: float) -> Float[Array, "frames 3"]:
    """The point of the ground under the middle of the body, each frame."""
    if vertices.size:
        middle = (vertices.max(axis=1) + vertices.min(axis=1)) / 2
    else:
        middle = np.zeros((len(vertices), 3))
    middle[:, 1] = floor
    return middle


def _box(
    vertices: Float[Array, "frames seen 3"], targets: Float[Array, "frames 3"], azimuth: float, size: float
) -> tuple[float, float, float]:
    """Half width, bottom and top of all frames on the plane of their targets, as the camera sees them, metres."""
    half, bottom, top = 0.2 * size, -0.03 * size, 0.1 * size
    if vertices.size == 0:
        return half, bottom, size
    for frame, target in zip(vertices, targets, strict=True):
        # A picture one pixel high that spans one metre: its pixels are metres.
        seen, _ = Camera(tuple(target.tolist()), azimuth, distance=AWAY * size, span=1.0).project(frame, 0, 1)
        half = max(half, float(np.abs(seen[:, 0]).max()))
        bottom, top = min(bottom, float(0.5 - seen[:, 1].max())), max(top, float(0.5 - seen[:, 1].min()))
    return half, bottom, top


@dataclass(frozen=True, eq=False)
class _Layout:
    """Where everything stands on a sheet, pixels."""

    rows: Sequence[Row]
    labels: list[list[str]]
    title: str
    size: int
    cell_width: int
    per_line: int
    left: int
    gap: int
    heights: tuple[int, ...]
    """Of each row's cells."""
    below: int
    """Space for captions and the gap to the next line."""
    begins: tuple[int, ...]
    """Where each row begins, then where the sheet ends."""

    @classmethod
    def of(
        cls, rows: Sequence[Row], frames: list[_Framing], size: int, cell_width: int, columns: int | None, title: str
    ) -> _Layout:
        gap = max(2, size // 32)
        notes = ["" if framing.floor == 0 else f"ground at y = {framing.floor:.2f} m" for framing in frames]
        texts = [f"{row.label}\n{note}".strip() for row, note in zip(rows, notes, strict=True)]
        font = _font(_label_size(size))
        labels = [_wrap(text, font, round(0.5 * size)) for text in texts]
        widest = max((font.getlength(line) for label in labels for line in label), default=0)
        longest = max(len(row.vertices) for row in rows)
        per_line = min(columns or longest, longest)
        captions = _caption_size(size) * 2 if any(row.captions for row in rows) else 0
        below = captions + gap
        top = gap + (2 * _title_size(size) if title else 0)
        lines = [-(-len(row.vertices) // per_line) for row in rows]
        heights = [framing.height for framing in frames]
        begins = np.cumsum([top] + [count * (height + below) for count, height in zip(lines, heights, strict=True)])
        plan = cls(
            rows=rows,
            labels=labels,
            title=title,
            size=size,
            cell_width=cell_width,
            per_line=per_line,
            left=gap + (round(widest) + gap if widest else 0),
            gap=gap,
            heights=tuple(heights),
            below=below,
            begins=tuple(begins.tolist()),
        )
        if plan.width * plan.height > LARGEST:
            pixels = f"{plan.width} x {plan.height}"
            raise RetargetError(f"the sheet would have {pixels} pixels; choose fewer frames or a smaller size")
        return plan

    @property
    def width(self) -> int:
        return self.left + self.per_line * (self.cell_width + self.gap // 2) + self.gap - self.gap // 2

    @property
    def height(self) -> int:
        return self.begins[-1]

    def cell(self, row: int, frame: int) -> tuple[int, int]:
        """Left and top of a cell."""
        y = self.begins[row] + frame // self.per_line * (self.heights[row] + self.below)
        return self.left + frame % self.per_line * (self.cell_width + self.gap // 2), y

    def write(self, canvas: UInt8[Array, "height width 3"]) -> UInt8[Array, "height width 3"]:
        """Title, labels and captions onto the canvas."""
        from PIL import Image, ImageDraw

        image = Image.fromarray(canvas)
        draw = ImageDraw.Draw(image)
        if self.title:
            draw.text((self.gap, self.gap), self.title, fill=INK, font=_font(_title_size(self.size)))
        for number, row in enumerate(self.rows):
            _, y = self.cell(number, 0)
            height = round(1.3 * _label_size(self.size))
            y += (self.heights[number] - height * len(self.labels[number])) // 2
            for k, line in enumerate(self.labels[number]):
                draw.text((self.gap, y + k * height), line, fill=INK, font=_font(_label_size(self.size)))
            for k, caption in enumerate(row.captions):
                x, y = self.cell(number, k)
                place = (x + self.cell_width // 2, y + self.heights[number] + _caption_size(self.size) // 3)
                draw.text(place, caption, fill=PALE, font=_font(_caption_size(self.size)), anchor="ma")
        return np.array(image)


def _title_size(size: int) -> int:
    return max(11, size // 18)


def _label_size(size: int) -> int:
    return max(9, size // 25)


def _caption_size(size: int) -> int:
    return max(8, size // 32)


def _font(pixels: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(pixels)


def _wrap(text: str, font: Any, width: int) -> list[str]:
    """Lines no wider than `width`, broken at spaces, else after _ - . /, else anywhere."""
    lines: list[str] = []
    for paragraph in text.splitlines():
        line = ""
        for letter in paragraph:
            line += letter
            if font.getlength(line) > width:
                cut = max(line.rfind(mark, 1, len(line) - 1) for mark in " _-./") + 1 or len(line) - 1
                lines.append(line[:cut].rstrip())
                line = line[cut:].lstrip()
        lines.append(line)
    return lines
