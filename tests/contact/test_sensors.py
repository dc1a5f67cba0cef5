"""Sensors: equal coordinates mean equal places, whatever the body, its rest pose and its rig."""

from dataclasses import replace

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.body.human import PRESETS, human
from retarget.body.kinematics import rest_pose, still_motion, world_pose
from retarget.body.skinning import skin_motion
from retarget.character import Character, Mesh, Skeleton, Skin
from retarget.contact.sensor_bones import BONES, sensor_bones
from retarget.contact.sensors import (
    Layout,
    dense_layout,
    paper_layout,
    place_sensors,
    pose_sensors,
    prepare_sensor_skinning,
    surface_points,
)
from retarget.correspond.joints import match_humanoid
from retarget.errors import RetargetError


def sensed(character, layout=None):
    return place_sensors(character, match_humanoid(character.skeleton), layout)


def turned_at_rest(character, turns):
    """The same character with another rest pose: joints turned (rotation vectors), the mesh bound as before."""
    rotations = character.skeleton.rest_rotations.copy()
    for name, turn in turns.items():
        joint = character.skeleton.index(name)
        rotations[joint] = rot.multiply(rot.from_rotation_vector(np.array(turn)), rotations[joint])
    return replace(character, skeleton=replace(character.skeleton, rest_rotations=rotations))


T_POSE = {"leftUpperArm": (0, 0, 0.75), "rightUpperArm": (0, 0, -0.75), "leftHand": (-0.5, 0, 0), "leftLowerArm": (-0.5, 0, 0)}  # fmt: skip


@pytest.fixture(scope="module")
def body():
    return human(**PRESETS["muscular"])


@pytest.fixture(scope="module")
def sensors(body):
    return sensed(body)


def moving(character, frames=3, seed=0):
    still = still_motion(character.skeleton, frames)
    turns = 0.4 * np.random.default_rng(seed).normal(size=still.rotations.shape[:2] + (3,))
    return replace(still, rotations=rot.multiply(still.rotations, rot.from_rotation_vector(turns)))


def test_the_papers_layout_has_every_combination():
    layout = paper_layout()
    assert len(layout) == 288 and len(BONES) == 18
    assert set(layout.along) == {0.0, 0.25, 0.5, 0.75}
    assert np.allclose(sorted(set(layout.around)), [0, np.pi / 2, np.pi, 3 * np.pi / 2])
    assert len(np.unique(np.stack([layout.bones, layout.along, layout.around]), axis=1).T) == 288


@pytest.mark.parametrize("name", ["thin", "very_heavy", "child", "toddler"])
def test_most_rays_hit_and_clavicles_stay_near_the_shoulder(name):
    sensors = sensed(human(**PRESETS[name]))
    shoulder = np.isin(sensors.layout.bones, [BONES.index("leftShoulder"), BONES.index("rightShoulder")])
    assert sensors.valid[~shoulder].mean() > 0.95
    assert 0.5 < sensors.valid[shoulder].mean() < 0.9, "rays that leave a clavicle downwards run through the trunk"
    high = surface_points(sensors.stance.vertices, sensors.stance.faces, sensors.faces, sensors.barycentrics)[:, 1]
    chest = sensors.stance.joints["leftUpperLeg"][1] + 0.6 * (
        sensors.stance.joints["leftUpperArm"][1] - sensors.stance.joints["leftUpperLeg"][1]
    )
    assert high[shoulder & sensors.valid].min() > chest


def test_a_sensor_lies_on_its_ray(sensors):
    stance = sensors.stance
    corners = stance.vertices[stance.faces[sensors.faces]]
    places = np.einsum("sc,sci->si", sensors.barycentrics, corners)
    for number, (name, bone) in enumerate(sensor_bones(stance).items()):
        which = sensors.valid & (sensors.layout.bones == number)
        along = sensors.layout.along[which, None]
        away = places[which] - ((1 - along) * bone.parent + along * bone.child)
        axis, facing, other = bone.axes
        assert np.allclose(bone.axes @ bone.axes.T, np.eye(3))
        assert np.allclose(other, np.cross(facing, axis))
        around = np.arctan2(away @ other, away @ facing) % (2 * np.pi)
        assert np.allclose(away @ axis, 0, atol=1e-9), name
        assert np.allclose(np.exp(1j * around), np.exp(1j * sensors.layout.around[which])), name


