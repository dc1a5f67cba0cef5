"""When does a point rest on the ground? Trajectories made by hand, a leg of 0.9 m, 60 frames a second."""

import numpy as np
import pytest

from retarget.contact.ground import ground_contacts, hysteresis, intervals, speeds

FPS, LEG = 60.0, 0.9


def ramp(frames, start, stop):
    t = np.clip((np.arange(frames) - start) / max(stop - start, 1), 0, 1)
    return t * t * (3 - 2 * t)


def feet(frames):
    """Two points, 20 cm apart, standing on the floor."""
    points = np.zeros((frames, 2, 3))
    points[:, 0, 0], points[:, 1, 0] = 0.1, -0.1
    return points


def test_standing_feet_rest_on_the_floor_all_the_time():
    found = ground_contacts(feet(90), FPS, LEG)
    assert found.touching.all() and found.floor == 0.0 and (found.support == 0).all()


def test_walking_feet_rest_between_their_steps():
    points, frames = feet(240), 240
    for start in (30, 150):
        went = ramp(frames, start, start + 36)
        points[:, 0, 2] += 0.7 * went
        points[:, 0, 1] += 0.1 * np.sin(np.pi * went)
    found = ground_contacts(points, FPS, LEG).touching
    assert found[:, 1].all()
    assert found[:28, 0].all() and found[72:148, 0].all() and found[192:, 0].all()
    for middle in (48, 168):
        assert not found[middle - 10 : middle + 11, 0].any()
    assert len(intervals(found[:, 0])) == 3


def test_a_foot_held_in_the_air_beside_a_standing_leg_does_not_rest():
    points = feet(120)
    points[:, 0, 1] = 0.3 * ramp(120, 20, 40)
    found = ground_contacts(points, FPS, LEG)
    assert found.touching[:18, 0].all() and not found.touching[45:, 0].any() and found.touching[:, 1].all()


def test_stairs_carry():
    """Left foot up by 20 cm, then the right one up to 40 cm, then left: each rests where nothing lower carries."""
    frames = 300
    points = feet(frames)
    points[:, 0, 1] = 0.2 * ramp(frames, 30, 50) + 0.4 * ramp(frames, 190, 215)
    points[:, 1, 1] = 0.4 * ramp(frames, 105, 130)
    points[:, 0, 2], points[:, 1, 2] = points[:, 0, 1] * 1.5, points[:, 1, 1] * 1.5
    found = ground_contacts(points, FPS, LEG)
    assert found.touching[135:185, 0].all() and found.support[140:180, 0] == pytest.approx(0.2)
    assert found.touching[220:, 0].all() or found.touching[220:, 1].all()
    assert found.support[150, 0] == pytest.approx(0.2, abs=1e-6)
    assert not found.touching[195:210, 0].any(), "the foot in the air does not rest"
    assert found.floor == pytest.approx(0.0, abs=1e-6)


def test_a_slow_slide_is_a_movement():
    frames = 300
    points = feet(frames)
    points[:, 0, 0] += 0.11 * np.arange(frames) / FPS * ramp(frames, 20, 40)  # 11 cm/s: below the speed of a rest
    found = ground_contacts(points, FPS, LEG).touching
    assert found[:, 1].all()
    assert found[80:240, 0].mean() < 0.1


def test_a_jump_leaves_the_ground_and_lands():
    frames = 120
    points = feet(frames)
    time = np.arange(frames) / FPS
    flight = np.clip((time - 0.5) / 0.6, 0, 1)
    points[..., 1] += (4 * 0.35 * flight * (1 - flight))[:, None]
    found = ground_contacts(points, FPS, LEG)
    assert found.touching[:28].all() and found.touching[70:].all()
    assert not found.touching[36:60].any(), "not even at the top, where it stands still for a moment"
    assert (found.support == 0).all()


def test_the_floor_is_where_feet_rest_not_where_a_foot_once_dips():
    points = feet(200) + [0, 0.5, 0]
    points[100:103, 0, 1] = 0.3
    found = ground_contacts(points, FPS, LEG)
    assert found.floor == pytest.approx(0.5)


@pytest.mark.parametrize("size", [0.1, 1.0, 10.0])
def test_a_giant_and_a_toddler_are_judged_alike(size):
    points = feet(240)
    went = ramp(240, 60, 100)
    points[:, 0, 2] += 0.7 * went
    points[:, 0, 1] += 0.1 * np.sin(np.pi * went)
    plain, other = ground_contacts(points, FPS, LEG), ground_contacts(points * size, FPS, LEG * size)
    assert np.array_equal(plain.touching, other.touching)
    assert np.allclose(other.support, plain.support * size)


@pytest.mark.parametrize("fps", [24.0, 30.0, 120.0])
def test_other_frame_rates_agree(fps):
    frames = int(4 * fps)
    points = feet(frames)
    went = ramp(frames, fps, 1.6 * fps)
    points[:, 0, 2] += 0.7 * went
    points[:, 0, 1] += 0.1 * np.sin(np.pi * went)
    (first, second) = intervals(ground_contacts(points, fps, LEG).touching[:, 0])
    assert first[1] / fps == pytest.approx(1.05, abs=0.1) and second[0] / fps == pytest.approx(1.55, abs=0.1)


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_the_shortest_clips(frames):
    found = ground_contacts(feet(frames), FPS, LEG)
    assert found.touching.shape == (frames, 2) and found.touching.all() and np.isfinite(found.support).all()


def test_speeds_of_a_steady_point():
    points = np.arange(20)[:, None, None] * np.array([0.0, 0.0, 0.03])
    assert np.allclose(speeds(points, 50.0), 1.5)
    assert speeds(points[:1], 50.0) == 0


def test_hysteresis_by_hand():
    enter = np.array([0, 0, 1, 0, 0, 0, 0, 1], bool)[:, None]
    stay = np.array([0, 1, 1, 1, 0, 1, 0, 1], bool)[:, None]
    assert hysteresis(enter, stay)[:, 0].astype(int).tolist() == [0, 1, 1, 1, 0, 0, 0, 1]


def test_intervals_by_hand():
    assert intervals(np.array([1, 1, 0, 0, 1, 0, 1], bool)) == [(0, 2), (4, 5), (6, 7)]
    assert intervals(np.zeros(3, bool)) == []
