"""Ways to retarget, one file or folder each, chosen by name."""

from retarget.methods.base import Method, Result, Retargeter, save_results
from retarget.methods.copy_rotations import CopyRotations
from retarget.methods.deformation_transfer import DeformationTransfer
from retarget.methods.interaction.learned import LearnedInteraction
from retarget.methods.interaction.method import Interaction
from retarget.methods.shape_transfer.method import ShapeTransfer

METHODS: dict[str, type[Method]] = {
    "copy-rotations": CopyRotations,
    "deformation-transfer": DeformationTransfer,
    "interaction": Interaction,
    "learned-interaction": LearnedInteraction,
    "shape-transfer": ShapeTransfer,
}

__all__ = [
    "METHODS", "CopyRotations", "DeformationTransfer", "Interaction", "LearnedInteraction", "Method", "Result", "Retargeter", "ShapeTransfer",
    "save_results",
]  # fmt: skip
