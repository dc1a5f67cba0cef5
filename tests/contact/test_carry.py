"""Carrying: a place on one skin finds the same place on another; bodies of one topology tell how well."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.body.human import PRESETS, human
from retarget.body.kinematics import rest_pose
from retarget.character import Character, Mesh, Skeleton, Skin
from retarget.contact.carry import carry, prepare_carry
from retarget.contact.carry_error import carrying_error, spread_points
from retarget.contact.sensor_surface import closest_barycentrics
from retarget.contact.sensors import dense_layout, paper_layout, place_sensors, surface_points
from retarget.correspond.joints import match_humanoid
from retarget.errors import RetargetError

REPORTED = [("man", "woman"), ("woman", "short"), ("elderly", "average"), ("short", "man")]
"""Pairs that nothing was tuned on."""
FAR = [("thin", "very_heavy"), ("muscular", "child"), ("toddler", "tall")]


def sensed(character, layout=None):
    return place_sensors(character, match_humanoid(character.skeleton), layout or dense_layout())


@cache
def body(name):
    return sensed(human(**PRESETS[name]))


def poorer(character):
    """The same surface on a lesser rig: hands without fingers, one joint for spine and chest, no neck, clavicles or
    toes, harder weights, and a T-pose at rest."""
    skeleton, skin = character.skeleton, character.skin
    gone = ("chest", "neck", "Shoulder", "Toes", "Thumb", "Index", "Middle", "Ring", "Little")
    kept = [
        j for j, name in enumerate(skeleton.names) if not any(part in name for part in gone) or name == "upperChest"
    ]
    above = np.arange(len(skeleton))
    for joint in range(len(skeleton)):
        while above[joint] not in kept:
            above[joint] = skeleton.parents[above[joint]]
    _, places = rest_pose(skeleton)
    new = {joint: i for i, joint in enumerate(kept)}
    parents = np.array([-1] + [new[above[skeleton.parents[joint]]] for joint in kept[1:]])
    places = places[kept]
    offsets = places - np.where(parents[:, None] >= 0, places[parents], 0.0)
    weights = np.zeros((len(skin.columns), len(kept)))
    for i in range(skin.columns.shape[1]):
        column = np.array([new[above[joint]] for joint in skin.joints])[skin.columns[:, i]]
        np.add.at(weights, (np.arange(len(weights)), column), skin.weights[:, i])
    columns = np.argsort(-weights, axis=1)[:, :4]
    hard = np.take_along_axis(weights, columns, axis=1) ** 3
    binds = np.broadcast_to(np.eye(4), (len(kept), 4, 4)).copy()
    binds[:, :3, 3] = -places
    rotations = np.broadcast_to(rot.IDENTITY, (len(kept), 4)).copy()
    names = tuple(skeleton.names[joint] for joint in kept)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        rotations[names.index(f"{side}UpperArm")] = rot.from_rotation_vector(np.array([0, 0, sign * 0.75]))
        rotations[names.index(f"{side}Hand")] = rot.from_rotation_vector(np.array([-0.7, 0, 0]))
    return Character(
        Skeleton(names, parents, offsets, rotations),
        Mesh(character.mesh.vertices, character.mesh.faces),
        Skin(np.arange(len(kept)), binds, columns, hard / hard.sum(axis=1, keepdims=True)),
    )


def test_it_agrees_with_the_true_correspondence_on_bodies_it_was_not_tuned_on():
    errors = [carrying_error(body(source), body(target), 2000).truth for source, target in REPORTED]
    assert np.mean([error["limbs"] for error in errors]) < 0.8
    assert np.mean([error["trunk"] for error in errors]) < 0.8
    for region in ("head", "hands", "feet"):
        assert np.mean([error[region] for error in errors]) < 0.4


@pytest.mark.parametrize("source, target", FAR)
def test_it_agrees_between_very_different_bodies(source, target):
    error = carrying_error(body(source), body(target), 2000).truth
    assert error["limbs"] < 0.8 and error["trunk"] < 1.0, error
    assert error["p95"] < 2.0


def test_it_is_much_nearer_than_the_nearest_sensor():
    source, target = body("thin"), body("heavy")
    faces, shares = spread_points(source, 1500)
    places = surface_points(source.stance.rest, source.stance.faces, faces, shares)
    truth = surface_points(target.stance.rest, target.stance.faces, faces, shares)
    both = source.valid & target.valid
    apart = np.linalg.norm(source.positions[None, both] - places[:, None], axis=2)
    naive = np.linalg.norm(target.positions[both][apart.argmin(axis=1)] - truth, axis=1)
    carried = carry(faces, shares, source, target)
    mine = surface_points(target.stance.rest, target.stance.faces, carried.faces, carried.barycentrics) - truth
    assert np.linalg.norm(mine, axis=1).mean() < 0.7 * naive.mean()


def test_a_lesser_rig_and_another_rest_pose_hardly_matter():
    target = sensed(poorer(human(**PRESETS["heavy"])))
    rich, poor = carrying_error(body("thin"), body("heavy"), 1500), carrying_error(body("thin"), target, 1500)
    for region in ("arms", "legs", "trunk", "head", "hands", "feet"):
        assert poor.truth[region] < rich.truth[region] + 0.2, region


def test_a_body_carries_to_itself():
    error = carrying_error(body("child"), body("child"), 1500)
    assert error.truth["all"] < 0.06 and error.round_trip < 0.06 and error.valid > 0.999


def test_neighbours_land_next_to_each_other():
    """No jump where the sensors of one bone end: along every edge the map stretches by little."""
    source, target = body("muscular"), body("heavy")
    stance = source.stance
    vertex, face = np.unique(stance.faces, return_index=True)
    shares = np.zeros((len(vertex), 3))
    shares[np.arange(len(vertex)), face % 3] = 1.0
    carried = prepare_carry(source, target)(face // 3, shares)
    there = surface_points(target.stance.rest, stance.faces, carried.faces, carried.barycentrics)
    edges = np.unique(np.sort(np.concatenate([stance.faces[:, :2], stance.faces[:, 1:]]), axis=1), axis=0)
    before = np.linalg.norm(stance.rest[edges[:, 0]] - stance.rest[edges[:, 1]], axis=1)
    after = np.linalg.norm(there[edges[:, 0]] - there[edges[:, 1]], axis=1)
    torn = after > 3 * before + 0.01 * stance.height
    assert torn.mean() < 0.001


def test_what_the_sensors_cannot_know_has_no_confidence():
    """A target without a left forearm: points there come out invalid, all others as before."""
    whole, source = human(**PRESETS["average"]), body("thin")
    lost = match_humanoid(whole.skeleton).joints["leftLowerArm"]
    arm = (whole.skin.weights * (whole.skin.columns == lost)).sum(axis=1) > 0.5
    stump = replace(whole, mesh=Mesh(whole.mesh.vertices, whole.mesh.faces[~arm[whole.mesh.faces].any(axis=1)]))
    faces, shares = spread_points(source, 1500)
    valid = prepare_carry(source, sensed(stump))(faces, shares).valid
    middle = arm[source.stance.faces[faces]].all(axis=1)
    assert valid[~middle].mean() > 0.98
    assert valid[middle].mean() < 0.5


def test_its_own_error_is_told():
    known = carrying_error(body("thin"), body("heavy"), 500)
    assert "trunk" in str(known) and "there and back" in str(known)
    mesh = body("heavy").character.mesh
    foreign = sensed(replace(body("heavy").character, mesh=replace(mesh, faces=mesh.faces[::-1])))
    unknown = carrying_error(body("thin"), foreign, 500)
    assert unknown.truth is None and "there and back" in str(unknown)
    assert unknown.round_trip == pytest.approx(known.round_trip, rel=0.3)


def test_closest_points_of_triangles():
    random = np.random.default_rng(1)
    corners, points = random.normal(size=(200, 3, 3)), 2 * random.normal(size=(200, 3))
    shares = closest_barycentrics(points, corners)
    assert shares.min() >= 0 and np.allclose(shares.sum(axis=1), 1)
    found = np.linalg.norm(np.einsum("pc,pci->pi", shares, corners) - points, axis=1)
    grid = random.dirichlet([0.5, 0.5, 0.5], size=4000)
    tried = np.linalg.norm(np.einsum("gc,pci->pgi", grid, corners) - points[:, None], axis=2).min(axis=1)
    assert (found <= tried + 1e-12).all() and (tried - found).max() < 0.1


def test_mistakes_are_named():
    sparse = place_sensors(body("thin").character, match_humanoid(body("thin").character.skeleton), paper_layout(1, 2))
    with pytest.raises(RetargetError, match="one layout only"):
        prepare_carry(body("heavy"), sparse)
    with pytest.raises(RetargetError, match="100 are needed"):
        prepare_carry(sparse, sparse)
    carrier = prepare_carry(body("thin"), body("heavy"), rounds=0)
    with pytest.raises(RetargetError, match="barycentrics"):
        carrier(np.array([1, 2]), np.ones((1, 3)) / 3)
    with pytest.raises(RetargetError, match="13762"):
        carrier(np.array([20000]), np.ones((1, 3)) / 3)
