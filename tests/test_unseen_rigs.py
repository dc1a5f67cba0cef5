"""Bodies and motions in the conventions people's files have: the whole way from file to file shows the same performance."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_motions import actor, body, fingerless, poses
from rig_variants import (
    HERE,
    bound_in,
    on_roots,
    performed,
    renamed,
    rig_of,
    shown,
    with_axes,
    with_joint,
    with_more_spine,
    with_twists,
    without,
    without_matching,
    write_glb,
)

from retarget.body import rotations as rot
from retarget.body.kinematics import local_rotations, world_pose
from retarget.casting import cast
from retarget.character import Character, Motion
from retarget.contact.ground import ground_contacts
from retarget.evaluate.cases import arms_turned, in_other_rest_pose
from retarget.io import bvh
from retarget.motion.align import Similarity
from retarget.motion.library import embedded_motion, performer
from retarget.retargeting import prepare, retarget


def turn(*degrees):
    return rot.from_rotation_vector(np.radians(np.array(degrees, float)))


T_POSE, HANGING = arms_turned(-35.0), arms_turned(45.0)
STEP = {"leftUpperLeg": (-0.7, 0, 0), "leftLowerLeg": (0.9, 0, 0), "rightUpperArm": (-0.5, 0, 0.7), "hips": (0, 0.4, 0)}
FBX = [("Armature", (0, 0, 0), turn(-90, 0, 0), 0.01)]
UNREAL = {
    "UpperArm": "upperarm",
    "LowerArm": "lowerarm",
    "UpperLeg": "thigh",
    "LowerLeg": "calf",
    "Shoulder": "clavicle",
}
CHINESE = {"UpperArm": "上臂", "LowerArm": "前臂", "UpperLeg": "大腿", "LowerLeg": "小腿", "Hand": "手", "Foot": "脚"}


@cache
def plain():
    """The thin human without fingers and with fewer triangles: the same joints, quicker to read."""
    rig = rig_of(fingerless(performer()))
    return replace(rig, faces=rig.faces[::9])


def words(table, left, right):
    def name(joint):
        for side, mark in (("left", left), ("right", right)):
            if joint.startswith(side):
                return table.get(joint[len(side) :], joint[len(side) :]) + mark
        return joint

    return name


def child_mesh(maker, number):
    sword = {"POSITION": maker.accessor(np.array([[0, 0, 0], [0, 0, 1.2], [0.05, 0, 0.6]]))}
    mesh = maker.add("meshes", {"primitives": [{"attributes": sword}]})
    hand = maker.json["nodes"][number["rightHand"]]
    hand.setdefault("children", []).append(maker.add("nodes", {"name": "Sword", "mesh": mesh}))


def earlier_clip(maker, number):
    values = {"rotation": np.array([turn(0, 30, 0), turn(40, 0, 0)]), "translation": np.array([[0, 1, 0], [0, 1, 3]])}
    times, clip = maker.accessor(np.array([0.0, 1.0])), {"name": "earlier", "samplers": [], "channels": []}
    for sampler, (path, keys) in enumerate(values.items()):
        clip["samplers"].append({"input": times, "output": maker.accessor(keys)})
        clip["channels"].append({"sampler": sampler, "target": {"node": number["hips"], "path": path}})
    maker.add("animations", clip)


TARGETS = {
    # name: (the rig, how it is written)
    "centimetres under an FBX armature": lambda r: (with_axes(r, "blender"), {"above": FBX}),
    "centimetres throughout, z up": lambda r: (r, {"file": Similarity(turn(90, 0, 0), 100.0)}),
    "x up": lambda r: (r, {"file": Similarity(turn(0, 0, -90), 1.0)}),
    "moved and turned in its scene": lambda r: (r, {"above": [("Armature", (3, 1.5, 2), turn(0, 40, 0), 1.0)]}),
    "a stack of roots": lambda r: (
        on_roots(with_joint(r, "pelvis", None, r.places["hips"], between=["hips"]), "Armature", "root"),
        {"above": FBX},
    ),
    "nodes stand in a step": lambda r: (with_axes(on_roots(r, "root"), "blender"), {"pose": STEP, "above": FBX}),
    "random axes": lambda r: (with_axes(r, "random"), {}),
    "Unreal": lambda r: (with_axes(renamed(on_roots(r, "root"), words(UNREAL, "_l", "_r")), "unreal"), {}),
    "Chinese names": lambda r: (renamed(r, words(CHINESE, "左", "右")), {}),
    "twists on the path": lambda r: (with_twists(r, True), {}),
    "several skins, a sword": lambda r: (r, {"skins": 3, "extras": child_mesh}),
    "an earlier clip": lambda r: (r, {"extras": earlier_clip}),
}
CLOSE = {
    # Other joints or another pose of binding: creases and shares differ by millimetres.
    "bound in a T": (lambda r: (bound_in(r, T_POSE), {}), 6.0),
    "bound with arms hanging": (lambda r: (bound_in(r, HANGING), {}), 6.0),
    "twists beside": (lambda r: (with_twists(r, False), {}), 1.0),
    "one spine joint": (lambda r: (without(r, "chest", "upperChest"), {}), 6.0),
    "five spine joints": (lambda r: (with_more_spine(r), {}), 6.0),
    "no neck": (lambda r: (without(r, "neck"), {}), 6.0),
    "no clavicles, no toes": (lambda r: (without_matching(r, "Shoulder", "Toes"), {}), 8.0),
}


@pytest.mark.parametrize("name", [*TARGETS, *CLOSE])
def test_a_body_in_any_disguise_performs_the_same(name, tmp_path):
    make, tolerance = (TARGETS[name], 0.2) if name in TARGETS else CLOSE[name]
    rig, written = make(plain())
    path, out = tmp_path / "body.glb", tmp_path / "out.glb"
    write_glb(path, rig, **written)
    motion, source = fingerless(embedded_motion("demo")), fingerless(performer())
    prepare(cast(source), cast(path), "copy-rotations", foot_lock=False)(motion).save(out)
    frames = np.array([40, 170])
    seen = shown(out, rig, frames, motion.fps, written.get("file", HERE), skins=written.get("skins", 1))
    used = np.unique(rig.faces)
    gaps = np.linalg.norm(seen - performed(source, motion, frames), axis=-1)[:, used] * 1000
    assert gaps.mean() < tolerance, f"{gaps.mean():.2f} mm"


def at_rest_in(turns):
    turns = {name: np.asarray(turn, float) for name, turn in turns.items()}
    return lambda motion: replace(motion, skeleton=in_other_rest_pose(performer(), turns).skeleton)


SOURCES = {
    # name: (change of the motion, mean error in mm without and with foot lock)
    "inches, z up": (Similarity(turn(90, 0, 0), 1 / 0.0254).motion, 0.1, 5),
    "decimetres, x up": (Similarity(turn(0, 0, -90), 10.0).motion, 0.1, 5),
    "a T at rest": (at_rest_in(T_POSE), 0.2, 5),
    "arms hanging at rest": (at_rest_in(HANGING), 0.2, 5),
    "lying at rest": (at_rest_in({"hips": (-np.pi / 2, 0, 0)}), 15, 10),
    "lying on a side at rest": (at_rest_in({"hips": (0, 0, np.pi / 2)}), 15, 10),
    "a floor at -1 m": (lambda motion: replace(motion, translations=motion.translations - [0, 1, 0]), None, 5),
}


@pytest.mark.parametrize("name", SOURCES)
def test_a_motion_in_any_disguise_is_the_same_performance(name, tmp_path):
    change, free, held = SOURCES[name]
    motion, target = embedded_motion("walk"), performer()
    bvh.save(tmp_path / "walk.bvh", change(motion))
    _, expected = world_pose(motion)
    for lock, tolerance in ((False, free), (True, held)):
        if tolerance is not None:
            _, positions = world_pose(retarget(tmp_path / "walk.bvh", target, method="copy-rotations", foot_lock=lock).motion)
            assert np.linalg.norm(positions - expected, axis=-1).mean() * 1000 < tolerance


def test_legs_forward_at_rest_keep_the_feet(tmp_path):
    """A skeleton drawn sitting on the ground: its feet point up at rest, which is not how they stand."""
    motion = embedded_motion("walk")
    seated = at_rest_in({"leftUpperLeg": (-np.pi / 2, 0, 0), "rightUpperLeg": (-np.pi / 2, 0, 0)})(motion)
    bvh.save(tmp_path / "walk.bvh", seated)
    result = retarget(tmp_path / "walk.bvh", performer(), method="copy-rotations", foot_lock=False).motion
    foot = motion.skeleton.index("leftFoot")
    gap = rot.angle_between(world_pose(result)[0][:, foot], world_pose(motion)[0][:, foot])
    assert np.degrees(np.median(gap)) < 20


def crawl(frames=90, fps=30.0, way=0.8):
    """On hands and knees, slowly forward: trunk level, thighs and arms down, shins back."""
    skeleton, quarter = body().skeleton, np.array([np.pi / 2, 0, 0])
    turns = {"hips": quarter}
    for side in ("left", "right"):
        turns |= {f"{side}UpperLeg": -quarter, f"{side}UpperArm": -quarter}
        turns |= {f"{side}LowerLeg": quarter, f"{side}Foot": 0.8 * quarter}  # the instep lies on the floor
    hips = np.zeros((frames, 1, 3))
    hips[:, 0, 2] = np.linspace(0, way, frames)
    motion = Motion(skeleton, local_rotations(skeleton.parents, poses(frames, turns)), hips, fps, name="crawl")
    knee = world_pose(motion)[1][0, skeleton.index("leftLowerLeg"), 1]
    return replace(motion, translations=hips + [0, 0.05 - knee, 0])


def test_who_crawls_from_first_to_last_does_not_stand(tmp_path):
    bvh.save(tmp_path / "crawl.bvh", crawl())
    result = retarget(tmp_path / "crawl.bvh", performer(), method="copy-rotations", foot_lock=False)
    assert any("up axis +y" in note for note in result.stats["notes"])
    _, expected = world_pose(crawl())
    trunk = [result.motion.skeleton.index(name) for name in ("hips", "head")]
    found, wanted = (np.diff(places[:, trunk], axis=1) for places in (world_pose(result.motion)[1], expected))
    assert np.abs(found - wanted).max() < 0.05


@pytest.mark.parametrize("way", [0.0, 0.8])
def test_who_crawls_is_carried_by_the_knees(way):
    """Feet that lie behind tell little of the floor that the knees are on, nor do they set how high the body is."""
    source = cast(Character(body().skeleton))
    for preset in ("heavy", "child"):
        target = cast(actor(preset).character)
        result = prepare(source, target, "copy-rotations")(crawl(way=way))
        knee = world_pose(result.motion)[1][:, target.skeleton.index("leftLowerLeg"), 1]
        wanted = (0.05 - result.stats["source_floor_m"]) * result.stats["scale"]
        assert np.abs(knee - wanted).max() < 0.006
        assert 0.02 < wanted < 0.06, "the floor lies below the knees by their thickness"


def test_hands_without_fingers_do_not_lower_the_floor():
    """Where a palm is guessed it may go through the floor that the feet stand on; feet stay on it nevertheless."""
    points = np.zeros((120, 3, 3))
    points[:, 2, 1] = np.linspace(1.0, -0.1, 120).clip(-0.1)
    points[60:, 2, 1] = -0.1
    found = ground_contacts(points, 30.0, 0.9, feet=2)
    assert found.floor == 0.0 and found.touching[70:, 2].all() and (found.support == 0.0).all()
