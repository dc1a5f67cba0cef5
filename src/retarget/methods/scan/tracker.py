"""A body followed through a stream of clouds: one frame in, one pose out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Shaped

from retarget.body import rotations as rot
from retarget.body.human import human_model
from retarget.character import Character, Pose
from retarget.methods.scan.cloud import MOST, binned, fewer, pieces, thinned, without_floor
from retarget.methods.scan.fit import (
    Expected,
    Fit,
    fit_cloud,
    relative_turns,
    rotation_vectors,
    turn_matrices,
    world_turns,
)
from retarget.methods.scan.hanging import Cloth, skin_only
from retarget.methods.scan.recover import (
    LEGS,
    POOR,
    alike,
    joints_of,
    limbs_shown,
    seen_elsewhere,
    sought_elsewhere,
    straightened,
)
from retarget.methods.scan.scan_body import BODY, ScanBody, ShapedBody, scan_body
from retarget.methods.scan.starts import Regressor, Start, best_fit, guessed_starts, misfit, stances
from retarget.methods.scan.usual import steadiness, usual_precision
from retarget.rig.fit_model import BodyState

Array = np.ndarray

FOLLOWED, FOUND, HELD, NOBODY = "followed", "found", "held", "nobody"
"""What became of a frame: the pose before was followed, the body was looked for and found, the cloud says nothing and the last
pose is held, or nobody has been found yet."""
REACHES = (0.1, 0.06, 0.045, 0.035)
"""Metres: a round of the fit each."""
WITH_FLOOR = 4 * MOST
"""Points of a thinned cloud before its floor is taken away."""
FEWEST = 100
"""Points of a thinned cloud in which a body can be followed."""
ALMOST, ENOUGH = 0.06, 0.05
"""Metres of misfit beyond which a frame is not believed, and a new start not."""
SETTLED = 45
"""Well fitted frames after which the shape stays as it is."""
SHAPE_GAIN = 0.1
"""Share of what a frame says of the shape that is believed: neighbouring frames err alike."""
GAIN = 0.8
"""Share of a surprise that is taken for a change of speed."""
CALM = 0.95
"""Share of its speed that a body keeps from one frame to the next where nothing else is known."""
LEAP = 0.7
"""Radians of surprise beyond which a joint was found elsewhere rather than moved there."""
ROOT_UNSTEADY = 0.02
"""Metres that the hips are off from what their speed foretells: one standard deviation."""
PATIENCE = 5
"""Frames that may not be believed until the body is looked for again."""
LOST = 0.5
"""A limb of whose skin less than this share of the usual is shown may be elsewhere."""
STRANGE = 0.02
"""Share of the cloud that nothing explains, beyond twice the usual, at which limbs may be elsewhere."""
USUAL = 0.1
"""Share of a frame in what is usual."""
GUESSED = 0.3
"""Radians that a regressor's turns are off: one standard deviation. It is little against what the cloud shows, and decides for
what it does not show."""
DOUBTFUL = 0.03
"""Metres that a regressor takes a joint to be off at which it counts for half."""
SURE = 5
"""Frames that fitted as right ones do, after which all of the body is not given up for little."""
LOOK = 3
"""Frames after which limbs are tried where a regressor sees them, though nothing seems amiss."""
DISMISSED = 0.8
"""Radians between a regressor's turn and what the frame before foretells at which the regressor counts for half."""
OUTLYING = 0.35
"""Metres around the body that was there before, beyond which points are not looked at."""


@dataclass(frozen=True, eq=False)
class Tracked:
    """What a frame shows."""

    pose: Pose | None
    """Of all 52 joints of the embedded human, fingers at rest; None as long as nobody has been found."""
    shape: Float[Array, "shapes"]
    """Coefficients of `ScanBody` as they are known by now."""
    state: BodyState | None
    """The same as world turns of the body's 22 joints."""
    status: str
    """`FOLLOWED`, `FOUND`, `HELD` or `NOBODY`."""
    confidence: float
    """0 to 1, by how well the body explains the cloud."""
    distance: float
    """Metres between skin and cloud, root mean square; infinite where there is neither."""


