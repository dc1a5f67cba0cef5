"""Laws of deformation transfer, and the paper's own system solved densely."""

from dataclasses import replace

import numpy as np
import pytest
from made_bodies import ball, box, joined
from scipy.spatial.transform import Rotation

from retarget.body.human import PRESETS, human
from retarget.body.skinning import rest_vertices, skin_motion
from retarget.errors import RetargetError
from retarget.motion.deformation_transfer import prepare_deformation_transfer
from retarget.motion.library import embedded_motion, performer

TURN = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
SHIFT = np.array([0.3, -0.2, 1.5])


@pytest.fixture(scope="module")
def source():
    return rest_vertices(performer()), performer().mesh.faces


@pytest.fixture(scope="module")
def posed():
    return skin_motion(performer(), embedded_motion("arms_crossed"))[::50]


@pytest.fixture(scope="module")
def target():
    return rest_vertices(human(**PRESETS["heavy"]))


def bent(points, by=0.6):
    """The plane x-y rolled up around z: every gradient is another."""
    angle, radius = by * points[..., 0], 1 / by + points[..., 1]
    return np.stack([radius * np.sin(angle), radius * np.cos(angle) - 1 / by, 1.3 * points[..., 2]], axis=-1)


def patch(columns=5, rows=5, seed=0):
    """An uneven sheet of 2·columns·rows triangles, and another with the same faces."""
    generator = np.random.default_rng(seed)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(columns + 1.0), np.arange(rows + 1.0), indexing="ij"))
    one = np.stack([x, y, 0.2 * x * y], axis=1) + generator.normal(scale=0.15, size=(len(x), 3))
    other = np.stack([1.5 * x, y - 0.1 * x, np.sin(x)], axis=1) + generator.normal(scale=0.15, size=(len(x), 3))
    corner = np.array([i * (rows + 1) + j for i in range(columns) for j in range(rows)])
    up, right = corner + 1, corner + rows + 1
    faces = np.concatenate([np.stack([corner, right, up], axis=1), np.stack([right, right + 1, up], axis=1)])
    return one, other, faces


