"""Bare meshes come out rigged: in any pose, size, place, order of vertices; and what is no body is refused."""

from dataclasses import replace

import numpy as np
import pytest
from rig_bodies import capsules, case, figurine, mapped, rigged

from retarget.body import rotations as rot
from retarget.body.human import human, human_model, textured
from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices
from retarget.character import Mesh, PointCloud
from retarget.errors import RetargetError
from retarget.rig.rigging import rig
from retarget.rig.template import MAIN
from retarget.rig.templates import human_template

CLEAN, DRESSED = 6, 14
"""Seeds of cases that may be looked at: arms crossed; shoes, skirt and hat. Noise is gated by `retarget bench rig-transfer`."""


def joint_errors(seed, found):
    """Of the body's joints, in cm at 1.7 m."""
    truth = case(seed)
    order = [human_model().joint_names.index(name) for name in MAIN]
    return np.linalg.norm(found.joints[: len(MAIN)] - truth.joints[order], axis=1) / truth.height * 170


@pytest.mark.parametrize("seed", [CLEAN, DRESSED])
def test_joints_and_weights_are_found(seed):
    found, truth = rigged(seed), case(seed)
    errors = joint_errors(seed, found)
    assert errors.mean() < 1.0 and errors.max() < 4.0
    assert found.confidence > 0.8
    template = human_template()
    weights = np.zeros((len(truth.mesh.vertices), len(template.skeleton)))
    skin = found.character.skin
    np.add.at(weights, (np.arange(len(weights))[:, None], skin.columns), skin.weights)
    true = truth.places.of(template.weights)
    assert 100 * ((weights - true)[truth.body] ** 2).mean() < 0.2


@pytest.mark.parametrize("seed", [CLEAN, DRESSED])
def test_the_rest_pose_is_the_templates(seed):
    found, truth = rigged(seed), case(seed)
    turns, _ = rest_pose(found.character.skeleton)
    assert np.allclose(turns, rest_pose(human().skeleton)[0])
    mine = found.character.mesh.vertices[truth.body] * (
        truth.height / truth.scale / np.ptp(found.character.mesh.vertices[:, 1])
    )
    true = truth.places.of(truth.character.mesh.vertices)[truth.body]
    away = np.linalg.norm(mine - mine.mean(axis=0) - true + true.mean(axis=0), axis=1)
    assert away.mean() < 0.03
    assert found.character.mesh.vertices[:, 1].min() == pytest.approx(0, abs=1e-9)


def test_what_came_in_stays():
    truth, found = case(DRESSED), rigged(DRESSED)
    assert np.array_equal(found.character.mesh.faces, truth.mesh.faces)
    assert len(found.character.mesh.vertices) == len(truth.mesh.vertices)
    skin = found.character.skin
    assert skin.columns.shape[1] <= 4 and np.allclose(skin.weights.sum(axis=1), 1)
    assert np.allclose(rest_vertices(found.character), found.character.mesh.vertices, atol=1e-5)


def test_turned_moved_and_scaled_it_is_the_same():
    truth, first = case(CLEAN), rigged(CLEAN)
    turn = rot.from_rotation_vector(np.array([0.7, -1.1, 0.4]))
    moved = replace(truth.mesh, vertices=rot.rotate(turn, truth.mesh.vertices) * 40 + [5.0, -3, 8])
    second = rig(moved, unit=first.unit / 40)
    away = np.linalg.norm(second.character.mesh.vertices - first.character.mesh.vertices, axis=1)
    assert away.mean() < 0.005 and np.percentile(away, 90) < 0.01  # surfaces are decimated otherwise when turned
    body = slice(len(MAIN))
    assert np.allclose(second.joints[body], rot.rotate(turn, first.joints[body]) * 40 + [5.0, -3, 8], atol=0.4)


def test_order_of_vertices_sense_of_faces_and_a_stray_triangle_do_not_matter():
    mesh, first = case(CLEAN).mesh, rigged(CLEAN)
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    inwards = np.argsort(order)[mesh.faces[:, ::-1]]
    far = mesh.vertices.max(axis=0) + 30 * np.ptp(mesh.vertices) + np.eye(3) * 0.01 * np.ptp(mesh.vertices)
    faces = np.concatenate([inwards, [len(order) + np.arange(3)]])
    second = rig(Mesh(np.concatenate([mesh.vertices[order], far]), faces))
    found = second.character.mesh
    assert np.abs(found.vertices[: len(order)] - first.character.mesh.vertices[order]).max() < 0.02
    assert np.array_equal(found.faces, faces)
    assert second.confidence > 0.8 and joint_errors(CLEAN, second).mean() < 1.0


