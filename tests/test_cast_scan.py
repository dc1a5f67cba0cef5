"""Captures as performers: their space, what is refused, and the way onto a target."""

import re
from dataclasses import replace

import numpy as np
import pytest
from made_scans import StandIn, capture

from retarget import RetargetError, retarget
from retarget.body.human import human
from retarget.casting import Hints, cast
from retarget.character import PointMotion
from retarget.io.asset import Convention
from retarget.live import LiveRetargeter
from retarget.methods.scan import evidence
from retarget.methods.scan.starts import own_regressor
from retarget.motion.library import embedded_motion, performer
from retarget.performing import cast_scan

FRAMES = 8


@pytest.fixture(scope="module")
def walk():
    motion = embedded_motion("walk")
    cut = replace(motion, rotations=motion.rotations[30 : 30 + FRAMES], translations=motion.translations[30 : 30 + FRAMES])
    return capture(performer(), cut, points=4000)


class Never:
    """A regressor that must not be needed."""

    def __call__(self, points):
        raise AssertionError


class Upright(StandIn):
    """Knows the truth where the body stands as it did, and rubbish elsewhere."""

    def __call__(self, points):
        seen = super().__call__(points)
        if abs(np.median(points, axis=0) - np.median(self.made.clouds.clouds[0], axis=0)).max() > 0.3:
            seen.places = seen.places + 5.0
        return seen


def in_space(walk, matrix, scale):
    return replace(walk.clouds, clouds=tuple(cloud @ np.array(matrix, np.float32).T * scale for cloud in walk.clouds.clouds))


def test_a_capture_in_metres_is_taken_as_it_is(walk):
    seen = cast_scan(walk.clouds, regressor=StandIn(walk))
    assert seen.notes == () and seen.shown.all() and len(seen.motion) == FRAMES
    assert abs(seen.actor.height - cast(walk.character).height) < 0.03


def test_millimetres_and_z_up_are_seen(walk):
    lying = in_space(walk, [[1, 0, 0], [0, 0, -1], [0, 1, 0]], 1000.0)
    seen = cast_scan(lying, regressor=Upright(walk, off=0.0, turned=0.05))
    assert re.fullmatch(r"unit: mm \(the body is then 1\.[56]\d m tall\)", seen.notes[0])
    assert seen.notes[1:] == ("up axis +z: the body stands that way",)
    away = seen.motion.translations[:, 0] - walk.places[:, 0]
    assert np.linalg.norm(away, axis=1).max() < 0.02


def test_what_is_told_is_not_guessed(walk):
    lying = in_space(walk, [[1, 0, 0], [0, 0, -1], [0, 1, 0]], 1000.0)
    for hints, convention in ((Hints(up="+z", unit=0.001), None), (None, Convention(0.001, "+z"))):
        assert cast_scan(lying, hints, convention, StandIn(walk)).notes == ()


@pytest.mark.parametrize(
    "hints, match", [(Hints(up="y"), "the up axis is one of"), (Hints(unit=0.0), "unit must be positive"), (Hints(unit=float("nan")), "unit must")]
)
def test_hints_that_are_none_are_refused(walk, hints, match):
    with pytest.raises(RetargetError, match=match):
        cast_scan(walk.clouds, hints, regressor=Never())


def test_too_few_points_are_refused():
    few = PointMotion((np.zeros((3, 3)), np.zeros((0, 3))))
    with pytest.raises(RetargetError, match="no frame holds enough points for a body: at most 3"):
        cast_scan(few, regressor=Never())


def test_noise_is_nobody(walk):
    rng = np.random.default_rng(0)
    noise = PointMotion(tuple(rng.random((3000, 3)) * [1, 1.7, 1] for _ in range(2)))
    with pytest.raises(RetargetError, match="nothing like a human body is seen in the 2 frames"):
        cast_scan(noise, regressor=StandIn(walk))


def test_two_people_are_refused(walk):
    two = PointMotion(tuple(np.concatenate([cloud, cloud + np.float32([1.3, 0, 0])]) for cloud in walk.clouds.clouds))
    with pytest.raises(RetargetError, match="two bodies are seen"):
        cast_scan(two, regressor=StandIn(walk))


