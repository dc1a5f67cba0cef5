"""Motions of the SMPL family in .npz archives: AMASS (Mahmood 2019), and what SMPL-X's own tools write.

Rotations are axis times angle, parent-from-joint, from the model's rest pose. They come whole (`poses`) or in parts
(`root_orient`, `pose_body`, `pose_hand`, ... or `global_orient`, `body_pose`, `left_hand_pose`, ...). `trans` or
`transl` moves the whole model. Joint positions are not in the file: the embedded human stands in (`smpl_stand_in`),
or the user's own model gives them, and a surface with them.

Which way is up is nowhere said. AMASS stands on z = 0 with +Z up, and its archives are known by `mocap_framerate` or
`mocap_frame_rate`; but others use that key with +Y up. So such an archive is taken to have +Z up unless its body
stands on straight legs along +Y. For archives without the key nothing is stated, and the motion decides
(`motion.align`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import world_pose
from retarget.character import Character, Motion
from retarget.io.asset import Asset, Clip, Convention
from retarget.io.npz_arrays import Archive
from retarget.io.smpl_joints import FAMILIES, Family
from retarget.io.smpl_model import LEFT_OUT, SmplModel, open_model
from retarget.io.smpl_stand_in import PELVIS, stand_in

Array = np.ndarray

MOCAP_RATES = ("mocap_framerate", "mocap_frame_rate")
"""Both spellings of AMASS; they also tell its archives from others."""
RATES = (*MOCAP_RATES, "fps", "frame_rate", "framerate")
PATHS = ("trans", "transl")
ASSUMED_RATE = 30.0
"""Frames a second of an archive that says nothing; a note tells."""
RATE = (0.1, 10_000.0)
"""Frames a second that are believed."""
LONGEST = 1 << 25
"""Values of all rotations of a motion: half an hour of SMPL+H at 120 frames a second."""
Z_UP_FROM_Y_UP = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
STRAIGHT = 0.75
"""Share of the legs' length from hips to ankles along an axis that a body stands along; crawling and sitting have
half."""
LYING, OFF_THE_FLOOR = 0.4, 0.3
"""Metres: pelvis of a lying body above the floor, at most; feet away from the floor's height that stand on none."""
LOOKED_AT = 200
"""Frames that are looked at for it, about."""

_X = FAMILIES[55].names
BODY, FACE, LEFT_FINGERS, RIGHT_FINGERS = _X[:22], _X[22:25], _X[25:40], _X[40:]
PARTS: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (
    # spellings, joints
    (("root_orient", "global_orient"), BODY[:1]),
    (("pose_body", "body_pose"), BODY[1:]),
    (("pose_hand",), LEFT_FINGERS + RIGHT_FINGERS),
    (("left_hand_pose",), LEFT_FINGERS),
    (("right_hand_pose",), RIGHT_FINGERS),
    (("pose_jaw", "jaw_pose"), FACE[:1]),
    (("pose_eye",), FACE[1:]),
    (("leye_pose",), FACE[1:2]),
    (("reye_pose",), FACE[2:]),
)
"""A pose that comes in parts. The body may bring SMPL's two hand joints along."""


@dataclass(frozen=True, eq=False)
class Angles:
    """The rotations of an archive by joint."""

    family: Family
    vectors: dict[str, Float[Array, "frames 3"]]
    """Axis times angle, radians; joints that the archive does not speak of are absent."""
    notes: tuple[str, ...] = ()

    def rotations(self, names: tuple[str, ...]) -> Float[Array, "frames joints 4"]:
        """Local rotations of these joints, at rest where nothing is known."""
        rest = np.zeros_like(self.vectors["pelvis"])
        return rot.from_rotation_vector(np.stack([self.vectors.get(name, rest) for name in names], axis=1))


