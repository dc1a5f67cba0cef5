"""Body parts of a skinned character: which vertex and face belongs to the head, the chest, the left hand ...

The parts are read from the skinning weights: each joint belongs to the part of the humanoid joint it is or hangs on. What
is no body (sheets of hair or cloth, things held or worn on joints of their own) is told apart by its shape, its joints
and its material's name.
"""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices
from retarget.character import Character, Mesh, Skeleton
from retarget.correspond.joints import Humanoid
from retarget.errors import RetargetError, unknown_name
from retarget.geometry.topology import (
    areas,
    distinct,
    is_oriented,
    loops,
    pieces,
    proper,
    rim_edges,
    signed_volume,
    unique_pairs,
    weld,
)

Array = np.ndarray
log = logging.getLogger("retarget")

_ARM = {"UpperArm": "UpperArm", "LowerArm": "Forearm", "Hand": "Hand"}
_LEG = {"UpperLeg": "Thigh", "LowerLeg": "Shin", "Foot": "Foot", "Toes": "Foot"}

PARTS: tuple[str, ...] = (
    "head", "neck", "chest", "abdomen", "pelvis",
    *(f"{side}{part}" for side in ("left", "right") for part in _ARM.values()),
    *(f"{side}{part}" for side in ("left", "right") for part in ("Thigh", "Shin", "Foot")),
)  # fmt: skip
"""The seventeen parts of Basset 2019, figure 3, by our names. A body without a neck joint has no neck."""

PART_OF_JOINT: dict[str, str] = {
    "hips": "pelvis", "spine": "abdomen", "chest": "chest", "upperChest": "chest", "neck": "neck", "head": "head",
    "leftEye": "head", "rightEye": "head", "jaw": "head",
    **{f"{side}{joint}": f"{side}{part}" for side in ("left", "right") for joint, part in (*_ARM.items(), *_LEG.items())},
    **{f"{side}Shoulder": "chest" for side in ("left", "right")},
}  # fmt: skip
"""The part of each canonical joint; fingers belong to their hand."""

LIMBS = tuple(name for name in PARTS if name.startswith(("left", "right")))

SHEET = 10.0
"""Squared lengths of its rims over its area from which on an open piece encloses nothing: a disc has 12.6, a half sphere
6.3, a sleeve as long as wide 6.3, an arm cut off at the shoulder about 1, a strand of hair far more. Ours."""
THIN = 0.005
"""Isoperimetric quotient (36 pi volume² / area³; a ball has 1, whole human bodies .03 to .1) below which a closed piece is
cloth with two sides: a cape a metre long and a centimetre thick has .002. Ours."""
ISLAND = 0.1
"""Share of a part's largest patch on the body below which a patch of its own is given to what surrounds it. Ours."""
OWN_JOINTS = 0.9
"""Share of a piece's weight on joints that are no human's (hair, capes, weapons) from which on it is not body."""
HELD = 1.5
"""Forearms that a piece which only a hand moves is long, from which on the hand holds it. Ours."""

_THINGS: tuple[tuple[str, str], ...] = (
    ("hair", r"hair|ponytail|pigtail|braid|bangs|beard|moustache|eyebrow|eyelash|lashes"),
    ("prop", r"weapon|sword|shield|axe|bow|gun|rifle|bag|backpack|prop|staff|wand|arrow|quiver|spear|dagger|knife|mug"),
    (
        "cloth",
        r"cloth|cape|cloak|skirt|dress|shirt|coat|jacket|robe|scarf|pants|trousers|shorts|shoes?|boots?|hat|helmet",
    ),
)


