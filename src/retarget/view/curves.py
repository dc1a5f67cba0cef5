"""A report's curves over time as one picture: contacts as bars, penetration, height of the feet, speed of hands and feet."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from retarget.contact.ground import intervals
from retarget.errors import FileError
from retarget.evaluate.report import Report
from retarget.io.whole_file import written_whole

Array = np.ndarray

LEFT, RIGHT = "#0072b2", "#d55e00"
"""Colours of the body's sides, apart for every kind of colour vision (Okabe and Ito 2008)."""
NEUTRAL, SOURCE = "#3b3b3b", "#a6a6a6"
MOST_BARS = 14
"""Rows of contacts at most."""
LEAST_CM, LEAST_SPEED = 4.0, 0.5
"""The axes reach at least so far, lest noise on standing feet fill a panel; cm and m/s."""
WIDTH, DPI = 11.0, 110
"""Inches, and pixels an inch."""


def save_curves(path: Path, report: Report, title: str = "") -> None:
    """Write the picture. Raises `FileError` for a name that is not .png."""
    if path.suffix.lower() != ".png":
        raise FileError(path, "pictures are written as .png")
    figure = draw_curves(report, title)
    with written_whole(path) as file:
        figure.savefig(file, format="png", dpi=DPI)


def draw_curves(report: Report, title: str = "") -> Any:
    """The picture as a matplotlib figure. The result in colour, the source in grey or dashed, scaled to the result's size."""
    from matplotlib.figure import Figure

    bars = list(bar_rows(report))
    panels = [("bars", max(1.0, 0.26 * len(bars)))] if bars else []
    if "depth_cm/result" in report.curves:
        panels.append(("depth", 1.3))
    panels += [("height", 1.5), ("hands", 1.3), ("feet", 1.3)]
    heights = [height for _, height in panels]
    figure = Figure(figsize=(WIDTH, sum(heights) + 0.35 * len(panels) + 1.0), layout="constrained")
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    figure.suptitle(title or "Result and source over time", fontsize=11, x=0.01, ha="left", weight="bold")
    draw = {
        "bars": lambda axis: _bars(axis, bars, report),
        "depth": lambda axis: _depth(axis, report),
        "height": lambda axis: _sides(axis, report, "foot_height_cm", "foot", "foot over\nthe floor (cm)"),
        "hands": lambda axis: _sides(axis, report, "speed_m_s", "hand", "hand speed\n(m/s)"),
        "feet": lambda axis: _sides(axis, report, "speed_m_s", "foot", "foot speed\n(m/s)"),
    }
    for axis, (name, _) in zip(axes, panels):
        draw[name](axis)
        _plain(axis, report)
    axes[-1].set_xlabel("time (s)", fontsize=9)
    figure.align_ylabels([axis for axis, (name, _) in zip(axes, panels) if name != "bars"])
    _legend(figure)
    return figure


def bar_rows(report: Report) -> Iterator[tuple[str, Bool[Array, "frames"], Bool[Array, "frames"] | None]]:
    """(label, result, source) of each row: ground contacts, then parts that touch, first those of the source, the longest
    first; what never touches is left out. The source is None where it is not known."""
    rows = []
    for order, kind in enumerate(("ground", "touch")):
        names = dict.fromkeys(name.split("/", 2)[2] for name in report.curves if name.startswith(f"{kind}/"))
        known = kind == "ground" or any(name.startswith(f"{kind}/source/") for name in report.curves)
        for name in names:
            sides = [report.curves.get(f"{kind}/{who}/{name}") for who in ("result", "source")]
            none = np.zeros(len(report.curves["time_s"]), dtype=bool)
            result, source = (none if side is None else side for side in sides)
            longest = int(max(result.sum(), source.sum()))
            if longest:
                label = f"{name} – floor" if kind == "ground" else name
                rows.append((order, not source.any(), -longest, label, result, source if known else None))
    for *_, label, result, source in sorted(rows, key=lambda row: row[:4])[:MOST_BARS]:
        yield label, result, source