def test_unlike_axes_are_tried_only_where_needed(walk, monkeypatch):
    asked = []
    fits = evidence._fits
    monkeypatch.setattr(evidence, "_fits", lambda frames, axis, *rest: asked.append(axis) or fits(frames, axis, *rest))
    cast_scan(walk.clouds, regressor=StandIn(walk))
    assert asked == ["+y"]


def test_a_capture_moves_a_target(walk, monkeypatch):
    monkeypatch.setattr("retarget.methods.scan.starts.own_regressor", lambda: StandIn(walk))
    result = retarget(walk.clouds, human(weight=0.9), method="copy-rotations")
    same = retarget(replace(walk.motion), human(weight=0.9), source=walk.character, method="copy-rotations")
    away = np.linalg.norm(result.motion.translations[:, 0] - same.motion.translations[:, 0], axis=1)
    assert len(result.motion) == FRAMES and away.max() < 0.03


def test_a_capture_is_its_own_performer(walk):
    with pytest.raises(RetargetError, match="a capture is its own performer"):
        retarget(walk.clouds, human(), source=human())


def test_live_poses_are_the_tracker_s_on_the_target(walk):
    live = LiveRetargeter(cast(human(weight=0.9)), "copy-rotations", regressor=StandIn(walk))
    first = live.step(np.zeros((0, 3)))
    assert first.status == "nobody" and first.motion is None and live.line(first)["rotations"] is None
    poses = [live.step(cloud) for cloud in walk.clouds.clouds[:3]]
    assert [pose.status for pose in poses] == ["found", "followed", "followed"]
    line = live.line(poses[-1])
    assert line["frame"] == 3 and len(line["rotations"]) == len(live.header()["joints"]) == 52
    same = retarget(walk.motion, human(weight=0.9), source=walk.character, method="copy-rotations", foot_lock=False)
    assert np.abs(np.array(line["translations"][0]) - same.motion.translations[2, 0]).max() < 0.03


@pytest.mark.parametrize("wrong", [{"up": "up"}, {"unit": -1.0}, {"fps": 0.0}])
def test_a_live_space_that_is_none_is_refused(wrong):
    with pytest.raises(RetargetError):
        LiveRetargeter(cast(human()), regressor=Never(), **wrong)


@pytest.mark.parametrize("up, matrix", [("+z", [[1, 0, 0], [0, 0, -1], [0, 1, 0]]), ("-y", [[1, 0, 0], [0, -1, 0], [0, 0, -1]])])
def test_who_is_found_lying_does_not_say_which_way_is_up(walk, up, matrix):
    """The program's own regressor has learnt from people who fell."""
    turned = walk.clouds.clouds[0] @ np.array(matrix, np.float32).T
    seen = evidence.look_at([turned], own_regressor(), None, 1.0)
    assert seen.notes == (f"up axis {up}: the body stands that way",)
    assert np.abs(seen.space.points(turned)[:, 1] - walk.clouds.clouds[0][:, 1]).max() < 1e-6


@pytest.mark.parametrize("head_down, chosen", [(0.027, "+y"), (0.022, "-y")])
def test_a_body_is_head_down_only_where_that_fits_better(monkeypatch, head_down, chosen):
    """It is found upside down somewhat less well than on its feet; .03 stands for noise beyond what ends the search at +y."""
    misfits = {"+y": 0.03, "+z": 0.04, "-y": head_down, "-z": 0.04}
    monkeypatch.setattr(evidence, "_fits", lambda frames, axis, unit, regressor: evidence.Try(misfits[axis], misfits[axis]))
    seen = evidence.look_at([np.random.default_rng(0).uniform(0, 1.7, (2000, 3))], None, None, 1.0)
    assert [note for note in seen.notes if note.startswith("up axis")] == ([] if chosen == "+y" else [f"up axis {chosen}: the body stands that way"])


def test_a_body_that_stands_no_way_up_is_not_said_to(monkeypatch):
    misfits = {"+y": 0.05, "+z": 0.02, "-y": 0.05, "-z": 0.05}
    monkeypatch.setattr(evidence, "_fits", lambda frames, axis, unit, regressor: evidence.Try(misfits[axis], np.inf))
    seen = evidence.look_at([np.random.default_rng(0).uniform(0, 1.7, (2000, 3))], None, None, 1.0)
    assert seen.notes == ("up axis +z: a body fits best that way, though lying (--up says otherwise)",)
