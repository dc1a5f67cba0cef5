"""A body followed through clouds: what holds whatever the capture."""

from dataclasses import replace

import numpy as np
import pytest
from made_scans import StandIn, capture

from retarget.body import rotations as rot
from retarget.body.kinematics import forward
from retarget.body.skinning import skin_motion
from retarget.character import PointMotion
from retarget.evaluate.scan_cases import SCANNER, scanned
from retarget.geometry.clothes import Outfit, dressed
from retarget.methods.scan.clip import follow_clip
from retarget.methods.scan.fit import Expected, rotation_vectors, turn_matrices, world_turns
from retarget.methods.scan.scan_body import BODY, scan_body
from retarget.methods.scan.starts import Start
from retarget.methods.scan.tracker import FOLLOWED, FOUND, HELD, NOBODY, PATIENCE, Tracker, told_by
from retarget.methods.scan.usual import usual_precision
from retarget.motion.library import embedded_motion, performer
from retarget.rig.fit_model import BodyState

FRAMES = 14


def part_of(name, first, frames=FRAMES):
    motion = embedded_motion(name)
    return replace(motion, rotations=motion.rotations[first : first + frames], translations=motion.translations[first : first + frames])


@pytest.fixture(scope="module")
def walk():
    return capture(performer(), part_of("walk", 30), points=4000)


@pytest.fixture(scope="module")
def followed(walk):
    tracker = Tracker(StandIn(walk))
    return [tracker.step(cloud) for cloud in walk.clouds.clouds], tracker


def joints_of(frames, character):
    rotations = np.stack([each.pose.rotations for each in frames])
    offsets = np.broadcast_to(character.skeleton.offsets, (len(frames), len(character.skeleton), 3)).copy()
    offsets[:, 0] = [each.pose.translations[0] for each in frames]
    return forward(character.skeleton.parents, rotations, offsets)


def errors(made, frames, character, at=slice(None)):
    turns, places = joints_of(frames, character)
    away = np.linalg.norm(places[:, :22] - made.places[at, :22], axis=2)
    return away.mean(), np.degrees(rot.angle_between(turns[:, :22], made.turns[at, :22])).mean()


def test_a_walk_is_followed(walk, followed):
    frames, tracker = followed
    assert [each.status for each in frames] == [FOUND] + [FOLLOWED] * (FRAMES - 1)
    away, turned = errors(walk, frames, tracker.character())
    assert away < 0.008 and turned < 6.0
    assert min(each.confidence for each in frames) > 0.7


def test_the_actor_has_the_performer_s_bones(walk, followed):
    """Legs to a hundredth; the skin to what its shape tells."""
    own, true = (each.skeleton.offsets for each in (followed[1].character(), walk.character))
    leg = lambda offsets: np.linalg.norm(offsets[[11, 12]], axis=1).sum()  # noqa: E731
    assert abs(leg(own) / leg(true) - 1) < 0.015


def test_a_body_does_not_grow_into_a_skirt():
    """Nor where a scanner sees next to nothing but the cloth."""
    worn, motion = dressed(performer(), Outfit(skirt=1.0, flare=0.2)), part_of("walk", 30, 8)
    seen = scanned(SCANNER, skin_motion(worn, motion), worn.mesh.faces, motion.fps, seed=1)
    tracker = Tracker(StandIn(capture(worn, motion, points=1000)))
    for cloud in seen.clouds:
        tracker.step(cloud)
    own, true = (each.skeleton.offsets for each in (tracker.character(), performer()))
    leg = lambda offsets: np.linalg.norm(offsets[[11, 12]], axis=1).sum()  # noqa: E731
    assert abs(leg(own) / leg(true) - 1) < 0.05
    worn_before, nobody = tracker.memory[0].cloth, np.zeros((0, 3))
    for _ in range(PATIENCE + 1):
        tracker.step(nobody)
    bare = capture(performer(), part_of("walk", 30, 1), points=4000).clouds.clouds[0]
    assert tracker.step(bare).status == FOUND
    assert tracker.memory[0].cloth is worn_before, "what was worn is known when the body is found again"


def test_bones_stay_once_the_shape_is_known(walk):
    tracker = Tracker(StandIn(walk), settled=4)
    shapes = np.stack([tracker.step(cloud).shape for cloud in walk.clouds.clouds])
    assert np.ptp(shapes[:4], axis=0).max() > 0 and (shapes[5:] == shapes[5]).all()


def test_stances_do_without_a_regressor(walk):
    tracker = Tracker()
    frames = [tracker.step(cloud) for cloud in walk.clouds.clouds[:6]]
    assert errors(walk, frames, tracker.character(), slice(0, 6))[0] < 0.012


def test_the_order_of_points_does_not_matter(walk, followed):
    rng = np.random.default_rng(5)
    tracker = Tracker(StandIn(walk))
    other = [tracker.step(rng.permutation(cloud)) for cloud in walk.clouds.clouds[:5]]
    for one, two in zip(followed[0], other):
        assert np.abs(one.pose.rotations - two.pose.rotations).max() < 1e-6


def test_equal_input_gives_equal_poses(walk, followed):
    tracker = Tracker(StandIn(walk))
    for one, cloud in zip(followed[0], walk.clouds.clouds[:5]):
        assert np.array_equal(one.pose.rotations, tracker.step(cloud).pose.rotations)


def test_a_turned_and_moved_capture_gives_the_same_motion_there(walk, followed):
    yaw, move = rot.from_rotation_vector(np.array([0.0, 1.1, 0.0])), np.array([3.0, 0.2, -5.0])
    tracker = Tracker(StandIn(walk, turn=yaw, move=move))
    frames = [tracker.step(rot.rotate(yaw, cloud.astype(float)) + move) for cloud in walk.clouds.clouds[:6]]
    _, places = joints_of(frames, tracker.character())
    _, before = joints_of(followed[0][:6], followed[1].character())
    away = np.linalg.norm(places - rot.rotate(yaw, before) - move, axis=2)[:, :22]
    assert away.mean() < 0.004


