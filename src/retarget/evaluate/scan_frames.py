"""Single clouds of unseen bodies in unseen poses: what the regressor says of a skeleton, and the skinning field of weights."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.human import human_model
from retarget.body.kinematics import forward
from retarget.body.skinning import prepare_skinning
from retarget.character import Character, Mesh
from retarget.errors import RetargetError
from retarget.evaluate.scan_cases import POINTS, performed_by, unseen_body
from retarget.evaluate.scan_split import BODY_SEEDS, EMBEDDED, TEST
from retarget.geometry.capture import Scanner, scan
from retarget.geometry.sampling import sample_surface
from retarget.methods.scan.regressor import load_regressor
from retarget.methods.scan.scan_body import BODY, scan_body
from retarget.methods.scan.skinning_field import load_field
from retarget.methods.scan.tracker import Tracker
from retarget.motion.library import embedded_motion
from retarget.rig.rigging import rig

Array = np.ndarray

WHOLE, HALF_VIEW, FEW_POINTS = "whole", "half view", "500 points"
"""`POINTS` points of all of the skin; one noisy depth camera; 500 points of all of the skin."""
CAMERA = Scanner(cameras=1, points=POINTS, noise=0.005)
FEW = 500
REFUSED = 0.5
"""Metres of error that a refusal counts as."""
LIFTS = {"": 40.0, "_arms_down": -38.0}
"""Degrees that arms are lifted from the embedded human's rest pose: T poses, and arms at the side."""
BODIES = 12
"""On which weights are judged; in the quick run 2."""
PER_BODY = 2


def regressor_errors(kind: str, count: int) -> list[float]:
    """Mean distance of the regressor's 22 joints from the true ones in each of so many clouds, metres; of one look at one cloud,
    nothing fitted."""
    regressor, found = load_regressor(), []
    for number in range(count):
        cloud, joints = single_cloud(kind, number)
        try:
            found.append(float(np.linalg.norm(regressor(cloud).places - joints, axis=1).mean()))
        except RetargetError:
            found.append(REFUSED)
    return found


def fitted_errors(kind: str, count: int) -> list[float]:
    """The same of the body that is fitted to each cloud by itself, from the regressor's guess; nobody found is a refusal."""
    found = []
    for number in range(count):
        cloud, truth = single_cloud(kind, number)
        fitted = fitted_joints(cloud)
        found.append(REFUSED if fitted is None else float(np.linalg.norm(fitted[0] - truth, axis=1).mean()))
    return found


def fitted_joints(cloud: Float[Array, "points 3"]) -> tuple[Float[Array, "body 3"], Float[Array, "body 4"]] | None:
    """Joints (metres) and world rotations of the body that is fitted to a single cloud; nothing where nobody is found."""
    body, seen = scan_body(), Tracker(load_regressor()).step(cloud)
    if seen.pose is None:
        return None
    rest, joints = body.rest_joints(seen.shape), np.empty((BODY, 3))
    joints[0] = seen.state.root
    for joint in range(1, BODY):
        above = body.parents[joint]
        joints[joint] = joints[above] + seen.state.turns[above] @ (rest[joint] - rest[above])
    return joints, rot.from_matrix(seen.state.turns)


def single_cloud(kind: str, number: int) -> tuple[Float[Array, "points 3"], Float[Array, "joints 3"]]:
    """A cloud and the true joints in it (metres): a body of the test set, a moment of a motion of the test set, any facing."""
    seeds = BODY_SEEDS[TEST]
    draw = np.random.default_rng([number, 2302])
    body = unseen_body(seeds[number % len(seeds)])
    motion = performed_by(body, embedded_motion(EMBEDDED[TEST][number % len(EMBEDDED[TEST])]))
    frame = int(draw.integers(len(motion)))
    yaw = rot.from_rotation_vector(np.array([0.0, draw.uniform(-np.pi, np.pi), 0.0]))
    rotations = motion.rotations[frame].copy()
    rotations[0] = rot.multiply(yaw, rotations[0])
    vertices, joints = posed(body, rotations, rot.rotate(yaw, motion.translations[frame, 0]))
    if kind == HALF_VIEW:
        return scan(vertices, body.mesh.faces, CAMERA, number), joints
    return sample_surface(vertices, body.mesh.faces, FEW if kind == FEW_POINTS else POINTS, number), joints


