"""Clothes on the embedded human: around the body, moved by its bones, the same for the same seed."""

from dataclasses import replace

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.body.human import PRESETS, human, human_model
from retarget.body.kinematics import forward
from retarget.body.skinning import prepare_skinning, rest_vertices
from retarget.errors import RetargetError
from retarget.geometry.clothes import THICKEST, Outfit, dressed, random_outfit
from retarget.geometry.topology import vertex_normals

BODY = human()
COUNT = len(BODY.mesh.vertices)
SIZE = np.ptp(BODY.mesh.vertices[:, 1]) / 1.7


def part(*names):
    model = human_model()
    return np.isin(model.vertex_parts, [model.part_names.index(name) for name in names])


def test_nothing_worn_is_nothing_changed():
    bare = dressed(BODY, Outfit())
    assert np.array_equal(bare.mesh.vertices, BODY.mesh.vertices) and np.array_equal(bare.mesh.faces, BODY.mesh.faces)


def test_a_top_stands_away_where_it_is_worn():
    worn = dressed(BODY, Outfit(top=0.03, sleeves=1))
    moved = worn.mesh.vertices - BODY.mesh.vertices
    away = np.linalg.norm(moved, axis=1)
    assert away.max() <= THICKEST * SIZE + 1e-9 and away[part("chest", "abdomen")].mean() > 0.015
    assert away[part("leftHand", "rightHand", "leftShin", "leftFoot")].max() < 1e-9
    other, smooth = (
        np.linalg.norm(dressed(BODY, outfit, seed).mesh.vertices - BODY.mesh.vertices, axis=1)
        for outfit, seed in ((Outfit(top=0.03), 1), (Outfit(top=0.03, wrinkles=0.0), 0))
    )
    assert np.abs(other - away).max() > 0.005 and 0.001 < np.abs(smooth - away).max() < 0.02, "uneven, and wrinkled"
    outward = (moved * vertex_normals(BODY.mesh.vertices, BODY.mesh.faces)).sum(axis=1)
    assert outward[away > 0.005].mean() > 0.8 * away[away > 0.005].mean()
    long = np.linalg.norm(dressed(BODY, Outfit(top=0.03, sleeves=2)).mesh.vertices - BODY.mesh.vertices, axis=1)
    assert long[part("leftForearm")].mean() > 0.01 > away[part("leftForearm")].mean()


def test_a_skirt_hangs_around_the_legs_to_its_hem():
    worn = dressed(BODY, Outfit(skirt=0.6, flare=0.15))
    skirt = worn.mesh.vertices[COUNT:]
    navel = BODY.mesh.vertices[human_model().landmark("navel")][1]
    assert skirt[:, 1].max() == pytest.approx(navel) and skirt[:, 1].min() == pytest.approx(
        navel * (1 - 0.57), abs=0.01
    )
    hem, waist = (skirt[np.abs(skirt[:, 1] - y) < 1e-6] for y in (skirt[:, 1].min(), skirt[:, 1].max()))
    assert np.ptp(hem[:, 0]) > np.ptp(waist[:, 0]) + 0.15
    legs = BODY.mesh.vertices[part("leftThigh", "rightThigh") & (BODY.mesh.vertices[:, 1] > skirt[:, 1].min())]
    assert legs[:, 0].max() < skirt[:, 0].max() and legs[:, 0].min() > skirt[:, 0].min()
    coat = dressed(BODY, Outfit(skirt=0.6, coat=True)).mesh.vertices[COUNT:]
    assert coat[:, 1].max() > navel + 0.1


@pytest.mark.parametrize(("outfit", "near"), [
    (Outfit(hat=0.02), "head"), (Outfit(hat=0.02, brim=0.08), "head"), (Outfit(shoes=0.01), "leftFoot"),
    (Outfit(hair=0.03, hair_length=0.3), "chest"),
])  # fmt: skip
def test_what_is_worn_follows_the_body_beneath(outfit, near):
    worn = dressed(BODY, outfit)
    assert len(worn.mesh.vertices) > COUNT + 50
    assert np.allclose(rest_vertices(worn), worn.mesh.vertices, atol=1e-5)
    names = worn.skeleton.names
    rotations = np.tile(rot.IDENTITY, (len(names), 1))
    rotations[names.index("hips")] = rot.from_rotation_vector(np.array([0.0, 0, 1.2]))
    rotations[names.index("leftUpperLeg")] = rot.from_rotation_vector(np.array([-1.0, 0, 0]))
    rotations[names.index("neck")] = rot.from_rotation_vector(np.array([0.5, 0.5, 0]))
    posed = prepare_skinning(worn).vertices(
        *forward(worn.skeleton.parents, rotations[None], worn.skeleton.offsets[None])
    )[0]
    from scipy.spatial import cKDTree

    before = cKDTree(worn.mesh.vertices[:COUNT]).query(worn.mesh.vertices[COUNT:])[0]
    after = cKDTree(posed[:COUNT]).query(posed[COUNT:])[0]
    assert np.quantile(after - before, 0.95) < 0.04
    assert np.isfinite(posed).all()


def test_long_hair_hangs_down_the_back():
    worn = dressed(BODY, Outfit(hair=0.02, hair_length=0.35))
    hair = worn.mesh.vertices[COUNT:]
    ear = BODY.mesh.vertices[human_model().landmark("leftEar")]
    assert hair[:, 1].min() == pytest.approx(ear[1] - 0.35 * SIZE, abs=0.01)
    assert np.abs(hair[:, 0]).max() < 0.16 and hair[:, 2].max() < BODY.mesh.vertices[human_model().landmark("nose")][2]


def test_shoes_stand_on_the_floor():
    worn = dressed(BODY, Outfit(shoes=0.015))
    assert worn.mesh.vertices[:, 1].min() == pytest.approx(BODY.mesh.vertices[:, 1].min())


def test_the_same_seed_gives_the_same_and_another_other_clothes():
    one, again, other = (dressed(BODY, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(one.mesh.vertices, again.mesh.vertices) and np.array_equal(
        one.skin.weights, again.skin.weights
    )
    assert one.mesh.vertices.shape != other.mesh.vertices.shape or not np.array_equal(
        one.mesh.vertices, other.mesh.vertices
    )
    assert random_outfit(3) == random_outfit(3) != random_outfit(4)


@pytest.mark.parametrize("preset", ["toddler", "very_heavy", "tall"])
def test_every_body_can_wear_it(preset):
    body = human(**PRESETS[preset])
    for seed in range(4):
        worn = dressed(body, seed=seed)
        size = np.ptp(body.mesh.vertices[:, 1])
        assert np.isfinite(worn.mesh.vertices).all() and np.ptp(worn.mesh.vertices[:, 1]) < 1.1 * size
        assert np.abs(worn.mesh.vertices).max() < 1.2 * size
        assert worn.skeleton is body.skeleton and len(worn.mesh.face_materials) == len(worn.mesh.faces)


def test_other_bodies_are_refused():
    other = replace(BODY, mesh=replace(BODY.mesh, faces=BODY.mesh.faces[::-1].copy()))
    with pytest.raises(RetargetError, match="not on the embedded human's topology"):
        dressed(other)
