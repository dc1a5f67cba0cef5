"""Collision of a body with itself: exact against brute force, blind to how a file is built, honest about what is no body."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_bodies import (
    ARMS_AT_WORK,
    ball,
    box_figure,
    joined,
    pose,
    posed,
    random_turns,
    sheet,
    tube,
    with_faces,
    with_joint,
    with_piece,
    with_skin_of_nearest,
)
from made_motions import UP, actor, body, cast_by_names, fingerless, in_other_order, scaled, with_vertices_permuted

from retarget.body import rotations as rot
from retarget.body.human import PRESETS, textured
from retarget.body.skinning import prepare_skinning, rest_vertices
from retarget.character import Mesh, Skin
from retarget.contact.collide import NEIGHBOURHOOD, prepare_collider
from retarget.contact.parts import PARTS, body_height, body_parts
from retarget.errors import RetargetError
from retarget.evaluate.cases import arms_turned
from retarget.evaluate.reference.ray_parity import distance_to_faces, inside_by_parity
from retarget.geometry.distance import distance_along_edges, edge_graph
from retarget.geometry.topology import closing_fans

DIRECTION = np.array([0.3117, 0.7412, 0.5945]) / np.linalg.norm([0.3117, 0.7412, 0.5945])
SHORT_NAMES = {name: name for name in body().skeleton.names[:22]}


def cast(character):
    return cast_by_names(character, SHORT_NAMES)


@cache
def collider_of(preset):
    return prepare_collider(actor(preset).character, actor(preset).humanoid)


def collider(character):
    person = cast(character)
    return prepare_collider(person.character, person.humanoid)


def pairs_of(found, collider, own, other):
    """Which rows are vertices of one part in or beside another."""
    return (collider.parts.vertex_parts[found.vertex] == PARTS.index(own)) & (found.part == PARTS.index(other))


def part_surfaces(character, parts, vertices):
    """Closed surfaces of the parts, by (piece, part), made anew: posed points, all faces, skin faces."""
    corners = parts.welded[character.mesh.faces]
    for piece, kind in enumerate(parts.piece_kinds):
        for part in range(17) if kind == "body" else ():
            skin = corners[(parts.face_pieces == piece) & (parts.face_parts == part)]
            if len(skin):
                caps, rims = closing_fans(skin, len(vertices))
                centres = np.array([vertices[rim].mean(axis=0) for rim in rims]).reshape(-1, 3)
                yield part, np.concatenate([vertices, centres]), np.concatenate([skin, caps]), skin


def depths_by_force(character, collider, vertices):
    """Depth of every vertex in every part by the reference, of the pairs that the collider tests; (solids, vertices)."""
    found = np.zeros((len(collider.solid_parts), len(vertices)))
    tested = np.zeros(len(vertices), dtype=bool)
    tested[np.unique(collider.parts.welded[collider.parts.body_vertices])] = True
    surfaces = part_surfaces(character, collider.parts, vertices)
    for solid, (part, points, faces, skin) in enumerate(surfaces):
        assert part == collider.solid_parts[solid]
        inside = inside_by_parity(vertices, points, faces, DIRECTION) & tested & ~collider.excluded[:, solid]
        found[solid, inside] = distance_to_faces(vertices[inside], points, skin)
    return found


@pytest.mark.parametrize(
    "name, seed", [("thin", 0), ("very_heavy", 2), ("toddler", 3), ("textured", 4), ("boxes", 5)]
)
def test_brute_force_agrees(name, seed):
    made = {"textured": lambda: textured(body("heavy")), "boxes": box_figure}
    character = cast(made[name]() if name in made else body(name)).character
    found_by = collider(character)
    seen = 0
    for turns in (random_turns(seed), ARMS_AT_WORK):
        vertices = posed(character, turns)
        truth = depths_by_force(character, found_by, vertices)
        found = found_by.pairs(vertices)
        assert (found.distance <= 0).all()
        ours = np.zeros_like(truth)
        # One solid a part on these bodies.
        solid_of = {part: solid for solid, part in enumerate(found_by.solid_parts.tolist())}
        ours[[solid_of[part] for part in found.part.tolist()], found.vertex] = -found.distance
        deep = (truth > 1e-3) | (ours > 1e-3)
        assert ours[deep] == pytest.approx(truth[deep], abs=1e-9)
        seen += int(deep.sum())
    assert seen > (0 if name == "boxes" else 50), "the poses are wild enough to test something"


@pytest.mark.parametrize("preset", ["heavy", "toddler"])
def test_points_normals_and_rows_are_what_they_say(preset):
    collider, vertices = collider_of(preset), posed(actor(preset).character, ARMS_AT_WORK)
    found = collider.pairs(vertices, reach=0.02)
    mesh = actor(preset).character.mesh
    assert (found.distance > 0).any() and (found.distance < -0.003).any()
    assert np.linalg.norm(found.normal, axis=1) == pytest.approx(1)
    assert found.barycentric.min() >= -1e-12 and found.barycentric.sum(axis=1) == pytest.approx(1)
    on_face = (found.barycentric[:, :, None] * vertices[mesh.faces[found.face]]).sum(axis=1)
    assert on_face == pytest.approx(found.point, abs=1e-12)
    assert vertices[found.vertex] == pytest.approx(found.point + found.distance[:, None] * found.normal, abs=1e-9)
    assert np.array_equal(collider.parts.face_parts[found.face], found.part)
    assert (collider.parts.vertex_parts[found.vertex] != found.part).all()
    keys = found.vertex * 17 + found.part
    assert (np.diff(keys) > 0).all(), "by vertex and part, each once"


def test_the_normal_is_the_gradient_of_the_distance():
    """A hand moves, the belly stays: central differences of its vertices' distances in random directions."""
    collider, vertices = collider_of("heavy"), posed(actor("heavy").character, ARMS_AT_WORK)
    hand = collider.parts.vertex_parts == PARTS.index("leftHand")
    found = collider.pairs(vertices, 0.02)
    rows = pairs_of(found, collider, "leftHand", "abdomen")
    assert rows.sum() > 50
    step = 1e-6
    for seed in range(3):
        direction = rot.unit(np.random.default_rng(seed).normal(size=3))
        sides = []
        for sign in (1, -1):
            moved = collider.pairs(vertices + sign * step * hand[:, None] * direction, 0.03)
            there = pairs_of(moved, collider, "leftHand", "abdomen")
            sides.append(dict(zip(moved.vertex[there].tolist(), moved.distance[there])))
        slope = np.array([(sides[0][v] - sides[1][v]) / (2 * step) for v in found.vertex[rows].tolist()])
        # Where two points of the skin are equally near there is no gradient; that is a seam of measure zero.
        assert np.quantile(np.abs(slope - found.normal[rows] @ direction), 0.98) < 1e-3


