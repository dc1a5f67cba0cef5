"""Body models of the SMPL family (SMPL, SMPL+H, SMPL-X; Loper 2015, Romero 2017, Pavlakos 2019) from the user's own
.npz.

A model is a template surface, directions that its shape numbers ("betas") move it in, a regressor from surface to
joints, and skinning weights. Pose-dependent corrections (`posedirs`) are left out: a skinned character has none.
Models come under their own licence, so none is part of this project.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.character import Character, Mesh, Skeleton, Skin
from retarget.errors import FileError, RetargetError
from retarget.io.asset import Asset, Convention
from retarget.io.npz_arrays import Archive, open_archive
from retarget.io.smpl_joints import FAMILIES, Family

Array = np.ndarray

NEEDED = ("v_template", "f", "J_regressor", "weights", "kintree_table")
LEFT_OUT = (
    "pose-dependent corrections (posedirs) are left out: the surface follows its joints by skinning weights alone"
)
SHAPES_OF_SMPLX = 300
"""Shape components of SMPL-X; those behind them are expressions. Its first release had 10 and 10."""
CURE_FOR_PICKLES = (
    "pickles are not read, since they run code; take the model's .npz, or save v_template, f, J_regressor (dense), "
    "weights, kintree_table and shapedirs of it with numpy.savez"
)


@dataclass(frozen=True, eq=False)
class SmplModel:
    """A model file, read but for its shape directions, which are large and read when a body is made."""

    archive: Archive
    family: Family
    template: Float[Array, "vertices 3"]
    """The mean body at rest, metres, +Y up, facing +Z."""
    faces: Int[Array, "faces 3"]
    regressor: Float[Array, "joints vertices"]
    weights: Float[Array, "vertices joints"]

    @property
    def shapes(self) -> int:
        """How many betas it takes."""
        if "shapedirs" not in self.archive:
            return 0
        count = self.archive.shape("shapedirs")[2]
        if self.family.name != "SMPL-X":
            return count
        return SHAPES_OF_SMPLX if count >= SHAPES_OF_SMPLX else 10 if count == 20 else count

    def character(self, betas: Float[Array, "betas"] | None = None) -> Character:
        """The body of a shape, at rest in the model's own space; betas beyond `shapes` are passed over.

        Raises `FileError` for shape directions that cannot be read, weights that are none and faces without vertices.
        """
        vertices = self.template
        if betas is not None and (used := min(len(betas), self.shapes)):
            vertices = vertices + self.archive.numbers("shapedirs")[:, :, :used] @ betas[:used]
        joints = self.regressor @ vertices
        parents = np.array(self.family.parents)
        offsets = joints - joints[parents]
        offsets[0] = joints[0]
        skeleton = Skeleton(self.family.names, parents, offsets, np.broadcast_to(rot.IDENTITY, (len(joints), 4)))
        inverse_binds = np.broadcast_to(np.eye(4), (len(joints), 4, 4)).copy()
        inverse_binds[:, :3, 3] = -joints
        influences = max(1, int(np.count_nonzero(self.weights, axis=1).max()))
        columns = np.argsort(-np.abs(self.weights), axis=1, kind="stable")[:, :influences]
        weights = np.take_along_axis(self.weights, columns, axis=1)
        try:
            mesh, skin = Mesh(vertices, self.faces), Skin(np.arange(len(joints)), inverse_binds, columns, weights)
        except RetargetError as error:
            raise FileError(self.archive.path, str(error)) from None
        return Character(skeleton, mesh, skin, self.archive.path.stem)


def load(archive: Archive) -> Asset:
    """The model's mean body as a character. Raises `FileError` for a model that cannot be used."""
    model = read_model(archive)
    said = f"{model.family.name} model: the mean body"
    notes = (said, LEFT_OUT) if "posedirs" in archive else (said,)
    return Asset(archive.path, "character", model.character(), convention=Convention(1.0, "+y", "+z"), notes=notes)


def open_model(path: str | Path) -> SmplModel:
    """Read a model file. Raises `FileError` for what is none; a .pkl is refused unread."""
    path = Path(path)
    if not path.is_file():
        raise FileError(path, "is not a file" if path.exists() else "no such file")
    if path.suffix.lower() in (".pkl", ".pickle"):
        raise FileError(path, CURE_FOR_PICKLES)
    if path.suffix.lower() != ".npz":
        raise FileError(path, f"an SMPL model is given as .npz, received {path.suffix or 'no suffix'!r}")
    return read_model(open_archive(path))


def read_model(archive: Archive) -> SmplModel:
    """The model in an archive. Raises `FileError` naming the array that is missing or does not fit."""
    missing = [name for name in NEEDED if name not in archive]
    if missing:
        raise FileError(archive.path, f"is no SMPL-family model: the array {', '.join(missing)} is missing")
    vertices, joints = _size(archive, "v_template", (None, 3)), _size(archive, "kintree_table", (2, None), axis=1)
    if joints not in FAMILIES or joints == 22:
        raise archive.fail("kintree_table", f"has {joints} joints; bodies have 24 (SMPL), 52 (SMPL+H) or 55 (SMPL-X)")
    _size(archive, "f", (None, 3))
    _size(archive, "J_regressor", (joints, vertices))
    _size(archive, "weights", (vertices, joints))
    if "shapedirs" in archive:
        _size(archive, "shapedirs", (vertices, 3, None))
    family = FAMILIES[joints]
    if tuple(archive.integers("kintree_table")[0, 1:].tolist()) != family.parents[1:]:
        raise archive.fail("kintree_table", f"joints do not hang on each other as in {family.name}")
    return SmplModel(
        archive, family, archive.numbers("v_template"), archive.integers("f"), archive.numbers("J_regressor"),
        archive.numbers("weights"),
    )  # fmt: skip


def _size(archive: Archive, name: str, wanted: tuple[int | None, ...], axis: int = 0) -> int:
    """Check an array's declared shape and give its length along one axis."""
    shape = archive.shape(name)
    if name == "J_regressor" and shape == ():
        raise archive.fail(name, "is no dense array; save it with .toarray()")
    if len(shape) != len(wanted) or 0 in shape or any(want not in (None, got) for want, got in zip(wanted, shape)):
        listed = ", ".join("any" if want is None else str(want) for want in wanted)
        raise archive.fail(name, f"must have the shape ({listed}), has {shape}")
    return shape[axis]