def load(archive: Archive, smpl_model: str | Path | None = None) -> Asset:
    """A motion of kind 'motion' on the embedded human's skeleton, or of kind 'character' on the body of a model.

    The joints carry SMPL's names; the unit is the metre. Raises `FileError` naming the array for what cannot be used.
    """
    angles = read_angles(archive)
    frames = len(angles.vectors["pelvis"])
    fps, rate_notes = _rate(archive)
    space = _shape_space(archive, angles.family)
    notes = [f"{angles.family.name} motion", *rate_notes, *angles.notes]
    if smpl_model is None:
        gender = archive.text("gender") if "gender" in archive else None
        character = stand_in(angles.family, gender, space or "SMPL")
        of = f" of gender {gender!r}" if gender else ""
        notes.append(f"joint positions are not in the file: the embedded human stands in for the model{of}")
    else:
        character, more = _body(archive, open_model(smpl_model), angles.family, space)
        notes += more
    pelvis = character.skeleton.offsets[0]
    if smpl_model is not None and space is not None and space != _space_of(character):
        pelvis = np.array(PELVIS[space])
    path = _path(archive, frames)
    if path is None:
        path = np.zeros((frames, 3))
        notes.append("the file holds no path (trans or transl): the body stays in its place")
    name, rotations = archive.path.stem, angles.rotations(character.skeleton.names)
    motion = Motion(character.skeleton, rotations, (path + pelvis)[:, None], fps, name=name)
    up = None
    if archive.first(*MOCAP_RATES) is not None:
        up = "+y" if _stands_on_y(motion) else "+z"
    if up == "+y":
        notes.append(
            "archives with this key for the frame rate have +z up, but the body stands along +y: so that is up"
        )
    if up == "+z":
        character = _stood_up(character)
        motion = replace(motion, skeleton=character.skeleton)
    kind = "motion" if character.skin is None else "character"
    return Asset(
        archive.path, kind, replace(character, name=name), clips=(Clip(name, frames, fps),),
        convention=Convention(1.0, up), notes=tuple(notes), read_clip=lambda number: motion,
    )  # fmt: skip


def read_angles(archive: Archive) -> Angles:
    """The rotations, whole or in parts. Raises `FileError` for shapes that are none of the family's."""
    if "poses" in archive:
        vectors = _vectors(archive, "poses")
        if vectors.shape[1] not in FAMILIES:
            known = ", ".join(f"{3 * joints} ({family.name})" for joints, family in FAMILIES.items())
            raise archive.fail("poses", f"has {3 * vectors.shape[1]} values a frame; known are {known}")
        family = FAMILIES[vectors.shape[1]]
        return Angles(family, {name: vectors[:, joint] for joint, name in enumerate(family.names)})
    found: dict[str, Array] = {}
    notes = []
    for spellings, names in PARTS:
        key = archive.first(*spellings)
        if key is None:
            continue
        shape = archive.shape(key)
        if names[0] in LEFT_FINGERS + RIGHT_FINGERS and len(shape) == 2 and 0 < shape[1] < 3 * len(names):
            notes.append(
                f"{key} holds {shape[1]} components of hand poses instead of angles: these fingers stay straight"
            )
            continue
        vectors = _vectors(archive, key)
        if names == BODY[1:] and vectors.shape[1] == 23:
            names = FAMILIES[24].names[1:]
        if vectors.shape[1] != len(names):
            raise archive.fail(key, f"has {3 * vectors.shape[1]} values a frame; {3 * len(names)} are needed")
        if found and len(vectors) != len(found["pelvis"]):
            raise archive.fail(key, f"has {len(vectors)} frames, the root has {len(found['pelvis'])}")
        found |= {name: vectors[:, joint] for joint, name in enumerate(names)}
    fitting = [family for family in FAMILIES.values() if set(found) <= set(family.names)]
    family = fitting[0] if fitting else FAMILIES[55]  # hand ends of SMPL with fingers or face: the ends are let go
    return Angles(family, found, tuple(notes))


def _vectors(archive: Archive, key: str) -> Float[Array, "frames joints 3"]:
    """One array of rotations. Flat or not, its last axes are joints and three numbers."""
    shape = archive.shape(key)
    flat = len(shape) == 2 and shape[1] % 3 == 0
    if not flat and not (len(shape) == 3 and shape[2] == 3):
        raise archive.fail(key, f"must be frames x joints times 3 (axis times angle), has the shape {shape}")
    if 0 in shape:
        raise archive.fail(key, f"holds no frames: its shape is {shape}")
    if int(np.prod(shape, dtype=object)) > LONGEST:
        raise archive.fail(key, f"has {shape[0]} frames; motions of up to {LONGEST // (3 * 52)} are read: cut it")
    return archive.numbers(key).reshape(shape[0], -1, 3)


def _path(archive: Archive, frames: int) -> Float[Array, "frames 3"] | None:
    key = archive.first(*PATHS)
    if key is None:
        return None
    if archive.shape(key) != (frames, 3):
        raise archive.fail(key, f"must have the shape ({frames}, 3), has {archive.shape(key)}")
    return archive.numbers(key)


def _rate(archive: Archive) -> tuple[float, list[str]]:
    """Frames a second, and what was assumed."""
    key = archive.first(*RATES)
    if key is None:
        return ASSUMED_RATE, [f"the file states no frame rate: {ASSUMED_RATE:g} frames a second are assumed"]
    if archive.shape(key) not in ((), (1,)):
        raise archive.fail(key, f"must be one number, has the shape {archive.shape(key)}")
    fps = float(archive.numbers(key).reshape(()))
    if not RATE[0] <= fps <= RATE[1]:
        raise archive.fail(key, f"must be frames a second from {RATE[0]:g} to {RATE[1]:g}, is {fps:g}")
    return fps, []


