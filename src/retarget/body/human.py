"""The embedded parametric human: one watertight topology for every body, from toddler to very heavy.

Shape space, skeleton and weights derive from MakeHuman's CC0 base mesh and targets (`docs/human.md` says how);
`tools/build_human.py` makes `human.npz`. The macro parameters are MakeHuman's: targets weighted by products of the
factors gender, age, muscle, weight, height and proportions, each factor linear between its named levels.

    >>> character = human(weight=0.9, height=1.6, age=0.3)
    >>> len(character.skeleton), character.mesh.vertices.shape
    (52, (6883, 3))
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from retarget.character import Character, Material, Mesh, Skeleton, Skin
from retarget.errors import RetargetError, unknown_name

Array = np.ndarray

PARAMETERS: dict[str, tuple[float, float, float]] = {
    # name: (lowest, neutral, highest)
    "gender": (0.0, 0.5, 1.0),  # 0 female, 1 male
    "age": (0.0, 0.5, 1.0),  # 0 one year, 0.1875 twelve, 0.5 twenty-five, 1 ninety
    "muscle": (0.0, 0.5, 1.0),
    "weight": (0.0, 0.5, 2.0),  # beyond 1, MakeHuman's heaviest, the line is continued
    "proportions": (0.0, 0.5, 1.0),  # 0 uncommon, 1 ideal
}
HEIGHT = (0.4, 3.0)
"""Metres that `height` accepts. What MakeHuman's height scale does not reach is scaled uniformly."""

LEVELS: dict[str, tuple[tuple[float, str], ...]] = {
    "gender": ((0.0, "female"), (1.0, "male")),
    "age": ((0.0, "baby"), (0.1875, "child"), (0.5, "young"), (1.0, "old")),
    "muscle": ((0.0, "minmuscle"), (0.5, "averagemuscle"), (1.0, "maxmuscle")),
    "weight": ((0.0, "minweight"), (0.5, "averageweight"), (1.0, "maxweight")),
}

PRESETS: dict[str, dict[str, float]] = {
    "average": {},
    "woman": {"gender": 0.0},
    "man": {"gender": 1.0},
    "thin": {"gender": 0.4, "weight": 0.0, "muscle": 0.35},
    "heavy": {"gender": 0.7, "weight": 1.1, "muscle": 0.45, "belly": 0.2},
    "very_heavy": {
        "gender": 0.6,
        "weight": 2.0,
        "muscle": 0.35,
        "belly": 0.6,
        "hips": 0.3,
        "upper_arm_fat": 0.5,
        "thigh_fat": 0.5,
        "double_chin": 0.7,
        "face_fat": 0.6,
        "neck_girth": 0.3,
    },  # fmt: skip
    "muscular": {"gender": 1.0, "muscle": 1.0, "weight": 0.62, "proportions": 0.8},
    "tall": {"gender": 0.8, "height": 2.0, "weight": 0.45},
    "short": {"gender": 0.3, "height": 1.45, "weight": 0.6},
    "elderly": {"gender": 0.3, "age": 0.95, "muscle": 0.3, "weight": 0.55},
    "child": {"age": 0.12, "height": 1.2, "head_size": 0.25},
    "toddler": {"age": 0.02, "height": 0.82, "head_size": 0.5},
}
"""Shape parameters of bodies with a name: `human(**PRESETS["child"])`."""


@dataclass(frozen=True, eq=False)
class ShapeSpace:
    """How shapes are made: offsets of the left half and the midline; the right half mirrors them."""

    base: Float[Array, "half 3"]
    """MakeHuman's base mesh, metres."""
    macro: dict[str, Float[Array, "rank"]]
    """Coefficients of each macro target, by its MakeHuman name."""
    basis: Float[Array, "rank half*3"]
    """What the coefficients multiply (all targets agree with MakeHuman's to 0.05 mm)."""
    detail: dict[str, int]
    """Row of each finer component at -1 (`waist-`) and at +1 (`waist+`)."""
    detail_rows: Int[Array, "details half*3"]
    detail_scale: Float[Array, "details"]
    regressor: Float[Array, "points vertices"]
    """Joints, then ends of bones, from a whole surface: not negative, rows sum to one."""
    ends: tuple[int, ...]
    """The joints whose bone ends the last rows of `regressor` give."""


