"""The interaction network in use: how a copied pose is corrected in a few milliseconds (after Ye 2024).

The paper's network reads the dense field of every sensor through PointNets and a transformer and says all rotations anew, learning from the
field's agreement alone. Ours starts from the copied pose, looks at the field summed up by pairs of parts (`contact/part_field.py`), says
what each pair and each joint weigh in a small linear system (`part_equations.py`) and what to add to its solution, and looks again at
what that has made, three times, each time in the mirror too; and it has learnt from the solver. No frame sees another, but clips are
smoothed a little afterwards. `train/interaction.py` is its recipe, `docs/models/interaction.md` its card.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from retarget.body.kinematics import world_pose
from retarget.character import Motion
from retarget.contact.part_field import FIGURES, PAIRS
from retarget.contact.sensor_bones import SIDES
from retarget.contact.skin_levers import TURNING
from retarget.io.onnx_network import open_network
from retarget.methods.interaction.looker import SEEN, Looker, Posed, beside_seen, nothing_turned
from retarget.methods.interaction.mirrored import mirror_of_features, mirror_of_said
from retarget.methods.interaction.part_equations import part_steps
from retarget.methods.interaction.unknowns import SIZE
from retarget.motion.filter import gaussian
from retarget.motion.touch.mend import frames_of
from retarget.motion.touch.solve import FREE, FREE_SHIFT

Array = np.ndarray

KIND, VERSION = "interaction", "2"
FOLDER = Path(__file__).with_name("weights")
FILES = tuple(f"interaction_look_{number}.onnx" for number in (1, 2))
ORDER = (0, 1, 1)
"""Which network looks, one after the other."""
CALM = 0.06
"""Seconds: standard deviation of the Gaussian that corrections of a clip are smoothed with."""
TOUCHES, SINKS = (0.1, 0.25), (0.014, 0.024)
"""Closeness of two parts on the performer from which on they may touch, and do (`part_field_kernels.TOUCHING`); and how deep one is in the
other on the target: `MARGIN` there where they touch."""
STRETCH = 512
"""Frames that are looked at in one go."""
FREEDOM = np.append([FREE[name.removeprefix("left").removeprefix("right")] for name in TURNING], FREE_SHIFT)
"""Radians of each joint, and heights of the hips' shift."""


@dataclass(frozen=True, eq=False)
class InteractionNetwork:
    """Says corrections; `load_network()` makes it. One thread."""

    looks: tuple[Any, ...]
    """Sessions of ONNX Runtime."""

    def __call__(self, looker: Looker, performed: Motion, copied: Motion) -> Float[Array, "frames SIZE"]:
        """The corrections of copied poses, each by itself; a stretch at a time, so that memory does not grow with a clip."""
        parts = [np.arange(start, min(start + STRETCH, len(copied))) for start in range(0, len(copied), STRETCH)]
        return np.concatenate([self.said(looker, looker.source(frames_of(performed, part)), frames_of(copied, part)) for part in parts])

    def clip(self, looker: Looker, performed: Motion, copied: Motion, fps: float) -> Float[Array, "frames SIZE"]:
        """The corrections of a clip of so many frames a second, smoothed: no frame has seen another."""
        return gaussian(self(looker, performed, copied), CALM * fps)

    def said(self, looker: Looker, source: Posed, copied: Motion) -> Float[Array, "frames SIZE"]:
        """The same for sensors of the performer that are posed already."""
        world, turned = world_pose(copied)[0], nothing_turned(len(copied))
        first = looker.features(source, copied, world, turned)
        for place, number in enumerate(ORDER):
            features = looker.features(source, copied, world, turned) if place else first
            turned = bounded(turned + self._change(number, features, turned))
        return cause(first) * turned

    def _change(
        self, number: int, features: Float[Array, "frames features"], turned: Float[Array, "frames SIZE"]
    ) -> Float[Array, "frames SIZE"]:
        """What a look says of poses, evened with what it says of their mirror images: it errs less, and sides are treated alike."""
        seen = features[:, :SEEN]
        both = np.concatenate([seen, mirror_of_features().beginning(SEEN)(seen)])
        own, other = np.split(self.looks[number].run(None, {"features": both})[0], 2)
        places, axes, asked = beside_seen(features)
        return part_steps(features, places, axes, turned, asked, 0.5 * (own + mirror_of_said()(other)))


def cause(features: Float[Array, "frames features"]) -> Float[Array, "frames SIZE"]:
    """From 0 to 1, how much cause copied poses give to turn each joint of the arms; 1 for all others.

    An arm that touches something on the performer, or is inside something on the target, has some. One that merely hangs beside the
    body has none, however far from its own trunk a lean one's arms hang."""
    figures = features[:, : FIGURES * len(PAIRS)].reshape(-1, len(PAIRS), FIGURES)
    touching, sunk = (np.clip((figures[..., place] - low) / (high - low), 0.0, 1.0) for place, (low, high) in ((0, TOUCHES), (15, SINKS)))
    out = np.ones((len(features), SIZE))
    for side in SIDES:
        touches, sinks = _arm_pairs(side)
        own = np.maximum(touching[:, touches].max(axis=1), sunk[:, sinks].max(axis=1))
        for number, name in enumerate(TURNING):
            if name.startswith(side) and not name.endswith(("Leg", "Foot")):
                out[:, 3 * number : 3 * number + 3] = own[:, None]
    return out


@lru_cache(maxsize=2)
def _arm_pairs(side: str) -> tuple[Int[Array, "touch"], Int[Array, "sink"]]:
    """Pairs of parts by which an arm may touch, and by which it may sink in: an upper arm is always next to its trunk and shoulder."""
    touches, sinks = [], []
    for number, pair in enumerate(PAIRS):
        arm = [part for part in pair if part.startswith(side) and part.endswith(("Arm", "Hand"))]
        others = [part for part in pair if part not in arm]
        if not arm:
            continue
        upper = arm[0].endswith("UpperArm") and len(others) == 1
        if not (upper and others[0].endswith("Shoulder")):
            sinks.append(number)
            if not (upper and others[0] in ("spine", "chest", "neck", "head")):
                touches.append(number)
    return np.array(touches), np.array(sinks)


def bounded(turned: Float[Array, "frames SIZE"]) -> Float[Array, "frames SIZE"]:
    """Corrections within the freedom that the solver gives each joint: figures unlike all that was learnt from stay in one piece."""
    vectors = turned.reshape(len(turned), -1, 3)
    lengths = np.linalg.norm(vectors, axis=2, keepdims=True)
    return (vectors * np.minimum(1.0, FREEDOM[:, None] / np.maximum(lengths, 1e-9))).reshape(turned.shape)


@lru_cache(maxsize=4)
def load_network(folder: Path = FOLDER) -> InteractionNetwork:
    """The network with the package's weights, or those of a folder. Raises `FileError` for weights that are missing, damaged or
    of another version."""
    return InteractionNetwork(tuple(open_network(folder / name, KIND, VERSION) for name in FILES))
