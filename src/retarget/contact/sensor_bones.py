"""The eighteen bones that sensors look out from, on any humanoid, whatever its rest pose and rig.

Ye 2024 casts its rays in the rest pose. Rest poses differ (T, A, arms hanging), and a shoulder looks different in each,
so we first bring every body into one *stance* by linear blend skinning: trunk and head as they rest, arms straight at
45 degrees with the back of the hand up and outward, legs straight and 7 degrees apart, feet flat and ahead. The stance
is in the body's own axes (+X left, +Y up, +Z forward, metres). In the rest pose these are rays in the bone's
anatomical frame.

The bones do not lean on joints that rigs lack or place freely (spine, neck, clavicles, knuckles, toes): the trunk runs
from the middle of the hip joints to the base of the neck, halfway from the shoulder joints to the head joint; palm and
foot are measured on the surface. All of this is ours; the paper names neither its 18 bones nor its meshes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body import rotations as rot
from retarget.body.kinematics import forward, local_rotations, rest_pose
from retarget.body.skinning import prepare_skinning
from retarget.character import Character
from retarget.contact.parts import held_pieces
from retarget.correspond.joints import Humanoid
from retarget.errors import RetargetError

Array = np.ndarray

SIDES = ("left", "right")
BONES: tuple[str, ...] = (
    "spine", "chest", "neck", "head",
    *(side + part for side in SIDES
      for part in ("Shoulder", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot")),
)  # fmt: skip
"""Lower and upper half of the trunk, neck, head; a side: clavicle, arm, forearm, hand with fingers, thigh, shin, foot
with toes."""
LIMBS = ("leftArm", "rightArm", "leftLeg", "rightLeg")
NEEDED = ("head", *(side + part for side in SIDES for part in
          ("UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot")))  # fmt: skip

ARM_DOWN, LEG_OUT = np.radians(45.0), np.radians(7.0)
FLAT = 0.5
"""A hand whose thickness varies by less than this share of its width (variances) shows where its back is."""
UPRIGHT = np.cos(np.radians(25.0))
X, Y, Z = np.eye(3)


@dataclass(frozen=True, eq=False)
class Stance:
    """A body brought into the common stance, in its own axes: +X left, +Y up, +Z forward, metres."""

    vertices: Float[Array, "vertices 3"]
    normals: Float[Array, "vertices 3"]
    """Unit; vertices at one place share theirs."""
    faces: Int[Array, "faces 3"]
    body: Bool[Array, "faces"]
    """False for props: connected pieces that follow none of the body's own joints (a sword in its slot)."""
    joints: dict[str, Float[Array, "3"]]
    """Places of the matched joints."""
    pools: dict[str, Float[Array, "vertices"]]
    """Skin weight of each vertex by part: 'trunk', 'neck', 'head' and the limb bones with all that hangs on them."""
    turns: dict[str, Float[Array, "4"]]
    """World rotation of each limb bone from the rest pose to the stance; absent where it does not turn."""
    world_from_body: Float[Array, "4"]
    rest: Float[Array, "vertices 3"]
    """The same vertices in the rest pose, in the world."""
    height: float
    """Of the body at rest, metres."""

    def limbs(self) -> Float[Array, "vertices 4"]:
        """How much each vertex belongs to each of `LIMBS`."""
        none = np.zeros(len(self.vertices))
        parts = {"Arm": ("UpperArm", "LowerArm", "Hand"), "Leg": ("UpperLeg", "LowerLeg", "Foot")}
        return np.stack(
            [sum((self.pools.get(limb[:-3] + part, none) for part in parts[limb[-3:]]), start=none) for limb in LIMBS],
            axis=1,
        )


@dataclass(frozen=True, eq=False)
class SensorBone:
    """One bone in the stance and the mesh it looks at."""

    parent: Float[Array, "3"]
    child: Float[Array, "3"]
    axes: Float[Array, "3 3"]
    """Rows: along the bone; the reference of phi = 0 (forward, for feet up); reference x bone, at phi = 90 degrees."""
    weight: Float[Array, "vertices"]
    """Skin weight by which a face is associated with the bone."""
    outermost: bool = False
    """Take the last surface that a ray leaves, not the first."""
    reach: float = np.inf
    """Metres from the bone within which a surface counts."""