@dataclass(frozen=True, eq=False)
class HumanModel:
    """What all embedded bodies share. Vertices come left, middle, right; `human_model()` loads it."""

    faces: Int[Array, "faces 3"]
    """Closed, outward oriented triangles, the same for every body."""
    mirror: Int[Array, "vertices"]
    """The vertex on the other side of each vertex; vertices of the midline are their own."""
    joint_names: tuple[str, ...]
    """VRM names: 22 joints of the body, then 15 a hand."""
    parents: Int[Array, "joints"]
    skin_columns: Int[Array, "vertices 4"]
    skin_weights: Float[Array, "vertices 4"]
    part_names: tuple[str, ...]
    """The 17 body parts."""
    vertex_parts: Int[Array, "vertices"]
    """Index into `part_names` of each vertex."""
    face_parts: Int[Array, "faces"]
    """Index into `part_names` of each face; every part is one connected piece."""
    seams: dict[tuple[str, str], Int[Array, "_"]]
    """Closed vertex loop between two neighbouring parts, in order, the first part on its left seen from outside."""
    landmarks: dict[str, int]
    """Vertex of each named place: nose, navel, leftPalm, rightHeel, ..."""
    detail_names: tuple[str, ...]
    """Finer shape components; each takes a value in [-1, 1]."""
    materials: tuple[Material, ...]
    face_materials: Int[Array, "faces"]
    uvs: Float[Array, "corners 2"]
    """Texture corners, origin top left; charts have seams, so one vertex can have several."""
    face_uvs: Int[Array, "faces 3"]
    """The three texture corners of each face."""
    texture: bytes
    """PNG that goes with `uvs`: skin, hair, T-shirt and shorts."""
    source: str
    """SHA-256 over the names and hashes of the MakeHuman files the data was built from."""
    shape: ShapeSpace

    def part_vertices(self, name: str) -> Int[Array, "_"]:
        """Vertices of one body part. Raises `RetargetError` for an unknown name."""
        if name not in self.part_names:
            raise unknown_name("part", name, self.part_names, "the embedded human")
        return np.flatnonzero(self.vertex_parts == self.part_names.index(name))

    def landmark(self, name: str) -> int:
        """Vertex of a landmark. Raises `RetargetError` naming the nearest ones where there is none."""
        if name not in self.landmarks:
            raise unknown_name("landmark", name, self.landmarks, "the embedded human")
        return self.landmarks[name]

    def joints(self, vertices: Float[Array, "*batch vertices 3"]) -> Float[Array, "*batch joints 3"]:
        """Joint positions of a rest surface: a fixed non-negative average of nearby vertices."""
        return (self.shape.regressor @ vertices)[..., : len(self.joint_names), :]


@lru_cache(maxsize=1)
def human_model() -> HumanModel:
    """The topology, parts, landmarks and shape space, read once."""
    with np.load(Path(__file__).with_name("human.npz")) as archive:
        stored = {name: archive[name] for name in archive.files}
    integers = {name: stored[name].astype(np.int64) for name in _INTEGER_FIELDS}
    names = {
        key: tuple(stored[f"{key}_names"].tolist())
        for key in ("joint", "part", "landmark", "detail", "material", "macro")
    }
    pairs = [(names["part"][a], names["part"][b]) for a, b in stored["seam_parts"].tolist()]
    loops = np.split(stored["seam_vertices"].astype(np.int64), np.cumsum(stored["seam_lengths"])[:-1])
    colors = stored["material_colors"].tolist()
    return HumanModel(
        **integers,
        joint_names=names["joint"],
        skin_weights=stored["skin_weights"].astype(np.float64),
        part_names=names["part"],
        seams=dict(zip(pairs, loops, strict=True)),
        landmarks=dict(zip(names["landmark"], stored["landmark_vertices"].tolist(), strict=True)),
        detail_names=tuple(dict.fromkeys(name[:-1] for name in names["detail"])),
        materials=tuple(Material(name, (*color, 1.0)) for name, color in zip(names["material"], colors, strict=True)),
        uvs=stored["uvs"] / 65535.0,
        texture=stored["texture_png"].tobytes(),
        source=str(stored["source_sha256"]),
        shape=ShapeSpace(
            base=stored["base"].astype(np.float64),
            macro=dict(zip(names["macro"], stored["macro_coefficients"], strict=True)),
            basis=stored["macro_basis"] * stored["macro_basis_scale"].astype(np.float32)[:, None],
            detail={name: row for row, name in enumerate(names["detail"])},
            detail_rows=stored["detail"],
            detail_scale=stored["detail_scale"],
            regressor=_dense_rows(stored),
            ends=tuple(stored["ends"].tolist()),
        ),
    )