@dataclass(frozen=True, eq=False)
class Memory:
    """What a tracker knows of the frames before."""

    state: BodyState
    shaped: ShapedBody
    speed: Float[Array, "joints 3"]
    """Rotation vectors a frame, in the parents' frames."""
    root_speed: Float[Array, "3"]
    shape_precision: Float[Array, "shapes shapes"]
    good: int = 0
    """Well fitted frames so far."""
    shown: Float[Array, "limbs"] = field(default_factory=lambda: np.zeros(4))
    """Share of each limb's skin that the cloud usually shows."""
    astray: float = 0.0
    """Share of the cloud that usually nothing explains."""
    well: int = 0
    """Frames since the body was found that fitted as right ones do."""
    held: int = 0
    """Frames in a row that were not believed."""
    cloth: Cloth | None = None
    """What hung around the body when it was found."""


@dataclass(frozen=True, eq=False)
class Tracker:
    """Follows one body. Frames are expected about a thirtieth of a second apart, in metres with +Y up."""

    regressor: Regressor | None = None
    """Says where to begin; without one stances are tried."""
    fps: float = 30.0
    shape: Float[Array, "shapes"] | None = None
    """The actor's shape where it is known; it then stays."""
    settled: int = SETTLED
    """Well fitted frames after which the shape stays as it is."""
    memory: list[Memory] = field(default_factory=list)
    """The last, where there is one."""

    def step(self, points: Shaped[Array, "points 3"]) -> Tracked:
        """The next frame; any number of points, also none. Never raises for what they are."""
        body = scan_body()
        cloud = ready(points)
        memory = self.memory[0] if self.memory else None
        if memory is None or memory.held > PATIENCE:
            return self._looked_for(body, cloud, memory)
        near = cloud[around(cloud, memory)] if len(cloud) else cloud
        if len(near) < FEWEST:
            return self._hold(memory)
        shaping = self.shape is None and memory.good < self.settled
        foretold = self._foretold(body, memory)
        start = BodyState(memory.state.shape, world_turns(body, foretold.turns), foretold.root)
        guesses = [] if self.regressor is None else list(guessed_starts(body, self._look(memory)(near)))
        expected = foretold
        if guesses:
            guess = alike(guesses, start)
            # Where cloth hung when the body was found, a body that grows into it must not say what is skin.
            states = (guess.state,) if memory.cloth else (guess.state, start)
            expected, near = told_by(body, foretold, guess), skin_only(body, states, near, memory.shaped)
            if memory.cloth and shaping:
                memory = _dressed(body, memory, memory.cloth.after(body, guess.state.shape, memory.state.shape))
                shaping = not memory.cloth.overgrown
                start, expected = replace(start, shape=memory.state.shape), replace(expected, shape=memory.state.shape)
        if len(near) < FEWEST:
            return self._hold(memory)
        fit = fit_cloud(body, start, binned(near), expected, REACHES, shaping, memory.shaped)
        fit = self._doubted(body, memory, fit, near, expected, guesses)
        if misfit(fit) > ALMOST or fit.explained < 0.4:
            return self._hold(memory)
        return self._follow(body, memory, foretold, fit)

    def _look(self, memory: Memory) -> Regressor:
        """The regressor; where the body was followed well, and nothing hangs around it, the regressor's glance if it has one."""
        followed = memory.well > SURE and not memory.cloth and not memory.held
        return getattr(self.regressor, "glance", self.regressor) if followed else self.regressor

    def _doubted(self, body: ScanBody, memory: Memory, fit: Fit, points: Array, expected: Expected, guesses: list[Start]) -> Fit:
        """The same fit, or a better one where limbs are no longer shown, or a regressor sees them elsewhere."""
        doubted = limbs_shown(body, fit) < LOST * memory.shown
        strange = 1.0 - fit.explained > 2.0 * memory.astray + STRANGE
        shaped = memory.shaped if fit.state.shape is memory.state.shape else body.shaped(fit.state.shape)
        if not (doubted.any() or strange or memory.good % LOOK == 1):
            return fit
        fit = straightened(body, fit, shaped, points, expected)
        if guesses:
            clothed = memory.cloth is not None
            fit = seen_elsewhere(body, fit, shaped, points, expected, guesses, memory.well > SURE, clothed)
        if doubted.any() or strange:
            still = limbs_shown(body, fit) < (0.8 if strange else LOST) * memory.shown
            if memory.cloth is not None:
                still &= ~LEGS  # nothing explains the cloth
            fit = sought_elsewhere(body, fit, shaped, points, expected, still)
        return fit

    def _foretold(self, body: ScanBody, memory: Memory) -> Expected:
        step = 30.0 / self.fps
        relative = relative_turns(body, memory.state.turns)
        turns = np.matmul(turn_matrices(memory.speed), relative)
        return Expected(
            turns, steadiness() / step**2, usual_precision(), memory.state.root + memory.root_speed,
            (ROOT_UNSTEADY * step) ** -2, memory.state.shape, memory.shape_precision,
        )  # fmt: skip

    def _follow(self, body: ScanBody, memory: Memory, foretold: Expected, fit: Fit) -> Tracked:
        surprise = rotation_vectors(np.matmul(relative_turns(body, fit.state.turns), foretold.turns.transpose(0, 2, 1)))
        speed = CALM * memory.speed + GAIN * surprise
        speed[np.linalg.norm(surprise, axis=1) > LEAP] = 0.0
        root_speed = CALM * memory.root_speed + GAIN * (fit.state.root - foretold.root)
        precision = memory.shape_precision
        if len(fit.information) > 3 * BODY + 3:
            precision = precision + SHAPE_GAIN * _shape_information(body, fit, foretold)
        known = np.array_equal(fit.state.shape, memory.state.shape)
        shaped = memory.shaped if known else body.shaped(fit.state.shape)
        shown = memory.shown + USUAL * (limbs_shown(body, fit) - memory.shown)
        astray = memory.astray + USUAL * (1.0 - fit.explained - memory.astray)
        well = memory.well + (misfit(fit) < POOR)
        good, cloth = memory.good + 1, memory.cloth
        self.memory[:] = [Memory(fit.state, shaped, speed, root_speed, precision, good, shown, astray, well, cloth=cloth)]
        return _seen(fit, FOLLOWED)

    def _hold(self, memory: Memory) -> Tracked:
        still = replace(memory, speed=0 * memory.speed, root_speed=0 * memory.root_speed, held=memory.held + 1)
        self.memory[:] = [still]
        return Tracked(pose_of(memory.state), memory.state.shape, memory.state, HELD, 0.0, float("inf"))

    def _looked_for(self, body: ScanBody, cloud: Array, memory: Memory | None) -> Tracked:
        fit = self.found(cloud)
        if fit is None or misfit(fit) > ENOUGH:
            return self._nobody(body, memory)
        shaping = self.shape is None and (memory is None or memory.good < self.settled)
        state, precision = fit.state, body.usual_shape
        if not shaping:
            state = replace(state, shape=self.shape if self.shape is not None else memory.state.shape)
        elif memory is not None:
            precision = memory.shape_precision
        shaped, still = body.shaped(state.shape), np.zeros((BODY, 3))
        good, shown = 0 if memory is None else memory.good, limbs_shown(body, fit)
        astray = 1.0 - fit.explained
        now = Memory(state, shaped, still, np.zeros(3), precision, good, shown, astray)
        cloth = None if memory is None else memory.cloth  # worn still, whatever hangs where the body is found again
        if cloth is None and self.regressor is not None and len(skin_only(body, (state,), cloud, shaped)) < len(cloud):
            cloth = Cloth(alike(list(guessed_starts(body, self.regressor(cloud))), state).state.shape, state.shape)
        if cloth is not None:
            now = _dressed(body, now, cloth) if shaping else replace(now, cloth=cloth)
        self.memory[:] = [now]
        return _seen(replace(fit, state=now.state), FOUND)

    def found(self, cloud: Float[Array, "points 3"]) -> Fit | None:
        """The body where it fits best, whatever was before, in a cloud that `ready` made; None where points are too few."""
        body = scan_body()
        if len(cloud) >= FEWEST:
            cloud = cloud[pieces(cloud) == 0]
        if len(cloud) < FEWEST:
            return None
        unknown = self._unknown(body, self.memory[0] if self.memory else None)
        anyone, fits = self.shape is None and not self.memory, []
        if self.regressor is not None:
            guesses = list(guessed_starts(body, self.regressor(cloud)))
            skin = skin_only(body, [guess.state for guess in guesses], cloud)
            cloud = skin if len(skin) >= FEWEST else cloud
            fits = [best_fit(body, guesses, cloud, unknown, anyone)]
        if not fits or misfit(fits[0]) > POOR:
            fits.append(best_fit(body, stances(body, cloud), cloud, unknown, anyone))
        return min(fits, key=misfit)

    def _unknown(self, body: ScanBody, memory: Memory | None) -> Expected:
        """Nothing is expected but a body."""
        shape, precision = np.zeros(body.shapes), body.usual_shape
        if self.shape is not None:
            shape, precision = self.shape, 1e6 * precision
        elif memory is not None:
            shape, precision = memory.state.shape, memory.shape_precision
        turns = np.tile(np.eye(3), (BODY, 1, 1))
        return Expected(turns, np.zeros(BODY), usual_precision(), np.zeros(3), 0.0, shape, precision)

    def _nobody(self, body: ScanBody, memory: Memory | None) -> Tracked:
        if memory is not None:
            return self._hold(memory)
        shape = np.zeros(body.shapes) if self.shape is None else self.shape
        return Tracked(None, shape, None, NOBODY, 0.0, float("inf"))

    def character(self) -> Character:
        """The actor as known by now: the embedded human in the shape seen so far."""
        shape = self.memory[0].state.shape if self.memory else self.shape
        return scan_body().character(np.zeros(scan_body().shapes) if shape is None else shape)