@dataclass(frozen=True, eq=False)
class BodyParts:
    """How a character's surface divides."""

    names: tuple[str, ...]
    """`PARTS`."""
    vertex_parts: Int[Array, "vertices"]
    """Index into `names` of each vertex."""
    face_parts: Int[Array, "faces"]
    """Index into `names` of each face; -1 for faces that do not count: two of their corners lie in one place at rest, or
    they double another face."""
    welded: Int[Array, "vertices"]
    """The first vertex at each vertex's place: files double vertices along texture seams."""
    face_pieces: Int[Array, "faces"]
    """Connected piece of the welded surface that each face belongs to; -1 as above."""
    piece_kinds: tuple[str, ...]
    """What each piece is: 'body' (worn clothes that enclose a volume included), 'sheet' (encloses nothing, or a layer of
    cloth), 'hair', 'cloth' or 'prop' (told by joints of their own or by name)."""

    def index(self, name: str) -> int:
        """Raises `RetargetError` for an unknown part."""
        if name not in self.names:
            raise unknown_name("part", name, self.names, "the body")
        return self.names.index(name)

    @property
    def body_faces(self) -> Bool[Array, "faces"]:
        """The faces of pieces that are body."""
        kinds = np.array([kind == "body" for kind in self.piece_kinds] + [False])
        return kinds[self.face_pieces]

    @property
    def body_vertices(self) -> Bool[Array, "vertices"]:
        """The vertices of pieces that are body; all copies along texture seams."""
        on = np.zeros(len(self.vertex_parts), dtype=bool)
        on[self._corners[self.body_faces]] = True
        return on[self.welded]

    @property
    def limb_vertices(self) -> Bool[Array, "vertices"]:
        """Body vertices of arms and legs, hands and feet: those that penetration is counted over."""
        limbs = np.isin(np.array(self.names), LIMBS)
        return self.body_vertices & limbs[self.vertex_parts]

    _corners: Int[Array, "faces 3"]
    """The faces over welded vertices."""


def joint_parts(skeleton: Skeleton, humanoid: Humanoid) -> Int[Array, "joints"]:
    """Index into `PARTS` for each joint: its own if it is a canonical joint, else that of the joint it hangs on. Where one
    joint moves the whole trunk it moves the chest."""
    of_joint = PART_OF_JOINT if "chest" in humanoid.joints else PART_OF_JOINT | {"spine": "chest"}
    part = np.full(len(skeleton), PARTS.index("pelvis"))
    known = {joint: name for name, joint in humanoid.joints.items()}
    for joint in range(len(skeleton)):
        name = of_joint.get(known.get(joint, ""))
        if name is not None:
            part[joint] = PARTS.index(name)
        elif skeleton.parents[joint] >= 0:
            part[joint] = part[skeleton.parents[joint]]
    return part


def body_parts(character: Character, humanoid: Humanoid) -> BodyParts:
    """Divide a character's surface. Raises `RetargetError` for a character without one."""
    if character.skin is None or character.mesh is None or len(character.mesh.vertices) == 0:
        raise RetargetError(f"{character.name or 'the character'} has no surface to divide into body parts")
    rest = rest_vertices(character)
    own = weight_by_part(character, humanoid)
    welded = weld(rest, own)
    corners = welded[character.mesh.faces]
    counts = proper(corners) & distinct(corners)
    face_pieces = np.full(len(corners), -1)
    face_pieces[counts] = pieces(corners[counts], len(rest))
    kinds = _kinds(character, humanoid, rest, corners, face_pieces)
    if kinds and "body" not in kinds:
        name = character.name or "the character"
        log.warning(
            "%s: the skin follows other joints than the human's that were matched; none of it counts as body", name
        )
    face_parts = np.full(len(corners), -1)
    face_parts[counts] = own[corners[counts]].sum(axis=1).argmax(axis=1)
    on_body = np.array([kind == "body" for kind in kinds] + [False])[face_pieces]
    face_parts = _without_islands(corners, face_parts, areas(rest, corners), on_body)
    vertex_parts = _parts_of_vertices(corners, face_parts, own)[welded]
    return BodyParts(PARTS, vertex_parts, face_parts, welded, face_pieces, kinds, corners)


def body_height(rest: Float[Array, "vertices 3"], parts: BodyParts, humanoid: Humanoid) -> float:
    """Extent (metres) of the body along its up axis at rest; hats that enclose their head count, what hands hold does not.
    0 for a character none of whose pieces is body."""
    own = rest[parts.body_vertices]
    return float(np.ptp(own @ humanoid.axes[1])) if len(own) else 0.0


