"""Captures made from the embedded human, whose truth is known, and a regressor that guesses as well as a trained one would."""

from dataclasses import dataclass

import numpy as np

from retarget.body import rotations as rot
from retarget.body.kinematics import world_pose
from retarget.body.skinning import prepare_skinning
from retarget.character import PointMotion


def sampled(vertices, faces, count, rng, noise=0.003):
    """So many points of a surface, evenly by area, in random order, with noise (metres)."""
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = rng.choice(len(faces), count, p=area / area.sum())
    share = rng.random((count, 2))
    share = np.where(share.sum(axis=1, keepdims=True) > 1, 1 - share, share)
    picked = corners[chosen]
    points = picked[:, 0] + share[:, :1] * (picked[:, 1] - picked[:, 0]) + share[:, 1:] * (picked[:, 2] - picked[:, 0])
    return points + rng.normal(0, noise, points.shape)


def half_view(vertices, faces, azimuth):
    """Faces that look towards a camera far away; nothing hides what lies behind."""
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return faces[across @ np.array([np.sin(azimuth), 0.0, np.cos(azimuth)]) > 0]


@dataclass(frozen=True, eq=False)
class Capture:
    """Clouds with what they were made from."""

    clouds: PointMotion
    character: object
    motion: object
    turns: np.ndarray
    """World rotations of all joints (frames, joints, 4)."""
    places: np.ndarray
    """World places of all joints (frames, joints, 3)."""
    surface: np.ndarray


def capture(character, motion, points=6890, noise=0.003, seed=0, view=None, spoil=None):
    """A scan of a performing embedded human; `view` is the azimuth of a half view, `spoil` changes a frame's points."""
    rng = np.random.default_rng(seed)
    turns, places = world_pose(motion)
    surface = prepare_skinning(character).vertices(turns, places)
    faces, clouds = character.mesh.faces, []
    for frame, vertices in enumerate(surface):
        seen = faces if view is None else half_view(vertices, faces, view)
        cloud = sampled(vertices, seen, points, rng, noise)
        clouds.append((cloud if spoil is None else spoil(cloud, frame, rng)).astype(np.float32))
    return Capture(PointMotion(tuple(clouds), motion.fps, motion.name), character, motion, turns, places, surface)


@dataclass
class Guess:
    """What a regressor returns."""

    places: np.ndarray
    turns: np.ndarray
    names: tuple


class StandIn:
    """A regressor that knows the truth, and is as far off as a trained one: 20 mm and 12 degrees, turned about now and then.

    It knows a frame by where its points lie; `back` brings points to where the capture was made.
    """

    def __init__(self, made, seed=0, off=0.02, turned=0.2, flips=0.0, turn=rot.IDENTITY, move=(0.0, 0.0, 0.0)):
        self.made, self.rng, self.off, self.turned, self.flips = made, np.random.default_rng(seed), off, turned, flips
        self.turn, self.move = turn, np.array(move)
        self.middles = np.array([cloud.mean(axis=0) if len(cloud) else np.full(3, np.inf) for cloud in made.clouds.clouds])

    def __call__(self, points):
        own = rot.rotate(rot.inverse(self.turn), points - self.move)
        frame = int(np.abs(self.middles - own.mean(axis=0)).sum(axis=1).argmin())
        places = self.made.places[frame, :22] + self.rng.normal(0, self.off / 1.6, (22, 3))
        turns = rot.multiply(rot.from_rotation_vector(self.rng.normal(0, self.turned / 1.6, (22, 3))), self.made.turns[frame, :22])
        names = self.made.character.skeleton.names[:22]
        if self.rng.random() < self.flips:
            half = np.array([0.0, 1.0, 0.0, 0.0])
            swap = [names.index(("right" + n[4:]) if n.startswith("left") else ("left" + n[5:]) if n.startswith("right") else n) for n in names]
            places, turns = places[swap], rot.multiply(turns[swap], half)
        return Guess(rot.rotate(self.turn, places) + self.move, rot.multiply(self.turn, turns), names)
