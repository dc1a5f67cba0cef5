"""The embedded motions: whole, smooth, on the floor, and with contacts that are closed on the skin."""

import sys
from pathlib import Path

import numpy as np
import pytest

from retarget.body.human import PRESETS, human_model
from retarget.body.kinematics import world_pose
from retarget.body.rotations import angle_between
from retarget.body.skinning import skin_motion
from retarget.errors import RetargetError
from retarget.motion import library
from retarget.motion.library import PERFORMER, embedded_contacts, embedded_motion, motion_names, performer

NAMES = (
    "demo", "walk", "run", "jump", "turn", "wave", "hands_on_hips", "hand_to_shoulder", "hand_on_belly", "hands_behind_head",
    "arms_crossed", "clap", "legs_crossed", "squat_hands_on_knees",
)  # fmt: skip
MOVING = {"demo", "walk", "run", "jump", "turn", "legs_crossed"}  # in the others both feet stay where they are
TOUCHES = {  # pairs of parts that each motion is named for
    "demo": {("leftHand", "pelvis"), ("rightHand", "pelvis"), ("leftHand", "chest")},
    "hands_on_hips": {("leftHand", "pelvis"), ("rightHand", "pelvis")},
    "hand_to_shoulder": {("leftHand", "chest")},
    "hand_on_belly": {("rightHand", "abdomen")},
    "hands_behind_head": {("leftHand", "head"), ("rightHand", "head")},
    "arms_crossed": {("leftHand", "rightUpperArm"), ("rightHand", "leftUpperArm")},
    "clap": {("leftHand", "rightHand")},
    "legs_crossed": {("rightThigh", "leftThigh")},
    "squat_hands_on_knees": {("leftHand", "leftThigh"), ("rightHand", "rightThigh")},
}
every_motion = pytest.mark.parametrize("name", NAMES)


@pytest.fixture(scope="module")
def surfaces():
    """Posed vertices of the performer by motion, made once."""
    made = {}

    def of(name):
        if name not in made:
            made[name] = skin_motion(performer(), embedded_motion(name)).astype(np.float64)
        return made[name]

    return of


def frames_of(contact):
    """Frames in which a contact is stated to be closed."""
    return np.arange(int(np.ceil(contact.start * 30 - 1e-3)), int(np.floor(contact.end * 30 + 1e-3)) + 1)


def sampled(vertices, faces, count=5):
    """Points spread over triangles: a stand-in for their surface, off by less than a seventh of an edge."""
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1))
    inside = (i + j) <= count
    mix = np.stack([i[inside], j[inside], count - i[inside] - j[inside]], axis=1) / count
    return np.einsum("mk,fkj->fmj", mix, vertices[faces]).reshape(-1, 3)


def winding(points, corners):
    """How often closed triangles go round each point: near one inside, near zero outside (van Oosterom, Strackee 1983)."""
    a, b, c = (corners[None, :, k] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    dot = lambda u, v: np.einsum("pfk,pfk->pf", u, v)  # noqa: E731
    low = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
    return np.arctan2(dot(a, np.cross(b, c)), low).sum(axis=1) / (2 * np.pi)


def limb_of(part):
    """All parts that move with one: an arm, or a leg."""
    for side in ("left", "right"):
        for limb in (("Hand", "Forearm", "UpperArm"), ("Foot", "Shin", "Thigh")):
            if part in [side + each for each in limb]:
                return [side + each for each in limb]
    raise AssertionError(part)


def test_the_library_holds_what_it_promises():
    assert motion_names() == NAMES
    assert PERFORMER in PRESETS
    assert library.FILE.stat().st_size < 1.5e6


def test_an_unknown_name_is_refused_with_the_nearest_one():
    for ask in (embedded_motion, embedded_contacts):
        with pytest.raises(RetargetError, match=r"motion 'wlak' .* nearest: 'walk'"):
            ask("wlak")


@every_motion
def test_motions_are_whole(name):
    motion = embedded_motion(name)
    assert motion.name == name and motion.fps == 30.0
    assert (6 if name == "demo" else 3) <= motion.seconds <= (8 if name == "demo" else 5)
    assert motion.skeleton.names == performer().skeleton.names
    with np.load(library.FILE) as archive:
        stored = archive[f"{name}/rotations"] / 32767.0
        assert tuple(archive["joint_names"]) == motion.skeleton.names
    np.testing.assert_allclose(np.linalg.norm(stored, axis=-1), 1.0, atol=1e-4)
    assert ((stored[1:] * stored[:-1]).sum(axis=-1) > 0.8).all()  # neighbours keep their sign


@every_motion
def test_motions_are_smooth(name):
    motion = embedded_motion(name)
    turned = angle_between(motion.rotations[1:], motion.rotations[:-1])
    assert np.degrees(turned.max()) < (32 if name in ("run", "jump") else 24), motion.skeleton.names[int(turned.max(axis=0).argmax())]
    positions = world_pose(motion)[1]
    acceleration = np.linalg.norm(np.diff(positions, 2, axis=0), axis=-1) * motion.fps**2
    limit = {"jump": 180, "run": 95, "walk": 55, "demo": 55, "turn": 55}.get(name, 30)  # m/s^2
    joint = int(acceleration.max(axis=0).argmax())
    assert acceleration.max() < limit, f"{motion.skeleton.names[joint]} in frame {acceleration[:, joint].argmax()}"


@every_motion
def test_motions_begin_and_end_in_a_stand(name):
    if name == "run":
        pytest.skip("a steady run begins and ends in its midst")
    positions = world_pose(embedded_motion(name))[1]
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=-1) * 30
    assert speed[0].max() < 0.12 and speed[-1].max() < 0.12
    legs = performer().skeleton.offsets
    height = -sum(legs[performer().skeleton.index(f"left{part}")][1] for part in ("UpperLeg", "LowerLeg", "Foot"))
    for frame in (0, -1):
        hips, foot = positions[frame, 0], positions[frame, performer().skeleton.index("leftFoot")]
        assert hips[1] - foot[1] > 0.96 * height


