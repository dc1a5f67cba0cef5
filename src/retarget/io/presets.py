"""What the programs that results go to expect of a file: its format, its frame rate, a bone that carries the skeleton.

Axes and units need no choice: glTF fixes both, and our FBX (`blender.py`) is in centimetres with +Y up, which Unreal, Unity,
Maya and Blender read without a scale or a turn.
"""

from __future__ import annotations

from dataclasses import dataclass

from retarget.errors import unknown_name


@dataclass(frozen=True)
class Preset:
    """Conventions of one program."""

    suffix: str
    """The format of results whose file is not named."""
    root: str = ""
    """A bone at the ground that shall carry the skeleton, in FBX; none if empty."""
    rates: tuple[float, ...] = ()
    """Frames a second that it plays without reckoning between frames, rising; any if empty."""

    def rate(self, fps: float) -> float:
        """The rate for a clip of `fps` frames a second: the highest it plays that is no higher (29.97 counts as 30), else its
        lowest."""
        if not self.rates:
            return fps
        return max((rate for rate in self.rates if rate <= 1.005 * fps), default=self.rates[0])


PRESETS: dict[str, Preset] = {
    "unreal": Preset(".fbx", "root", (24.0, 25.0, 30.0, 50.0, 60.0)),
    "unity": Preset(".fbx"),
    "blender": Preset(".glb", rates=(24.0,)),
    "godot": Preset(".glb", rates=(30.0, 60.0)),
}
"""Unreal moves characters by a bone named root and wants whole rates; Blender lays glTF keys out at its scene's 24 frames a
second; Godot samples what it imports at 30."""


def preset(name: str) -> Preset:
    """A preset by its name. Raises `RetargetError` for one there is not."""
    if name not in PRESETS:
        raise unknown_name("preset", name, PRESETS, "this version")
    return PRESETS[name]