def stand(character: Character, humanoid: Humanoid) -> Stance:
    """Bring a character (metres, +Y up) into the common stance.

    Raises `RetargetError` for a character without skin and for a humanoid without head or a whole limb.
    """
    missing = [name for name in NEEDED if name not in humanoid.joints]
    if missing:
        raise RetargetError(
            f"sensors need head, arms and legs; {character.name or 'the character'} has no {', '.join(missing)}"
        )
    skinner, skeleton = prepare_skinning(character), character.skeleton
    rotations, positions = rest_pose(skeleton)
    rest = skinner.vertices(rotations[None], positions[None])[0].astype(np.float64)
    names = _part_of_joint(character, humanoid)
    pools = _pools(character, names)
    world_from_body = _trunk_frame(humanoid.axes)
    up = rest @ rot.rotate(world_from_body, Y)
    height = float(np.percentile(up, 99.9) - np.percentile(up, 0.1)) if len(up) else 0.0
    if not height > 0:
        raise RetargetError(f"{character.name or 'the character'} has a surface without height; sensors need a body")
    place = welded(rest, height)
    faces = character.mesh.faces
    body = _body_faces(character, humanoid, rest, place)
    turns = _RestBody(humanoid.joints, positions, rest, faces[body], pools, world_from_body).turns()

    own = {humanoid.joints[name]: turn for name, turn in turns.items()}
    delta = np.empty((len(skeleton), 4))
    for joint, parent in enumerate(skeleton.parents):
        delta[joint] = own.get(joint, delta[parent] if parent >= 0 else rot.IDENTITY)
    local = local_rotations(skeleton.parents, rot.multiply(delta, rotations))
    turned, moved = forward(skeleton.parents, local, skeleton.offsets)
    posed = skinner.vertices(turned[None], moved[None])[0].astype(np.float64)
    body_from_world = rot.inverse(world_from_body)
    vertices, moved = rot.rotate(body_from_world, posed), rot.rotate(body_from_world, moved)
    return Stance(
        vertices=vertices,
        normals=vertex_normals(vertices, faces, place),
        faces=faces,
        body=body,
        joints={name: moved[joint] for name, joint in humanoid.joints.items()},
        pools=pools,
        turns=turns,
        world_from_body=world_from_body,
        rest=rest,
        height=height,
    )


def sensor_bones(stance: Stance) -> dict[str, SensorBone]:
    """The bones of `BONES` in the stance, in that order."""
    at, none = stance.joints, np.zeros(len(stance.vertices))

    def pool(*parts: str) -> Array:
        return sum((stance.pools.get(part, none) for part in parts), start=none)

    hips = (at["leftUpperLeg"] + at["rightUpperLeg"]) / 2
    neck = (at["head"] + (at["leftUpperArm"] + at["rightUpperArm"]) / 2) / 2
    waist, trunk = (hips + neck) / 2, pool("trunk")
    bones = {
        "spine": _bone(hips, waist, trunk),
        "chest": _bone(waist, neck, trunk),
        "neck": _bone(neck, at["head"], pool("trunk", "neck", "head")),
        "head": _bone(at["head"], _head_centre(stance, at["head"]), pool("head"), outermost=True),
    }
    for side in SIDES:
        arm, elbow, wrist = (at[side + part] for part in ("UpperArm", "LowerArm", "Hand"))
        leg, knee, ankle = (at[side + part] for part in ("UpperLeg", "LowerLeg", "Foot"))
        bones[side + "Shoulder"] = replace(_bone(neck, arm, trunk), reach=float(np.linalg.norm(arm - neck)))
        bones[side + "UpperArm"] = _bone(arm, elbow, pool(side + "UpperArm"))
        bones[side + "LowerArm"] = _bone(elbow, wrist, pool(side + "LowerArm"))
        bones[side + "Hand"] = _bone(wrist, _palm_end(stance, side, elbow, wrist), pool(side + "Hand"))
        bones[side + "UpperLeg"] = _bone(leg, knee, pool(side + "UpperLeg"))
        bones[side + "LowerLeg"] = _bone(knee, ankle, pool(side + "LowerLeg"))
        bones[side + "Foot"] = _bone(ankle, _ball(stance, side, knee, ankle), pool(side + "Foot"), Y)
    return {name: bones[name] for name in BONES}


