"""The part of a report that needs joints only: limbs, feet on the ground, smoothness, speed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from retarget.body.kinematics import rest_pose
from retarget.contact.ground import GroundContacts, intervals, running_maximum, speeds
from retarget.contact.support import support_points
from retarget.evaluate import metrics
from retarget.evaluate.cases import limb_directions, marker_directions, orientation_markers
from retarget.evaluate.problems import Episode, Problem, cm, episodes, problem, spoken, when
from retarget.evaluate.take import FPS, Take
from retarget.motion.filter import resample
from retarget.motion.standing import standing_contacts

Array = np.ndarray
Figures = dict[str, float | None]
Curves = dict[str, Array]

LIMBS = tuple(f"{side}{part}" for side in ("left", "right") for part in ("UpperArm", "Forearm", "Thigh", "Shin"))
"""As `limb_directions` lists them."""
HANDS, FEET = ("leftHand", "rightHand"), ("leftFoot", "rightFoot")
ENDS = ("hips", "head", *HANDS, *FEET)
POINTS = {"leftFoot": (0, 1), "rightFoot": (2, 3), "leftHand": (4,), "rightHand": (5,)}
"""Columns of the support points of each limb's end."""
FOOT_POINTS = slice(0, 4)

# What a person lets pass, for a body of 1.7 m: beyond it there is a sentence. Ours.
SLIDE = 0.01
"""Metres that a resting foot may move more than the source's."""
OFF_FLOOR = 0.015
"""Metres over or under its support, beyond the source's own."""
AWAY = 25.0
"""Degrees between a limb and the source's, for at least `LASTING`."""
LASTING = 0.15
"""Seconds."""
JUMP = 0.03
"""Metres by which a point leaves a straight path within a frame of 1/30 s, beyond what the source's does around it."""
SHAKE = 1.5
"""Jerk over the source's."""
OTHER_FLOOR = 0.1
"""Heights between the floor of the rest pose and where the result stands, beyond which it stands on a floor of its own."""


@dataclass(frozen=True, eq=False)
class Grounds:
    """Where source and result stand."""

    source: GroundContacts
    result: GroundContacts
    floor: float
    """Height of the result's floor: the one that its rest pose shows, unless it stands elsewhere (metres)."""
    scale: float
    """Leg over leg: by this the source's heights become the result's."""
    notes: tuple[str, ...] = ()

    @property
    def support(self) -> Float[Array, "frames points"]:
        """Height at which the result should rest where the source rests, metres."""
        return (self.source.support - self.source.floor) * self.scale + self.floor

    @property
    def source_heights(self) -> Float[Array, "frames points"]:
        """Heights of the source's points over its supports, in the result's size, metres."""
        return (self.source.heights - self.source.support) * self.scale


def grounds(source: Take, result: Take) -> Grounds:
    """Find the floors and contacts of both.

    The result's floor is the one that its rest pose shows; or as far above or below it as the source stands above or
    below its own, if the result stands nearer to that.
    """
    found = [standing_contacts(each.actor, each.limbs, *each.pose, each.fps) for each in (source, result)]
    scale, stands = result.leg / source.leg, found[1].floor
    rest = rest_floor(result)
    along = rest + (found[0].floor - rest_floor(source)) * scale
    floor, notes = (along if abs(along - stands) < abs(rest - stands) else rest), ()
    if found[1].touching.any() and abs(stands - floor) > OTHER_FLOOR * result.actor.height:
        notes = (
            f"the result stands at a height of {stands:.2f} m, its rest pose at {rest:.2f} m; the former is taken",
        )
        floor = stands
    return Grounds(*found, floor, scale, notes)


def rest_floor(take: Take) -> float:
    """Height of the floor that the rest pose shows, metres; 0 where the file has its origin elsewhere than at the soles."""
    legs = support_points(take.limbs[:2], *(each[None] for each in rest_pose(take.actor.skeleton)))
    sole = float(min(points[..., 1].min() for points in legs))
    return sole if abs(sole) < 0.25 * take.leg else 0.0