def _shape_space(archive: Archive, family: Family) -> str | None:
    """Whose betas and pelvis the archive means: 'SMPL', 'SMPL-X', or None where nothing tells."""
    said = archive.text("surface_model_type") if "surface_model_type" in archive else None
    if said:
        return "SMPL-X" if said.lower().startswith("smplx") else "SMPL"
    return None if family is FAMILIES[22] else family.shape_space


def _space_of(character: Character) -> str:
    return FAMILIES[len(character.skeleton)].shape_space


def _body(archive: Archive, model: SmplModel, family: Family, space: str | None) -> tuple[Character, list[str]]:
    """The model's body in the motion's shape, and what does not fit."""
    notes = [f"the body is {model.archive.path.name} ({model.family.name})"]
    lost = set(family.names) - set(model.family.names) - {"left_hand", "right_hand"}
    if lost:
        notes.append(f"{len(lost)} joints of the motion are not in the model and are left out")
    if "posedirs" in model.archive:
        notes.append(LEFT_OUT)
    betas = None
    if space not in (None, model.family.shape_space):
        notes.append(
            f"the motion's shape is one of {space}, which {model.family.name} does not know: the mean body is used"
        )
    elif "betas" in archive:
        betas, more = _betas(archive)
        notes += more
        if len(betas) > model.shapes:
            notes.append(f"the model knows {model.shapes} of the motion's {len(betas)} shape numbers")
    else:
        notes.append("the motion states no shape (betas): the mean body is used")
    return model.character(betas), notes


def _betas(archive: Archive) -> tuple[Float[Array, "betas"], list[str]]:
    """The shape of the performer; given frame by frame, their mean."""
    shape = archive.shape("betas")
    if len(shape) not in (1, 2) or (len(shape) == 2 and shape[0] == 0):
        raise archive.fail("betas", f"must be a row of numbers, or one a frame; has the shape {shape}")
    betas = np.atleast_2d(archive.numbers("betas"))
    varies = float(np.ptp(betas, axis=0).max(initial=0.0)) > 1e-6
    return betas.mean(axis=0), ["betas change from frame to frame: their mean is used"] if varies else []


def _stands_on_y(motion: Motion) -> bool:
    """Whether the body stands on straight legs along +Y, on average.

    A body that lies stretched out in an archive with +Z up may do the same: it is known by a pelvis at a lying one's
    height, with feet away from y = 0.
    """
    some = slice(None, None, max(1, len(motion) // LOOKED_AT))
    few = replace(motion, rotations=motion.rotations[some], translations=motion.translations[some])
    _, positions = world_pose(few)
    at = {name: positions[:, joint] for joint, name in enumerate(motion.skeleton.names)}
    sides = ("left", "right")
    drops = [at[f"{side}_hip"][:, 1] - at[f"{side}_ankle"][:, 1] for side in sides]
    bones = [
        motion.skeleton.offsets[motion.skeleton.index(f"{side}_{end}")] for side in sides for end in ("knee", "ankle")
    ]
    if np.median(drops) < STRAIGHT * 0.5 * np.linalg.norm(bones, axis=1).sum():
        return False
    height, feet = np.median(at["pelvis"][:, 2]), np.median([at[f"{side}_foot"][:, 1] for side in sides])
    return not (0.0 < height < LYING and abs(feet) > OFF_THE_FLOOR)


def _stood_up(character: Character) -> Character:
    """A body at rest with +Y up, turned so that it rests with +Z up; joints' own axes stay, so rotations apply as
    before."""
    skeleton, turn = character.skeleton, Z_UP_FROM_Y_UP
    rest, offsets = skeleton.rest_rotations.copy(), skeleton.offsets.copy()
    rest[0], offsets[0] = turn, rot.rotate(turn, offsets[0])
    skeleton = replace(skeleton, rest_rotations=rest, offsets=offsets)
    if character.skin is None:
        return replace(character, skeleton=skeleton)
    back = np.eye(4)
    back[:3, :3] = rot.to_matrix(rot.inverse(turn))
    skin = replace(character.skin, inverse_binds=character.skin.inverse_binds @ back)
    mesh = replace(character.mesh, vertices=rot.rotate(turn, character.mesh.vertices))
    return replace(character, skeleton=skeleton, mesh=mesh, skin=skin)