@pytest.mark.parametrize("preset", ["average", "heavy"])
def test_a_hand_pushed_into_the_belly_reads_its_depth(preset):
    """By 1, 2, 3 cm along the normal of the belly: 1, 2, 3 cm, within a millimetre."""
    character, collider = actor(preset).character, collider_of(preset)
    vertices = posed(character, {"leftUpperArm": [-0.3, 0, 0.4], "rightUpperArm": [0, 0, -0.4]})
    belly = vertices[character.mesh.faces[collider.parts.face_parts == PARTS.index("abdomen")]]
    a, b, c = belly[belly[..., 2].sum(axis=1).argmax()]  # the foremost face, where it is flat
    place, outward = (a + b + c) / 3, rot.unit(np.cross(b - a, c - a))
    hand = np.flatnonzero(collider.parts.vertex_parts == PARTS.index("leftHand"))
    free = hand[~collider.excluded[hand][:, np.flatnonzero(collider.solid_parts == PARTS.index("abdomen"))[0]]]
    tip = free[(vertices[free] @ -outward).argmax()]
    read = []
    for push in (-0.002, 0.0025, 0.005, 0.01, 0.02, 0.03):
        moved = vertices.copy()
        moved[hand] += place - push * outward - vertices[tip]
        read.append(float(collider.depths(moved[None])[0, hand].max()))
    assert read[0] == 0 and (np.diff(read) > 0).all(), "monotone"
    assert np.abs(np.array(read[3:]) - [0.01, 0.02, 0.03]).max() < 1e-3