def weight_by_part(character: Character, humanoid: Humanoid) -> Float[Array, "vertices parts"]:
    """Share of each vertex's skinning weight that belongs to each of `PARTS`."""
    skin = character.skin
    part = joint_parts(character.skeleton, humanoid)[skin.joints]
    return _weight_by(skin, part, len(PARTS), len(skin.weights))


def _weight_by(skin, groups: Int[Array, "columns"], count: int, vertices: int) -> Float[Array, "vertices groups"]:
    """Sum of the skinning weights of each group of columns."""
    total = np.zeros((vertices, count))
    rows = np.repeat(np.arange(vertices), skin.columns.shape[1])
    np.add.at(total, (rows, groups[skin.columns].ravel()), skin.weights.ravel())
    return total


def _without_islands(
    corners: Int[Array, "faces 3"],
    face_parts: Int[Array, "faces"],
    area: Float[Array, "faces"],
    on_body: Bool[Array, "faces"],
) -> Int[Array, "faces"]:
    """Patches of a part that are small beside its largest on the body are given to the largest patch that they touch. What
    is no body does not count: a shield must not make an island of the hand that holds it."""
    face_parts = face_parts.copy()
    for _ in range(3):
        patch = _patches(corners, face_parts)
        size = np.bincount(patch[patch >= 0], weights=area[patch >= 0])
        part_of = np.full(len(size), -1)
        part_of[patch[patch >= 0]] = face_parts[patch >= 0]
        largest = np.zeros(len(PARTS))
        np.maximum.at(largest, face_parts[on_body], size[patch[on_body]])
        small = np.flatnonzero(size < ISLAND * largest[part_of])
        if len(small) == 0:
            break
        neighbours = _neighbouring_patches(corners, patch)
        changed = False
        for number in small[np.argsort(size[small])]:
            around = [other for other in neighbours.get(int(number), ()) if size[other] > size[number]]
            if around:  # a piece of its own has nothing around it and stays
                face_parts[patch == number] = part_of[max(around, key=lambda other: (size[other], -other))]
                changed = True
        if not changed:
            break
    return face_parts


def _patches(corners: Array, face_parts: Array) -> Int[Array, "faces"]:
    """Connected patch of one part that each face belongs to."""
    patch = np.full(len(corners), -1)
    total = 0
    for part in range(len(PARTS)):
        own = np.flatnonzero(face_parts == part)
        if len(own):
            patch[own] = pieces(corners[own], int(corners.max()) + 1) + total
            total = int(patch[own].max()) + 1
    return patch


def _neighbouring_patches(corners: Array, patch: Array) -> dict[int, set[int]]:
    """Patches that share a vertex."""
    pairs = np.stack([corners.ravel(), np.repeat(patch, 3)], axis=1)
    pairs, _, _ = unique_pairs(pairs[pairs[:, 1] >= 0])
    found: dict[int, set[int]] = {}
    for group in np.split(pairs[:, 1], np.flatnonzero(np.diff(pairs[:, 0])) + 1):
        for one in group.tolist() if len(group) > 1 else ():
            found.setdefault(one, set()).update(other for other in group.tolist() if other != one)
    return found


def _parts_of_vertices(corners: Array, face_parts: Array, own: Array) -> Int[Array, "vertices"]:
    """A vertex belongs to the part of its faces; on a seam to the one among them that its weights favour."""
    touching = np.zeros(own.shape, dtype=bool)
    known = face_parts >= 0
    for corner in range(3):
        touching[corners[known, corner], face_parts[known]] = True
    favoured = np.where(touching, own + 1.0, own)
    return favoured.argmax(axis=1)


def _kinds(
    character: Character, humanoid: Humanoid, rest: Array, corners: Array, face_pieces: Array
) -> tuple[str, ...]:
    """What each piece is."""
    skin, mesh, skeleton = character.skin, character.mesh, character.skeleton
    foreign = _foreign_joints(skeleton, humanoid)
    foreign_share = _weight_by(skin, foreign[skin.joints].astype(int), 2, len(rest))[:, 1]
    area = areas(rest, corners)
    held = held_pieces(character, humanoid, rest, corners, face_pieces)
    kinds = []
    for piece in range(int(face_pieces.max()) + 1 if len(face_pieces) else 0):
        own = np.flatnonzero(face_pieces == piece)
        material = _thing_of_materials(mesh, own, area)
        if foreign_share[corners[own]].mean() > OWN_JOINTS:
            joints = [skeleton.names[joint] for joint in _leading_joints(skin, corners[own])]
            kinds.append(material or _thing(joints) or "prop")
        elif _is_sheet(rest, corners[own], float(area[own].sum())):
            kinds.append("sheet")
        elif held[piece]:
            kinds.append(material or "prop")
        else:  # clothes that enclose a volume may be all the body there is
            kinds.append("hair" if material == "hair" else "body")
    return tuple(kinds)


