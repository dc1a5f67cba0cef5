"""A body for SMPL motions whose model is not at hand: the embedded human's joints, standing in SMPL's rest pose.

SMPL archives hold angles, not joint positions; these belong to a model under its own licence. The angles count from
the model's rest pose, so what matters of the body that stands in is that its bones point where the model's do: then
the same angles give the same directions.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.human import human, human_model
from retarget.body.kinematics import rest_pose
from retarget.character import Character, Skeleton
from retarget.io.smpl_joints import CANONICAL, Family

Array = np.ndarray

DIRECTIONS: dict[str, tuple[str, tuple[float, float, float]]] = {
    # bone of the left side: (where it ends, where it points: left, up, forward)
    "Shoulder": ("UpperArm", (0.94, 0.32, -0.09)),
    "UpperArm": ("LowerArm", (0.99, -0.05, -0.11)),
    "LowerArm": ("Hand", (1.0, 0.04, 0.0)),
    "UpperLeg": ("LowerLeg", (0.09, -1.0, -0.01)),
    "LowerLeg": ("Foot", (-0.03, -0.99, -0.11)),
}
"""How the limbs of SMPL's mean body lie in its rest pose, to a degree or so; trunk, head and feet are as in the
embedded human, which stands upright too. Hands and fingers lie flat along the arms' axis, palms down."""

SPINE = {"spine1": 0.21, "spine2": 0.47, "spine3": 0.58}
"""How high SMPL's spine joints sit between pelvis and neck: it matters how a bend is shared out along the back."""

PELVIS = {"SMPL": (0.0, -0.22, 0.03), "SMPL-X": (0.0, -0.35, 0.01)}
"""Where the pelvis of the published mean bodies rests in their own space, metres, to a centimetre. An archive's path
does not say where the pelvis is but how far the model is moved, so this is added."""

GENDERS = {"female": 0.0, "f": 0.0, "male": 1.0, "m": 1.0}


def stand_in(family: Family, gender: str | None, shape_space: str) -> Character:
    """A skeleton under the family's joint names, at rest, +Y up, facing +Z, all rotations the identity; no surface.

    `gender` is 'male' or 'female'; anything else gives the embedded human between both. `shape_space` chooses where the
    pelvis lies ('SMPL' or 'SMPL-X').
    """
    places, ends = _joints_in_t(GENDERS.get((gender or "").lower(), 0.5))
    parents = np.array(family.parents)
    positions = np.array([places[name] for name in family.names])
    offsets = positions - positions[parents]
    offsets[0] = PELVIS[shape_space]
    last = [joint for joint in range(len(parents)) if joint not in parents]
    end_offsets = {joint: ends[family.names[joint]] for joint in last if family.names[joint] in ends}
    identity = np.broadcast_to(rot.IDENTITY, (len(parents), 4))
    return Character(Skeleton(family.names, parents, offsets, identity, end_offsets), name="the embedded human")


@lru_cache(maxsize=4)
def _joints_in_t(gender: float) -> tuple[dict[str, Float[Array, "3"]], dict[str, Float[Array, "3"]]]:
    """Joints of the embedded human in SMPL's rest pose by SMPL's names, and where bones without a child end
    (offsets)."""
    character = human(gender=gender)
    skeleton, vertices = character.skeleton, character.mesh.vertices
    _, relaxed = rest_pose(skeleton)
    turns = np.broadcast_to(rot.IDENTITY, (len(skeleton), 4)).copy()
    for side, out in (("left", 1.0), ("right", -1.0)):
        at = {name.removeprefix(side): j for j, name in enumerate(skeleton.names) if name.startswith(side)}
        for part, (end, direction) in DIRECTIONS.items():
            wanted = rot.unit(np.array(direction) * [out, 1.0, 1.0])
            turns[at[part]] = rot.swing_between(rot.unit(skeleton.offsets[at[end]]), wanted)
        hand, along = at["Hand"], np.array([out, 0.0, 0.0])
        across = relaxed[at["IndexProximal"]] - relaxed[at["LittleProximal"]]
        held = rot.from_frame(skeleton.offsets[at["MiddleProximal"]], across)
        flat = rot.from_frame(along, np.array([0.0, 0.0, 1.0]))
        turns[hand] = rot.multiply(flat, rot.inverse(held))
        for part, joint in at.items():
            if part.startswith("Thumb"):
                turns[joint] = turns[hand]
            elif part.startswith(("Index", "Middle", "Ring", "Little")):
                below = skeleton.children(joint)
                bone = skeleton.offsets[below[0]] if below else skeleton.end_offsets[joint]
                turns[joint] = rot.swing_between(rot.unit(bone), along)
    positions = relaxed.copy()
    for joint in range(1, len(skeleton)):
        parent = skeleton.parents[joint]
        positions[joint] = positions[parent] + rot.rotate(turns[parent], skeleton.offsets[joint])
    places = {name: positions[skeleton.index(canonical)] for name, canonical in CANONICAL.items()}
    trunk = np.array([places[name] for name in ("pelvis", *SPINE, "neck")])
    for name, share in SPINE.items():
        height = (1.0 - share) * trunk[0, 1] + share * trunk[-1, 1]
        places[name] = np.array([np.interp(height, trunk[:, 1], trunk[:, axis]) for axis in range(3)])
    ends = {
        name: rot.rotate(turns[skeleton.index(canonical)], skeleton.end_offsets[skeleton.index(canonical)])
        for name, canonical in CANONICAL.items()
        if skeleton.index(canonical) in skeleton.end_offsets
    }
    for side in ("left", "right"):
        places[f"{side}_hand"] = places[f"{side}_middle1"]
        ends[f"{side}_hand"] = places[f"{side}_middle3"] + ends[f"{side}_middle3"] - places[f"{side}_hand"]
        ends[f"{side}_wrist"] = places[f"{side}_middle3"] + ends[f"{side}_middle3"] - places[f"{side}_wrist"]
    landmark = {name: vertices[vertex] for name, vertex in human_model().landmarks.items()}
    ears = 0.5 * (landmark["leftEar"] + landmark["rightEar"])
    places["jaw"] = np.array([0.0, 0.5 * (ears[1] + landmark["chin"][1]), ears[2]])
    for side in ("left", "right"):
        places[f"{side}_eye_smplhf"] = landmark[f"{side}Eye"] - [0.0, 0.0, 0.012]  # the middle of the ball
    return places, ends
