"""The nouns of the house: frozen dataclasses of numpy arrays, checked when made, changed by `dataclasses.replace`.

Lengths are metres, angles radians, time seconds; +Y is up and characters face +Z. Quaternions are `xyzw`; a joint's
rotation is parent-from-joint, so `T_world_joint = T_world_parent @ T_parent_joint`. What a reader returns is still in
the file's own space (`io.Asset.convention` says what is known of it); `motion.align` brings it here.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from retarget.errors import RetargetError, unknown_name

Array = np.ndarray


def _floats(owner: Any, field: str, shape: tuple[int | None, ...], dtype: type = np.float64) -> None:
    """Normalise one array field of a frozen dataclass: dtype, contiguity, shape, finiteness."""
    raw = getattr(owner, field)
    try:
        value = np.ascontiguousarray(raw, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise RetargetError(f"{type(owner).__name__}.{field} is not an array of numbers: {error}") from None
    _expect_shape(owner, field, value, shape)
    if not np.isfinite(value).all():
        raise RetargetError(
            f"{type(owner).__name__}.{field} has {int((~np.isfinite(value)).sum())} values that are not finite"
        )
    object.__setattr__(owner, field, value)


def _ints(owner: Any, field: str, shape: tuple[int | None, ...]) -> None:
    value = np.ascontiguousarray(getattr(owner, field))
    if value.size and not np.issubdtype(value.dtype, np.integer):
        raise RetargetError(f"{type(owner).__name__}.{field} must hold integers, received {value.dtype}")
    _expect_shape(owner, field, value, shape)
    object.__setattr__(owner, field, value.astype(np.int64, copy=False))


def _expect_shape(owner: Any, field: str, value: Array, shape: tuple[int | None, ...]) -> None:
    if value.ndim != len(shape) or any(want is not None and want != got for want, got in zip(shape, value.shape)):
        wanted = "(" + ", ".join("any" if size is None else str(size) for size in shape) + ")"
        raise RetargetError(f"{type(owner).__name__}.{field} must have shape {wanted}, received {value.shape}")


def _unit_quaternions(owner: Any, field: str) -> None:
    value = getattr(owner, field)
    length = np.linalg.norm(value, axis=-1, keepdims=True)
    if value.size and length.min() < 1e-6:
        raise RetargetError(f"{type(owner).__name__}.{field} has a quaternion of length zero")
    object.__setattr__(owner, field, value / length)


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A tree of named joints in its rest pose.

    Raises `RetargetError` for cycles, several roots, parents after their children, double names or wrong shapes.
    """

    names: tuple[str, ...]
    """One name a joint, unique."""
    parents: Int[Array, "joints"]
    """Index of the parent, -1 for the root, which is joint 0; parents come before their children."""
    offsets: Float[Array, "joints 3"]
    """Rest position of each joint in its parent's frame (the root's in the world), metres."""
    rest_rotations: Float[Array, "joints 4"]
    """Rest rotation of each joint, parent-from-joint, quaternion xyzw."""
    end_offsets: dict[int, Float[Array, "3"]] | None = None
    """Where a bone without child ends, in its joint's frame (BVH end sites); joints without one are absent."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        count = len(self.names)
        if count == 0:
            raise RetargetError("a skeleton needs at least one joint")
        _ints(self, "parents", (count,))
        _floats(self, "offsets", (count, 3))
        _floats(self, "rest_rotations", (count, 4))
        _unit_quaternions(self, "rest_rotations")
        if len(set(self.names)) != count:
            double = sorted({name for name in self.names if self.names.count(name) > 1})
            raise RetargetError(
                f"joint names must be unique; {double[0]!r} appears {self.names.count(double[0])} times"
            )
        roots = np.flatnonzero(self.parents == -1)
        if len(roots) != 1 or roots[0] != 0:
            raise RetargetError(
                f"a skeleton has exactly one root, its first joint; received roots {[self.names[i] for i in roots[:4]]}"
            )
        if (self.parents[1:] < 0).any() or (self.parents >= np.arange(count)).any():
            raise RetargetError("parents must come before their children (the joints form a cycle or are out of order)")

    def __len__(self) -> int:
        return len(self.names)

    def index(self, name: str) -> int:
        """The joint of that name. Raises `RetargetError` naming the nearest ones where there is none."""
        try:
            return self.names.index(name)
        except ValueError:
            raise unknown_name("joint", name, self.names, "the skeleton") from None

    def children(self, joint: int) -> list[int]:
        return np.flatnonzero(self.parents == joint).tolist()


@dataclass(frozen=True, eq=False)
class Material:
    """How a surface looks, as far as our pictures need it."""

    name: str = ""
    base_color: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)
    """Linear RGBA factor, as in glTF."""
    image: bytes | None = None
    """Encoded PNG or JPEG of the base colour texture, multiplied with `base_color`."""
    double_sided: bool = False


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh."""

    vertices: Float[Array, "vertices 3"]
    """Positions, metres."""
    faces: Int[Array, "faces 3"]
    """Vertex indices, counter-clockwise seen from outside."""
    uvs: Float[Array, "vertices 2"] | None = None
    """Texture coordinates, origin top left (glTF)."""
    materials: tuple[Material, ...] = ()
    face_materials: Int[Array, "faces"] | None = None
    """Index into `materials` for each face; None means material 0 throughout."""

    def __post_init__(self) -> None:
        _floats(self, "vertices", (None, 3))
        _ints(self, "faces", (None, 3))
        if self.faces.size and (self.faces.min() < 0 or self.faces.max() >= len(self.vertices)):
            raise RetargetError(f"Mesh.faces names vertex {int(self.faces.max())} of {len(self.vertices)}")
        if self.uvs is not None:
            _floats(self, "uvs", (len(self.vertices), 2))
        if self.face_materials is not None:
            _ints(self, "face_materials", (len(self.faces),))
            if self.face_materials.size and not 0 <= self.face_materials.min() <= self.face_materials.max() < max(
                len(self.materials), 1
            ):
                raise RetargetError(f"Mesh.face_materials names a material outside the {len(self.materials)} present")


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Unordered points of a surface, metres."""

    points: Float[Array, "points 3"]

    def __post_init__(self) -> None:
        _floats(self, "points", (None, 3))


@dataclass(frozen=True, eq=False)
class Skin:
    """Which joints move which vertex: linear blend skinning.

    A column is one joint seen through one bind matrix. One skin has a column a joint; a file with several skins bound
    differently to the same joint simply has more columns, so that posed vertices stay exact:
    `v_posed = sum_k weights[v, k] T_world_joint[joints[c]] inverse_binds[c] v` with `c = columns[v, k]`.
    """

    joints: Int[Array, "columns"]
    """The joint that each column follows."""
    inverse_binds: Float[Array, "columns 4 4"]
    """Joint-from-mesh at binding time; may carry a scale when mesh and skeleton have different units."""
    columns: Int[Array, "vertices influences"]
    """Column of each influence of each vertex."""
    weights: Float[Array, "vertices influences"]
    """Weights, not negative, rows sum to one."""

    def __post_init__(self) -> None:
        _ints(self, "joints", (None,))
        _floats(self, "inverse_binds", (len(self.joints), 4, 4))
        _ints(self, "columns", (None, None))
        _floats(self, "weights", self.columns.shape)
        if self.columns.size and not 0 <= self.columns.min() <= self.columns.max() < len(self.joints):
            raise RetargetError(f"Skin.columns names column {int(self.columns.max())} of {len(self.joints)}")
        if (self.weights < 0).any():
            raise RetargetError("Skin.weights must not be negative")
        total = self.weights.sum(axis=1)
        if self.weights.size and np.abs(total - 1.0).max() > 1e-3:
            raise RetargetError(
                f"Skin.weights must sum to one a vertex; vertex {int(np.abs(total - 1).argmax())} sums to {total[np.abs(total - 1).argmax()]:.4g}"
            )
        if self.weights.size:
            object.__setattr__(self, "weights", self.weights / total[:, None])


@dataclass(frozen=True, eq=False)
class Character:
    """A body that can be moved: skeleton, surface and skinning weights. A bare skeleton has neither mesh nor skin."""

    skeleton: Skeleton
    mesh: Mesh | None = None
    skin: Skin | None = None
    name: str = ""
    origin: Any = None
    """The file it came from, as its reader kept it, so that the writer of the same format can append instead of rewrite."""

    def __post_init__(self) -> None:
        if (self.mesh is None) != (self.skin is None):
            raise RetargetError("a character has both a mesh and a skin, or neither")
        if self.skin is not None:
            if len(self.skin.columns) != len(self.mesh.vertices):
                raise RetargetError(
                    f"the skin has {len(self.skin.columns)} vertices, the mesh {len(self.mesh.vertices)}"
                )
            if self.skin.joints.size and self.skin.joints.max() >= len(self.skeleton):
                raise RetargetError(f"the skin follows joint {int(self.skin.joints.max())} of {len(self.skeleton)}")


@dataclass(frozen=True, eq=False)
class Pose:
    """One frame of a `Motion`: what an online retargeter takes and returns."""

    rotations: Float[Array, "joints 4"]
    """Local rotations, parent-from-joint, xyzw."""
    translations: Float[Array, "moved 3"]
    """Local positions of the joints in `moved`, metres; the others keep their offsets."""
    moved: tuple[int, ...] = (0,)
    """The joints whose local position changes, as in `Motion`."""

    def __post_init__(self) -> None:
        _floats(self, "rotations", (None, 4))
        _floats(self, "translations", (len(self.moved), 3))


@dataclass(frozen=True)
class Provenance:
    """Which part of which clip of which file a motion was made from: what a result remembers of its source."""

    file: str
    """Name of the source's file, without folders."""
    clip: str
    start: float
    """Seconds of the clip at which its first frame was taken."""
    end: float
    """The same of the last."""
    fps: float
    """The clip's own frames a second."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise RetargetError(f"Provenance.fps must be positive, received {self.fps}")
        if not (np.isfinite(self.end) and 0 <= self.start <= self.end):
            raise RetargetError(f"Provenance must name a part of a clip, received {self.start} to {self.end} s")

    @classmethod
    def whole(cls, file: str | Path, motion: Motion) -> Provenance:
        """All of a clip of a file; `motion.filter.cut` makes it less."""
        return cls(_plain_name(Path(file).name), _plain_name(motion.name), 0.0, motion.seconds, float(motion.fps))

    def is_of(self, file: str | Path) -> bool:
        """Whether a file has the name of the source. Where it lies does not matter."""
        return _plain_name(Path(file).name) == self.file

    def __str__(self) -> str:
        return f"{self.file!r} [{self.clip!r}], {self.start:.6g} to {self.end:.6g} s"


def _plain_name(name: str) -> str:
    """Names of files may hold bytes that are no text."""
    return name.encode(errors="replace").decode()


@dataclass(frozen=True, eq=False)
class Motion:
    """Local joint rotations and root path over a skeleton, at a constant frame rate."""

    skeleton: Skeleton
    rotations: Float[Array, "frames joints 4"]
    """Local rotations, parent-from-joint, xyzw; they replace the rest rotations."""
    translations: Float[Array, "frames moved 3"]
    """Local positions of the joints in `moved`, metres; the others keep their offsets."""
    fps: float = 30.0
    """Frames a second."""
    moved: tuple[int, ...] = (0,)
    """The joints whose local position changes, ascending; always begins with the root."""
    name: str = ""
    made_from: Provenance | None = None
    """What it was retargeted from, where that is known; formats that have a place for it keep it (glTF, USD)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "moved", tuple(int(joint) for joint in self.moved))
        _floats(self, "rotations", (None, len(self.skeleton), 4))
        _unit_quaternions(self, "rotations")
        _floats(self, "translations", (len(self.rotations), len(self.moved), 3))
        if (
            self.moved[:1] != (0,)
            or list(self.moved) != sorted(set(self.moved))
            or self.moved[-1] >= len(self.skeleton)
        ):
            raise RetargetError(
                f"Motion.moved must ascend from the root (0) within {len(self.skeleton)} joints, received {self.moved}"
            )
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise RetargetError(f"Motion.fps must be positive, received {self.fps}")

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def seconds(self) -> float:
        """Duration from the first frame to the last."""
        return max(len(self) - 1, 0) / self.fps

    def pose(self, frame: int) -> Pose:
        return Pose(self.rotations[frame], self.translations[frame], self.moved)