def joint_report(source: Take, result: Take, ground: Grounds) -> tuple[Figures, Curves, list[Problem]]:
    """All that joints tell."""
    limbs = metrics.angle_error_degrees(
        limb_directions(source.actor, source.positions), limb_directions(result.actor, result.positions)
    )
    figures = {"direction_error_deg": float(limbs.mean()), "orientation_error_deg": _orientation_error(source, result)}
    figures |= _ground_figures(source, result, ground) | _smoothness(source, result)
    problems = [*_turned_away(limbs, result.fps), *_slides(source, result, ground), *_off_floor(result, ground)]
    problems += [*_jumps(source, result), *_shakes(source, result)]
    return figures, _curves(source, result, ground), problems


def _orientation_error(source: Take, result: Take) -> float | None:
    mine, theirs = orientation_markers(source.actor), orientation_markers(result.actor)
    shared = sorted(set(mine) & set(theirs))
    if not shared:
        return None
    errors = metrics.angle_error_degrees(
        marker_directions(mine, shared, source.rotations), marker_directions(theirs, shared, result.rotations)
    )
    return float(errors.mean())


def _ground_figures(source: Take, result: Take, ground: Grounds) -> Figures:
    touching = ground.source.touching[:, FOOT_POINTS]
    mean = lambda values: float(values.mean()) if len(values) else None  # noqa: E731
    height = result.actor.height
    return {
        "foot_slide_cm": mean(metrics.foot_slide_cm(result.support[:, FOOT_POINTS], touching, height)),
        "source_foot_slide_cm": mean(
            metrics.foot_slide_cm(source.support[:, FOOT_POINTS], touching, source.actor.height)
        ),
        "floor_error_cm": mean(
            metrics.floor_error_cm(result.support[:, FOOT_POINTS], touching, ground.support[:, FOOT_POINTS], height)
        ),
        "source_floor_error_cm": mean(
            metrics.floor_error_cm(
                source.support[:, FOOT_POINTS], touching, ground.source.support[:, FOOT_POINTS], source.actor.height
            )
        ),
    }


def _smoothness(source: Take, result: Take) -> Figures:
    jerks, figures = [], {}
    for prefix, each in (("source_", source), ("", result)):
        smooth = Take(each.actor, resample(each.motion, FPS))
        jerks.append(metrics.jerk(smooth.joints(ENDS), FPS, each.leg))
        for name, joints in (("hand", HANDS), ("foot", FEET)):
            speed = speeds(each.joints(joints), each.fps)
            figures[f"{prefix}{name}_speed_m_s"] = float(speed.mean())
            figures[f"{prefix}{name}_top_speed_m_s"] = float(speed.max())
    return {"jerk_ratio": jerks[1] / jerks[0] if jerks[0] > 1e-3 else None} | figures


def _curves(source: Take, result: Take, ground: Grounds) -> Curves:
    curves: Curves = {"time_s": np.arange(len(result)) / result.fps}
    taller = result.actor.height / source.actor.height
    sides = (
        ("result", result, ground.result, ground.floor, 1.0, 1.0),
        ("source", source, ground.source, ground.source.floor, ground.scale, taller),
    )
    for who, each, contacts, floor, longer, bigger in sides:
        for name, points in POINTS.items():
            curves[f"ground/{who}/{spoken(name)}"] = contacts.touching[:, list(points)].any(axis=1)
        for name in FEET:
            lowest = each.support[:, list(POINTS[name]), 1].min(axis=1)
            curves[f"foot_height_cm/{who}/{spoken(name)}"] = 100 * longer * (lowest - floor)
        for name, speed in zip((*HANDS, *FEET), speeds(each.joints((*HANDS, *FEET)), each.fps).T):
            curves[f"speed_m_s/{who}/{spoken(name)}"] = bigger * speed
    return curves


def _turned_away(errors: Float[Array, "frames limbs"], fps: float) -> Iterator[Problem]:
    for limb, error in zip(LIMBS, errors.T):
        for episode in episodes(error, error > AWAY, fps):
            if episode.stop - episode.start >= LASTING * fps:
                text = (
                    f"{spoken(limb)} points {episode.value:.0f}° away from the source's at {episode.worst / fps:.2f} s"
                )
                yield problem(text, episode.value / AWAY, episode, fps, "direction", limb)