def _dressed(body: ScanBody, memory: Memory, cloth: Cloth) -> Memory:
    """The same knowing what hangs around the body, in the shape that was told where it has grown into that."""
    if not cloth.overgrown:
        return replace(memory, cloth=cloth)
    return replace(memory, cloth=cloth, state=replace(memory.state, shape=cloth.told), shaped=body.shaped(cloth.told))


def ready(points: Shaped[Array, "points 3"]) -> Float[Array, "ready 3"]:
    """A frame's points thinned, without floor."""
    return fewer(without_floor(thinned(points, WITH_FLOOR)))


def pose_of(state: BodyState) -> Pose:
    """A state as a pose of the embedded human's 52 joints: fingers rest in their hands."""
    rotations = np.tile(rot.IDENTITY, (len(human_model().parents), 1))
    rotations[:BODY] = rot.from_matrix(relative_turns(scan_body(), state.turns))
    return Pose(rotations, state.root[None])


def _seen(fit: Fit, status: str) -> Tracked:
    confidence = float(np.clip((ALMOST - misfit(fit)) / (ALMOST - 0.01), 0.0, 1.0))
    return Tracked(pose_of(fit.state), fit.state.shape, fit.state, status, confidence, fit.distance)


def told_by(body: ScanBody, foretold: Expected, guess: Start) -> Expected:
    """What is foretold together with a regressor's guess: between both, by their precisions."""
    apart = rotation_vectors(np.matmul(relative_turns(body, guess.state.turns), foretold.turns.transpose(0, 2, 1)))
    angle = np.linalg.norm(apart, axis=1)
    precision = GUESSED**-2 / (1.0 + (angle / DISMISSED) ** 2) / (1.0 + (guess.doubts / DOUBTFUL) ** 2)
    share = precision / (precision + foretold.turn_precision)
    turns = np.matmul(turn_matrices(apart * share[:, None]), foretold.turns)
    return replace(foretold, turns=turns, turn_precision=precision + foretold.turn_precision)


def around(cloud: Float[Array, "points 3"], memory: Memory) -> Array:
    """Which points lie in the box around where the body was."""
    joints = joints_of(scan_body(), memory.shaped, memory.state)
    low, high = joints.min(axis=0) - OUTLYING, joints.max(axis=0) + OUTLYING
    return ((cloud >= low) & (cloud <= high)).all(axis=1)


def _shape_information(body: ScanBody, fit: Fit, expected: Expected) -> Float[Array, "shapes shapes"]:
    """What the frame says of the shape when the pose is unknown: the Schur complement of its equations."""
    first = 3 * BODY + 3
    pose = fit.information[:first, :first] + np.diag(
        np.concatenate([np.repeat(expected.turn_precision, 3), np.full(3, expected.root_precision)])
    )
    cross = fit.information[:first, first:]
    return fit.information[first:, first:] - cross.T @ np.linalg.solve(pose + 1e-3 * np.eye(first), cross)
