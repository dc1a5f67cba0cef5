"""Ways to retarget, one file each, chosen by name."""

from retarget.methods.base import Method, Result, Retargeter, save_results
from retarget.methods.copy_rotations import CopyRotations

METHODS: dict[str, type[Method]] = {"copy-rotations": CopyRotations}

__all__ = ["METHODS", "CopyRotations", "Method", "Result", "Retargeter", "save_results"]
