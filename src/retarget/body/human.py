"""The embedded parametric human: one watertight topology for every body, from toddler to very heavy.

Shape space, skeleton and weights derive from MakeHuman's CC0 base mesh and targets (`docs/human.md` says how);
`tools/build_human.py` makes `human.npz`. The macro parameters are MakeHuman's: targets weighted by products of the
factors gender, age, muscle, weight, height and proportions, each factor linear between its named levels.

    >>> character = human(weight=0.9, height=1.6, age=0.3)
    >>> len(character.skeleton), character.mesh.vertices.shape
    (52, (6883, 3))
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from retarget.character import Character, Material, Mesh, Skeleton, Skin
from retarget.errors import RetargetError, unknown_name

Array = np.ndarray

PARAMETERS: dict[str, tuple[float, float, float]] = {
    # name: (lowest, neutral, highest)
    "gender": (0.0, 0.5, 1.0),  # 0 female, 1 male
    "age": (0.0, 0.5, 1.0),  # 0 one year, 0.1875 twelve, 0.5 twenty-five, 1 ninety
    "muscle": (0.0, 0.5, 1.25),
    "weight": (0.0, 0.5, 1.5),  # beyond 1, MakeHuman's heaviest, the line is continued
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
    "thin": {"gender": 0.4, "weight": 0.08, "muscle": 0.4},
    "heavy": {"gender": 0.7, "weight": 1.0, "muscle": 0.45},
    "very_heavy": {"gender": 0.6, "weight": 1.4, "muscle": 0.35},
    "muscular": {"gender": 1.0, "muscle": 1.0, "weight": 0.62, "proportions": 0.8},
    "tall": {"gender": 0.8, "height": 2.0, "weight": 0.45},
    "short": {"gender": 0.3, "height": 1.45, "weight": 0.6},
    "elderly": {"gender": 0.3, "age": 0.95, "muscle": 0.3, "weight": 0.55},
    "child": {"age": 0.12, "height": 1.2},
    "toddler": {"age": 0.03, "height": 0.86},
}
"""Shape parameters of bodies with a name: `human(**PRESETS["child"])`."""


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
    source: str
    """SHA-256 over the MakeHuman files the data was built from."""
    data: Any
    """The shape space, as `human.npz` stores it."""

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
        return (self.data["regressor"] @ vertices)[..., : len(self.joint_names), :]


@lru_cache(maxsize=1)
def human_model() -> HumanModel:
    """The topology, parts, landmarks and shape space, read once."""
    with np.load(Path(__file__).with_name("human.npz")) as archive:
        stored = {name: archive[name] for name in archive.files}
    names = {key: tuple(stored[f"{key}_names"].tolist()) for key in ("joint", "part", "landmark", "detail", "material", "macro")}
    ends = np.cumsum(stored["seam_lengths"])[:-1]
    loops = np.split(stored["seam_vertices"].astype(np.int64), ends)
    pairs = [(names["part"][a], names["part"][b]) for a, b in stored["seam_parts"].tolist()]
    data = {
        "base": stored["base"],
        "macro": {name: row for name, row in zip(names["macro"], stored["macro_coefficients"], strict=True)},
        "basis": stored["macro_basis"].astype(np.float32) * stored["macro_basis_scale"][:, None].astype(np.float32),
        "detail": {name: i for i, name in enumerate(names["detail"])},
        "detail_rows": (stored["detail"], stored["detail_scale"]),
        "regressor": _dense_rows(stored),
        "ends": stored["ends"].tolist(),
    }
    return HumanModel(
        faces=stored["faces"].astype(np.int64),
        mirror=stored["mirror"].astype(np.int64),
        joint_names=names["joint"],
        parents=stored["parents"].astype(np.int64),
        skin_columns=stored["skin_joints"].astype(np.int64),
        skin_weights=stored["skin_weights"].astype(np.float64),
        part_names=names["part"],
        vertex_parts=stored["vertex_parts"].astype(np.int64),
        face_parts=stored["face_parts"].astype(np.int64),
        seams=dict(zip(pairs, loops, strict=True)),
        landmarks=dict(zip(names["landmark"], stored["landmark_vertices"].tolist(), strict=True)),
        detail_names=tuple(dict.fromkeys(name[:-1] for name in names["detail"])),
        materials=tuple(
            Material(name, (*color, 1.0)) for name, color in zip(names["material"], stored["material_colors"].tolist(), strict=True)
        ),
        face_materials=stored["face_materials"].astype(np.int64),
        source=str(stored["source_sha256"]),
        data=data,
    )  # fmt: skip


def _dense_rows(stored: dict[str, Array]) -> Float[Array, "points vertices"]:
    """The joint regressor, stored by its non-zeros."""
    pointers = stored["regressor_indptr"]
    dense = np.zeros((len(pointers) - 1, len(stored["mirror"])))
    rows = np.repeat(np.arange(len(pointers) - 1), np.diff(pointers))
    dense[rows, stored["regressor_indices"]] = stored["regressor_data"]
    return dense


def human(*, height: float | None = None, name: str = "", **shape: float) -> Character:
    """The embedded human of a given shape, in its rest pose: a relaxed A, feet on y = 0, hips at x = z = 0, facing +Z.

    `height` is the body's height in metres (None: what the other parameters give). `shape` takes the macro parameters
    of `PARAMETERS` (gender, age, muscle, weight, proportions) and the components of `human_model().detail_names`, each
    in [-1, 1]. All rest rotations are the identity; the joints follow the surface of each shape.

    Raises `RetargetError` for an unknown parameter or a value out of its range.
    """
    model = human_model()
    vertices = human_vertices(height=height, **shape)
    points = model.data["regressor"] @ vertices
    joints = points[: len(model.joint_names)]
    offsets = joints - np.where(model.parents[:, None] >= 0, joints[model.parents], 0.0)
    ends = {joint: points[len(joints) + i] - joints[joint] for i, joint in enumerate(model.data["ends"])}
    identity = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(joints), 4))
    skeleton = Skeleton(model.joint_names, model.parents, offsets, identity, ends)
    inverse_binds = np.broadcast_to(np.eye(4), (len(joints), 4, 4)).copy()
    inverse_binds[:, :3, 3] = -joints
    mesh = Mesh(vertices, model.faces, materials=model.materials, face_materials=model.face_materials)
    skin = Skin(np.arange(len(joints)), inverse_binds, model.skin_columns, model.skin_weights)
    return Character(skeleton, mesh, skin, name or "human")


def human_vertices(*, height: float | None = None, **shape: float) -> Float[Array, "vertices 3"]:
    """The rest surface alone (metres), where no skeleton is needed. Parameters and errors as in `human`."""
    model = human_model()
    _check(model, height, shape)
    still, taller, shorter = _shape_offsets(model, shape)
    half = model.data["base"].reshape(-1).astype(np.float64) + still
    if height is not None:
        half = half + _height_offset(half, taller, shorter, height)
    vertices = _unfold(model, half.reshape(-1, 3))
    low, high = vertices[:, 1].min(), vertices[:, 1].max()
    scale = 1.0 if height is None else height / (high - low)
    hips = model.data["regressor"][0] @ vertices
    return (vertices - [0.0, low, hips[2]]) * scale


def _check(model: HumanModel, height: float | None, shape: dict[str, float]) -> None:
    ranges = {name: (low, high) for name, (low, _, high) in PARAMETERS.items()} | {"height": HEIGHT}
    ranges |= dict.fromkeys(model.detail_names, (-1.0, 1.0))
    for name, value in shape.items() | ({("height", height)} if height is not None else set()):
        if name not in ranges:
            raise unknown_name("shape parameter", name, ranges, "the embedded human")
        low, high = ranges[name]
        if not isinstance(value, (int, float, np.number)) or not low <= value <= high:
            unit = " metres" if name == "height" else ""
            raise RetargetError(f"shape parameter {name!r} must be a number from {low:g} to {high:g}{unit}, received {value!r}")


def _levels(parameter: str, value: float) -> dict[str, float]:
    """Weights of the two named levels around a value; they sum to one, and go on linearly beyond the last level."""
    scale = LEVELS[parameter]
    i = min(max(k for k, (at, _) in enumerate(scale) if at <= value), len(scale) - 2)
    (low, below), (high, above) = scale[i : i + 2]
    t = (value - low) / (high - low)
    return {below: 1.0 - t, above: t}


def _shape_offsets(model: HumanModel, shape: dict[str, float]) -> tuple[Array, Array, Array]:
    """Offsets of the left half: of the shape at middling height, and what full and no height add to it."""
    value = {name: float(shape.get(name, neutral)) for name, (_, neutral, _) in PARAMETERS.items()}
    table = model.data["macro"]
    none = np.zeros(len(model.data["basis"]))
    still, taller, shorter = none.copy(), none.copy(), none.copy()
    proportion = 2.0 * value["proportions"] - 1.0
    figure = "idealproportions" if proportion > 0 else "uncommonproportions"
    for gender, g in _levels("gender", value["gender"]).items():
        for age, a in _levels("age", value["age"]).items():
            still += g * a * table[f"{gender}-{age}"]
            for muscle, m in _levels("muscle", value["muscle"]).items():
                for weight, w in _levels("weight", value["weight"]).items():
                    kind, product = f"{gender}-{age}-{muscle}-{weight}", g * a * m * w
                    still += product * table.get(kind, none)
                    still += product * abs(proportion) * table.get(f"{kind}-{figure}", none)
                    taller += product * table.get(f"{kind}-maxheight", none)
                    shorter += product * table.get(f"{kind}-minheight", none)
    offsets = np.stack([still, taller, shorter]).astype(np.float32) @ model.data["basis"]
    rows, scales = model.data["detail_rows"]
    fine = offsets[0].astype(np.float64)
    for name, amount in shape.items():
        if name not in PARAMETERS and amount:
            row = model.data["detail"][name + ("+" if amount > 0 else "-")]
            fine += rows[row] * (scales[row] * abs(amount))
    return fine, offsets[1].astype(np.float64), offsets[2].astype(np.float64)


def _height_offset(half: Array, taller: Array, shorter: Array, height: float) -> Array:
    """The share of MakeHuman's height scale that gives a height; at its ends where it does not reach that far."""

    def reached(share: float) -> float:
        y = half[1::3] + (share * taller[1::3] if share > 0 else -share * shorter[1::3])
        return float(y.max() - y.min())

    low, high = -1.0, 1.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if reached(middle) < height else (low, middle)
    share = 0.5 * (low + high)
    return share * taller if share > 0 else -share * shorter


def _unfold(model: HumanModel, half: Float[Array, "half 3"]) -> Float[Array, "vertices 3"]:
    """Left and middle vertices, then the mirror images of the left ones."""
    left = len(model.mirror) - len(half)
    half[left:, 0] = 0.0
    return np.concatenate([half, half[:left] * [-1.0, 1.0, 1.0]])