def _bars(axis: Any, rows: list, report: Report) -> None:
    fps = _rate(report)
    for number, (label, result, source) in enumerate(rows):
        for on, colour, low, thick in ((result, _side_colour(label), 0.06, 0.5), (source, SOURCE, 0.6, 0.26)):
            if on is not None:
                spans = [(start / fps, (stop - start) / fps) for start, stop in intervals(on)]
                axis.broken_barh(spans, (number - 0.45 + low, thick), facecolors=colour, linewidth=0)
    axis.set_yticks(range(len(rows)), [label for label, *_ in rows], fontsize=8)
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.tick_params(axis="y", length=0)
    axis.set_title("contacts (thin grey: the source's)", fontsize=9, loc="left")


def _depth(axis: Any, report: Report) -> None:
    time, depth = report.curves["time_s"], report.curves["depth_cm/result"]
    axis.fill_between(time, depth, color=NEUTRAL, alpha=0.15, linewidth=0)
    axis.plot(time, depth, color=NEUTRAL, linewidth=1.3)
    if "depth_cm/source" in report.curves:
        axis.plot(time, report.curves["depth_cm/source"], color=SOURCE, linewidth=1.0, linestyle=(0, (4, 2)))
    worst = int(depth.argmax())
    if depth[worst] > 0.1:
        axis.plot(time[worst], depth[worst], "o", color=NEUTRAL, markersize=4)
        late = time[worst] > 0.6 * time[-1]
        axis.annotate(
            report.facts.get("deepest", ""), (time[worst], depth[worst]), (0, 6), textcoords="offset points",
            ha="right" if late else "left", va="bottom", fontsize=8, color=NEUTRAL,
        )  # fmt: skip
    axis.set_ylim(0, max(LEAST_CM / 2, 1.4 * float(depth.max())))
    axis.set_ylabel("deepest\npenetration (cm)", fontsize=8)


def _sides(axis: Any, report: Report, kind: str, part: str, label: str) -> None:
    time = report.curves["time_s"]
    for side, colour in (("left", LEFT), ("right", RIGHT)):
        source = report.curves[f"{kind}/source/{side} {part}"]
        axis.plot(time, source, color=colour, linewidth=1.0, linestyle=(0, (4, 2)), alpha=0.55)
    for side, colour in (("left", LEFT), ("right", RIGHT)):
        axis.plot(time, report.curves[f"{kind}/result/{side} {part}"], color=colour, linewidth=1.3)
    low, high = axis.get_ylim()
    if kind == "foot_height_cm":
        axis.axhline(0.0, color="black", linewidth=0.8)
        axis.set_ylim(min(low, -LEAST_CM / 4), max(high, LEAST_CM))
    else:
        axis.set_ylim(0.0, max(high, LEAST_SPEED))
    axis.set_ylabel(label, fontsize=8)


def _plain(axis: Any, report: Report) -> None:
    time = report.curves["time_s"]
    axis.set_xlim(0, max(float(time[-1]) if len(time) else 0.0, 1 / _rate(report)))
    axis.grid(axis="x", color="#dddddd", linewidth=0.7)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=8)
    for spine in ("top", "right"):
        axis.spines[spine].set_visible(False)


def _legend(figure: Any) -> None:
    from matplotlib.lines import Line2D

    dashed = {"linestyle": (0, (4, 2)), "linewidth": 1.0}
    handles = [
        Line2D([], [], color=LEFT, linewidth=2, label="left"),
        Line2D([], [], color=RIGHT, linewidth=2, label="right"),
        Line2D([], [], color=NEUTRAL, linewidth=2, label="both or neither side"),
        Line2D([], [], color=SOURCE, **dashed, label="dashed, grey: the source, in the result's size"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8, frameon=False)


def _side_colour(label: str) -> str:
    first = label.split(" – ")[0]
    return LEFT if first.startswith("left") else RIGHT if first.startswith("right") else NEUTRAL


def _rate(report: Report) -> float:
    return float(report.figures["fps"] or 1.0)
