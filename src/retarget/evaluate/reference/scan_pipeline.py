"""Rekik et al. 2023 end to end: clouds to joints (SKR), joints to the target's rotations and path (SMRM), and the target's skin
(SKIN), with weights that `retarget train paper-...` learnt. Needs torch: import only where used.

Ours, where the paper is silent: SMRM sees a window that ends with the frame it is asked for (online, as it was trained), the path
begins where it is told to, and SKIN reads the target with its arms level.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import forward
from retarget.character import Character, PointMotion
from retarget.errors import FileError, RetargetError
from retarget.methods.scan.features import JOINTS, PARENTS, thinned

Array = np.ndarray

POINTS = 512
"""Drawn of each cloud, in training too (the paper takes 6,890)."""
LEVEL = 48.0
"""Degrees from the embedded human's rest pose to arms that are level."""
SKR, SMRM, SKIN = "paper-skr", "paper-smrm", "paper-skin"


@dataclass(frozen=True, eq=False)
class Published:
    """The three networks, or two of them and a variant of the third."""

    regressor: Any
    retargeter: Any
    skinner: Any
    context: int
    """Frames that SMRM sees."""
    seconds: Mapping[str, float]
    """Processor time that each was trained for."""

    def retargeted(
        self, capture: PointMotion, target: Character, first: Float[Array, "3"]
    ) -> tuple[Float[Array, "frames joints 3"], Float[Array, "frames vertices 3"]]:
        """The 22 joints and the vertices of an embedded human that does what the capture shows; its hips begin at `first`."""
        joints = self.regressed(capture)
        rotations, moves = self.driven(joints, target)
        path = first + np.cumsum(moves, axis=0) - moves[0]
        offsets = np.broadcast_to(target.skeleton.offsets[:JOINTS], (len(joints), JOINTS, 3)).copy()
        offsets[:, 0] = path
        turns, places = forward(PARENTS, rotations, offsets)
        return places, self.skinned(target, turns, places)

    def regressed(self, capture: PointMotion) -> Float[Array, "frames joints 3"]:
        """Joints of every cloud, metres, in the world."""
        import torch

        draw, points, middles = np.random.default_rng(13), [], []
        for cloud in capture.clouds:
            thin = thinned(np.ascontiguousarray(cloud, dtype=np.float64))
            points.append(thin.places[0][draw.integers(len(thin.places[0]), size=POINTS)])
            middles.append(thin.middles[0])
        with torch.no_grad():
            found = self.regressor(torch.from_numpy(np.stack(points))).numpy()
        return found.astype(np.float64) + np.stack(middles)[:, None]

    def driven(
        self, joints: Float[Array, "frames joints 3"], target: Character
    ) -> tuple[Float[Array, "frames joints 4"], Float[Array, "frames 3"]]:
        """The target's local rotations and its hips' move since the frame before, from the source's joints."""
        import torch

        moves = np.diff(joints[:, 0], axis=0, prepend=joints[:1, 0])
        rest = forward(PARENTS, np.tile(rot.IDENTITY, (JOINTS, 1)), target.skeleton.offsets[:JOINTS])[1]
        frames = np.maximum(np.arange(len(joints))[:, None] + np.arange(1 - self.context, 1), 0)
        read = [joints - joints[:, :1], moves]
        windows = [torch.from_numpy(each[frames].astype(np.float32)) for each in read]
        skeleton = torch.from_numpy((rest - rest[:1]).astype(np.float32)).expand(len(joints), -1, -1)
        with torch.no_grad():
            rotations, moved = self.retargeter(*windows, skeleton)
        return rotations[:, -1].numpy().astype(np.float64), moved[:, -1].numpy().astype(np.float64)

    def skinned(
        self, target: Character, turns: Float[Array, "frames joints 4"], places: Float[Array, "frames joints 3"]
    ) -> Float[Array, "frames vertices 3"]:
        """The target's vertices by the weights that SKIN gives them."""
        import torch

        from retarget.body.skinning import prepare_skinning

        level = np.tile(rot.IDENTITY, (len(target.skeleton), 1))
        for side, sign in (("left", 1.0), ("right", -1.0)):
            arm = target.skeleton.names.index(f"{side}UpperArm")
            level[arm] = rot.from_rotation_vector(np.array([0.0, 0.0, sign * np.radians(LEVEL)]))
        stance, joints = forward(target.skeleton.parents, level, target.skeleton.offsets)
        points = prepare_skinning(target).vertices(stance[None], joints[None])[0]
        asked = [torch.from_numpy(each[None].astype(np.float32)) for each in (points, joints[:JOINTS])]
        with torch.no_grad():
            weights = self.skinner(*asked)[0].numpy().astype(np.float64)
        onward = rot.multiply(turns, rot.inverse(stance[:JOINTS]))
        matrices = rot.to_matrix(onward)
        shifts = places - np.einsum("fjab,jb->fja", matrices, joints[:JOINTS])
        blended = np.tensordot(matrices, weights, axes=(1, 1))  # frames, 3, 3, vertices
        return np.einsum("fabv,vb->fva", blended, points) + np.einsum("fja,vj->fva", shifts, weights)


def load_published(folder: Path) -> dict[str, Published]:
    """The networks whose weights are in a folder, by the name of the variant ("" for the paper's own). Raises `FileError` for
    weights that are missing or of other networks, `RetargetError` where torch is not installed."""
    try:
        import torch
    except ModuleNotFoundError:
        raise RetargetError("the paper's networks need torch, which is not installed: pip install 'retarget[train]'") from None
    from retarget.evaluate.reference import scan_networks as networks

    makers = {SKR: networks.SkeletonRegressor, SMRM: networks.MotionRetargeter, SKIN: networks.SkinningPredictor}
    found, spent = {}, {}
    paths = sorted(path for name in makers for path in folder.glob(f"{name}*.pt"))  # other papers' may be there too
    for path in [folder / f"{name}.pt" for name in makers if folder / f"{name}.pt" not in paths] + paths:
        if not path.is_file():
            raise FileError(path, "the network's weights are not there; retarget train makes them")
        stored = torch.load(path, weights_only=True)
        network = makers["-".join(path.stem.split("-")[:2])]()
        try:
            network.load_state_dict(stored["weights"])
        except (KeyError, RuntimeError) as error:
            raise FileError(path, f"weights of another network ({type(error).__name__})") from None
        found[path.stem], spent[path.stem] = network.eval(), float(stored["seconds"])
    variants = {name: name for name in found if name not in makers} | {"": ""}
    return {
        name: _assembled(found, spent, {kind: name if name.startswith(kind) else kind for kind in makers})
        for name in sorted(variants)
    }


def _assembled(found: Mapping[str, Any], spent: Mapping[str, float], chosen: Mapping[str, str]) -> Published:
    from retarget.evaluate.reference.scan_networks import CONTEXT

    asked = chosen[SMRM].rpartition("context-")[2]
    context = int(asked) if asked.isdigit() else CONTEXT
    return Published(
        found[chosen[SKR]], found[chosen[SMRM]], found[chosen[SKIN]], context, {name: spent[name] for name in chosen.values()}
    )