def test_forward_is_where_the_body_faces_and_up_for_feet(sensors):
    bones = sensor_bones(sensors.stance)
    for name, bone in bones.items():
        reference = [0, 1, 0] if name.endswith("Foot") else [0, 0, 1]
        assert bone.axes[1] @ reference > 0.7, name


def test_a_sensor_sits_on_its_own_bones_mesh(sensors):
    for number, bone in enumerate(sensor_bones(sensors.stance).values()):
        which = sensors.valid & (sensors.layout.bones == number)
        assert (bone.weight[sensors.stance.faces[sensors.faces[which]]].mean(axis=1) > 0.1).all()


def test_frames_are_orthonormal_and_face_outwards(sensors, body):
    frames = sensors.frames[sensors.valid]
    assert np.allclose(np.swapaxes(frames, 1, 2) @ frames, np.eye(3))
    assert np.allclose(np.linalg.det(frames), 1)
    corners = body.mesh.vertices[body.mesh.faces[sensors.faces[sensors.valid]]]
    flat = rot.unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    assert (flat * frames[:, :, 2]).sum(axis=1).min() > 0.3  # smooth normals, so not the face's own


def test_what_misses_is_zero():
    sensors = sensed(human(**PRESETS["very_heavy"]))
    missed = ~sensors.valid
    assert missed.any()
    for field in ("positions", "frames", "barycentrics"):
        assert not getattr(sensors, field)[missed].any()


def test_the_rest_pose_does_not_move_sensors(body, sensors):
    other = sensed(turned_at_rest(body, T_POSE))
    both = sensors.valid & other.valid
    here, there = (
        np.einsum("sc,sci->si", each.barycentrics, body.mesh.vertices[body.mesh.faces[each.faces]])
        for each in (sensors, other)
    )
    away = np.linalg.norm(here - there, axis=1)[both] / sensors.stance.height
    assert both.mean() > 0.94 and away.mean() < 0.002 and np.percentile(away, 95) < 0.01


def test_size_and_the_order_of_vertices_do_not_matter(body, sensors):
    order = np.random.default_rng(3).permutation(len(body.mesh.vertices))
    back = np.argsort(order)
    skin, skeleton = body.skin, body.skeleton
    binds = skin.inverse_binds.copy()
    binds[:, :3, 3] *= 2
    ends = {joint: 2 * end for joint, end in skeleton.end_offsets.items()}
    shuffled = Character(
        replace(skeleton, offsets=2 * skeleton.offsets, end_offsets=ends),
        Mesh(2 * body.mesh.vertices[order], back[body.mesh.faces]),
        Skin(skin.joints, binds, skin.columns[order], skin.weights[order]),
    )
    other = sensed(shuffled)
    assert (other.valid == sensors.valid).mean() > 0.995
    assert np.median(np.abs(other.positions - 2 * sensors.positions)) < 1e-5
    assert (other.faces == sensors.faces).mean() > 0.98


def test_a_prop_gets_no_sensors(body):
    """A plate in front of the hand, in a slot of its own: a ray that would meet it goes on to the hand."""
    skeleton, mesh, skin = body.skeleton, body.mesh, body.skin
    hand = skeleton.index("leftHand")
    _, places = rest_pose(skeleton)
    grown = Skeleton(
        (*skeleton.names, "slot"),
        np.append(skeleton.parents, hand),
        np.concatenate([skeleton.offsets, [[0, -0.1, 0.0]]]),
        np.concatenate([skeleton.rest_rotations, [rot.IDENTITY]]),
        skeleton.end_offsets,
    )
    plate = places[hand] + np.array([[-0.3, -0.3, 0.2], [0.3, -0.3, 0.2], [0.3, 0.3, 0.2], [-0.3, 0.3, 0.2]])
    first, column = len(mesh.vertices), len(skin.joints)
    bind = np.eye(4)
    bind[:3, 3] = -(places[hand] + [0, -0.1, 0.0])
    armed = Character(
        grown,
        Mesh(np.concatenate([mesh.vertices, plate]), np.concatenate([mesh.faces, first + np.array([[0, 1, 2], [0, 2, 3]])])),
        Skin(
            np.append(skin.joints, len(skeleton)),
            np.concatenate([skin.inverse_binds, [bind]]),
            np.concatenate([skin.columns, np.full((4, 4), column)]),
            np.concatenate([skin.weights, np.tile([1.0, 0, 0, 0], (4, 1))]),
        ),
    )  # fmt: skip
    sensors, plain = sensed(armed), sensed(body)
    assert not sensors.stance.body[-2:].any() and sensors.stance.body[:-2].all()
    assert np.array_equal(sensors.faces, plain.faces)


