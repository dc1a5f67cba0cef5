"""Motions made in code for the tests: a walk whose feet stand, and ways to change bodies and motions without changing what is seen."""

from dataclasses import replace
from functools import cache

import numpy as np

from retarget.body import rotations as rot
from retarget.body.human import PRESETS, human
from retarget.body.kinematics import forward, local_rotations, rest_pose
from retarget.casting import Hints, cast
from retarget.character import Character, Motion, Skeleton, Skin
from retarget.contact.support import descendants
from retarget.motion.align import Similarity
from retarget.motion.ik import two_bone
from retarget.retargeting import prepare

UP = np.array([0.0, 1.0, 0.0])


@cache
def body(preset="thin"):
    """The embedded human; its joints carry canonical names."""
    return human(**PRESETS[preset])


@cache
def actor(preset="thin"):
    """The embedded human, ready for a method."""
    return cast_by_names(body(preset))


def cast_by_names(character, names=None):
    """Cast with the joints named by hand, so that matching has no part in what is tested."""
    names = names or {name: name for name in body().skeleton.names}
    return cast(character, Hints(joints=names))


@cache
def prepared(source, target, method):
    """A pair of bodies, prepared once for all tests that want it."""
    return prepare(source, target, method)


def fingerless(thing):
    """A character or motion on the embedded human's 22 joints of the body, which come first: quicker to match."""
    skeleton = thing.skeleton
    assert skeleton.names[22] == "leftThumbMetacarpal"
    ends = {joint: end for joint, end in skeleton.end_offsets.items() if joint < 22}
    fewer = Skeleton(
        skeleton.names[:22], skeleton.parents[:22], skeleton.offsets[:22], skeleton.rest_rotations[:22], ends
    )
    if isinstance(thing, Motion):
        return replace(thing, skeleton=fewer, rotations=thing.rotations[:, :22])
    hands = [skeleton.index("leftHand" if name.startswith("left") else "rightHand") for name in skeleton.names]
    columns = np.where(
        thing.skin.columns < 22, thing.skin.columns, np.array(hands)[thing.skin.columns]
    )  # one a joint here
    skin = Skin(thing.skin.joints[:22], thing.skin.inverse_binds[:22], columns, thing.skin.weights)
    return replace(thing, skeleton=fewer, skin=skin)


def ramp(frames, start, stop):
    """0 before `start`, 1 after `stop`, smooth between."""
    t = np.clip((np.arange(frames) - start) / (stop - start), 0, 1)
    return t * t * t * (t * (6 * t - 15) + 10)


def poses(frames, turns):
    """World rotations of the embedded human: named joints turned by rotation vectors, all below them along."""
    skeleton = body().skeleton
    world = np.broadcast_to(rot.IDENTITY, (frames, len(skeleton), 4)).copy()
    for name in skeleton.names:  # parents come first
        if name in turns:
            turn = rot.from_rotation_vector(np.broadcast_to(turns[name], (frames, 3)))
            below = descendants(skeleton, skeleton.index(name))
            world[:, below] = rot.multiply(turn[:, None], world[:, below])
    return world


def with_feet_at(world, hips, ankles, fps, name):
    """A motion of the embedded human: `ankles` are reached by the legs, feet stay level and face forward."""
    skeleton = body().skeleton
    offsets = np.broadcast_to(skeleton.offsets, (len(hips), len(skeleton), 3)).copy()
    offsets[:, 0] = hips
    _, at = forward(skeleton.parents, local_rotations(skeleton.parents, world), offsets)
    for side, goal in zip(("left", "right"), ankles):
        top, middle, end = (skeleton.index(side + part) for part in ("UpperLeg", "LowerLeg", "Foot"))
        pole = np.broadcast_to([0.0, 0.0, 1.0], goal.shape)
        upper, lower = two_bone(at[:, top], at[:, middle], at[:, end], goal, pole)
        world[:, top], world[:, middle] = rot.multiply(upper, world[:, top]), rot.multiply(lower, world[:, middle])
        world[:, descendants(skeleton, end)] = rot.IDENTITY
    return Motion(skeleton, local_rotations(skeleton.parents, world), hips[:, None], fps, name=name)