def held_pieces(
    character: Character, humanoid: Humanoid, rest: Array, corners: Array, face_pieces: Array
) -> Bool[Array, "pieces"]:
    """Which pieces of a surface (-1 where a face has none) are no hand but what one holds: a hand alone moves them, and they
    are too long (`HELD`)."""
    count = int(face_pieces.max(initial=-1)) + 1
    held, counted = np.zeros(count, dtype=bool), face_pieces >= 0
    number, corners = face_pieces[counted], corners[counted]
    places, own = rest_pose(character.skeleton)[1], weight_by_part(character, humanoid)
    for side in ("left", "right"):
        ends = [humanoid.joints.get(f"{side}{name}") for name in ("LowerArm", "Hand")]
        if None in ends:
            continue
        longest = HELD * float(np.linalg.norm(places[ends[0]] - places[ends[1]]))
        share = own[:, PARTS.index(f"{side}Hand")][corners].mean(axis=1)
        moved = np.bincount(number, share, count) > OWN_JOINTS * np.maximum(np.bincount(number, minlength=count), 1)
        for piece in np.flatnonzero(moved).tolist():
            held[piece] |= bool(np.linalg.norm(np.ptp(rest[corners[number == piece]].reshape(-1, 3), axis=0)) > longest)
    return held


def _is_sheet(rest: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], area: float) -> bool:
    """Whether a piece encloses next to nothing: its rims are long (`SHEET`), or it is closed and thin (`THIN`)."""
    rim = rim_edges(faces)
    if len(rim):
        lengths = np.bincount(loops(rim, len(rest)), weights=np.linalg.norm(rest[rim[:, 0]] - rest[rim[:, 1]], axis=1))
        return bool((lengths**2).sum() > SHEET * area)
    if not is_oriented(faces):  # then its volume is not known
        return False
    return bool(36 * np.pi * float(signed_volume(rest - rest[faces[0, 0]], faces)) ** 2 < THIN * area**3)


def _foreign_joints(skeleton: Skeleton, humanoid: Humanoid) -> Bool[Array, "joints"]:
    """Joints that are neither a human's nor above a human's: hair, capes, what hands hold."""
    known = set(humanoid.joints.values()) | set(humanoid.twists)
    ours = np.zeros(len(skeleton), dtype=bool)
    ours[list(known)] = True
    for joint in range(len(skeleton) - 1, 0, -1):
        if ours[joint]:
            ours[skeleton.parents[joint]] = True
    return ~ours


def _leading_joints(skin, corners: Array) -> Int[Array, "_"]:
    """The joints that lead a piece's vertices."""
    vertices = np.unique(corners)
    lead = skin.weights[vertices].argmax(axis=1)
    return np.unique(skin.joints[skin.columns[vertices, lead]])


def _thing_of_materials(mesh: Mesh, faces: Int[Array, "_"], area: Float[Array, "faces"]) -> str | None:
    """What the name of the material says that covers nearly all of a piece."""
    if mesh.face_materials is None or not mesh.materials:
        return None
    covered = np.bincount(mesh.face_materials[faces], weights=area[faces])
    most = int(covered.argmax())
    return _thing([mesh.materials[most].name]) if covered[most] > 0.9 * covered.sum() else None


def _thing(names: list[str]) -> str | None:
    """What names of joints and materials say that a thing is."""
    text = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", " ".join(names)).lower()  # the words of LongHair
    for kind, pattern in _THINGS:
        if re.search(rf"(?:^|[^a-z])(?:{pattern})", text):
            return kind
    return None
