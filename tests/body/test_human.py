"""The embedded human: one sound topology, shapes that keep their promises, a skin that moves well."""

import time
from pathlib import Path

import numpy as np
import pytest

from retarget.body import human as human_module
from retarget.body import rotations as rot
from retarget.body.human import (
    PARAMETERS,
    PRESETS,
    height_range,
    human,
    human_model,
    human_vertices,
    textured,
)
from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices, skin_motion
from retarget.character import Motion
from retarget.errors import RetargetError

FOLDED = 40  # faces of 13,762 turned by more than a right angle; corners of the shape space have up to 36
CENTRE = {"spine": "hips", "chest": "spine", "upperChest": "chest", "neck": "upperChest", "head": "neck"}
SIDES = {
    "Shoulder": "upperChest", "UpperArm": "Shoulder", "LowerArm": "UpperArm", "Hand": "LowerArm", "UpperLeg": "hips",
    "LowerLeg": "UpperLeg", "Foot": "LowerLeg", "Toes": "Foot", "ThumbMetacarpal": "Hand",
    "ThumbProximal": "ThumbMetacarpal", "ThumbDistal": "ThumbProximal",
} | {
    f"{finger}{phalanx}": finger + above if above else "Hand"
    for finger in ("Index", "Middle", "Ring", "Little")
    for phalanx, above in (("Proximal", ""), ("Intermediate", "Proximal"), ("Distal", "Intermediate"))
}  # fmt: skip
TREE = CENTRE | {
    side + name: above if above in ("hips", "upperChest") else side + above
    for side in ("left", "right")
    for name, above in SIDES.items()
}


@pytest.fixture(scope="module")
def model():
    return human_model()


@pytest.fixture(scope="module")
def average():
    return human_vertices()