def test_moving_and_turning_the_world_changes_nothing():
    character, collider = actor("heavy").character, collider_of("heavy")
    vertices = posed(character, ARMS_AT_WORK)
    here = collider.pairs(vertices, 0.02)
    turn = rot.from_rotation_vector(np.array([0.3, -1.5, 0.7]))
    there = collider.pairs(rot.rotate(turn, vertices) + [30.0, -2.0, 11.0], 0.02)
    assert np.array_equal(here.vertex, there.vertex) and np.array_equal(here.part, there.part)
    assert there.distance == pytest.approx(here.distance, abs=1e-9)
    near = np.linalg.norm(rot.rotate(turn, here.point) + [30.0, -2.0, 11.0] - there.point, axis=1) < 1e-6
    assert near.mean() > 0.99, "but for points with two nearest ones"
    assert rot.rotate(turn, here.normal)[near] == pytest.approx(there.normal[near], abs=1e-4)


def test_depths_are_the_deepest_pairs_and_every_call_gives_the_same_bits():
    character, collider = actor("very_heavy").character, collider_of("very_heavy")
    frames = np.stack([posed(character, turns) for turns in (ARMS_AT_WORK, random_turns(8), random_turns(9))])
    depths = collider.depths(frames)
    for vertices, depth in zip(frames, depths):
        found, again = collider.pairs(vertices, 0.01), collider.pairs(vertices, 0.01)
        for column in ("vertex", "part", "distance", "point", "normal", "face", "barycentric"):
            assert np.array_equal(getattr(found, column), getattr(again, column))
        expected = np.zeros(len(vertices))
        np.maximum.at(expected, found.vertex, -found.distance)
        assert depth == pytest.approx(expected, abs=1e-12)
    assert np.array_equal(collider.depths(frames), depths) and depths.max() > 0.01
    assert collider.depths(frames[:0]).shape == (0, frames.shape[1])


def test_only_what_is_asked_for_is_found():
    vertices = posed(actor("heavy").character, ARMS_AT_WORK)
    wide, narrow, inside = (collider_of("heavy").pairs(vertices, reach) for reach in (0.03, 0.01, 0.0))
    for found, reach in ((narrow, 0.01), (inside, 0.0)):
        kept = wide.distance < reach
        assert np.array_equal(found.vertex, wide.vertex[kept]) and found.distance == pytest.approx(wide.distance[kept])
    none = collider_of("heavy").without(inside.vertex, inside.part).pairs(vertices)
    assert len(none.vertex) == 0


# What a body is built of makes no difference.


def depths_of(character, turns):
    return collider(character).depths(posed(cast(character).character, turns)[None])[0]


@cache
def plain_depths():
    """Of the heavy body, both hands in its belly."""
    return collider_of("heavy").depths(posed(actor("heavy").character, ARMS_AT_WORK)[None])[0]


def test_copies_along_seams_doubled_faces_and_scraps_change_nothing():
    plain = plain_depths()
    assert plain.max() > 0.02
    copies = depths_of(textured(body("heavy")), ARMS_AT_WORK)
    corners = textured(body("heavy")).mesh.faces
    assert copies[corners] == pytest.approx(plain[body("heavy").mesh.faces], abs=1e-12)
    faces = body("heavy").mesh.faces
    for more in (faces[:, ::-1], [[0, 0, 1], [7, 7, 7]]):
        assert np.array_equal(depths_of(with_faces(body("heavy"), np.concatenate([faces, more])), ARMS_AT_WORK), plain)


def test_orders_of_joints_vertices_and_faces_change_nothing():
    plain = plain_depths()
    permuted, order = with_vertices_permuted(fingerless(body("heavy")), 3)
    assert depths_of(permuted, ARMS_AT_WORK) == pytest.approx(plain[order], abs=1e-6)
    faces = fingerless(body("heavy")).mesh.faces
    shuffled = with_faces(fingerless(body("heavy")), np.roll(faces[np.random.default_rng(0).permutation(len(faces))], 1, 1))
    assert depths_of(shuffled, ARMS_AT_WORK) == pytest.approx(plain, abs=1e-6)
    mixed, _ = in_other_order(fingerless(body("heavy")), 4)
    vertices = posed(cast(body("heavy")).character, ARMS_AT_WORK)
    assert collider(mixed).depths(vertices[None])[0] == pytest.approx(plain, abs=1e-6)