def test_posed_sensors_stay_on_the_posed_surface(body):
    character = turned_at_rest(body, T_POSE)
    sensors, motion = sensed(character), moving(character)
    places, frames = pose_sensors(sensors, motion)
    surface = skin_motion(character, motion)[:, character.mesh.faces[sensors.faces]]
    assert np.allclose(places, np.einsum("sc,fsci->fsi", sensors.barycentrics, surface), atol=2e-6)
    shown = frames[:, sensors.valid]
    assert np.allclose(np.swapaxes(shown, 2, 3) @ shown, np.eye(3), atol=1e-5)
    assert np.allclose(np.linalg.det(shown), 1, atol=1e-5)
    assert not places[:, ~sensors.valid].any() and not frames[:, ~sensors.valid].any()


def test_at_rest_posed_sensors_are_where_they_were_placed(body):
    character = turned_at_rest(body, T_POSE)
    sensors = sensed(character)
    places, frames = pose_sensors(sensors, still_motion(character.skeleton))
    assert np.allclose(places[0], sensors.positions, atol=2e-6)
    assert np.allclose(frames[0], sensors.frames, atol=1e-4)


def test_turning_the_world_turns_sensors(body, sensors):
    motion, turn = moving(body), rot.from_rotation_vector(np.array([0.3, -1.0, 0.5]))
    rotations, places = world_pose(motion)
    skinner = prepare_sensor_skinning(sensors)
    here = skinner.pose(rotations, places)
    there = skinner.pose(rot.multiply(turn, rotations), rot.rotate(turn, places))
    matrix = rot.to_matrix(turn)
    assert np.allclose(there[0], here[0] @ matrix.T, atol=1e-5)
    assert np.allclose(there[1], matrix @ here[1], atol=1e-5)


def test_dense_layouts_cover_the_whole_body():
    for count in (1000, 4675, 12000):
        assert abs(len(dense_layout(count)) / count - 1) < 0.1
    sensors = sensed(human(**PRESETS["heavy"]), dense_layout())
    places, surface = sensors.positions[sensors.valid], sensors.stance.rest
    nearest = np.min([np.linalg.norm(surface[::5] - place, axis=1) for place in places], axis=0)
    assert np.percentile(nearest, 99) < 0.025 * sensors.stance.height
    assert nearest.max() < 0.05 * sensors.stance.height


def test_a_robot_of_few_faces_is_sensed(data):
    from retarget.casting import cast

    actor = cast(data / "characters/kaykit/Knight.glb")
    sensors = place_sensors(actor.character, actor.humanoid)
    assert sensors.valid.mean() > 0.95
    assert 1000 < (~sensors.stance.body).sum() < 4000  # sword, shields


def test_mistakes_are_named(body):
    humanoid = match_humanoid(body.skeleton)
    with pytest.raises(RetargetError, match="no skin"):
        place_sensors(Character(body.skeleton), humanoid)
    without = {name: joint for name, joint in humanoid.joints.items() if name != "leftHand"}
    with pytest.raises(RetargetError, match="leftHand"):
        place_sensors(body, replace(humanoid, joints=without))
    with pytest.raises(RetargetError, match="500 to 100000"):
        dense_layout(10)
    with pytest.raises(RetargetError, match="at least one place"):
        paper_layout(0)
    with pytest.raises(RetargetError, match="from 0 to 17"):
        Layout(np.array([18]), np.zeros(1), np.zeros(1))
    with pytest.raises(RetargetError, match="within"):
        Layout(np.array([0]), np.array([3.0]), np.zeros(1))