def posed(
    body: Character, rotations: Float[Array, "joints 4"], root: Float[Array, "3"]
) -> tuple[Float[Array, "vertices 3"], Float[Array, "body 3"]]:
    """Skin and body joints (metres) of an embedded human in a pose."""
    skeleton = body.skeleton
    places = np.concatenate([root[None], skeleton.offsets[1:]])
    world, joints = forward(skeleton.parents, rotations[None], places[None])
    return prepare_skinning(body).vertices(world, joints)[0].astype(np.float64), joints[0, :BODY]


def skinning_errors(quick: bool) -> dict[str, float]:
    """Mean squared error of weights over points and 22 joints: the field with the regressor's joints and with true ones, and rig
    transfer of the same surface, in T poses and with arms down. What rig transfer refuses is left out and counted."""
    found: dict[str, float] = {}
    for suffix, lift in LIFTS.items():
        rows: dict[str, list[float]] = {"skin_weight_mse": [], "skin_weight_mse_true_joints": [], "skin_weight_mse_rig": []}
        for seed in BODY_SEEDS[TEST][: 2 if quick else BODIES]:
            body = unseen_body(seed)
            vertices, joints, turns = resting(body, lift)
            truth = body_weights(body)
            cloud = sample_surface(vertices, body.mesh.faces, POINTS, seed)
            seen = load_regressor()(cloud)
            for key, places, turned in (
                ("skin_weight_mse", seen.places, seen.turns), ("skin_weight_mse_true_joints", joints, turns),
            ):  # fmt: skip
                rows[key].append(float(((load_field()(vertices, places, turned, cloud) - truth) ** 2).mean()))
            if not quick:
                rows["skin_weight_mse_rig"] += _by_rig(Mesh(vertices, body.mesh.faces), truth)
        found |= {f"{key}{suffix}": float(np.mean(values)) for key, values in rows.items() if values}
    return found


def _by_rig(mesh: Mesh, truth: Float[Array, "vertices joints"]) -> list[float]:
    try:
        return [float(((body_weights(rig(mesh).character) - truth) ** 2).mean())]
    except RetargetError:
        return []


def resting(body: Character, lift: float) -> tuple[Array, Array, Array]:
    """Skin, joints (metres) and world rotations of a body that stands with its arms lifted by so many degrees."""
    names = list(human_model().joint_names)
    rotations = np.tile(rot.IDENTITY, (len(names), 1))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        rotations[names.index(f"{side}UpperArm")] = rot.from_rotation_vector(np.radians([0.0, 0.0, sign * lift]))
    skeleton = body.skeleton
    turns = forward(skeleton.parents, rotations[None], skeleton.offsets[None])[0][0, :BODY]
    return *posed(body, rotations, skeleton.offsets[0]), turns


@lru_cache(maxsize=1)
def _to_body() -> Float[Array, "joints body"]:
    """Fingers go with their hands."""
    parents = human_model().parents
    shares = np.zeros((len(parents), BODY))
    for joint in range(len(parents)):
        above = joint
        while above >= BODY:
            above = parents[above]
        shares[joint, above] = 1.0
    return shares


def body_weights(character: Character) -> Float[Array, "vertices body"]:
    """Skinning weights of an embedded rig by its 22 body joints."""
    skin = character.skin
    weights = np.zeros((len(skin.weights), len(character.skeleton)))
    np.add.at(weights, (np.arange(len(weights))[:, None], skin.joints[skin.columns]), skin.weights)
    return weights @ _to_body()