def test_the_same_twice_and_looks_stay():
    mesh, first = case(CLEAN).mesh, rigged(CLEAN)
    uvs = np.random.default_rng(0).random((len(mesh.vertices), 2))
    looks = replace(mesh, uvs=uvs, materials=textured(human()).mesh.materials)
    again = rig(looks)
    assert np.array_equal(again.character.mesh.vertices, first.character.mesh.vertices)
    assert np.array_equal(again.character.skin.weights, first.character.skin.weights)
    assert np.array_equal(again.character.mesh.uvs, uvs)
    assert again.character.mesh.materials == looks.materials != first.character.mesh.materials


def test_a_given_map_is_followed():
    assert joint_errors(CLEAN, mapped(CLEAN)).mean() < 0.8


def test_a_map_of_another_mesh_is_refused():
    with pytest.raises(RetargetError, match="the surface map is of"):
        rig(case(CLEAN).mesh, surface_map=case(DRESSED).places)


def test_a_figurine_is_a_body():
    found = rig(figurine())
    head = found.joints[MAIN.index("head")]
    assert head[1] > 1.2 and found.joints[MAIN.index("leftHand")][0] > 0.4


def test_landmarks_decide_what_is_in_doubt():
    """A figure without feet or face has no front; two landmarks say which."""
    legs = [((0.1 * side, 0.9, 0), (0.12 * side, 0.06, 0), 0.07) for side in (-1, 1)]
    arms = [((0.15 * side, 1.38, 0), (0.7 * side, 1.38, 0), 0.05) for side in (-1, 1)]
    mesh = capsules(((0, 0.9, 0), (0, 1.4, 0), 0.1), ((0, 1.5, 0), (0, 1.65, 0), 0.11), *legs, *arms)
    with pytest.raises(RetargetError, match=r"no body was found with certainty in .* --landmarks head="):
        rig(mesh)
    for side in (1, -1):
        hands = {"leftHand": np.array([0.75 * side, 1.38, 0.0]), "rightHand": np.array([-0.75 * side, 1.38, 0.0])}
        found = rig(mesh, landmarks=hands | {"head": np.array([0.0, 1.76, 0.0])})
        assert found.joints[MAIN.index("leftHand")][0] * side > 0.3
        assert found.joints[MAIN.index("head")][1] > 1.3


@pytest.mark.parametrize(
    "landmarks, reason",
    [
        ({"leftHandd": 3}, "landmark 'leftHandd' is not in the template; nearest: 'leftHand'"),
        ({"leftHand": 10**7}, "landmark 'leftHand' is vertex 10000000; the mesh has"),
    ],
)
def test_landmarks_that_do_not_exist(landmarks, reason):
    with pytest.raises(RetargetError, match=reason):
        rig(case(CLEAN).mesh, landmarks=landmarks)


@pytest.mark.parametrize(
    "vertices, faces, reason",
    [
        (np.zeros((0, 3)), np.zeros((0, 3), dtype=int), "all vertices lie in one place"),
        (np.ones((5, 3)), np.array([[0, 1, 2]]), "all vertices lie in one place"),
        (np.eye(3), np.array([[0, 1, 2]]), "the mesh has 1 triangle with an area"),
    ],
)
def test_what_has_no_surface_is_refused(vertices, faces, reason):
    with pytest.raises(RetargetError, match=reason):
        rig(Mesh(vertices, faces))


def test_a_handful_of_points_is_refused():
    with pytest.raises(RetargetError, match="the cloud has 20 points; at least 300"):
        rig(PointCloud(np.random.default_rng(0).normal(size=(20, 3))))


def test_any_rigged_character_is_a_template():
    from retarget.casting import cast
    from retarget.rig.templates import character_template

    actor = cast(human(gender=1.0, weight=0.3, name="hero"))
    template = character_template(actor.character, actor.humanoid)
    assert not len(template.other_vertices)
    found = rig(case(CLEAN).mesh, template)
    assert joint_errors(CLEAN, found).mean() < 2.5
    assert found.character.skeleton.names == actor.skeleton.names


def test_a_template_needs_a_surface():
    from retarget.casting import cast
    from retarget.rig.templates import character_template

    actor = cast(human())
    with pytest.raises(RetargetError, match="has no surface, so it cannot be a template"):
        character_template(replace(actor.character, mesh=None, skin=None), actor.humanoid)
    few = replace(
        actor.humanoid, joints={name: joint for name, joint in actor.humanoid.joints.items() if name != "head"}
    )
    with pytest.raises(RetargetError, match="it lacks head"):
        character_template(actor.character, few)