def test_a_guess_that_looks_the_wrong_way_is_turned_about(walk):
    tracker = Tracker(StandIn(walk, flips=1.0))
    frames = [tracker.step(cloud) for cloud in walk.clouds.clouds[:4]]
    assert errors(walk, frames, tracker.character(), slice(0, 4))[0] < 0.01


@pytest.mark.parametrize(
    "broken",
    [np.zeros((0, 3)), np.zeros((3, 3)), np.full((500, 3), np.nan), np.random.default_rng(0).uniform(-1, 2, (4000, 3))],
    ids=["empty", "three points", "not numbers", "noise"],
)
def test_a_frame_that_says_nothing_is_held(walk, broken):
    tracker = Tracker(StandIn(walk))
    before = [tracker.step(cloud) for cloud in walk.clouds.clouds[:4]][-1]
    held = tracker.step(broken)
    assert held.status == HELD and np.array_equal(held.pose.rotations, before.pose.rotations)
    assert tracker.step(walk.clouds.clouds[5]).status == FOLLOWED
    assert Tracker(StandIn(walk)).step(broken).status == NOBODY


def test_who_leaves_and_comes_back_elsewhere_is_found(walk):
    guess = StandIn(walk)
    tracker = Tracker(guess)
    for cloud in walk.clouds.clouds[:3]:
        tracker.step(cloud)
    for _ in range(8):
        assert tracker.step(np.zeros((0, 3))).status == HELD
    move = np.array([0.0, 0.0, 2.0])
    guess.move = move
    again = [tracker.step(cloud + move) for cloud in walk.clouds.clouds[:2]]
    assert [each.status for each in again] == [FOUND, FOLLOWED]
    _, places = joints_of(again, tracker.character())
    assert np.linalg.norm(places[:, :22] - walk.places[:2, :22] - move, axis=2).mean() < 0.01


def test_half_views_are_followed():
    made = capture(performer(), part_of("walk", 30, 8), view=0.4, points=3000)
    tracker = Tracker(StandIn(made))
    frames = [tracker.step(cloud) for cloud in made.clouds.clouds]
    assert errors(made, frames, tracker.character())[0] < 0.015


def test_a_clip_followed_causally_is_the_steps(walk, followed):
    clip = follow_clip(walk.clouds, StandIn(walk), causal=True)
    stepped = rot.continuous(np.stack([each.pose.rotations for each in followed[0]]))
    assert np.allclose(clip.motion.rotations, stepped, atol=1e-12) and clip.shown.all()
    assert np.array_equal(clip.motion.translations[:, 0], np.stack([each.pose.translations[0] for each in followed[0]]))


def test_a_clip_looks_ahead(walk, followed):
    clip = follow_clip(walk.clouds, StandIn(walk, off=0.0, turned=0.05))
    poses = [type("Frame", (), {"pose": clip.motion.pose(frame)}) for frame in range(FRAMES)]
    ahead, behind = errors(walk, poses, clip.character), errors(walk, followed[0], followed[1].character())
    assert ahead[0] < behind[0] + 5e-4 and ahead[1] < behind[1] + 0.5


def test_frames_that_show_nobody_lie_between_their_neighbours(walk):
    clouds = list(walk.clouds.clouds)
    clouds[5] = clouds[6] = np.zeros((0, 3), np.float32)
    clip = follow_clip(PointMotion(tuple(clouds), 30.0), StandIn(walk, off=0.0, turned=0.05))
    assert clip.shown.tolist() == [frame not in (5, 6) for frame in range(FRAMES)]
    assert clip.notes == ("2 of 14 frames show nobody and are interpolated: 5 to 6",)
    poses = [type("Frame", (), {"pose": clip.motion.pose(frame)}) for frame in (5, 6)]
    assert errors(walk, poses, clip.character, [5, 6])[0] < 0.012


def test_an_arm_that_leaps_is_found_again_where_nothing_explains_the_points():
    motion = part_of("walk", 30, 9)
    arm, turns = performer().skeleton.names.index("leftUpperArm"), motion.rotations.copy()
    turns[4:, arm] = rot.multiply(rot.from_rotation_vector(np.array([0.0, 0.0, 1.6])), turns[4:, arm])
    made = capture(performer(), replace(motion, rotations=turns), points=4000)
    tracker = Tracker()
    frames = [tracker.step(cloud) for cloud in made.clouds.clouds]
    _, places = joints_of(frames[-2:], tracker.character())
    hand = performer().skeleton.names.index("leftHand")
    assert np.linalg.norm(places[:, hand] - made.places[-2:, hand], axis=1).max() < 0.03


def test_a_regressor_tells_what_the_cloud_hides_and_its_doubts_take_away_from_that():
    body = scan_body()
    still = np.tile(np.eye(3), (BODY, 1, 1))
    foretold = Expected(still, np.full(BODY, 100.0), usual_precision(), np.zeros(3), 1.0, np.zeros(body.shapes), body.usual_shape)
    bent = world_turns(body, turn_matrices(np.tile([0.0, 0.0, 0.2], (BODY, 1))))

    def share(doubt):
        start = Start(BodyState(np.zeros(body.shapes), bent, np.zeros(3)), True, np.full(BODY, doubt))
        return rotation_vectors(told_by(body, foretold, start).turns)[:, 2] / 0.2

    assert np.allclose(share(0.0), 0.09, atol=0.02) and (share(0.1) < 0.2 * share(0.0)).all()
