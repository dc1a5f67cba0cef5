"""A report's curves over time as SVG for its page: a panel a kind, with a line that marks the moment shown."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

import numpy as np
from jaxtyping import Bool, Float

from retarget.contact.ground import intervals
from retarget.evaluate.report import Report
from retarget.view.curves import LEAST_CM, LEAST_SPEED, LEFT, NEUTRAL, RIGHT, SOURCE, bar_rows

Array = np.ndarray

WIDTH, LEFT_EDGE, RIGHT_EDGE = 960.0, 190.0, 12.0
"""Units of the drawing, and what is left of and right of the time axis."""
PLOT = WIDTH - LEFT_EDGE - RIGHT_EDGE
HIGH, ROW = 110.0, 17.0
"""Height of a panel of curves, and of a row of contacts."""
BEFORE = "#b8860b"
"""Colour of the copied joint angles, before correction."""


def curve_panels(report: Report, before: Report | None = None) -> Iterator[tuple[str, str]]:
    """(title, SVG) of each panel. The result is drawn full, the source dashed, what was before correction in ochre."""
    bars = list(bar_rows(report))
    if bars:
        yield "Contacts (thin grey: the source's)", _bars(bars, report)
    time = report.curves["time_s"]
    if "depth_cm/result" in report.curves:
        lines = [(report.curves["depth_cm/result"], NEUTRAL, "")]
        if "depth_cm/source" in report.curves:
            lines.insert(0, (report.curves["depth_cm/source"], SOURCE, "5 3"))
        if before is not None and "depth_cm/result" in before.curves:
            lines.insert(0, (before.curves["depth_cm/result"], BEFORE, ""))
        yield "Deepest penetration, cm", _lines(time, lines, 0.0, LEAST_CM / 2)
    for title, kind, part, low, high in (
        ("Foot over the floor, cm", "foot_height_cm", "foot", -LEAST_CM / 4, LEAST_CM),
        ("Hand speed, m/s", "speed_m_s", "hand", 0.0, LEAST_SPEED),
        ("Foot speed, m/s", "speed_m_s", "foot", 0.0, LEAST_SPEED),
    ):
        lines = [
            (report.curves[f"{kind}/{who}/{side} {part}"], colour, dash)
            for who, dash in (("source", "5 3"), ("result", ""))
            for side, colour in (("left", LEFT), ("right", RIGHT))
            if f"{kind}/{who}/{side} {part}" in report.curves
        ]
        if lines:
            yield title, _lines(time, lines, low, high)


def _lines(
    time: Float[Array, "frames"], lines: list[tuple[Float[Array, "frames"], str, str]], low: float, high: float
) -> str:
    low = min(low, *(float(values.min()) for values, *_ in lines))
    high = max(high, *(float(values.max()) for values, *_ in lines)) * 1.08
    tall = HIGH - 24
    y = lambda value: 6 + tall * (high - value) / (high - low)  # noqa: E731
    marks = [
        f'<line x1="{LEFT_EDGE}" x2="{WIDTH - RIGHT_EDGE}" y1="{y(mark):.1f}" y2="{y(mark):.1f}" class="grid"/>'
        f'<text x="{LEFT_EDGE - 8}" y="{y(mark) + 4:.1f}" text-anchor="end">{mark:g}</text>'
        for mark in _marks(low, high, 4)
    ]
    x = LEFT_EDGE + PLOT * time / max(float(time[-1]), 1e-9)
    drawn = []
    for values, colour, dash in lines:
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y(values)))
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        drawn.append(f'<polyline points="{points}" stroke="{colour}"{dashes} class="curve"/>')
    return _panel(HIGH, float(time[-1]), [*marks, *drawn])


def _bars(rows: list[tuple[str, Bool[Array, "frames"], Bool[Array, "frames"] | None]], report: Report) -> str:
    frames = len(report.curves["time_s"])
    drawn = []
    for number, (label, result, source) in enumerate(rows):
        top = 4 + ROW * number
        colour = LEFT if label.startswith("left") else RIGHT if label.startswith("right") else NEUTRAL
        drawn.append(f'<text x="{LEFT_EDGE - 8}" y="{top + 11:.1f}" text-anchor="end">{escape(label)}</text>')
        for on, tone, down, thick in ((result, colour, 1, 8), (source, SOURCE, 10, 4)):
            for start, stop in intervals(on) if on is not None else ():
                x, wide = LEFT_EDGE + PLOT * start / frames, PLOT * (stop - start) / frames
                drawn.append(f'<rect x="{x:.1f}" y="{top + down}" width="{wide:.1f}" height="{thick}" fill="{tone}"/>')
    return _panel(ROW * len(rows) + 26, float(report.curves["time_s"][-1]), drawn)


def _panel(high: float, seconds: float, drawn: list[str]) -> str:
    ticks = [
        f'<text x="{LEFT_EDGE + PLOT * mark / max(seconds, 1e-9):.1f}" y="{high - 4}" text-anchor="middle">{mark:g}</text>'
        for mark in _marks(0.0, seconds, 10)
    ]
    head = f'<line class="playhead" data-width="{PLOT}" x1="{LEFT_EDGE}" x2="{LEFT_EDGE}" y1="0" y2="{high - 18}"/>'
    return (
        f'<svg viewBox="0 0 {WIDTH} {high}" data-left="{LEFT_EDGE}" data-plot="{PLOT}" data-whole="{WIDTH}">'
        + "".join([*drawn, *ticks, head])
        + "</svg>"
    )


def _marks(low: float, high: float, most: int) -> list[float]:
    """Round values within a range, at most about so many."""
    if not high > low:
        return [low]
    rough = (high - low) / most
    size = 10.0 ** np.floor(np.log10(rough))
    step = size * next(each for each in (1, 2, 5, 10) if each * size >= rough * 0.999)
    first = int(np.ceil(low / step - 1e-9))
    return [round(float(number * step), 10) for number in range(first, int(np.floor(high / step + 1e-9)) + 1)]
