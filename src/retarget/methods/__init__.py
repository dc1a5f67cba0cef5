"""Ways to retarget, one file or folder each, chosen by name."""

from retarget.methods.base import Method, Result, Retargeter, save_results
from retarget.methods.copy_rotations import CopyRotations
from retarget.methods.interaction.method import Interaction

METHODS: dict[str, type[Method]] = {"copy-rotations": CopyRotations, "interaction": Interaction}

__all__ = ["METHODS", "CopyRotations", "Interaction", "Method", "Result", "Retargeter", "save_results"]