def test_depths_scale_with_the_body():
    vertices = posed(actor("heavy").character, ARMS_AT_WORK)
    hundred = collider(scaled(body("heavy"), 100.0))  # a body in centimetres
    plain = collider_of("heavy").depths(vertices[None])
    assert hundred.depths(100 * vertices[None]) == pytest.approx(100 * plain, abs=1e-7)


def test_hidden_triangles_on_an_edge_do_not_open_the_body():
    """A fin on an edge, a spike on a vertex: edges with three faces, rims that touch the body."""
    heavy = body("heavy")
    belly = np.flatnonzero(collider_of("heavy").parts.vertex_parts == PARTS.index("abdomen"))
    a = belly[heavy.mesh.vertices[belly, 2].argmax()]
    b = next(v for v in heavy.mesh.faces[(heavy.mesh.faces == a).any(axis=1)].ravel().tolist() if v != a)
    tip = heavy.mesh.vertices[[a]] + [0, 0, 0.01]
    finned = with_skin_of_nearest(heavy, (tip, np.zeros((0, 3), int)))
    new = len(heavy.mesh.vertices)
    character = with_faces(finned, np.concatenate([heavy.mesh.faces, [[a, b, new]]]))
    depth, plain = depths_of(character, ARMS_AT_WORK)[:new], plain_depths()
    assert ((depth > 0) == (plain > 0)).all() and np.abs(depth - plain).max() < 0.011


# What is no body, or no penetration, is not reported.


@pytest.mark.parametrize("preset", PRESETS)
def test_nothing_penetrates_at_rest_nor_with_the_arms_out(preset):
    """And nothing had to be left out for it but what is near along the skin."""
    person, found_by = actor(preset), collider_of(preset)
    rest = rest_vertices(person.character)
    graph = edge_graph(rest, person.character.mesh.faces)
    limit = NEIGHBOURHOOD * body_height(rest, found_by.parts, person.humanoid)
    for solid, part in enumerate(found_by.solid_parts):
        skin = np.unique(person.character.mesh.faces[found_by.parts.face_parts == part])
        near = distance_along_edges(graph, skin, limit) <= limit
        assert np.array_equal(found_by.excluded[:, solid], near | (found_by.parts.vertex_parts == part))
    poses = [posed(person.character, arms_turned(angle)) for angle in (0.0, -20.0, -40.0, -50.0)]
    assert found_by.depths(np.stack(poses)).max() == 0


def test_a_body_of_several_pieces_has_no_collisions_in_its_joints():
    figure = cast(box_figure()).character
    found_by = collider(figure)
    assert len(found_by.solid_parts) == 17
    for turns in (
        {},
        arms_turned(-45.0),
        {"leftLowerArm": [-1.2, 0, 0], "rightLowerLeg": [1.3, 0, 0], "head": [0.4, 0.3, 0]},
        {"leftUpperArm": [0, 0, 0.8], "rightUpperLeg": [-1.0, 0, 0], "spine": [0.3, 0.2, 0.1], "rightHand": [0, 0, 0.8]},
    ):
        assert found_by.depths(posed(figure, turns)[None]).max() == 0
    folded = posed(figure, {"leftUpperArm": [0, -1.2, 0.4], "leftLowerArm": [0, -1.3, 0.8]})
    assert found_by.depths(folded[None]).max() > 0.01, "but a forearm before the chest is seen"


