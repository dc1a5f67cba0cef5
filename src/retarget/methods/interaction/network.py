"""The interaction network in use: how a copied pose is corrected without solving anything (after Ye 2024).

The paper's network reads the dense field of every sensor through PointNets and a transformer and says all rotations anew, learning from the
field's agreement alone. Ours starts from the copied pose, looks at the field summed up by pairs of parts (`contact/part_field.py`), says how
joints should turn, and looks again at what that has made, three times, each time in the mirror too; and it has learnt from the
solver. No frame sees another, but clips are smoothed a little afterwards. `train/interaction.py` is its recipe, `docs/models/interaction.md` its card.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import world_pose
from retarget.character import Motion
from retarget.contact.skin_levers import TURNING
from retarget.io.onnx_network import open_network
from retarget.methods.interaction.looker import Looker, Posed, nothing_turned
from retarget.methods.interaction.mirrored import mirror_of_features, mirror_of_turned
from retarget.motion.touch.mend import frames_of
from retarget.motion.touch.solve import FREE, FREE_SHIFT

Array = np.ndarray

KIND, VERSION = "interaction", "1"
FOLDER = Path(__file__).with_name("weights")
FILES = tuple(f"interaction_look_{number}.onnx" for number in (1, 2))
ORDER = (0, 1, 1)
"""Which network looks, one after the other."""
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

    def said(self, looker: Looker, source: Posed, copied: Motion) -> Float[Array, "frames SIZE"]:
        """The same for sensors of the performer that are posed already."""
        world, turned = world_pose(copied)[0], nothing_turned(len(copied))
        for number in ORDER:
            features = looker.features(source, copied, world, turned)
            turned = bounded(turned + self._change(number, features))
        return turned

    def _change(self, number: int, features: Float[Array, "frames features"]) -> Float[Array, "frames SIZE"]:
        """What a look says of poses, evened with what it says of their mirror images: it errs less, and sides are treated alike."""
        mirrored = np.concatenate([features, mirror_of_features()(features)])
        own, other = np.split(self.looks[number].run(None, {"features": mirrored})[0], 2)
        return 0.5 * (own + mirror_of_turned()(other))


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
