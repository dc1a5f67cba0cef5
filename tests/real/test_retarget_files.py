"""Every real motion onto two characters: a game figure with a big head and the heavy embedded human."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from made_motions import actor

from retarget.body.kinematics import world_pose
from retarget.casting import cast
from retarget.contact.ground import ground_contacts
from retarget.contact.support import leg_length, support_limbs, support_points
from retarget.evaluate.cases import limb_directions
from retarget.evaluate.metrics import angle_error_degrees, foot_slide_cm
from retarget.io import load
from retarget.motion.filter import cut, resample
from retarget.retargeting import prepare

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
SECONDS, FPS = 6.0, 30.0
CLIPS_OF_A_FILE = 25
"""Of files with dozens of clips every so manieth is taken."""

pytestmark = pytest.mark.slow


def motion_files():
    if not DATA.is_dir():
        return []
    return sorted(path for path in DATA.rglob("*") if path.suffix in (".bvh", ".glb", ".gltf"))


@cache
def target(name):
    return actor("heavy") if name == "heavy" else cast(load(DATA / "characters/kaykit/Knight.glb"))


def feet(person, motion):
    limbs = support_limbs(person.character, person.humanoid)[:2]
    return np.concatenate(support_points(limbs, *world_pose(motion)), axis=1)


def measure(source, motion, person):
    """Bounds, direction error with nothing held, mean slide with feet held (cm at 1.7 m)."""
    free = prepare(source, person, "copy-rotations", foot_lock=False, limits=False, steady=False).retargeter(motion).motion
    directions = [limb_directions(each, world_pose(moving)[1]) for each, moving in ((source, motion), (person, free))]
    assert angle_error_degrees(*directions).max() < 0.1
    held = prepare(source, person, "copy-rotations").retargeter(motion)
    _, places = world_pose(held.motion)
    assert np.isfinite(places).all() and np.isfinite(held.motion.rotations).all()
    joints = list(person.humanoid.joints.values())
    from_hips = np.linalg.norm(places[:, joints] - places[:, person.humanoid.joints["hips"], None], axis=-1)
    assert from_hips.max() < 1.2 * person.height, "no joint flies off"
    assert places[:, joints, 1].min() > -0.3 * person.height + min(
        0.0, source_lowest(source, motion) * held.stats["scale"]
    )
    touching = ground_contacts(feet(source, motion), motion.fps, leg_length(source.skeleton, source.humanoid)).touching
    slides = foot_slide_cm(feet(person, held.motion), touching, person.height)
    assert not len(slides) or slides.mean() < 1.0
    return held


def source_lowest(source, motion):
    return float(world_pose(motion)[1][..., 1].min())


@pytest.mark.parametrize("path", motion_files(), ids=lambda path: f"{path.parent.name}/{path.name}")
def test_every_motion_onto_two_characters(data, path):
    asset = load(path)
    for number in range(0, len(asset.clips), CLIPS_OF_A_FILE):
        motion = asset.motion(number)
        source = cast(asset, motion=motion)
        motion = resample(cut(motion, None, min(SECONDS, motion.seconds)), min(FPS, motion.fps))
        for name in ("Knight", "heavy"):
            measure(source, source.house_from_file.motion(motion), target(name))


def test_lying_stays_lying(data):
    """Clips that lie or push up from first to last are no sign that their file has another up axis."""
    asset = load(data / "characters/kaykit/Knight.glb")
    motion = asset.motion("Lie_Idle")
    source = cast(asset, motion=motion)
    held = measure(source, source.house_from_file.motion(motion), target("heavy"))
    _, places = world_pose(held.motion)
    assert np.ptp(places[0, :, 1]) < 0.5 * target("heavy").height


def test_one_performance_on_two_skeletons_looks_alike(data):
    results = []
    for kind in ("cmu_daz", "cmu_cgspeed"):
        asset = load(data / "motions" / kind / "01_01.bvh")
        motion = asset.motion()
        source = cast(asset, motion=motion)
        clip = source.house_from_file.motion(resample(cut(motion, 0.0, 8.0), FPS))
        results.append(prepare(source, actor("heavy"), "copy-rotations").retargeter(clip).motion)
    (_, first), (_, second) = (world_pose(motion) for motion in results)
    names = ("rightHand", *(f"{side}{part}" for side in ("left", "right") for part in ("LowerArm", "LowerLeg", "Foot")))
    body = [actor("heavy").humanoid.joints[name] for name in names]  # the first file bends its left elbow the wrong way
    from_hips = [places[15:, body] - places[15:, :1] for places in (first, second)]  # one file begins with a T-pose
    assert np.linalg.norm(from_hips[0] - from_hips[1], axis=-1).mean() < 0.08