def clothed(name):
    average = fingerless(body("average"))
    at = dict(zip(average.skeleton.names, rest_joints(average)))
    arm = at["leftLowerArm"] - at["leftUpperArm"]
    if name == "hair card":
        return with_piece(average, sheet([-0.03, 1.62, -0.12], [0.06, 0, 0], [0, -0.45, 0.0]), {"head": 1.0})
    if name == "cape":
        vertices, faces = sheet([-0.3, 1.38, -0.17], [0.6, 0, 0], [0, -0.8, 0.0])
        return with_skin_of_nearest(average, (vertices, np.concatenate([faces, faces[:, ::-1]])))
    if name == "sleeve":
        start = at["leftUpperArm"] + 0.3 * arm
        return with_skin_of_nearest(average, tube(start, at["leftLowerArm"] + 0.5 * arm, 0.085, rows=14))
    if name == "eyes":
        vertices, faces = ball(8, 12, 0.012)
        eyes = joined((vertices + [0.03, 1.55, 0.06], faces), (vertices + [-0.03, 1.55, 0.06], faces))
        return with_piece(average, eyes, {"head": 1.0})
    sword = with_joint(average, "weapon_r", "rightHand", [0, 0, 0])
    blade = ball(8, 12, 0.3)
    return with_piece(sword, (blade[0] + at["rightHand"], blade[1]), {"weapon_r": 1.0})


def rest_joints(character):
    from retarget.body.kinematics import rest_pose

    return rest_pose(character.skeleton)[1]


@pytest.mark.parametrize("name", ["hair card", "cape", "sleeve", "eyes", "weapon"])
def test_what_is_worn_is_not_reported_where_the_bare_body_is_not(name):
    character = cast(clothed(name)).character
    bare = len(body("average").mesh.vertices)
    found_by, bare_by = collider(character), collider_of("average")
    for turns in (
        {},
        {"leftLowerArm": [-1.4, 0, 0], "leftUpperArm": [0.2, 0, 0.3], "rightLowerArm": [-0.9, 0.2, 0]},
        {"neck": [0.3, 0, 0], "head": [0.2, 0.5, 0], "spine": [0.4, 0, 0.2]},
        {"neck": [-0.3, 0, 0], "head": [-0.3, 0, 0], "chest": [-0.2, 0.3, 0]},
    ):
        vertices = posed(character, turns)
        assert np.array_equal(found_by.depths(vertices[None])[0, :bare], bare_by.depths(vertices[None, :bare])[0])
        assert found_by.depths(vertices[None]).max() == 0, name


def test_what_overlaps_at_rest_was_built_so():
    """A holster on the thigh that follows the hand: what is hidden in the thigh at rest is never reported in it."""
    vertices, faces = ball(8, 16, 0.06)
    at = rest_joints(body("average"))[body().skeleton.index("leftUpperLeg")] + [0.06, -0.2, 0]
    character = with_piece(body("average"), (vertices + at, faces), {"leftHand": 1.0})
    found_by, own = collider(character), len(body("average").mesh.vertices) + np.arange(len(vertices))
    hidden = found_by.excluded[own][:, found_by.solid_parts == PARTS.index("leftThigh")].any(axis=1)
    rest = rest_vertices(cast(character).character)
    assert 0 < hidden.sum() < len(own) and found_by.depths(rest[None]).max() == 0
    deeper = rest.copy()
    deeper[own] -= [0.05, 0, 0]
    assert found_by.depths(deeper[None])[0, own[~hidden]].max() > 0.01, "the rest of it is"


# Real penetration is not left out because parts are neighbours in the skeleton.


@pytest.mark.parametrize(
    "preset, turns, own, other",
    [
        ("very_heavy", {f"{s}UpperLeg": [-2.2, 0, 0] for s in ("left", "right")}, "leftThigh", "abdomen"),
        ("very_heavy", {f"{s}UpperLeg": [-2.2, 0, 0] for s in ("left", "right")}, "abdomen", "leftThigh"),
        ("very_heavy", {"leftUpperLeg": [-2.2, 0, 0], "leftLowerLeg": [2.4, 0, 0]}, "leftShin", "leftThigh"),
        ("very_heavy", arms_turned(30.0), "leftUpperArm", "abdomen"),
        ("toddler", {"neck": [0.6, 0, 0], "head": [0.7, 0, 0]}, "head", "chest"),
        ("average", {"leftUpperLeg": [0, 0, -0.35], "rightUpperLeg": [0, 0, 0.35]}, "leftThigh", "rightThigh"),
        ("heavy", {"rightUpperArm": [-0.4, 0.9, 0.7], "rightLowerArm": [-0.8, 1.2, 0]}, "rightHand", "chest"),
    ],
)
def test_neighbouring_parts_are_tested_beyond_their_joint(preset, turns, own, other):
    found = collider_of(preset).pairs(posed(actor(preset).character, turns))
    assert (found.distance[pairs_of(found, collider_of(preset), own, other)] < -1e-3).any()