def with_fourth(vertices, faces):
    """Edges and the way to the fourth vertex as columns (Sumner and Popović 2004, equation 1)."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    normal = np.cross(b - a, c - a)
    fourth = normal / np.sqrt(np.linalg.norm(normal, axis=1, keepdims=True))
    return np.stack([b - a, c - a, fourth], axis=2)


def as_the_paper_has_it(one, other, faces, pose):
    """Vertices and fourth vertices together, by dense least squares."""
    wanted = with_fourth(pose, faces) @ np.linalg.inv(with_fourth(one, faces))
    inverse = np.linalg.inv(with_fourth(other, faces))
    system = np.zeros((3 * len(faces), len(one) + len(faces)))
    for number, (face, rows) in enumerate(zip(faces, inverse)):
        for column, vertex in enumerate([face[1], face[2], len(one) + number]):
            system[3 * number : 3 * number + 3, vertex] += rows[column]
            system[3 * number : 3 * number + 3, face[0]] -= rows[column]
    return np.linalg.lstsq(system, wanted.transpose(0, 2, 1).reshape(-1, 3), rcond=None)[0][: len(one)]


@pytest.mark.parametrize("seed", range(3))
def test_agrees_with_the_papers_own_system(seed):
    one, other, faces = patch(seed=seed)
    pose = bent(one) + np.random.default_rng(seed).normal(scale=0.1, size=one.shape)
    expected = as_the_paper_has_it(one, other, faces, pose)
    found = prepare_deformation_transfer(one, other, faces).frames(pose[None])[0]
    assert np.abs((found - found.mean(axis=0)) - (expected - expected.mean(axis=0))).max() < 1e-8


def test_the_same_body_gets_the_same_motion(source, posed):
    rest, faces = source
    assert np.abs(prepare_deformation_transfer(rest, rest, faces).frames(posed) - posed).max() < 1e-6


def test_rest_gives_rest(source, target):
    rest, faces = source
    assert np.abs(prepare_deformation_transfer(rest, target, faces).frames(rest[None])[0] - target).max() < 1e-6


def test_a_body_of_another_size_gets_the_motion_in_that_size(source, posed):
    rest, faces = source
    found = prepare_deformation_transfer(rest, 1.7 * rest, faces).frames(posed)
    assert np.abs(found - 1.7 * posed).max() < 1e-6


def test_a_rigid_motion_stays_one(source, target):
    rest, faces = source
    transfer = prepare_deformation_transfer(rest, target, faces)
    found = transfer.frames((rest @ TURN.T + SHIFT)[None])[0]
    assert transfer.scale == pytest.approx(np.ptp(target[:, 1]) / np.ptp(rest[:, 1]))
    assert np.abs(found - (target @ TURN.T + transfer.scale * SHIFT)).max() < 1e-6


def test_a_turned_source_gives_the_turned_result(source, target, posed):
    rest, faces = source
    transfer = prepare_deformation_transfer(rest, target, faces)
    assert np.abs(transfer.frames(posed @ TURN.T) - transfer.frames(posed) @ TURN.T).max() < 1e-6


def test_near_to_what_the_targets_own_skin_does(source, target, posed):
    rest, faces = source
    motion = replace(embedded_motion("arms_crossed"), skeleton=human(**PRESETS["heavy"]).skeleton)
    own = skin_motion(human(**PRESETS["heavy"]), motion)[::50]
    found = prepare_deformation_transfer(rest, target, faces).frames(posed)
    apart = (found - found.mean(axis=1, keepdims=True)) - (own - own.mean(axis=1, keepdims=True))
    assert np.sqrt((apart**2).sum(axis=2).mean(axis=1)).max() < 0.01  # metres; bodies that are not moved: 0.2 and more


def test_frames_do_not_depend_on_each_other(source, target, posed):
    rest, faces = source
    transfer = prepare_deformation_transfer(rest, target, faces)
    assert np.array_equal(transfer.frames(posed)[1:2], transfer.frames(posed[1:2]))
    assert transfer.frames(posed[:0]).shape == (0, len(rest), 3)


def split(faces):
    """Every face with corners of its own: which vertex each is a copy of, and the faces of the copies."""
    return faces.ravel(), np.arange(faces.size).reshape(-1, 3)


def test_vertices_doubled_along_seams_change_nothing(source, target, posed):
    rest, faces = source
    whole = prepare_deformation_transfer(rest, target, faces).frames(posed)
    shuffled = np.random.default_rng(0).permutation(len(faces))
    torn = faces.copy()
    torn[shuffled[:4000]] += len(rest)  # these use copies: seams all over the body
    twice = prepare_deformation_transfer(*(np.concatenate([each, each]) for each in (rest, target)), torn)
    assert (twice.piece == 0).all()
    found = twice.frames(np.concatenate([posed, posed], axis=1))
    assert np.abs(found - np.concatenate([whole, whole], axis=1)).max() < 1e-6


def test_a_soup_of_triangles_is_a_surface_where_it_touches():
    one, other, faces = patch()
    copy_of, soup = split(faces)
    transfer, pose = prepare_deformation_transfer(one[copy_of], other[copy_of], soup), bent(one)
    assert len(transfer.first) == len(one)
    whole = prepare_deformation_transfer(one, other, faces).frames(pose[None])[0]
    assert np.abs(transfer.frames(pose[copy_of][None])[0] - whole[copy_of]).max() < 1e-8


def test_what_touches_on_one_body_only_stays_two():
    one, other, faces = patch()
    both = np.concatenate([one, one]), np.concatenate([other, other + [9.0, 0.0, 0.0]])
    transfer = prepare_deformation_transfer(*both, np.concatenate([faces, faces + len(one)]))
    assert len(transfer.first) == 2 * len(one)
    found = transfer.frames(np.concatenate([one, one])[None])[0]
    assert np.abs(found - both[1]).max() < 1e-8


def test_what_touches_at_rest_comes_apart_as_on_the_source():
    one, other, faces = patch()
    slid = one + [0.0, 0.0, 0.4]
    both = [np.concatenate([each, each]) for each in (one, other)]
    joint, pose = np.concatenate([faces, faces + len(one)]), np.concatenate([one, slid])
    transfer = prepare_deformation_transfer(*both, joint, 2.0)
    found = transfer.frames(pose[None])[0]
    assert np.abs(found[len(one) :] - found[: len(one)] - [0.0, 0.0, 0.8]).max() < 1e-9
    apart = prepare_deformation_transfer(*both, joint, 2.0, np.arange(len(pose)))
    assert apart.piece.max() == 1 and transfer.piece.max() == 0


@pytest.fixture(scope="module")
def in_pieces():
    """A ball, a small box just beside it, another far off, and a vertex without faces; and the same with a bigger ball."""
    near, far = box([1.05, -0.1, -0.1], [1.25, 0.1, 0.1]), box([-0.1, 2.0, -0.1], [0.1, 2.2, 0.1])
    vertices, faces = joined(near, ball(12, 24), far)
    rest = np.concatenate([vertices, [[0.0, 0.0, 1.5]]])
    other = rest.copy()
    other[8:-9] *= 2.0
    other[:8, 0] += 1.0
    other[-9:-1, 1] += 1.0
    other[-1, 2] += 1.0
    return rest, other, faces, np.arange(8, len(rest) - 9)


def test_pieces_move_as_on_the_source_where_the_bodies_are_one(in_pieces):
    rest, _, faces, _ = in_pieces
    pose = bent(rest, 0.3)
    pose[:8] += [0.5, 0.1, 0.0]  # the near box slides about on its own
    assert np.abs(prepare_deformation_transfer(rest, rest, faces).frames(pose[None])[0] - pose).max() < 1e-6


def test_pieces_keep_their_rest_offset_from_the_main_one(in_pieces):
    rest, other, faces, middle = in_pieces
    transfer = prepare_deformation_transfer(rest, other, faces)
    assert set(np.flatnonzero(transfer.piece == 0)) == set(middle)
    near, far = other[transfer.anchors.vertices[:2]]
    assert near[0] == pytest.approx(2.05) and far[1] == pytest.approx(3.0)
    assert np.abs(transfer.frames(rest[None])[0] - other).max() < 1e-9
    found = transfer.frames((rest @ TURN.T + SHIFT)[None])[0]
    assert np.abs(found - (other @ TURN.T + transfer.scale * SHIFT)).max() < 1e-9
    assert (
        np.abs(transfer.frames(1.5 * rest[None])[0] - 1.5 * other).max() < 1e-9
    )  # offsets grow with the surface below


def test_turning_pieces_turns_the_result(in_pieces):
    rest, other, faces, _ = in_pieces
    transfer, pose = prepare_deformation_transfer(rest, other, faces), bent(rest, 0.3)
    one, turned = transfer.frames(np.stack([pose, pose @ TURN.T]))
    assert np.abs(turned - one @ TURN.T).max() < 1e-8


def test_scale_can_be_told_and_does_not_stretch(source, target, posed):
    rest, faces = source
    one, other = (prepare_deformation_transfer(rest, target, faces, scale).frames(posed) for scale in (1.0, 3))
    apart = other - one
    assert np.abs(apart - apart.mean(axis=1, keepdims=True)).max() < 1e-9
    assert np.abs(apart).max() > 0.01


def flattened():
    """A patch whose first face has its corners in a line, and whose last has them at one place, with a face that names one
    vertex twice."""
    one, other, faces = patch()
    spare = len(one)
    line = [faces[0, 0], faces[0, 1], spare]
    point = [faces[-1, 0], spare + 1, spare + 2]
    faces = np.concatenate([faces, [line, point, [faces[3, 0], faces[3, 1], faces[3, 1]]]])

    def with_spares(vertices):
        middle, corner = vertices[faces[0, :2]].mean(axis=0), vertices[point[0]]
        return np.concatenate([vertices, [middle, corner, corner]])

    return one, other, faces, with_spares


@pytest.mark.parametrize("welded", [None, np.arange(39)], ids=["welded", "apart"])
def test_triangles_without_area_are_counted_and_harmless(welded):
    one, other, faces, with_spares = flattened()
    transfer = prepare_deformation_transfer(with_spares(one), with_spares(other), faces, welded=welded)
    assert (transfer.flat_source, transfer.flat_target) == (3, 3)
    assert np.abs(transfer.frames(with_spares(one)[None])[0] - with_spares(other)).max() < 1e-8
    pose = bent(one)
    found = transfer.frames(with_spares(pose)[None])[0]
    assert np.isfinite(found).all()
    assert (
        np.abs(found - with_spares(found[: len(one)])).max() < 0.01
    )  # the spares stay where they were, on patches of 5 x 5
    transfer = prepare_deformation_transfer(with_spares(one), with_spares(one), faces, welded=welded)
    same = transfer.frames(with_spares(pose)[None])[0]
    assert np.abs(same - with_spares(pose)).max() < 1e-6


def test_a_point_that_is_one_but_for_rounding_tells_nothing():
    one, other, faces, with_spares = flattened()
    noise = np.random.default_rng(0).normal(scale=1e-14, size=(3, len(one) + 3, 3))
    transfer = prepare_deformation_transfer(
        with_spares(one) + noise[0], with_spares(other) + noise[1], faces, None, np.arange(39)
    )
    assert transfer.flat_source == 3
    found = transfer.frames((with_spares(bent(one)) + noise[2])[None])[0]
    assert np.abs(found - with_spares(found[: len(one)])).max() < 0.01


def test_a_triangle_without_area_asks_its_own_piece():
    one, other, faces = patch()
    speck = one[faces[10]].mean(axis=0) + np.array(
        [[0, 0, 0], [1e-10, 0, 0], [0, 1e-10, 0]]
    )  # in the midst of the patch
    second = np.concatenate([speck, speck[0] + [[9.0, 0.0, 0.0], [9.0, 1.0, 0.0]]])
    grown = np.concatenate([speck[0] + 1e10 * (speck - speck[0]), second[3:]])  # no longer a speck on the target
    joint = np.concatenate([faces, len(one) + np.array([[0, 1, 2], [0, 3, 4]])])
    transfer = prepare_deformation_transfer(np.concatenate([one, second]), np.concatenate([other, grown]), joint)
    assert transfer.flat_source == 1
    found = transfer.frames(np.concatenate([bent(one, 0.9), (second - speck[0]) @ TURN.T])[None])[0, len(one) :]
    assert np.abs(found - found[0] - (grown - grown[0]) @ TURN.T).max() < 1e-6


def test_needles_are_not_the_main_piece():
    one, other, faces = patch()
    needle = np.array([[0.0, 0.0, 5.0], [2000.0, 0.0, 5.0], [0.0, 0.15, 5.0]])
    both = [np.concatenate([needle, vertices]) for vertices in (one, other)]
    transfer = prepare_deformation_transfer(*both, np.concatenate([[[0, 1, 2]], faces + 3]))
    assert (transfer.piece[:3] == 1).all()
    assert np.abs(transfer.frames(both[0][None])[0] - both[1]).max() < 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_a_flat_sheet_is_turned_not_mirrored(seed):
    one, _, faces = patch()
    one[:, 2] = 0.0
    other = one + [0.0, 0.0, 3.0]
    turn = Rotation.random(random_state=seed).as_matrix()
    found = prepare_deformation_transfer(one, other, faces).frames((one @ turn.T)[None])[0]
    assert np.abs(found - other @ turn.T).max() < 1e-8


def test_a_triangle_flat_on_one_body_only_is_no_fault():
    one, other, faces = patch()
    squashed = other.copy()
    squashed[faces[7, 2]] = other[faces[7, :2]].mean(axis=0)
    for source, target, counts in ((one, squashed, (0, 1)), (squashed, one, (1, 0))):
        transfer = prepare_deformation_transfer(source, target, faces)
        assert (transfer.flat_source, transfer.flat_target) == counts
        found = transfer.frames(np.stack([source, bent(source)]))
        assert np.abs(found[0] - target).max() < 1e-8
        assert np.abs(found[1]).max() < 20


def test_a_pose_without_area_is_finite(source, target):
    rest, faces = source
    found = prepare_deformation_transfer(rest, target, faces).frames(np.zeros((1, len(rest), 3)))
    assert np.isfinite(found).all()
    assert np.ptp(found[0], axis=0).max() < 1e-6


def test_triangles_of_all_sizes_at_once():
    one, other, faces = patch()
    sizes = [1e-4, 1.0, 1e4]
    count = len(one)
    both = [np.concatenate([vertices * size + 3 * size for size in sizes]) for vertices in (one, other)]
    joint = np.concatenate([faces + count * n for n in range(3)])
    transfer = prepare_deformation_transfer(*both, joint, welded=np.arange(3 * count))
    found = transfer.frames(np.stack([both[0], bent(both[0], 1e-3)]))
    assert np.abs(found[0] - both[1]).max() < 1e-6
    assert np.isfinite(found[1]).all()


ONE, OTHER, FACES = patch()
BROKEN = ONE.copy()
BROKEN[[4, 9], 1] = np.nan
LINE = ONE * [1.0, 0.0, 0.0]


@pytest.mark.parametrize(
    "arguments, words",
    [
        ((ONE, OTHER[:-1], FACES), "source has 36 vertices, the target 35"),
        ((ONE, OTHER, FACES[:0]), "no faces"),
        ((ONE, OTHER, FACES + 1), "names vertex 36; there are 36"),
        ((ONE, OTHER, FACES - 1), "names vertex -1"),
        ((BROKEN, OTHER, FACES), "source's rest pose is not finite at 2 vertices, the first of them 4"),
        ((ONE, BROKEN, FACES), "target's rest pose is not finite"),
        ((LINE, OTHER, FACES, 1.0), "none of the source's 50 triangles has an area"),
        ((ONE, 0 * OTHER, FACES, 1.0), "corners at one place"),
        ((ONE[:, [0, 2, 1]] * [1, 0, 1], OTHER, FACES), "heights along \\+Y are 0 m"),
        ((ONE, OTHER, FACES, 1.0, np.arange(35)), "`welded` has 35 entries; the bodies have 36"),
        ((ONE, OTHER, FACES, 0.0), "scale is 0.0"),
        ((ONE, OTHER, FACES, float("nan")), "scale is nan"),
    ],
)
def test_bad_bodies_are_refused(arguments, words):
    with pytest.raises(RetargetError, match=words):
        prepare_deformation_transfer(*arguments)


def test_bad_poses_are_refused():
    transfer = prepare_deformation_transfer(ONE, OTHER, FACES)
    with pytest.raises(RetargetError, match=r"shape \(2, 35, 3\); the bodies need \(frames, 36, 3\)"):
        transfer.frames(np.zeros((2, 35, 3)))
    with pytest.raises(RetargetError, match="frame 1 of the source is not finite at 2 vertices"):
        transfer.frames(np.stack([ONE, BROKEN]))
