"""Surface metrics against values worked out by hand."""

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.errors import RetargetError
from retarget.evaluate.metrics import mdel, mpvd, pa_mpvd, volume_error_percent

# A cube of side 1 with its corners numbered 4x + 2y + z, every face turned outward.
CUBE = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
CUBE_FACES = np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]])


def cloud(seed, frames=3, points=40):
    return np.random.default_rng(seed).normal(size=(frames, points, 3))


def turned(points):
    """The whole world moved."""
    return rot.rotate(rot.from_rotation_vector(np.array([0.4, -1.1, 0.3])), points) + [10.0, -20.0, 30.0]


METRICS = pytest.mark.parametrize("compare", [mpvd, pa_mpvd, mdel])


@METRICS
def test_zero_on_identity(compare):
    assert compare(cloud(0), cloud(0)) == pytest.approx(0, abs=1e-14)


@METRICS
def test_neither_the_world_nor_the_order_counts(compare):
    wanted = compare(cloud(0), cloud(1))
    assert compare(turned(cloud(0)), turned(cloud(1))) == pytest.approx(wanted, rel=1e-9)
    order = np.random.default_rng(5).permutation(40)
    assert compare(cloud(0)[:, order], cloud(1)[:, order]) == pytest.approx(wanted, rel=1e-12)


@METRICS
def test_a_larger_error_reads_larger(compare):
    read = [compare(cloud(0) + size * cloud(1), cloud(0)) for size in (0.001, 0.002, 0.004, 0.008)]
    assert read == sorted(read) and read[3] > 1.5 * read[2]


def test_vertex_distance_by_hand():
    truth, result = np.zeros((2, 4, 3)), np.zeros((2, 4, 3))
    result[1, 2] = [0.0, 0.08, 0.06]
    assert mpvd(result, truth) == pytest.approx(0.1 / 8)
    corners = 2 * (CUBE[None] - 0.5)
    assert pa_mpvd(turned(1.1 * corners), corners) == pytest.approx(0.1 * np.sqrt(3)), (
        "size stays, place does not count"
    )


@pytest.mark.parametrize("compare", [pa_mpvd, mdel])
def test_a_rigid_error_of_each_frame_is_forgiven(compare):
    turns = rot.normalise(np.random.default_rng(2).normal(size=(3, 1, 4)))
    assert compare(rot.rotate(turns, cloud(0)) + cloud(3, points=1), cloud(0)) == pytest.approx(0, abs=1e-12)


def test_edge_lengths_by_hand():
    line = np.zeros((1, 7, 3))
    line[0, :, 0] = np.arange(7)  # seven points: each one's neighbours are the six others
    distances = np.abs(np.subtract.outer(np.arange(7), np.arange(7)))
    assert mdel(1.25 * line, line) == pytest.approx(0.25 * distances.sum() / 42)
    bent = line.copy()
    bent[0, 6] = [5, 1, 0]  # the last point swings round its neighbour
    changes = [abs(np.hypot(5 - k, 1) - (6 - k)) for k in range(6)]
    assert mdel(bent, line) == pytest.approx(2 * sum(changes) / 42)


def test_edges_are_those_of_the_truth():
    truth, result = cloud(0), cloud(1)
    brute = []
    for made, right in zip(result, truth):
        lengths = np.linalg.norm(right[:, None] - right, axis=-1)
        near = np.argsort(lengths, axis=1)[:, 1:7]
        now = np.linalg.norm(made[:, None] - made, axis=-1)
        brute.append(np.abs(np.take_along_axis(now - lengths, near, axis=1)).mean())
    assert mdel(result, truth) == pytest.approx(np.mean(brute), rel=1e-12)


def test_edges_sought_at_rest_do_not_cross_a_contact():
    finger = np.random.default_rng(4).uniform(size=(10, 3))
    rest = np.concatenate([finger, finger + [50.0, 0, 0]])
    posed = np.concatenate([finger, finger + [0.05, 0, 0]])[None]  # two fingers laid against each other
    parted = np.concatenate([finger, finger + [0.15, 0, 0]])[None]
    assert mdel(parted, posed, rest=rest) == pytest.approx(0, abs=1e-12)
    assert mdel(parted, posed) > 0.01


def test_points_that_coincide_do_not_become_their_own_neighbours():
    rest = np.zeros((8, 3))
    rest[7] = [1.0, 0, 0]
    result = rest.copy()
    result[0] = [0.0, 0.6, 0]  # leaves its six twins, an edge each way; the eighth point may have an edge to it too
    read = mdel(result[None], rest[None])
    assert 12 * 0.6 / 48 - 1e-12 <= read <= (12 * 0.6 + np.hypot(1, 0.6) - 1) / 48 + 1e-12


def test_too_few_points():
    with pytest.raises(RetargetError, match="more than 6 points, received 6"):
        mdel(cloud(0, points=6), cloud(0, points=6))


def two_cubes(sizes):
    """Two cubes apart, each scaled along x."""
    return np.concatenate([CUBE * [sizes[0], 1, 1], CUBE * [sizes[1], 1, 1] + [5.0, 0, 0]])


PARTS = [CUBE_FACES, CUBE_FACES + 8]


def test_volumes_by_hand():
    truth = two_cubes([1, 2])[None]
    result = np.stack([two_cubes([1, 2]), two_cubes([1.1, 1.0]), two_cubes([0.7, 4])])
    wanted = [[0, 0], [10, 50], [30, 100]]
    np.testing.assert_allclose(volume_error_percent(result, truth, PARTS), wanted, atol=1e-10)
    np.testing.assert_allclose(volume_error_percent(result, result[[0, 0, 0]], PARTS), wanted, atol=1e-10)
    np.testing.assert_allclose(volume_error_percent(result, result, PARTS), 0)
    inward = [faces[:, ::-1] for faces in PARTS]
    np.testing.assert_allclose(volume_error_percent(result, truth, inward), wanted, atol=1e-10)


def test_volumes_do_not_depend_on_the_place():
    truth, result = two_cubes([1, 2])[None], two_cubes([1.1, 1.0])[None]
    far = volume_error_percent(turned(result) + 1e5, truth, PARTS)
    np.testing.assert_allclose(far, [[10, 50]], atol=1e-4)


def test_parts_that_have_no_volume_are_refused():
    truth = two_cubes([1, 1])[None]
    with pytest.raises(RetargetError, match="part 1 is not closed: 3 edges"):
        volume_error_percent(truth, truth, [CUBE_FACES, CUBE_FACES[1:]])
    with pytest.raises(RetargetError, match="part 0 is not closed"):
        flipped = np.concatenate([CUBE_FACES[:1, ::-1], CUBE_FACES[1:]])
        volume_error_percent(truth, truth, [flipped])
    with pytest.raises(RetargetError, match="part 0 has no volume"):
        volume_error_percent(truth, truth * [1, 0, 1], [CUBE_FACES])
    with pytest.raises(RetargetError, match="part 0 has no faces"):
        volume_error_percent(truth, truth, [CUBE_FACES[:0]])
    with pytest.raises(RetargetError, match="truth has 2 frames"):
        volume_error_percent(np.concatenate([truth] * 3), np.concatenate([truth] * 2), PARTS)
    needle = np.concatenate([CUBE_FACES, [[0, 0, 1]]])  # a face without area closes nothing and opens nothing
    np.testing.assert_allclose(volume_error_percent(truth, truth, [needle]), 0)