# Bad input.


def scrap(faces, count=3):
    thin = body("thin")
    vertices = np.eye(3)[np.arange(count) % 3] * (1 + np.arange(count)[:, None] // 3)
    skin = Skin(thin.skin.joints, thin.skin.inverse_binds, np.zeros((count, 1), int), np.ones((count, 1)))
    return replace(thin, mesh=Mesh(vertices, np.array(faces, dtype=int).reshape(-1, 3)), skin=skin)


@pytest.mark.parametrize("faces", [[], [[0, 1, 2]], [[0, 0, 1]], [[0, 1, 2], [2, 1, 0], [0, 0, 0]]])
def test_scraps_collide_with_nothing(faces):
    found_by = collider(scrap(faces))
    vertices = scrap(faces).mesh.vertices
    assert found_by.depths(vertices[None]).tolist() == [[0.0, 0, 0]] and len(found_by.pairs(vertices, 5.0).vertex) == 0


def test_flat_folded_and_collapsed_bodies_give_finite_answers():
    found_by, rest = collider(box_figure()), rest_vertices(cast(box_figure()).character).astype(np.float64)
    for vertices in (rest * [1, 1, 0], rest * 0, rest * [1, 0, 0], np.round(rest, 1), rest[::-1].copy()):
        found = found_by.pairs(vertices, 0.01)
        assert np.isfinite(found.distance).all() and np.isfinite(found.normal).all()
        assert np.isfinite(found_by.depths(vertices[None])).all()
    assert found_by.depths((rest + 1e6 * UP)[None]).max() < 1e-6


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])
def test_vertices_that_are_nowhere_are_refused(value):
    vertices = rest_vertices(actor("thin").character).astype(np.float64)
    vertices[17, 1] = value
    with pytest.raises(RetargetError, match="nowhere"):
        collider_of("thin").pairs(vertices)
    with pytest.raises(RetargetError, match="nowhere"):
        collider_of("thin").depths(np.stack([vertices, vertices]))


def test_vertices_of_another_body_are_refused():
    with pytest.raises(RetargetError, match="6883 vertices, received"):
        collider_of("thin").pairs(np.zeros((100, 3)))
    with pytest.raises(RetargetError, match="no surface"):
        prepare_collider(replace(actor("thin").character, mesh=None, skin=None), actor("thin").humanoid)


@pytest.mark.parametrize("missing", [("neck",), ("chest", "upperChest"), ("leftToes", "rightToes", "neck")])
def test_a_humanoid_may_lack_joints(missing):
    person = actor("heavy")
    fewer = {name: joint for name, joint in person.humanoid.joints.items() if name not in missing}
    found_by = prepare_collider(person.character, replace(person.humanoid, joints=fewer))
    depth = found_by.depths(posed(person.character, ARMS_AT_WORK)[None])[0]
    plain = collider_of("heavy").depths(posed(person.character, ARMS_AT_WORK)[None])[0]
    hands = np.isin(found_by.parts.vertex_parts, [PARTS.index("leftHand"), PARTS.index("rightHand")])
    assert (depth[hands] > 0.02).any() and depth[hands].max() == pytest.approx(plain[hands].max(), abs=0.05)


def test_float_vertices_of_skinning_are_taken_as_they_are():
    character = actor("heavy").character
    single = prepare_skinning(character).vertices(*pose(character, ARMS_AT_WORK))[0]
    assert collider_of("heavy").depths(single[None]) == pytest.approx(
        collider_of("heavy").depths(single[None].astype(np.float64)), abs=1e-12
    )


def test_parts_made_before_are_used():
    person = actor("thin")
    parts = body_parts(person.character, person.humanoid)
    assert prepare_collider(person.character, person.humanoid, parts).parts is parts