def _bone(parent: Array, child: Array, weight: Array, reference: Array = Z, outermost: bool = False) -> SensorBone:
    along = rot.unit(child - parent)
    for candidate in (reference, Y, Z):  # the reference, unless it is parallel to the bone
        normal = candidate - (candidate @ along) * along
        if np.linalg.norm(normal) > 0.1:
            break
    normal = rot.unit(normal)
    return SensorBone(parent, child, np.stack([along, normal, np.cross(normal, along)]), weight, outermost)


def _head_centre(stance: Stance, head: Array) -> Float[Array, "3"]:
    """Above the head joint, at six tenths of the way to the crown: from here the whole skull is seen."""
    crown = stance.vertices[_owned(stance, "head"), 1].max(initial=head[1] + 0.01 * stance.height)
    return head + 0.6 * (crown - head[1]) * Y


def _palm_end(stance: Stance, side: str, elbow: Array, wrist: Array) -> Float[Array, "3"]:
    """Near the fingertips: four fifths of the hand's length beyond the wrist, along the forearm."""
    along = rot.unit(wrist - elbow)
    reach = (stance.vertices[_owned(stance, side + "Hand")] - wrist) @ along
    return wrist + 0.8 * reach.max(initial=0.3 * float(np.linalg.norm(wrist - elbow))) * along


def _ball(stance: Stance, side: str, knee: Array, ankle: Array) -> Float[Array, "3"]:
    """The ball of the foot: low, two thirds of the way from the ankle to the tip of the toes."""
    foot = stance.vertices[_owned(stance, side + "Foot")]
    shin = float(np.linalg.norm(knee - ankle))
    tip, sole = foot[:, 2].max(initial=ankle[2] + 0.1 * shin), foot[:, 1].min(initial=ankle[1] - 0.1 * shin)
    return np.array([ankle[0], sole + 0.3 * (ankle[1] - sole), ankle[2] + 0.65 * (tip - ankle[2])])


def _owned(stance: Stance, part: str) -> Int[Array, "_"]:
    """Vertices of the body itself that mostly follow a part."""
    used = np.zeros(len(stance.vertices), dtype=bool)
    used[stance.faces[stance.body]] = True
    return np.flatnonzero(used & (stance.pools.get(part, np.zeros(len(used))) > 0.5))


# --- who follows what ---------------------------------------------------------------------------------------------


def _part_of_joint(character: Character, humanoid: Humanoid) -> list[str]:
    """The part of every joint; joints that are none of a human's follow the joint above them."""
    own = {joint: _part_of_name(name) for name, joint in humanoid.joints.items()}
    own |= {joint: _part_of_name(name) for joint, name in humanoid.twists.items()}
    parts: list[str] = []
    for joint, parent in enumerate(character.skeleton.parents):
        parts.append(own.get(joint, parts[parent] if parent >= 0 else "trunk"))
    return parts


def _part_of_name(name: str) -> str:
    if name in ("hips", "spine", "chest", "upperChest") or name.endswith("Shoulder"):
        return "trunk"
    if name in ("head", "leftEye", "rightEye", "jaw"):
        return "head"
    side = next((side for side in SIDES if name.startswith(side)), "")
    part = name[len(side) :]
    if part == "Toes":
        return side + "Foot"
    return side + "Hand" if part.startswith(("Thumb", "Index", "Middle", "Ring", "Little")) else name


def _pools(character: Character, parts: list[str]) -> dict[str, Float[Array, "vertices"]]:
    skin, names = character.skin, sorted(set(parts))
    of_column = np.array([names.index(part) for part in parts])[skin.joints]
    rows = np.repeat(np.arange(len(skin.columns)), skin.columns.shape[1])
    cells = rows * len(names) + of_column[skin.columns].ravel()
    table = np.bincount(cells, skin.weights.ravel(), minlength=len(skin.columns) * len(names))
    return dict(zip(names, table.reshape(-1, len(names)).T.copy()))


