"""SMPL-family archives made in code: models from the embedded human, and motions as AMASS and SMPL-X's tools write
them."""

from functools import cache

import numpy as np

from retarget.body import rotations as rot
from retarget.body.human import human, human_model
from retarget.body.kinematics import local_rotations, rest_pose
from retarget.body.skinning import prepare_skinning
from retarget.io.smpl_joints import CANONICAL, FAMILIES
from retarget.io.smpl_stand_in import stand_in

ROOT_OF = {"left_hand": "leftMiddleProximal", "right_hand": "rightMiddleProximal"}


@cache
def into_t(gender=0.5):
    """World rotations (52, 4) that bring the embedded human from its relaxed A into the stand-in's T, by its own
    names."""
    skeleton = human(gender=gender).skeleton
    t = stand_in(FAMILIES[52], {0.0: "female", 1.0: "male"}.get(gender), "SMPL").skeleton
    _, places = rest_pose(t)
    at = {CANONICAL[name]: place for name, place in zip(t.names, places)}
    turns = np.broadcast_to(rot.IDENTITY, (len(skeleton), 4)).copy()
    for joint, name in enumerate(skeleton.names):
        below = skeleton.children(joint)
        parent = skeleton.parents[joint]
        if name.endswith("Hand"):
            side = name.removesuffix("Hand")
            knuckles = [skeleton.index(side + finger + "Proximal") for finger in ("Middle", "Index", "Little")]
            own, wanted = skeleton.offsets[knuckles], np.array([at[skeleton.names[k]] - at[name] for k in knuckles])
            from_own, from_wanted = (rot.from_frame(each[0], each[1] - each[2]) for each in (own, wanted))
            turns[joint] = rot.multiply(from_wanted, rot.inverse(from_own))
        elif "Thumb" in name or not below and parent >= 0:
            turns[joint] = turns[parent]
        elif name not in ("hips", "upperChest") and len(below) == 1:
            bone = at[skeleton.names[below[0]]] - at[name]
            turns[joint] = rot.swing_between(rot.unit(skeleton.offsets[below[0]]), rot.unit(bone))
    return turns


@cache
def model_arrays(joints=52, shapes=10, gender=0.5, moved=(0.0, -1.1, 0.03)):
    """The embedded human in a T under SMPL's names, with a few broad shape directions; the arrays of a model file."""
    character, family = human(gender=gender), FAMILIES[joints]
    turns = into_t(gender)
    _, relaxed = rest_pose(character.skeleton)
    places = relaxed.copy()
    for joint, parent in enumerate(character.skeleton.parents):
        if parent >= 0:
            places[joint] = places[parent] + rot.rotate(turns[parent], character.skeleton.offsets[joint])
    template = prepare_skinning(character).vertices(turns[None], places[None])[0].astype(np.float64) + moved
    own = {canonical: name for name, canonical in CANONICAL.items()}
    names = [own[name] for name in character.skeleton.names]
    regressor, weights = np.zeros((joints, len(template))), np.zeros((len(template), joints))
    dense = np.zeros((len(template), 52))
    np.add.at(dense, (np.arange(len(template))[:, None], character.skin.columns), character.skin.weights)
    for joint, name in enumerate(names):
        to = name
        while to not in family.names:  # fingers of a body without them move with the hand
            to = family.joints.get(to) or FAMILIES[52].joints[to]
        weights[:, family.names.index(to)] += dense[:, joint]
        if name in family.names:
            regressor[family.names.index(name)] = human_model().shape.regressor[joint]
    for joint, name in enumerate(family.names):
        if name not in CANONICAL:
            like = {"jaw": "mouth", "left_eye_smplhf": "leftEye", "right_eye_smplhf": "rightEye"}.get(name)
            if like:
                regressor[joint, human_model().landmark(like)] = 1.0
            else:
                regressor[joint] = human_model().shape.regressor[character.skeleton.index(ROOT_OF[name])]
    random = np.random.default_rng(5)
    directions = np.zeros((len(template), 3, shapes))
    for shape in range(shapes):
        directions[:, :, shape] = 0.03 * template @ (np.eye(3) * (shape == 0) + 0.1 * random.normal(size=(3, 3)))
    table = np.array([[*family.parents], range(joints)])
    return {
        "v_template": template,
        "f": human_model().faces.astype(np.uint32),
        "J_regressor": regressor,
        "weights": weights,
        "kintree_table": np.where(table < 0, 4294967295, table).astype(np.uint32),
        "shapedirs": directions,
    }


def angles(frames, joints=52, **turns):
    """Rotations (frames, joints, 3), the named joints turned: by one vector, or one a frame."""
    values = np.zeros((frames, joints, 3))
    for name, turn in turns.items():
        values[:, FAMILIES[joints].names.index(name)] = turn
    return values


def z_up(frames, turn=0.0):
    """Root rotations that stand a body along +Z, turned about it (radians) afterwards."""
    stood = rot.from_rotation_vector(np.array([np.pi / 2, 0.0, 0.0]))
    about = rot.from_rotation_vector(np.broadcast_to([0.0, 0.0, turn], (frames, 3)))
    return rot.to_rotation_vector(rot.multiply(about, np.broadcast_to(stood, (frames, 4))))


def amass(path, poses, trans, fps=120.0, rate="mocap_framerate", gender="neutral", **more):
    """Write an archive with AMASS's keys."""
    arrays = {"poses": poses.reshape(len(poses), -1), "trans": trans, "gender": np.array(gender), rate: np.array(fps)}
    np.savez(path, **(arrays | {"betas": np.zeros(16)} | more))
    return path


def from_performance(motion, joints=52, gender=0.5):
    """SMPL's rotations (frames, joints, 3) and pelvis positions, +Y up, of a motion of the embedded human."""
    from retarget.body.kinematics import world_pose

    world, places = world_pose(motion)
    smpl = rot.multiply(world, rot.inverse(into_t(gender)))
    at = {name: joint for joint, name in enumerate(motion.skeleton.names)}
    family = FAMILIES[joints]
    chosen = np.broadcast_to(rot.IDENTITY, (len(motion), joints, 4)).copy()
    for joint, name in enumerate(family.names):
        chosen[:, joint] = smpl[:, at[CANONICAL[name]]] if name in CANONICAL else chosen[:, family.parents[joint]]
    local = local_rotations(np.array(family.parents), chosen)
    return rot.to_rotation_vector(local), places[:, 0]
