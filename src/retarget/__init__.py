"""Any motion onto any body.

    from retarget import retarget
    retarget("dance.bvh", "knight.glb").save("knight_dance.glb")

The names below are the front door; each is loaded when first used, so importing the package costs next to nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from retarget.body.human import human
    from retarget.body.skinning import skin_motion
    from retarget.casting import Hints, cast
    from retarget.character import Character, Mesh, Motion, PointCloud, Pose, Skeleton, Skin
    from retarget.correspond.joints import match_humanoid
    from retarget.errors import FileError, MatchError, RetargetError
    from retarget.io import load, save
    from retarget.io.asset import Asset
    from retarget.methods import METHODS, Result, save_results
    from retarget.motion.align import Actor
    from retarget.motion.library import embedded_motion, motion_names
    from retarget.retargeting import Production, prepare, retarget

_HOME = {
    "retarget": "retargeting",
    "prepare": "retargeting",
    "Production": "retargeting",
    "save_results": "methods",
    "cast": "casting",
    "Hints": "casting",
    "load": "io",
    "save": "io",
    "METHODS": "methods",
    "Result": "methods",
    "Actor": "motion.align",
    "Asset": "io.asset",
    "Skeleton": "character",
    "Mesh": "character",
    "PointCloud": "character",
    "Skin": "character",
    "Character": "character",
    "Pose": "character",
    "Motion": "character",
    "human": "body.human",
    "skin_motion": "body.skinning",
    "embedded_motion": "motion.library",
    "motion_names": "motion.library",
    "match_humanoid": "correspond.joints",
    "RetargetError": "errors",
    "FileError": "errors",
    "MatchError": "errors",
}
__all__ = [*_HOME, "__version__"]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'retarget' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"retarget.{_HOME[name]}"), name)
    globals()[name] = value
    return value