@every_motion
def test_soles_lie_on_the_floor_and_do_not_slide(name, surfaces):
    vertices, model = surfaces(name), human_model()
    assert vertices[..., 1].min() > -1e-3
    floors = [contact for contact in embedded_contacts(name) if contact.other == "floor"]
    assert {contact.part for contact in floors} == {"leftFoot", "rightFoot"}
    for contact in floors:
        sole = vertices[frames_of(contact)][:, model.part_vertices(contact.part)]
        np.testing.assert_allclose(sole[..., 1].min(axis=1), 0.0, atol=3e-4)
        down = sole[..., 1] < 1.5e-3
        both = down[1:] & down[:-1]
        moved = np.where(both, np.linalg.norm(np.diff(sole[..., [0, 2]], axis=0), axis=-1), np.nan)
        rests = np.nanmin(moved, axis=1)  # a rolling foot turns about the point of it that rests
        assert rests.max(initial=0.0) < (1e-3 if name == "run" else 4e-4), f"{contact} in frame {rests.argmax()}"
        if name not in MOVING:
            assert np.nanmax(moved) < 3e-4


@pytest.mark.parametrize("name", TOUCHES)
def test_contacts_are_closed_on_the_skin(name, surfaces):
    from scipy.spatial import cKDTree

    vertices, model = surfaces(name), human_model()
    contacts = [contact for contact in embedded_contacts(name) if contact.other != "floor"]
    assert {(contact.part, contact.other) for contact in contacts} == TOUCHES[name]
    assert len(contacts) == (3 if name in ("clap", "demo") else len(TOUCHES[name]))
    for contact in contacts:
        frames = frames_of(contact)
        assert len(frames) >= (2 if name == "clap" else 20)
        faces = model.faces[model.face_parts == model.part_names.index(contact.other)]
        mine = model.part_vertices(contact.part)
        for frame in frames[:: max(len(frames) // 6, 1)]:
            gap = cKDTree(sampled(vertices[frame], faces)).query(vertices[frame][mine])[0].min()
            assert gap < 4e-3, f"{contact} is open by {gap * 1e3:.1f} mm in frame {frame}"


@pytest.mark.parametrize("name", TOUCHES)
def test_touching_limbs_do_not_sink_in(name, surfaces):
    from scipy.spatial import cKDTree

    vertices, model = surfaces(name), human_model()
    for contact in embedded_contacts(name):
        if contact.other == "floor":
            continue
        own = limb_of(contact.part)
        apart = own + (["pelvis"] if contact.part.endswith("Thigh") else [])  # next to the limb: always at distance zero
        faces = model.faces[~np.isin(model.face_parts, [model.part_names.index(part) for part in apart])]
        limb = np.concatenate([model.part_vertices(part) for part in {*own[:2], contact.part}])[::2]
        frame = int(frames_of(contact).mean())
        points, surface = vertices[frame][limb], sampled(vertices[frame], faces, 4)
        distance = cKDTree(surface).query(points)[0]
        near = np.flatnonzero(distance < 0.02)
        inside = winding(points[near], vertices[frame][faces]) > 0.5
        depth = np.where(inside, distance[near], 0.0)
        assert depth.max() < 4e-3, f"{contact} sinks in by {depth.max() * 1e3:.1f} mm in frame {frame}"
        assert (depth > 1.5e-3).sum() < 0.02 * len(limb)


def test_the_tool_makes_what_the_file_holds(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[2] / "tools"))
    before = set(sys.modules)
    try:
        import build_motions

        made = build_motions.clip_arrays(build_motions.CLIPS["run"](build_motions.performer()))
    finally:
        for module in set(sys.modules) - before:
            if module.startswith(("motion_", "build_motions")):
                del sys.modules[module]
    with np.load(library.FILE) as archive:
        assert np.abs(made["run/rotations"].astype(int) - archive["run/rotations"]).max() <= 3  # of 32767
        np.testing.assert_allclose(made["run/hips"], archive["run/hips"], atol=1e-4)
