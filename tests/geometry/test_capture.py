"""The virtual scanner: points where the surface is, seen from where the cameras stand, with the faults asked for and no
others."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from retarget.body.human import human
from retarget.errors import RetargetError
from retarget.geometry import capture
from retarget.geometry.capture import Scanner, prepare_studio, scan
from retarget.geometry.capture_kernels import look, readings
from retarget.geometry.sampling import sample_surface

BODY = human().mesh
CLEAN = Scanner(noise=0.0, steps=0.0)
WALL = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
SQUARE = np.array([[0, 1, 2], [0, 2, 3]])


def scanned(scanner, seed=0):
    return scan(BODY.vertices, BODY.faces, scanner, seed).astype(float)


def off_the_surface(points):
    """Distances to a dense sample of the body, metres: about 1 mm where a point lies on it."""
    return cKDTree(sample_surface(BODY.vertices, BODY.faces, 200_000)).query(points)[0]


def test_a_clean_scan_lies_on_the_surface_and_covers_it():
    points = scanned(CLEAN)
    assert points.shape == (6890, 3) and np.quantile(off_the_surface(points), 0.999) < 0.005
    covered = cKDTree(points).query(sample_surface(BODY.vertices, BODY.faces, 3000))[0]
    assert np.quantile(covered, 0.9) < 0.03


def test_one_camera_sees_the_side_that_faces_it():
    front, back = scanned(replace(CLEAN, cameras=1)), scanned(replace(CLEAN, cameras=1, azimuth=np.pi))
    chest = lambda points: points[(np.abs(points[:, 1] - 1.2) < 0.05) & (np.abs(points[:, 0]) < 0.1), 2]  # noqa: E731
    assert chest(front).min() > chest(back).max() + 0.05
    assert np.ptp(front[:, 1]) > 0.98 * np.ptp(BODY.vertices[:, 1])


def test_what_stands_behind_is_not_seen():
    two = np.concatenate([WALL + [0, 0, 1], 0.5 * WALL])
    points = scan(two, np.concatenate([SQUARE, SQUARE + 4]), replace(CLEAN, cameras=1, points=None, pixel=0.02))
    assert len(points) and points[:, 2].min() > 0.99


def test_the_nearest_triangle_wins_and_depth_is_right_in_perspective():
    places = np.array([[0.0, 0, 1], [8, 0, 4], [0, 8, 4], [0, 0, 9], [8, 0, 9], [0, 8, 9], [0, 0, -1.0]])
    nearness, owner = np.zeros((8, 8)), np.full((8, 8), -1)
    look(places, np.array([[3, 4, 5], [0, 1, 2], [6, 4, 5], [0, 0, 1]]), 0.0, 0.0, nearness, owner)
    assert owner[0, 0] == 1 and owner[7, 7] == -1 and (owner >= 0).sum() == 36  # the middles on the long side too
    share = 4.5 / 8  # of the way along the upper edge, at column 4
    assert 1 / nearness[0, 4] == pytest.approx(1 / ((1 - share - 0.5 / 8) + (share + 0.5 / 8) / 4))


def test_facing_is_the_cosine_to_the_ray():
    depth, focal = 2.0, 10.0
    world = np.array([[0.0, 0, depth], [1, 0, depth + 1], [0, 1, depth]])  # turned by 45 degrees about the upright
    placed = np.concatenate([world[:, :2] / world[:, 2:] * focal, world[:, 2:]], axis=1)
    out = readings(
        placed, np.array([[0, 1, 2]]), np.full((1, 1), 1 / depth), np.zeros((1, 1), np.int64), focal, -0.5, -0.5
    )
    assert out.tolist() == [[0.0, 0.0, depth, np.inf, pytest.approx(np.sqrt(0.5)), 0.0]]


def test_what_lies_behind_a_pixel_is_the_farthest_around_it():
    nearness = np.array([[1.0, 0.5, 1], [0.25, 1, 0.2], [1, 1, 1]])
    out = readings(
        np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]]),
        np.array([[0, 1, 2]]),
        nearness,
        np.zeros((3, 3), np.int64),
        1.0,
        0.0,
        0.0,
    )
    assert out[4].tolist() == [1.5, 1.5, 1.0, 5.0, pytest.approx(1 / np.sqrt(5.5)), 0.0]
    assert np.isinf(np.delete(out[:, 3], 4)).all(), "nothing is beside the picture"


def test_noise_is_what_was_asked_for_and_grows_with_the_square_of_the_distance():
    wall = replace(CLEAN, cameras=1, points=None, pixel=0.01, noise=0.01)
    studio = prepare_studio(wall, WALL, SQUARE)
    middle = studio.eyes[0] + studio.middle * studio.axes[0, 2]
    spread = {}
    for far in (1.0, 2.0):
        moved = (
            studio.eyes[0]
            + far * (middle - studio.eyes[0])
            + 0.05 * WALL @ np.stack([studio.axes[0, 0], studio.axes[0, 1], studio.axes[0, 2]])
        )
        points = studio.scan(moved, SQUARE, 1)
        spread[far] = np.std((points - studio.eyes[0]) @ studio.axes[0, 2])
    assert spread[1.0] == pytest.approx(0.01, rel=0.15) and spread[2.0] / spread[1.0] == pytest.approx(4.0, rel=0.25)


def test_steps_are_even_in_disparity():
    studio = prepare_studio(replace(CLEAN, cameras=1, points=None, pixel=0.004, steps=0.02), BODY.vertices, BODY.faces)
    depth = (studio.scan(BODY.vertices, BODY.faces).astype(float) - studio.eyes[0]) @ studio.axes[0, 2]
    steps = (1 / depth) * studio.middle**2 / 0.02
    assert np.abs(steps - steps.round()).max() < 1e-2 and len(np.unique(steps.round())) < 60


def test_cameras_are_misplaced_alike_on_every_frame():
    scanner = replace(CLEAN, cameras=1, points=None, misplaced=0.05)
    studio = prepare_studio(scanner, BODY.vertices, BODY.faces, 5)
    straight = prepare_studio(replace(scanner, misplaced=0.0), BODY.vertices, BODY.faces, 5)
    shifts = [
        np.sort(studio.scan(BODY.vertices, BODY.faces, seed), axis=0)
        - np.sort(straight.scan(BODY.vertices, BODY.faces, seed), axis=0)
        for seed in (1, 2)
    ]
    assert np.allclose(shifts[0], studio.believed[0] - studio.eyes[0], atol=1e-6) and np.allclose(
        shifts[0], shifts[1], atol=1e-6
    )
    assert np.linalg.norm(shifts[0][0]) > 0.005


def test_holes_take_points_and_leave_what_stays():
    whole = replace(CLEAN, points=None, pixel=0.01)
    counts = [
        np.mean([len(scanned(replace(whole, holes=amount), seed)) for seed in range(5)]) for amount in (0.0, 0.3, 1.0)
    ]
    assert 1.0 > counts[1] / counts[0] > 0.75 and 0.75 > counts[2] / counts[0] > 0.3
    assert np.quantile(off_the_surface(scanned(replace(whole, holes=1.0))), 0.999) < 0.005
    holed = scanned(replace(whole, holes=1.0, cameras=1))
    gaps = cKDTree(holed).query(scanned(replace(whole, cameras=1)))[0]
    assert np.quantile(gaps, 0.95) > 0.03, "blobs, and not only thinner"


@pytest.mark.parametrize(("degrees", "seen"), [(0, True), (60, True), (86, False)])
def test_a_surface_that_turns_away_is_not_read(degrees, seen):
    turn = np.radians(degrees)
    wall = WALL @ np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    scanner = replace(CLEAN, cameras=1, points=None, pixel=0.01)
    whole, holed = (len(scan(wall, SQUARE, each)) for each in (scanner, replace(scanner, holes=1e-9)))
    assert whole > 50 and holed == (whole if seen else 0)


def test_outliers_fly_behind_edges():
    flying = scanned(replace(CLEAN, points=None, outliers=0.5))
    away = off_the_surface(flying) > 0.02
    assert 0.005 < away.mean() < 0.2
    astray = off_the_surface(scanned(replace(CLEAN, points=None, pixel=0.004, outliers=1.0))) > 0.3
    assert 10 < astray.sum() < 200, "some stray anywhere"
    assert np.abs(flying - 0.5 * (BODY.vertices.min(axis=0) + BODY.vertices.max(axis=0))).max() < 1.5


def test_floor_is_left_around_the_feet():
    with_floor = scanned(replace(CLEAN, floor=True), 2)
    floor = with_floor[off_the_surface(with_floor) > 0.02]
    assert 50 < len(floor) < 4000 and np.abs(floor[:, 1]).max() < 0.005
    walk = np.stack([BODY.vertices + [x, 0, 0] for x in (-3.0, 0.0, 3.0)])
    around = prepare_studio(replace(CLEAN, floor=True), walk, BODY.faces, 2).scan(walk[1], BODY.faces)
    assert np.abs(around[:, [0, 2]]).max() < 1.0, "what lies along the way is cut off"
    level = prepare_studio(replace(CLEAN, floor=True), BODY.vertices, BODY.faces, 2, floor=-0.2)
    assert np.allclose(level.floor_vertices[:, 1], -0.2)


@pytest.mark.parametrize("scanner", [Scanner(), Scanner(holes=0.5, outliers=0.5, floor=True, misplaced=0.01)])
def test_the_same_seed_gives_the_same_points(scanner):
    assert np.array_equal(scanned(scanner, 7), scanned(scanner, 7))
    assert not np.array_equal(scanned(scanner, 7), scanned(scanner, 8))


@pytest.mark.parametrize("points", [500, 50_000])
def test_as_many_points_as_wanted(points):
    assert len(scanned(Scanner(points=points))) == points


def test_cameras_stand_outside_what_moves():
    frames = np.stack([BODY.vertices + [x, 0, 0] for x in (0.0, 2.0, 4.0)])
    studio = prepare_studio(Scanner(cameras=8), frames, BODY.faces)
    assert np.linalg.norm(
        studio.eyes - (frames.min(axis=(0, 1)) + frames.max(axis=(0, 1))) / 2, axis=1
    ) == pytest.approx(studio.middle)
    assert cKDTree(frames.reshape(-1, 3)).query(studio.eyes)[0].min() > 1.0
    for frame in frames:
        assert len(studio.scan(frame, BODY.faces)) == 6890


def test_no_faces_no_points():
    studio = prepare_studio(Scanner(), BODY.vertices, BODY.faces)
    assert studio.scan(BODY.vertices, np.zeros((0, 3), np.int64)).shape == (0, 3)


@pytest.mark.parametrize(
    "wrong",
    [{"cameras": 0}, {"cameras": 65}, {"points": 0}, {"pixel": 0.0}, {"noise": -1.0}, {"steps": np.nan},
     {"misplaced": np.inf}, {"holes": 1.5},
     {"outliers": -0.1}, {"azimuth": np.nan}],
)  # fmt: skip
def test_settings_are_checked(wrong):
    with pytest.raises(RetargetError, match="scanner|pixel|length|share|angle"):
        Scanner(**wrong)


def test_what_cannot_be_scanned_is_told(monkeypatch):
    holed = BODY.vertices.copy()
    holed[3] = np.nan
    studio = prepare_studio(Scanner(), BODY.vertices, BODY.faces)
    for call in (lambda: prepare_studio(Scanner(), holed, BODY.faces), lambda: studio.scan(holed, BODY.faces)):
        with pytest.raises(RetargetError, match="not finite cannot be scanned"):
            call()
    with pytest.raises(RetargetError, match="without area cannot be scanned"):
        prepare_studio(Scanner(), BODY.vertices, BODY.faces[:0])
    monkeypatch.setattr(capture, "MOST_PIXELS", 100)
    with pytest.raises(RetargetError, match="pixels is too large"):
        studio.scan(BODY.vertices, BODY.faces)