_INTEGER_FIELDS = (
    "faces",
    "mirror",
    "parents",
    "skin_columns",
    "vertex_parts",
    "face_parts",
    "face_materials",
    "face_uvs",
)


def _dense_rows(stored: dict[str, Array]) -> Float[Array, "points vertices"]:
    """The joint regressor, stored by its non-zeros."""
    pointers = stored["regressor_indptr"]
    dense = np.zeros((len(pointers) - 1, len(stored["mirror"])))
    rows = np.repeat(np.arange(len(pointers) - 1), np.diff(pointers))
    dense[rows, stored["regressor_indices"]] = stored["regressor_data"]
    return dense


def human(*, height: float | int | None = None, name: str = "", **shape: float | int) -> Character:
    """The embedded human of a given shape, in its rest pose: a relaxed A, feet on y = 0, hips at x = z = 0, facing +Z.

    `height` is the body's height in metres (None: what the other parameters give). `shape` takes the macro parameters
    of `PARAMETERS` (gender, age, muscle, weight, proportions) and the components of `human_model().detail_names`, each
    in [-1, 1]. All rest rotations are the identity; the joints follow the surface of each shape.

    Raises `RetargetError` for an unknown parameter or a value out of its range.
    """
    model = human_model()
    vertices = human_vertices(height=height, **shape)
    points = model.shape.regressor @ vertices
    joints = points[: len(model.joint_names)]
    offsets = joints - np.where(model.parents[:, None] >= 0, joints[model.parents], 0.0)
    ends = {joint: points[len(joints) + i] - joints[joint] for i, joint in enumerate(model.shape.ends)}
    identity = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(joints), 4))
    skeleton = Skeleton(model.joint_names, model.parents, offsets, identity, ends)
    inverse_binds = np.broadcast_to(np.eye(4), (len(joints), 4, 4)).copy()
    inverse_binds[:, :3, 3] = -joints
    mesh = Mesh(vertices, model.faces, materials=model.materials, face_materials=model.face_materials)
    skin = Skin(np.arange(len(joints)), inverse_binds, model.skin_columns, model.skin_weights)
    return Character(skeleton, mesh, skin, name or "human")


def textured(character: Character) -> Character:
    """The same character for the embedded texture: one material, vertices doubled where the texture's charts part.

    Takes any character on the embedded topology; the result has more vertices and is closed no longer, so use it to
    show and to export, not to measure. Raises `RetargetError` for a character on another topology.
    """
    model = human_model()
    if (
        character.mesh is None
        or character.mesh.faces.shape != model.faces.shape
        or (character.mesh.faces != model.faces).any()
    ):
        raise RetargetError(
            f"{character.name or 'the character'} is not on the embedded human's topology, so its texture does not fit"
        )
    pairs = np.stack([model.faces.ravel(), model.face_uvs.ravel()], axis=1)
    kept, corner = np.unique(pairs, axis=0, return_inverse=True)
    vertex = kept[:, 0]
    faces = corner.reshape(-1, 3)
    skin = replace(character.skin, columns=character.skin.columns[vertex], weights=character.skin.weights[vertex])
    material = Material("human", (1.0, 1.0, 1.0, 1.0), image=model.texture)
    mesh = Mesh(character.mesh.vertices[vertex], faces, uvs=model.uvs[kept[:, 1]], materials=(material,))
    return replace(character, mesh=mesh, skin=skin)


def human_vertices(*, height: float | int | None = None, **shape: float | int) -> Float[Array, "vertices 3"]:
    """The rest surface alone (metres), where no skeleton is needed. Parameters and errors as in `human`."""
    model = human_model()
    _check(model, height, shape)
    half, taller, shorter = _shape_halves(model, shape)
    if height is not None:
        half = half + _height_offset(half, taller, shorter, height)
    vertices = _unfold(model, half)
    low, high = vertices[:, 1].min(), vertices[:, 1].max()
    scale = 1.0 if height is None else height / (high - low)
    hips = model.shape.regressor[0] @ vertices
    return (vertices - [0.0, low, hips[2]]) * scale


