"""The panel of the live viewer: its controls, its keys, and the tables of what was matched."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from retarget.contact.parts import PARTS
from retarget.view.patches import KINDS, Clock
from retarget.view.report_page import joint_table
from retarget.view.stage import StageBody, part_colors

SPEEDS = {"0.1 ×": 0.1, "0.25 ×": 0.25, "0.5 ×": 0.5, "1 ×": 1.0, "2 ×": 2.0}
BESIDE, OVERLAID = "side by side", "overlaid"
LAYERS = ("skin", "skeleton", "sensors", "body parts", "contacts")
"""What is shown of a body."""
SCENE = ("same size", "camera follows", "shadows")
"""Further switches."""
ON = ("skin", "contacts", "camera follows", "shadows")
"""Those that are on at first."""
STALE = 0.1
"""Seconds that the slider may stand behind while it plays: moving it costs the browser as much as a body."""
SOON = 0.005
"""Seconds that are not worth moving the slider for."""
TOLD = ("touches", "up to 1 cm inside", "deeper")


@dataclass(frozen=True)
class Acts:
    """What the controls do. Called by viser's threads."""

    toggle: Callable[[], None]
    """Play, or stop."""
    seek: Callable[[float], None]
    """Stand still at a second."""
    step: Callable[[int], None]
    """Stand still so many frames on."""
    speed: Callable[[float], None]
    changed: Callable[[], None]
    """Look at the switches again."""


class Panel:
    """The controls. `boxes` are the switches by name, `who` those of the bodies."""

    def __init__(self, gui: Any, bodies: Sequence[StageBody], clock: Clock, acts: Acts) -> None:
        gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        with gui.add_folder("Timeline"):
            self.play = gui.add_button("Play", hint="space; arrow keys go from frame to frame")
            self.scrub = gui.add_slider("second", 0.0, max(clock.seconds, 0.01), 0.01, 0.0)
            self.speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1 ×")
        with gui.add_folder("Bodies"):
            self.who = [gui.add_checkbox(body.label.split(":")[0], True, hint=body.label) for body in bodies]
            gui.add_html(_names(bodies))
            several = len(bodies) > 1
            self.layout = gui.add_dropdown("layout", (BESIDE, OVERLAID), initial_value=BESIDE, visible=several)
            self.boxes = {"same size": gui.add_checkbox("same size", False, visible=several)}
        with gui.add_folder("Show"):
            self.boxes |= {name: gui.add_checkbox(name, name in ON) for name in (*LAYERS, *SCENE[1:])}
            gui.add_html(_legend([color for _, color, *_ in KINDS], TOLD))
        with gui.add_folder("Colours of body parts", expand_by_default=False):
            gui.add_html(_legend(part_colors().tolist(), map(spoken, PARTS), rows=True))
        with gui.add_folder("Joints matched", expand_by_default=False):
            gui.add_html(_mapping(bodies))
        self._moved = -STALE
        self.tell(clock, 0.0)
        self._connect(gui, acts)

    def _connect(self, gui: Any, acts: Acts) -> None:
        self.play.on_click(lambda _: acts.toggle())
        # The clock moves the slider too; only a browser's hand has a client.
        self.scrub.on_update(lambda event: acts.seek(self.scrub.value) if event.client is not None else None)
        self.speed.on_update(lambda _: acts.speed(SPEEDS[self.speed.value]))
        for handle in (self.layout, *self.boxes.values(), *self.who):
            handle.on_update(lambda _: acts.changed())
        keys = (
            ("Play or stop", "space", acts.toggle),
            ("Next frame", "arrowright", lambda: acts.step(1)),
            ("Frame before", "arrowleft", lambda: acts.step(-1)),
            ("To the start", "home", lambda: acts.seek(0.0)),
        )
        for label, key, act in keys:
            gui.add_command(label, hotkey=key).on_trigger(lambda _, act=act: act())

    def layers(self) -> frozenset[str]:
        """What is to be seen of the bodies."""
        return frozenset(name for name in LAYERS if self.boxes[name].value)

    def tell(self, clock: Clock, now: float) -> None:
        """Bring the clock, read at a moment of this machine (seconds), to the panel."""
        label = "Pause" if clock.playing else "Play"
        if self.play.label != label:
            self.play.label = label
        if clock.playing and now - self._moved < STALE:
            return
        if abs(self.scrub.value - clock.time) > SOON:
            self.scrub.value, self._moved = round(clock.time, 2), now


def spoken(name: str) -> str:
    """A joint's or part's name as one says it: `leftUpperArm` is "left upper arm"."""
    return "".join(f" {letter.lower()}" if letter.isupper() else letter for letter in name)


def _names(bodies: Sequence[StageBody]) -> str:
    rows = "".join(f"<div>{escape(body.label)}</div>" for body in bodies)
    return f'<div style="padding:0 1em 0.3em;font-size:0.75em;opacity:0.7;overflow-wrap:anywhere">{rows}</div>'


def _legend(colors: Any, words: Any, rows: bool = False) -> str:
    """Squares of colour (sRGB) and what they mean."""
    tag = "div" if rows else "span"
    squares = "".join(
        f'<{tag} style="white-space:nowrap;margin-right:0.8em"><span style="color:rgb({red},{green},{blue})">■</span> '
        f"{escape(word)}</{tag}> "
        for (red, green, blue), word in zip(colors, words)
    )
    return f'<div style="padding:0 1em;font-size:0.8em">{squares}</div>'


def _mapping(bodies: Sequence[StageBody]) -> str:
    """The table of matched joints."""
    heads = "".join(f"<th>{escape(body.label.split(':')[0])}</th>" for body in bodies)
    rows = "".join(
        f"<tr><td>{escape(spoken(name))}</td>"
        + "".join(f"<td>{'–' if each is None else escape(each[0])}</td>" for each in told)
        + "</tr>"
        for name, told, _ in joint_table(bodies)
    )
    style = "font-size:0.75em;border-spacing:0.8em 0.1em;text-align:left"
    return f'<table style="{style}"><tr><th>joint</th>{heads}</tr>{rows}</table>'