@cache
def walk(fps=30.0, steps=4, stride=0.35, climb=0.0):
    """A walk forward: feet stand still while they stand, arms swing, the trunk turns. Each step climbs by `climb` metres."""
    skeleton = body().skeleton
    _, rest = rest_pose(skeleton)
    wait, step = int(0.5 * fps), int(0.5 * fps)
    frames = 2 * wait + steps * step
    left, right = (np.tile(rest[skeleton.index(side + "Foot")], (frames, 1)) for side in ("left", "right"))
    for number in range(steps):
        foot, start = (left, right)[number % 2], wait + number * step
        size = stride if number in (0, steps - 1) else 2 * stride
        went = ramp(frames, start, start + 0.8 * step)
        rise = climb * (1 if number in (0, steps - 1) else 2)
        foot[:, 2] += size * went
        foot[:, 1] += rise * ramp(frames, start, start + 0.5 * step) + 0.1 * np.sin(np.pi * went)
    hips = rest[0] + 0.5 * (left + right - left[0] - right[0]) - 0.10 * UP
    hips[:, 0] += 0.02 * np.sin(np.arange(frames) / frames * 8)
    swing = 0.5 * np.sin(np.arange(frames)[:, None] / step * np.pi) * ramp(frames, 0, wait)[:, None]
    turns = {
        "spine": swing * [0, 0.15, 0.05],
        "chest": swing * [0.1, -0.3, 0],
        "head": swing * [0.2, 0.4, 0],
        "leftUpperArm": [0.2, 0, -0.6] + swing * [1, 0, 0],
        "rightUpperArm": [0, 0, 0.5] + swing * [-1, 0.1, 0],
        "leftLowerArm": [-0.4, -0.3, 0] + swing * [0.3, 0, 0],
        "rightLowerArm": [-0.3, 0.2, 0.1],
        "leftHand": swing * [0.3, 0.5, 0],
        "rightIndexProximal": [0.3, 0, 0.4],
    }
    return with_feet_at(poses(frames, turns), hips, (left, right), fps, "walk")


@cache
def stand(fps=30.0, frames=45):
    """Standing still on both feet while the hips sway and sink and the arms wave."""
    skeleton = body().skeleton
    _, rest = rest_pose(skeleton)
    t = np.arange(frames)[:, None] / frames
    hips = rest[0] + np.sin(2 * np.pi * t) * [0.03, 0, 0.02] - 0.08 * UP * (1 + 0.5 * np.sin(2 * np.pi * t - 1))
    turns = {
        "leftUpperArm": np.sin(6 * t) * [0.3, 0, 1.0],
        "rightLowerArm": np.sin(5 * t) * [-0.8, 0.2, 0],
        "spine": np.sin(4 * t) * [0.1, 0.2, 0],
    }
    ankles = [np.tile(rest[skeleton.index(side + "Foot")], (frames, 1)) for side in ("left", "right")]
    return with_feet_at(poses(frames, turns), hips, ankles, fps, "stand")


def turned(motion, angle):
    """The motion in a world turned about the vertical."""
    turn = Similarity(rot.from_rotation_vector(angle * UP), 1.0)
    return replace(motion, rotations=turn.motion(motion).rotations, translations=turn.motion(motion).translations)


def scaled(thing, factor):
    """A character or a motion at another size."""
    similarity = Similarity(rot.IDENTITY, factor)
    return similarity.character(thing) if isinstance(thing, Character) else similarity.motion(thing)


def mirrored(motion):
    """The motion of the embedded human seen in a mirror across x = 0: sides change places."""
    names = motion.skeleton.names
    swap = {"left": "right", "right": "left"}
    other = [names.index(next((swap[s] + name[len(s) :] for s in swap if name.startswith(s)), name)) for name in names]
    return replace(
        motion,
        rotations=motion.rotations[:, other] * [1, -1, -1, 1],
        translations=motion.translations * [-1, 1, 1],
    )


def in_other_order(character, seed, rename=lambda name: name):
    """The same body with its joints listed in another order (parents still first) and under other names; returns it and
    the old index of each new joint."""
    skeleton, rng = character.skeleton, np.random.default_rng(seed)
    order, ready = [], [0]
    while ready:
        joint = ready.pop(rng.integers(len(ready)))
        order.append(joint)
        ready += skeleton.children(joint)
    new = np.argsort(order)  # new index of each old joint
    parents = np.array([-1 if skeleton.parents[joint] < 0 else new[skeleton.parents[joint]] for joint in order])
    ends = {int(new[joint]): end for joint, end in (skeleton.end_offsets or {}).items()}
    listed = Skeleton(
        tuple(rename(skeleton.names[joint]) for joint in order),
        parents,
        skeleton.offsets[order],
        skeleton.rest_rotations[order],
        ends,
    )
    return replace(character, skeleton=listed, skin=replace(character.skin, joints=new[character.skin.joints])), order


def with_vertices_permuted(character, seed):
    """The same surface with its vertices listed in another order; returns it and the old index of each new vertex."""
    order = np.random.default_rng(seed).permutation(len(character.mesh.vertices))
    new = np.argsort(order)
    mesh = replace(character.mesh, vertices=character.mesh.vertices[order], faces=new[character.mesh.faces])
    skin = Skin(
        character.skin.joints,
        character.skin.inverse_binds,
        character.skin.columns[order],
        character.skin.weights[order],
    )
    return replace(character, mesh=mesh, skin=skin), order