def _slides(source: Take, result: Take, ground: Grounds) -> Iterator[Problem]:
    """By the measure of `foot_slide_cm`, heel or ball, whichever slides more."""
    tolerable = result.own_size(SLIDE)
    for name, points in POINTS.items():
        for point in points:
            for start, stop in intervals(ground.source.touching[:, point]):
                slide, own = (_stray(each.support[start:stop, point]) for each in (result, source))
                own *= ground.scale
                if slide - own > tolerable:
                    episode = Episode(start, stop, start, slide)
                    text = f"{spoken(name)} slides {cm(slide)} {when(episode, result.fps)}"
                    text += f" (the source's {cm(own)})" if own > tolerable else ""
                    yield problem(text, (slide - own) / tolerable, episode, result.fps, "slide", name)


def _stray(path: Float[Array, "frames 3"]) -> float:
    """Largest horizontal distance from the mean place."""
    flat = path[:, [0, 2]]
    return float(np.linalg.norm(flat - flat.mean(axis=0), axis=1).max())


def _off_floor(result: Take, ground: Grounds) -> Iterator[Problem]:
    tolerable, fps = result.own_size(OFF_FLOOR), result.fps
    for name, points in POINTS.items():
        columns = list(points)
        rests = ground.source.touching[:, columns]
        over = np.where(rests, result.support[:, columns, 1] - ground.support[:, columns], np.inf).min(axis=1)
        own = np.where(rests, ground.source_heights[:, columns], np.inf).min(axis=1)
        resting = rests.any(axis=1)
        for word, sign in (("floats {} above", 1.0), ("sinks {} into", -1.0)):
            off = np.where(resting, sign * over, 0.0)
            beyond = off - np.where(resting, np.maximum(sign * own, 0.0), 0.0)
            for episode in episodes(off, beyond > tolerable, fps):
                text = f"{spoken(name)} {word.format(cm(episode.value))} the floor {when(episode, fps)}"
                text += ", where the source's rests" if sign > 0 else ""
                yield problem(text, beyond[episode.worst] / tolerable, episode, fps, "floor", name)


def _jumps(source: Take, result: Take) -> Iterator[Problem]:
    if len(result) < 3:
        return
    fps, taller = result.fps, result.actor.height / source.actor.height
    tolerable = result.own_size(JUMP)
    bend, own = (_bend(each.joints(ENDS)) * (fps / FPS) ** 2 for each in (result, source))
    beyond = bend - running_maximum(own * taller, 2)
    for name, bends, excess in zip(ENDS, bend.T, beyond.T):
        for episode in episodes(bends, excess > tolerable, fps):
            text = f"{spoken(name)} jumps by {cm(episode.value)} within a frame at {episode.worst / fps:.2f} s"
            yield problem(text, excess[episode.worst] / tolerable, episode, fps, "jump", name)


def _bend(points: Float[Array, "frames points 3"]) -> Float[Array, "frames points"]:
    """How far each point is from where it would be had it moved on straight; 0 on the first and last frame."""
    bend = np.linalg.norm(np.diff(points, n=2, axis=0), axis=-1)
    return np.pad(bend, ((1, 1), (0, 0)))


def _shakes(source: Take, result: Take) -> Iterator[Problem]:
    ends = [Take(each.actor, resample(each.motion, FPS)).joints(ENDS) for each in (source, result)]
    whole = Episode(0, len(result), 0, 0.0)
    for number, name in enumerate(ENDS):
        legs = (source.actor.height, result.actor.height) if name in (*HANDS, "head") else (source.leg, result.leg)
        own, made = (metrics.jerk(points[:, [number]], FPS, leg) for points, leg in zip(ends, legs))
        if own > 1.0 and made / own > SHAKE:
            text = f"{spoken(name)} shakes {made / own:.1f} times as much as the source's"
            yield problem(text, made / own / SHAKE, whole, result.fps, "shake", name)


def resting_names(touching: Bool[Array, "frames points"], fps: float) -> list[str]:
    """What rests on the ground for at least a fifth of a second, from support points alone."""
    return [name for name, points in POINTS.items() if touching[:, list(points)].any(axis=1).sum() >= 0.2 * fps]