@dataclass(frozen=True, eq=False)
class MeshMotion:
    """One mesh whose vertices move: a performance without skeleton."""

    mesh: Mesh
    """Faces and materials; its vertices are those of the first frame."""
    vertices: Float[Array, "frames vertices 3"]
    """Places on every frame, metres, in single precision."""
    fps: float = 30.0
    """Frames a second."""
    name: str = ""

    def __post_init__(self) -> None:
        _floats(self, "vertices", (None, len(self.mesh.vertices), 3), np.float32)
        if not len(self.vertices):
            raise RetargetError("a MeshMotion needs at least one frame")
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise RetargetError(f"MeshMotion.fps must be positive, received {self.fps}")

    def __len__(self) -> int:
        return len(self.vertices)


@dataclass(frozen=True, eq=False)
class PointMotion:
    """A point cloud a frame, each with points of its own: a capture without correspondence."""

    clouds: tuple[Float[Array, "_ 3"], ...]
    """Points of every frame, metres, in single precision; a frame in which nothing was seen has none."""
    fps: float = 30.0
    """Frames a second."""
    name: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "clouds", tuple(map(self._checked, self.clouds)))
        if not self.clouds:
            raise RetargetError("a PointMotion needs at least one frame")
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise RetargetError(f"PointMotion.fps must be positive, received {self.fps}")

    def __len__(self) -> int:
        return len(self.clouds)

    @staticmethod
    def _checked(cloud: Any) -> Array:
        points = np.asarray(cloud, dtype=np.float32)
        if points.ndim != 2 or points.shape[1] != 3:
            raise RetargetError(f"PointMotion.clouds must be arrays of shape (points, 3), received {points.shape}")
        if not np.isfinite(points).all():
            raise RetargetError("PointMotion.clouds must be finite")
        return points
