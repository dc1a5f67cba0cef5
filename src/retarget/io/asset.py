"""What a file held, before anyone interprets it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from retarget.character import Character, Mesh, MeshMotion, Motion, PointCloud, PointMotion, Provenance
from retarget.errors import FileError, unknown_name

MOST_JOINTS = 20_000
"""Joints of a file that is read: more are no skeleton, and would keep everyone busy for minutes."""


@dataclass(frozen=True)
class Convention:
    """What the file itself says of its space; None where it is silent (BVH, OBJ and PLY always are)."""

    metres_per_unit: float | None = None
    up: str | None = None
    """'+y', '+z' or another signed axis."""
    forward: str | None = None


@dataclass(frozen=True)
class Clip:
    """One animation of a file, without its data."""

    name: str
    frames: int
    fps: float
    made_from: Provenance | None = None
    """What it was retargeted from, where the file says so; its `Motion` says the same."""


@dataclass(frozen=True, eq=False)
class Asset:
    """What one file held, in the file's own units and axes."""

    path: Path
    kind: str
    """'motion' (skeleton and clips), 'character' (with a skin), 'mesh', 'points', 'mesh sequence' or 'point sequence'."""
    character: Character | None = None
    """Skeleton, and surface where the file has one; present for the kinds 'motion' and 'character'."""
    mesh: Mesh | None = None
    """The bare surface of a 'mesh'."""
    points: PointCloud | None = None
    """The cloud of a file of kind 'points'."""
    sequence: MeshMotion | None = None
    """The moving surface of a 'mesh sequence'."""
    clouds: PointMotion | None = None
    """The frames of a 'point sequence'."""
    clips: tuple[Clip, ...] = ()
    convention: Convention = field(default_factory=Convention)
    humanoid: Mapping[str, str] | None = None
    """The human that the file itself names (VRM): humanoid joint to joint name, as in a map file; None where it is silent."""
    notes: tuple[str, ...] = ()
    """Faults found, repairs made and content passed over, one sentence each."""
    beside: tuple[Path, ...] = ()
    """Other files in its folder that were looked for while it was read (pictures, buffers, layers), there or not: what the
    asset depends on besides `path`."""
    plays: int | None = None
    """The clip that the file itself plays, where its format says so (USD); appended ones stand last in all others."""
    read_clip: Callable[[int], Motion] | None = None
    """Decodes one clip; files with dozens of clips are not decoded for the one that is wanted."""

    def motion(self, clip: str | int | None = None) -> Motion:
        """One clip of the file: by name, by number, or the only one (the first, where there are several).

        Raises `FileError` if the file holds no clip, `RetargetError` if none has that name.
        """
        self.expect_joints()
        if not self.clips or self.read_clip is None:
            raise FileError(self.path, "holds no animation clip")
        names = [each.name for each in self.clips]
        if isinstance(clip, str):
            if clip not in names:
                raise unknown_name("clip", clip, names, str(self.path))
            clip = names.index(clip)
        if clip is not None and not 0 <= clip < len(names):
            raise FileError(self.path, f"has {len(names)} clips, numbered from 0; received {clip}")
        return self.read_clip(clip or 0)

    def expect_joints(self) -> None:
        """Raises `FileError` for a mesh or point sequence, saying what can be done with one."""
        if self.sequence is not None:
            cure = "`retarget run` takes it as a motion, `info` and `picture` show it, `convert` writes it in other formats"
            raise FileError(self.path, f"holds a mesh sequence, whose surface moves without joints to follow; {cure}")
        if self.clouds is not None:
            cure = "`retarget run` and `skeleton` take it as a motion, `info` and `picture` show it, `convert` writes it in other formats"
            raise FileError(self.path, f"holds a point sequence, a capture without joints to follow; {cure}")
