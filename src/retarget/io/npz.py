"""What an .npz file is, told by the names of its arrays: a motion or a model of the SMPL family, a mesh sequence, or
point clouds."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path

from retarget.errors import FileError
from retarget.io.asset import Asset
from retarget.io.npz_arrays import Archive, open_archive


@dataclass(frozen=True)
class Content:
    """One kind of archive."""

    what: str
    signs: tuple[tuple[str, ...], ...]
    """Sets of arrays; an archive that holds one of them whole is of this kind."""
    module: str
    """Its `load` takes the archive."""


CONTENTS = (
    Content("an SMPL-family model", (("v_template",),), "retarget.io.smpl_model"),
    Content(
        "an AMASS or SMPL-family motion",
        (("poses",), ("root_orient", "pose_body"), ("global_orient", "body_pose")),
        "retarget.io.amass",
    ),
    Content("a mesh sequence", (("vertices", "faces"),), "retarget.io.npz_sequence"),
    Content("point clouds", (("points",),), "retarget.io.npz_clouds"),
)
"""The first that fits decides."""


def load(path: str | Path, smpl_model: str | Path | None = None) -> Asset:
    """Read an .npz file by what it holds. `smpl_model` is the user's own model, for the body of a motion.

    Raises `FileError` for an archive of no known kind, and for whatever its reader refuses.
    """
    archive = open_archive(path)
    content = _content(archive)
    reader = importlib.import_module(content.module)
    if smpl_model is None:
        return reader.load(archive)
    if content.module != "retarget.io.amass":
        raise FileError(path, f"holds {content.what}; an SMPL model is given for motions only")
    return reader.load(archive, smpl_model)


def _content(archive: Archive) -> Content:
    for content in CONTENTS:
        if any(all(name in archive for name in sign) for sign in content.signs):
            return content
    held = [name if name.isprintable() else repr(name) for name in archive.entries]
    listed = ", ".join(name[:40] for name in held[:12]) + (", ..." if len(held) > 12 else "") if held else "no arrays"
    needed = ", ".join(
        f"{content.what} has {' or '.join(' with '.join(sign) for sign in content.signs)}" for content in CONTENTS
    )
    raise FileError(archive.path, f"holds {listed}, and is none of what is read: {needed}")