def height_range(**shape: float | int) -> tuple[float, float]:
    """Lowest and greatest height (metres) that MakeHuman's height scale gives a shape; beyond, bodies are scaled."""
    model = human_model()
    _check(model, None, shape)
    half, taller, shorter = _shape_halves(model, shape)
    return float(np.ptp((half + shorter)[:, 1])), float(np.ptp((half + taller)[:, 1]))


def _check(model: HumanModel, height: float | int | None, shape: dict[str, float | int]) -> None:
    ranges = {name: (low, high) for name, (low, _, high) in PARAMETERS.items()} | {"height": HEIGHT}
    ranges |= dict.fromkeys(model.detail_names, (-1.0, 1.0))
    for name, value in shape.items() | ({("height", height)} if height is not None else set()):
        if name not in ranges:
            raise unknown_name("shape parameter", name, ranges, "the embedded human")
        low, high = ranges[name]
        if not isinstance(value, (int, float, np.number)) or not low <= value <= high:
            unit = " metres" if name == "height" else ""
            raise RetargetError(
                f"shape parameter {name!r} must be a number from {low:g} to {high:g}{unit}, received {value!r}"
            )


def _levels(parameter: str, value: float) -> list[tuple[str, float]]:
    """The two named levels around a value and their weights, which sum to one."""
    scale = LEVELS[parameter]
    i = min(max(k for k, (at, _) in enumerate(scale) if at <= value), len(scale) - 2)
    (low, below), (high, above) = scale[i : i + 2]
    share = (value - low) / (high - low)
    return [(below, 1.0 - share), (above, share)]


def _shape_halves(model: HumanModel, shape: dict[str, float | int]) -> tuple[Array, Array, Array]:
    """The left half at middling height (half, 3), and the offsets that full and no height add to it."""
    value = {name: float(shape.get(name, neutral)) for name, (_, neutral, _) in PARAMETERS.items()}
    table, none = model.shape.macro, np.zeros(len(model.shape.basis))
    still, taller, shorter = none.copy(), none.copy(), none.copy()
    proportion = 2.0 * value["proportions"] - 1.0
    figure = "idealproportions" if proportion > 0 else "uncommonproportions"
    excess = max(value["weight"] - 1.0, 0.0) / 0.5  # in steps from average to the heaviest
    for (gender, g), (age, a) in product(_levels("gender", value["gender"]), _levels("age", value["age"])):
        still += g * a * table[f"{gender}-{age}"]
        for (muscle, m), (weight, w) in product(
            _levels("muscle", value["muscle"]), _levels("weight", min(value["weight"], 1.0))
        ):
            kind, share = f"{gender}-{age}-{muscle}-{weight}", g * a * m * w
            still += share * table.get(kind, none)
            still += share * abs(proportion) * table.get(f"{kind}-{figure}", none)
            taller += share * table.get(f"{kind}-maxheight", none)
            shorter += share * table.get(f"{kind}-minheight", none)
        # Only the gain of an averagely muscular body goes on: at little muscle the folds of the belly would cross.
        average = f"{gender}-{age}-averagemuscle"
        still += (
            g * a * excess * (table.get(f"{average}-maxweight", none) - table.get(f"{average}-averageweight", none))
        )
    offsets = np.stack([still, taller, shorter]).astype(np.float32) @ model.shape.basis
    still, taller, shorter = offsets.astype(np.float64).reshape(3, -1, 3)
    for name, amount in shape.items():
        if name not in PARAMETERS and amount:
            row = model.shape.detail[name + ("+" if amount > 0 else "-")]
            scale = model.shape.detail_scale[row] * abs(amount)
            still += model.shape.detail_rows[row].reshape(-1, 3) * scale
    return model.shape.base + still, taller, shorter


def _height_offset(half: Array, taller: Array, shorter: Array, height: float | int) -> Array:
    """The share of MakeHuman's height scale that gives a height; its end where it does not reach that far."""

    def offset(share: float) -> Array:
        return share * taller if share > 0 else -share * shorter

    low, high = -1.0, 1.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        reached = np.ptp(half[:, 1] + offset(middle)[:, 1])
        low, high = (middle, high) if reached < height else (low, middle)
    return offset(0.5 * (low + high))


def _unfold(model: HumanModel, half: Float[Array, "half 3"]) -> Float[Array, "vertices 3"]:
    """Left and middle vertices, then the mirror images of the left ones."""
    left = len(model.mirror) - len(half)
    middle = half[left:] * [0.0, 1.0, 1.0]
    return np.concatenate([half[:left], middle, half[:left] * [-1.0, 1.0, 1.0]])