def welded(vertices: Array, height: float) -> Int[Array, "vertices"]:
    """One number a place: vertices that texture seams or hard edges split fall together."""
    _, place = np.unique(np.round(vertices / (1e-6 * height)).astype(np.int64), axis=0, return_inverse=True)
    return place.reshape(-1)


def _body_faces(character: Character, humanoid: Humanoid, rest: Array, place: Array) -> Bool[Array, "faces"]:
    """Which faces lie on a connected piece that follows a joint of the body itself, or one between two of them, and is not
    held in a hand."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    parents, own = character.skeleton.parents, set(humanoid.joints.values()) | set(humanoid.twists)
    for joint in list(own):
        while parents[joint] >= 0 and parents[joint] not in own:
            joint = int(parents[joint])
            own.add(joint)
    skin, faces = character.skin, place[character.mesh.faces]
    followed = np.isin(skin.joints, sorted(own))[skin.columns]
    bodily = (skin.weights * followed).sum(axis=1) > 0.1
    size = int(place.max(initial=-1)) + 1
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = sparse.coo_matrix((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(size, size))
    count, piece = connected_components(graph, directed=False)
    kept = np.zeros(count, dtype=bool)
    kept[piece[place[bodily]]] = True
    own = piece[faces[:, 0]]
    held = held_pieces(character, humanoid, rest, character.mesh.faces, own)
    kept[: len(held)] &= ~held
    return kept[own]


def vertex_normals(vertices: Array, faces: Array, place: Array) -> Float[Array, "vertices 3"]:
    corners = vertices[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    at = place[faces].ravel()
    size = int(place.max(initial=-1)) + 1
    total = np.stack([np.bincount(at, np.repeat(area[:, i], 3), minlength=size) for i in range(3)], axis=1)
    return rot.unit(total)[place]


# --- from the rest pose to the stance -------------------------------------------------------------------------------


def _trunk_frame(axes: Float[Array, "3 3"]) -> Float[Array, "4"]:
    """World rotation of left, up and forward at rest; a trunk that leans a little is taken as upright."""
    left, up = axes[0], axes[1]
    if up[1] > UPRIGHT:
        up = Y
    return rot.from_frame(left - (left @ up) * up, up)


@dataclass(frozen=True, eq=False)
class _RestBody:
    """What the turns into the stance are measured from."""

    matched: dict[str, int]
    positions: Float[Array, "joints 3"]
    rest: Float[Array, "vertices 3"]
    faces: Int[Array, "faces 3"]
    pools: dict[str, Float[Array, "vertices"]]
    world_from_body: Float[Array, "4"]

    def turns(self) -> dict[str, Float[Array, "4"]]:
        """World rotation of every limb joint from the rest pose to the stance."""
        turns: dict[str, Array] = {}
        for side, sign in (("left", 1.0), ("right", -1.0)):
            out = self._world(sign * X)
            arm = self._world(np.array([sign * np.cos(ARM_DOWN), -np.sin(ARM_DOWN), 0.0]))
            leg = self._world(np.array([sign * np.sin(LEG_OUT), -np.cos(LEG_OUT), 0.0]))
            up, ahead = self._world(Y), self._world(Z)
            for part, end in (("UpperArm", "LowerArm"), ("LowerArm", "Hand")):
                turns[side + part] = self._swing(side + part, side + end, arm, out, up)
            for part, end in (("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot")):
                turns[side + part] = self._swing(side + part, side + end, leg, -up, ahead)
            self._turn_hand(turns, side, arm, out, up)
            turns[side + "Foot"] = self._turn_foot(side, up, ahead)
        return turns

    def _world(self, direction: Array) -> Float[Array, "3"]:
        return rot.rotate(self.world_from_body, direction)

    def _at(self, name: str) -> Float[Array, "3"]:
        return self.positions[self.matched[name]]

    def _swing(self, name: str, end: str, wanted: Array, resting: Array, second: Array) -> Float[Array, "4"]:
        """Turns a bone into the wanted direction; its second axis is carried over from the T-pose on both sides."""
        along = self._at(end) - self._at(name)
        here = rot.from_frame(along, rot.rotate(rot.swing_between(resting, along), second))
        there = rot.from_frame(wanted, rot.rotate(rot.swing_between(resting, wanted), second))
        return rot.multiply(there, rot.inverse(here))

    def _turn_hand(self, turns: dict[str, Array], side: str, arm: Array, out: Array, up: Array) -> None:
        """Back of the hand up and outward; the forearm takes half of the twist."""
        along, back = self._palm(side, out, up)
        carried = rot.rotate(rot.swing_between(out, along), up)
        here = rot.from_frame(along, carried if back is None else back)
        there = rot.from_frame(arm, rot.rotate(rot.swing_between(out, arm), up))
        turns[side + "Hand"] = rot.multiply(there, rot.inverse(here))
        if back is not None:
            forearm = turns[side + "LowerArm"]
            twist = rot.twist_about(rot.multiply(turns[side + "Hand"], rot.inverse(forearm)), arm)
            turns[side + "LowerArm"] = rot.multiply(rot.slerp(rot.IDENTITY, twist, 0.5), forearm)

    def _palm(self, side: str, out: Array, up: Array) -> tuple[Float[Array, "3"], Float[Array, "3"] | None]:
        """From the wrist to the middle of the hand's surface, and out of its back; None for a hand that is not flat.

        Measured on the surface, as only some rigs have fingers; the sign comes from the knuckles where there are any.
        """
        wrist = self._at(side + "Hand")
        forearm = wrist - self._at(side + "LowerArm")
        weight = self.pools.get(side + "Hand", np.zeros(len(self.rest)))
        corners = self.rest[self.faces[(weight[self.faces] > 0.5).all(axis=1)]]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        if not area.sum() > 0:
            return forearm, None
        centres = corners.mean(axis=1)
        middle = area @ centres / area.sum()
        along = rot.unit(middle - wrist)
        if along @ rot.unit(forearm) < 0.5:  # props or a fist: the hand goes on where the forearm points
            return forearm, None
        spread = centres - middle
        spread = spread - np.outer(spread @ along, along)
        variances, directions = np.linalg.eigh((area[:, None] * spread).T @ spread)
        if variances[1] > FLAT * variances[2]:
            return along, None
        knuckles = self._knuckle_normal(side, along)
        towards = rot.rotate(rot.swing_between(out, along), up) if knuckles is None else knuckles
        back = directions[:, 1]
        return along, back if back @ towards > 0 else -back

    def _knuckle_normal(self, side: str, along: Array) -> Float[Array, "3"] | None:
        row = [self._at(name) for finger in ("Index", "Middle", "Ring", "Little")
               if (name := f"{side}{finger}Proximal") in self.matched]  # fmt: skip
        if len(row) < 2:
            return None
        back = np.cross(row[0] - row[-1], along)
        return back if side == "left" else -back

    def _turn_foot(self, side: str, up: Array, ahead: Array) -> Float[Array, "4"]:
        """Heading straight ahead; a foot that hangs or points up at rest is turned flat from the usual slope."""
        foot, toes = self._at(side + "Foot"), self.matched.get(side + "Toes")
        along = ahead if toes is None else self.positions[toes] - foot
        heading, length = along - (along @ up) * up, float(np.linalg.norm(along))
        if np.linalg.norm(heading) > 0.35 * length and heading @ ahead > 0 and along @ up < 0.5 * length:
            here = rot.from_frame(heading, up)
        else:
            usual = np.cos(np.pi / 6) * ahead - np.sin(np.pi / 6) * up  # of a bone from ankle to toes
            turn = rot.swing_between(usual, along)
            here = rot.from_frame(rot.rotate(turn, ahead), rot.rotate(turn, up))
        return rot.multiply(rot.from_frame(ahead, up), rot.inverse(here))
