"""What the benches run on: embedded bodies and motions, and real files where they are at hand.

Looked at while building: the bodies heavy, child and muscular, the CMU clips of subjects 01 to 05, and the KayKit
characters. All others are only reported.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.human import human_model
from retarget.body.kinematics import local_rotations, rest_pose
from retarget.body.skinning import rest_vertices
from retarget.character import Character, Skeleton
from retarget.motion.align import Actor
from retarget.motion.anatomy import rest_frames

Array = np.ndarray

REPOSITORY = Path(__file__).resolve().parents[3]
SEEN_BODIES = ("heavy", "child", "muscular")
SEEN_CLIPS = ("01_", "02_", "03_", "05_")
SEEN_CHARACTERS = ("Knight", "Barbarian", "manny_med_mod")


def data_folder() -> Path | None:
    """The folder of real files: `RETARGET_DATA`, or shared/data beside the checkout; None where there is none."""
    named = os.environ.get("RETARGET_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    return folder if folder.is_dir() else None


def real_files(*suffixes: str) -> Iterator[Path]:
    """Real files of the given suffixes, sorted; none where there is no data folder."""
    folder = data_folder()
    if folder is not None:
        yield from sorted(path for path in folder.rglob("*") if path.suffix.lower() in suffixes)


def split_of(name: str, seen: tuple[str, ...]) -> str:
    return "seen" if name.startswith(seen) else "unseen"


def in_other_rest_pose(character: Character, turns: dict[str, Float[Array, "3"]]) -> Character:
    """The same body whose rest pose is another one: named joints turned in the world (rotation vectors, radians), their
    subtrees with them. The surface keeps its binding, so every pose looks as before."""
    skeleton = character.skeleton
    world, _ = rest_pose(skeleton)
    world = world.copy()
    for joint, name in enumerate(skeleton.names):
        parent = skeleton.parents[joint]
        if parent >= 0:
            world[joint] = rot.multiply(world[parent], skeleton.rest_rotations[joint])
        if name in turns:
            world[joint] = rot.multiply(rot.from_rotation_vector(np.asarray(turns[name], float)), world[joint])
    rested = replace(skeleton, rest_rotations=local_rotations(skeleton.parents, world))
    return replace(character, skeleton=rested, origin=None)


def with_other_joint_axes(character: Character, seed: int) -> Character:
    """The same body whose joints have other axes: every joint's frame rolled at random, nothing visible changes."""
    skeleton = character.skeleton
    turn = rot.normalise(np.random.default_rng(seed).normal(size=(len(skeleton), 4)))
    above = np.concatenate([rot.IDENTITY[None], turn[skeleton.parents[1:]]])
    back = rot.inverse(above)
    ends = skeleton.end_offsets and {
        j: rot.rotate(rot.inverse(turn[j]), end) for j, end in skeleton.end_offsets.items()
    }
    rolled = Skeleton(
        skeleton.names,
        skeleton.parents,
        rot.rotate(back, skeleton.offsets),
        rot.multiply(rot.multiply(back, skeleton.rest_rotations), turn),
        ends,
    )
    skin = character.skin
    if skin is not None:
        unroll = np.broadcast_to(np.eye(4), (len(skin.joints), 4, 4)).copy()
        unroll[:, :3, :3] = rot.to_matrix(rot.inverse(turn))[skin.joints]
        skin = replace(skin, inverse_binds=unroll @ skin.inverse_binds)
    return replace(character, skeleton=rolled, skin=skin, origin=None)


def arms_turned(down_degrees: float) -> dict[str, Float[Array, "3"]]:
    """Turns that lower both arms (raise them, if negative) about the forward axis."""
    angle = np.radians(down_degrees)
    return {"leftUpperArm": np.array([0, 0, -angle]), "rightUpperArm": np.array([0, 0, angle])}


def limb_directions(actor: Actor, world_positions: Float[Array, "frames joints 3"]) -> Float[Array, "frames limbs 3"]:
    """Upper and lower arms and legs, both sides."""
    at = lambda name: world_positions[:, actor.humanoid.joints[name]]  # noqa: E731
    pairs = [("UpperArm", "LowerArm"), ("LowerArm", "Hand"), ("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot")]
    return np.stack([at(side + b) - at(side + a) for side in ("left", "right") for a, b in pairs], axis=1)


def orientation_markers(actor: Actor) -> dict[str, tuple[int, Float[Array, "3"]]]:
    """Directions fixed to a joint (in its frame) that show how palms, feet and head are turned, measured on the body
    itself: knuckles, the sole's surface, the nose. Only what the body shows is there."""
    rotations, places = rest_pose(actor.skeleton)
    joints, found = actor.humanoid.joints, {}

    def note(name: str, joint: int, direction: Array) -> None:
        found[name] = (joint, rot.rotate(rot.inverse(rotations[joint]), rot.unit(direction)))

    for side in ("left", "right"):
        knuckles = [joints.get(f"{side}{finger}Proximal") for finger in ("Index", "Middle", "Little", "Ring")]
        first = knuckles[0] if knuckles[0] is not None else knuckles[1]
        last = knuckles[2] if knuckles[2] is not None else knuckles[3]
        hand = joints[f"{side}Hand"]
        if first is not None and last is not None:
            normal = np.cross(places[first] - places[hand], places[last] - places[hand])
            note(f"{side}Palm", hand, normal if side == "left" else -normal)
    if "leftEye" in joints and "rightEye" in joints:
        note("eyes", joints["head"], places[joints["leftEye"]] - places[joints["rightEye"]])
    if actor.character.skin is not None:
        surface = rest_vertices(actor.character)
        _sole_markers(actor, surface, note)
        if np.array_equal(actor.character.mesh.faces, human_model().faces):
            nose, nape = (human_model().landmark(name) for name in ("nose", "backOfHead"))
            note("face", joints["head"], surface[nose] - surface[nape])
    return found


def _sole_markers(actor: Actor, surface: Float[Array, "vertices 3"], note: Callable[[str, int, Array], None]) -> None:
    skin = actor.character.skin
    lead = skin.joints[np.take_along_axis(skin.columns, skin.weights.argmax(1)[:, None], 1)[:, 0]]
    for side in ("left", "right"):
        own = [actor.humanoid.joints.get(f"{side}{part}") for part in ("Foot", "Toes")]
        foot = surface[np.isin(lead, [joint for joint in own if joint is not None])]
        if len(foot) < 20:
            continue
        # The sole is flat whatever the rest pose: the foot's lowest layer across its thinnest direction.
        frame = rest_frames(actor.skeleton, actor.humanoid)[f"{side}Foot"]
        down = -rot.rotate(frame, np.array([0.0, 1.0, 0.0]))
        depth = foot @ down
        sole = foot[depth > np.percentile(depth, 80)]
        axes = np.linalg.svd(sole - sole.mean(0), full_matrices=False)[2]
        normal, heading = axes[2], axes[0]
        note(f"{side}Sole", own[0], normal * np.sign(-normal @ down))
        note(f"{side}FootHeading", own[0], heading * np.sign(heading @ rot.rotate(frame, np.array([1.0, 0, 0]))))


def marker_directions(
    markers: dict[str, tuple[int, Float[Array, "3"]]],
    names: list[str],
    world_rotations: Float[Array, "frames joints 4"],
) -> Float[Array, "frames markers 3"]:
    """World directions of the named markers in every frame."""
    return np.stack([rot.rotate(world_rotations[:, markers[name][0]], markers[name][1]) for name in names], axis=1)