def normals(vertices, faces):
    normal = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def volume(vertices, faces):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def winding(point, vertices, faces):
    """How often the surface winds around a point (van Oosterom and Strackee 1983)."""
    a, b, c = (vertices[faces[:, k]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    over = (a * np.cross(b, c)).sum(1)
    under = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
    return float(np.arctan2(over, under).sum() / (2 * np.pi))


def bent(character, turns):
    """Vertices with some joints turned: name -> rotation vector in degrees."""
    rotations = character.skeleton.rest_rotations.copy()
    for name, degrees in turns.items():
        rotations[character.skeleton.index(name)] = rot.from_rotation_vector(np.radians(np.array(degrees, float)))
    motion = Motion(character.skeleton, rotations[None], character.skeleton.offsets[None, :1])
    return skin_motion(character, motion)[0].astype(float)


class TestTopology:
    def test_closed_oriented_one_piece_without_handles(self, model):
        faces = model.faces
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        directed = {tuple(edge) for edge in edges.tolist()}
        assert len(directed) == len(edges), "an edge is used twice in one direction"
        assert all((b, a) in directed for a, b in directed), "the surface has a border"
        count = len(model.mirror)
        assert np.array_equal(np.unique(faces), np.arange(count))
        assert count - len(edges) // 2 + len(faces) == 2
        assert pieces(edges, count) == 1

    def test_every_vertex_has_one_fan_of_faces(self, model):
        following = {}
        for a, b, c in model.faces.tolist():
            for corner, ahead, behind in ((a, b, c), (b, c, a), (c, a, b)):
                following.setdefault(corner, {})[ahead] = behind
        for ring in following.values():
            start = at = next(iter(ring))
            steps = 0
            while steps == 0 or at != start:
                at, steps = ring[at], steps + 1
            assert steps == len(ring)

    def test_size(self, model):
        assert 6800 <= len(model.mirror) <= 6950
        assert Path(human_module.__file__).with_name("human.npz").stat().st_size < 8e6

    def test_mirrors_exactly(self, model, average):
        mirror = model.mirror
        assert np.array_equal(mirror[mirror], np.arange(len(mirror)))
        assert np.array_equal(average[mirror] * [-1, 1, 1], average)
        turned = {tuple(np.roll(face, -face.argmin())) for face in mirror[model.faces][:, ::-1]}
        assert turned == {tuple(np.roll(face, -face.argmin())) for face in model.faces}

    def test_triangles_are_of_good_shape(self, model, average):
        corners = average[model.faces]
        edges = np.roll(corners, -1, axis=1) - corners
        area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
        quality = 4 * np.sqrt(3) * area / (edges**2).sum(axis=(1, 2))
        assert quality.min() > 0.1 and np.percentile(quality, 1) > 0.3 and np.median(quality) > 0.8


def pieces(edges, count):
    """Connected pieces of a graph, by spreading the smallest label."""
    edges = np.concatenate([edges, edges[:, ::-1]])
    label = np.arange(count)
    while True:
        smaller = label.copy()
        np.minimum.at(smaller, edges[:, 0], label[edges[:, 1]])
        smaller = smaller[smaller]
        if np.array_equal(smaller, label):
            return len(np.unique(label))
        label = smaller


class TestRegions:
    def test_seventeen_parts_each_one_piece_sixteen_seams(self, model):
        assert len(model.part_names) == 17 and len(model.seams) == 16
        for part in range(17):
            faces = model.faces[model.face_parts == part]
            edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
            inside, relabelled = np.unique(edges, return_inverse=True)
            assert pieces(np.sort(relabelled.reshape(-1, 2)), len(inside)) == 1, model.part_names[part]

    def test_seams_are_closed_loops_between_their_parts(self, model):
        owner = {}
        for face, part in zip(model.faces.tolist(), model.face_parts.tolist(), strict=True):
            for a, b in zip(face, face[1:] + face[:1], strict=True):
                owner[a, b] = model.part_names[part]
        border = {
            edge for edge, part in owner.items() if part < owner[edge[1], edge[0]] or part > owner[edge[1], edge[0]]
        }
        walked = set()
        for (left, right), loop in model.seams.items():
            for a, b in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True):
                assert (owner[a, b], owner[b, a]) == (left, right)
                walked |= {(a, b), (b, a)}
        assert walked == border

    def test_parts_and_landmarks_mirror(self, model):
        for part, name in enumerate(model.part_names):
            other = model.part_names.index(swapped(name))
            assert np.array_equal(
                np.sort(model.mirror[model.vertex_parts == part]), np.flatnonzero(model.vertex_parts == other)
            )
        for name, vertex in model.landmarks.items():
            assert model.landmarks[swapped(name)] == model.mirror[vertex]

    def test_landmarks_lie_where_their_names_say(self, model, average):
        at = {name: average[vertex] for name, vertex in model.landmarks.items()}
        assert len(at) >= 40 and len(set(model.landmarks.values())) == len(at)
        assert at["crown"][1] == average[:, 1].max()
        order = [
            "crown",
            "forehead",
            "nose",
            "chin",
            "throat",
            "chest",
            "navel",
            "belly",
            "pubis",
            "leftKnee",
            "leftShin",
        ]
        heights = [at[name][1] for name in order]
        assert heights == sorted(heights, reverse=True)
        for front, back in (("nose", "backOfHead"), ("chest", "upperBack"), ("belly", "lowerBack"), ("leftKnee", "leftKneeBack"),
                            ("leftBigToeTip", "leftHeel"), ("leftBreast", "leftShoulderBlade"), ("leftHipFront", "leftButtock")):  # fmt: skip
            assert at[front][2] > at[back][2] + 0.05, (front, back)
        for name in ("leftEar", "leftPalm", "leftElbow", "leftHipSide", "leftHeel"):
            assert at[name][0] > 0.02
        assert np.linalg.norm(at["leftPalm"] - at["leftBackOfHand"]) > 0.015
        tips = [f"left{finger}Tip" for finger in ("Thumb", "Index", "Middle", "Ring", "Little")]
        assert all(model.part_names[model.vertex_parts[model.landmarks[tip]]] == "leftHand" for tip in tips)
        for sole in ("leftHeelSole", "leftBall", "leftBallOutside"):
            assert at[sole][1] < 0.015

    def test_the_palm_looks_to_the_body_and_the_back_of_the_hand_away(self, model, average):
        normal = np.zeros_like(average)
        for k in range(3):
            np.add.at(normal, model.faces[:, k], normals(average, model.faces))
        palm, back = normal[model.landmark("leftPalm")], normal[model.landmark("leftBackOfHand")]
        assert palm @ back < 0
        assert palm[0] < 0 < back[0], "the left palm looks to the right, where the body is"


def swapped(name):
    if name.startswith("left"):
        return "right" + name[4:]
    return "left" + name[5:] if name.startswith("right") else name


class TestSkeleton:
    def test_names_and_tree(self):
        skeleton = human().skeleton
        parent = {name: skeleton.names[p] for name, p in zip(skeleton.names[1:], skeleton.parents[1:], strict=True)}
        assert parent == TREE and skeleton.names[0] == "hips" and len(skeleton) == 52
        fingers = ("Thumb", "Index", "Middle", "Ring", "Little")
        assert [any(finger in name for finger in fingers) for name in skeleton.names] == [False] * 22 + [True] * 30
        ends = {skeleton.names[j] for j in skeleton.end_offsets}
        assert {"head", "leftToes", "rightToes", "leftIndexDistal", "rightThumbDistal"} <= ends and len(ends) == 13

    def test_regressor_is_an_average(self, model):
        regressor = model.shape.regressor
        assert (regressor >= 0).all() and np.allclose(regressor.sum(axis=1), 1, atol=1e-12)

    def test_weights(self, model):
        assert model.skin_weights.shape[1] == 4 and (model.skin_weights >= 0).all()
        assert np.allclose(model.skin_weights.sum(axis=1), 1, atol=1e-6)
        dense = np.zeros((len(model.mirror), 52))
        np.put_along_axis(dense, model.skin_columns, model.skin_weights, axis=1)
        swap = [model.joint_names.index(swapped(name)) for name in model.joint_names]
        assert np.allclose(dense[model.mirror][:, swap], dense, atol=1e-6)
        assert (dense.max(axis=0) > 0.4).all(), "a joint that leads nothing"

    @pytest.mark.parametrize("preset", PRESETS)
    def test_joints_lie_inside(self, preset, model):
        vertices = human_vertices(**PRESETS[preset])
        for name, point in zip(model.joint_names, model.joints(vertices), strict=True):
            assert winding(point, vertices, model.faces) == pytest.approx(1, abs=1e-3), name

    def test_rest_stands_on_the_floor_and_skins_to_itself(self):
        character = human(weight=0.9, height=1.6, age=0.3)
        vertices = character.mesh.vertices
        assert vertices[:, 1].min() == pytest.approx(0, abs=1e-12)
        hips = rest_pose(character.skeleton)[1][0]
        assert hips[[0, 2]] == pytest.approx([0, 0], abs=1e-12)
        assert np.abs(rest_vertices(character) - vertices).max() < 1e-5
        assert vertices[human_model().landmark("nose"), 2] > 0.05


class TestShapes:
    def test_deterministic(self):
        assert np.array_equal(human_vertices(weight=0.7, belly=0.3), human_vertices(belly=0.3, weight=0.7))

    @pytest.mark.parametrize("height", [0.5, 1.0, 1.6, 1.9, 2.6])
    @pytest.mark.parametrize("shape", [{}, {"age": 0.1}, {"weight": 1.7, "gender": 0.2}])
    def test_height_is_honoured(self, height, shape):
        assert np.ptp(human_vertices(height=height, **shape)[:, 1]) == pytest.approx(height, abs=1e-6)

    def test_within_its_range_height_is_not_mere_scaling(self, average):
        low, high = height_range()
        assert low < 1.35 and high > 2.1
        tall, natural = human_vertices(height=1.9), np.ptp(average[:, 1])
        assert np.abs(human_vertices(height=natural) - average).max() < 1e-4
        assert np.abs(tall / np.ptp(tall[:, 1]) - average / np.ptp(average[:, 1])).max() > 0.005
        beyond, end = human_vertices(height=high + 0.2), human_vertices(height=high)
        assert np.allclose(beyond / (high + 0.2), end / high, atol=1e-6)

    def test_factors_turn_the_right_way(self, model, average):
        def size(**shape):
            return volume(human_vertices(height=1.7, **shape), model.faces)

        assert size(weight=0.0) < size() < size(weight=1.0) < size(weight=2.0)
        breadth = [human_vertices(height=1.7, muscle=m)[model.landmark("leftShoulderTip"), 0] for m in (0.0, 0.5, 1.0)]
        assert breadth == sorted(breadth)
        assert np.ptp(human_vertices(age=0.0)[:, 1]) < np.ptp(human_vertices(age=0.1)[:, 1]) < np.ptp(average[:, 1])
        assert np.ptp(human_vertices(gender=0.0)[:, 1]) < np.ptp(human_vertices(gender=1.0)[:, 1])
        assert 0.04 < size(weight=0.5) < 0.09  # cubic metres of a grown-up

    def test_proportions_move_the_limbs_and_keep_the_middle(self, average):
        uncommon, ideal = human_vertices(proportions=0.0), human_vertices(proportions=1.0)
        assert np.linalg.norm(uncommon - average, axis=1).mean() > 0.003
        assert np.linalg.norm(ideal - average, axis=1).mean() > 0.003
        assert np.array_equal(human_vertices(proportions=0.5), average)

    def test_heads_of_toddlers_are_large(self, model):
        def share(**shape):
            vertices = human_vertices(**shape)
            return (vertices[model.landmark("crown"), 1] - vertices[model.landmark("chin"), 1]) / np.ptp(vertices[:, 1])

        assert share() < 0.15 < 0.19 < share(**PRESETS["toddler"])

    def test_continuous_across_the_levels(self):
        for name, at in (("age", 0.1875), ("age", 0.5), ("weight", 0.5), ("weight", 1.0), ("muscle", 0.5)):
            below, above = human_vertices(**{name: at - 1e-6}), human_vertices(**{name: at + 1e-6})
            assert np.abs(below - above).max() < 1e-4, name

    @pytest.mark.parametrize("preset", PRESETS)
    def test_presets_do_not_fold(self, preset, model, average):
        vertices = human_vertices(**PRESETS[preset])
        turned = (normals(vertices, model.faces) * normals(average, model.faces)).sum(axis=1) < 0
        assert turned.sum() <= FOLDED
        assert volume(vertices, model.faces) > 0

    def test_corners_of_the_shape_space_do_not_fold(self, model, average):
        for gender in (0.0, 1.0):
            for age in (0.0, 0.1875, 0.5, 1.0):
                for muscle in (0.0, 1.0):
                    for weight in (0.0, PARAMETERS["weight"][2]):
                        vertices = human_vertices(gender=gender, age=age, muscle=muscle, weight=weight)
                        turned = (normals(vertices, model.faces) * normals(average, model.faces)).sum(axis=1) < 0
                        assert turned.sum() <= FOLDED, (gender, age, muscle, weight)

    def test_presets_are_distinct(self):
        bodies = [human_vertices(**shape) for shape in PRESETS.values()]
        for i, one in enumerate(bodies):
            for other in bodies[:i]:
                assert np.linalg.norm(one - other, axis=1).mean() > 0.01

    def test_every_finer_component_does_something_both_ways(self, model, average):
        assert 20 <= len(model.detail_names) <= 60
        for name in model.detail_names:
            more, less = human_vertices(**{name: 1.0}), human_vertices(**{name: -1.0})
            for vertices in (more, less):
                assert np.linalg.norm(vertices - average, axis=1).max() > 0.002, name
                assert np.array_equal(vertices[model.mirror] * [-1, 1, 1], vertices)
            assert np.linalg.norm(more - less, axis=1).max() > 0.004, name

    @pytest.mark.parametrize(
        ("shape", "words"),
        [
            ({"wieght": 0.5}, "'weight'"),
            ({"weight": 2.5}, "from 0 to 2, received 2.5"),
            ({"weight": float("nan")}, "received nan"),
            ({"belly": -1.1}, "from -1 to 1"),
            ({"height": 170}, "from 0.4 to 3 metres"),
        ],
    )
    def test_wrong_parameters_are_named(self, shape, words):
        with pytest.raises(RetargetError, match=words):
            human_vertices(**shape)

    def test_unknown_places_are_named(self, model):
        with pytest.raises(RetargetError, match="leftPalm"):
            model.landmark("leftPlam")
        with pytest.raises(RetargetError, match="leftHand"):
            model.part_vertices("lefthand")


class TestSkinning:
    POSES = {
        "arms up": {"leftUpperArm": (0, 0, 110), "rightUpperArm": (0, 0, -110)},
        "sitting": {"leftUpperLeg": (-95, 0, 0), "rightUpperLeg": (-95, 0, 0), "leftLowerLeg": (95, 0, 0), "rightLowerLeg": (95, 0, 0)},
        "bent": {"spine": (30, 0, 0), "chest": (25, 0, 0), "upperChest": (15, 0, 0)},
        "looking": {"neck": (0, 30, 0), "head": (0, 40, 0)},
    }  # fmt: skip

    @pytest.mark.parametrize("preset", ["average", "heavy", "child", "muscular"])
    @pytest.mark.parametrize("pose", POSES)
    def test_poses_keep_the_volume(self, pose, preset, model):
        character = human(**PRESETS[preset])
        at_rest = volume(character.mesh.vertices, model.faces)
        assert volume(bent(character, self.POSES[pose]), model.faces) == pytest.approx(at_rest, rel=0.1)

    def test_a_turned_hand_leaves_the_body_alone(self, model):
        character = human()
        moved = np.linalg.norm(bent(character, {"leftHand": (0, 0, 40)}) - character.mesh.vertices, axis=1)
        parts = {model.part_names[p] for p in np.unique(model.vertex_parts[moved > 1e-4])}
        assert parts <= {"leftHand", "leftForearm"}

    def test_four_hundred_frames_a_second(self):
        character = human()
        rotations = np.broadcast_to(character.skeleton.rest_rotations, (200, 52, 4))
        motion = Motion(character.skeleton, rotations, np.zeros((200, 1, 3)))
        start = time.perf_counter()
        skin_motion(character, motion)
        assert 200 / (time.perf_counter() - start) > 400


class TestTexture:
    def test_textured_shows_the_same_surface(self):
        character = human(weight=0.9)
        shown = textured(character)
        assert np.array_equal(shown.mesh.vertices[shown.mesh.faces], character.mesh.vertices[character.mesh.faces])
        assert len(shown.mesh.vertices) < 1.15 * len(character.mesh.vertices)
        assert shown.mesh.uvs.min() >= 0 and shown.mesh.uvs.max() <= 1
        assert shown.mesh.materials[0].image.startswith(b"\x89PNG")

    def test_charts_hardly_ever_fold(self, model):
        (ax, ay), (bx, by), (cx, cy) = model.uvs[model.face_uvs].transpose(1, 2, 0)
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        assert (np.sign(area) != np.sign(np.median(area))).mean() < 0.01

    def test_another_topology_is_refused(self):
        with pytest.raises(RetargetError, match="topology"):
            textured(textured(human()))

    def test_colours_cover_every_region(self, model):
        names = [material.name for material in model.materials]
        assert set(np.unique(model.face_materials)) == set(range(len(names)))
        assert {"skin", "hair", "shirt", "shorts"} <= set(names)


def test_the_command_line_names_every_preset():
    from retarget.cli import PRESET_NAMES

    assert PRESET_NAMES.split() == list(PRESETS)
