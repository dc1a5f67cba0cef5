"""Who plays: a subject of any kind becomes an actor, with its joints matched, in metres with +Y up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from retarget.body.skinning import rest_vertices
from retarget.character import Character, Mesh, Motion, PointCloud
from retarget.correspond.joints import REQUIRED_JOINTS, Humanoid, humanoid_from_names, match_humanoid
from retarget.errors import FileError, MatchError, RetargetError
from retarget.geometry.riding import Riders, place_riders
from retarget.io import load
from retarget.io.asset import Asset, Convention
from retarget.motion.align import Actor, make_actor
from retarget.progress import Tell, untold

NEEDED = tuple(name for name in REQUIRED_JOINTS if name != "spine")
"""The joints without which no method has limbs to move."""


@dataclass(frozen=True)
class Hints:
    """What the user knows better than inference: joint names, up axis, unit."""

    joints: Mapping[str, str] | None = None
    """Canonical name to joint name, as in a map file; None lets matching decide."""
    up: str | None = None
    unit: float | None = None
    """Metres per unit."""


def open_asset(subject: str | Path | Asset) -> Asset:
    """The asset itself, or the file read."""
    return subject if isinstance(subject, Asset) else load(subject)


def cast(
    subject: str | Path | Asset | Character | Mesh | PointCloud,
    hints: Hints | None = None,
    motion: Motion | None = None,
    tell: Tell = untold,
) -> Actor:
    """Match the joints of a character or skeleton and bring it into metres with +Y up. A bare mesh or cloud of points gets
    the embedded human's rig first (`rig.rigging.rig`).

    `motion`, in the file's own space, shows which way the body stands. Raises `MatchError` for a body that is no
    humanoid, `FileError` for a file without body, and `RetargetError` where a bare mesh cannot be rigged with certainty.
    """
    hints = hints or Hints()
    named, made, cloud = None, (), None
    if isinstance(subject, Character):
        character, convention = subject, Convention(1.0, "+y")
    else:
        asset = None if isinstance(subject, (Mesh, PointCloud)) else open_asset(subject)
        if asset is not None:
            asset.expect_joints()
        bare = subject if asset is None else asset.mesh or asset.points
        if asset is not None and asset.character is not None:
            character, convention, named = asset.character, asset.convention, asset.humanoid
        elif bare is not None:
            character, made, cloud = _rigged(bare, asset, hints, tell)
            convention, hints = Convention(1.0, "+y"), replace(hints, up=None, unit=None)
        else:
            raise FileError(asset.path, f"holds a {asset.kind}; a character, a mesh or a skeleton is needed")
    humanoid, notes = _humanoid(character, hints.joints, named)
    surface = rest_vertices(character) if character.skin is not None else None
    actor = make_actor(character, humanoid, convention, motion, up=hints.up, unit=hints.unit, rest_surface=surface)
    return replace(actor, notes=(*made, *notes, *actor.notes), cloud=cloud)


def _rigged(
    bare: Mesh | PointCloud, asset: Asset | None, hints: Hints, tell: Tell
) -> tuple[Character, tuple[str, ...], Riders | None]:
    """A bare body with the embedded human's rig, in metres with +Y up, what was found of it, and where a cloud's points lie on
    its surface."""
    from retarget.rig.rigging import as_mesh, rig

    unit = hints.unit or (asset.convention.metres_per_unit if asset is not None else None)
    try:
        mesh = as_mesh(bare, tell)
        found = rig(mesh, unit=unit, tell=tell)
    except RetargetError as error:
        raise (error if asset is None else FileError(asset.path, str(error))) from None
    name = found.character.name if asset is None else asset.path.stem
    cloud = place_riders(bare.points, mesh.vertices, mesh.faces, found.unit) if isinstance(bare, PointCloud) else None
    return replace(found.character, name=name), (f"rigged with confidence {found.confidence:.2f}", *found.notes), cloud


def _humanoid(
    character: Character, told: Mapping[str, str] | None, named: Mapping[str, str] | None
) -> tuple[Humanoid, tuple[str, ...]]:
    """The humanoid by the map that the user told, else by the one that the file names, else matched; with notes."""
    skeleton, notes = character.skeleton, ()
    try:
        if not told and named:
            try:
                return replace(_complete(humanoid_from_names(skeleton, named)), evidence="the file"), ()
            except MatchError as error:
                missing = ", ".join(error.missing)
                notes = (f"the humanoid that the file names lacks {missing}: its joints are matched by names and shape",)
        return _complete(humanoid_from_names(skeleton, told) if told else match_humanoid(skeleton)), notes
    except MatchError as error:
        raise MatchError(f"{character.name}: {error}" if character.name else str(error), error.missing) from None


def _complete(humanoid: Humanoid) -> Humanoid:
    """The humanoid, if it has all the limbs that methods move. Raises `MatchError`."""
    missing = tuple(name for name in NEEDED if name not in humanoid.joints)
    if missing:
        lines = ", ".join(f'{name} = "name of the joint"' for name in missing)
        raise MatchError(
            f"no joint was found for {', '.join(missing)}; name what the body has in a map file, a line each: {lines}",
            missing,
        )
    return humanoid
