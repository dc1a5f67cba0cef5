"""Clips and single poses through shape transfer."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float, Int, Shaped

from retarget.body.kinematics import forward, local_positions, world_pose
from retarget.body.skinning import skin_motion
from retarget.character import MeshMotion, Motion, Pose
from retarget.contact.contact_edits import let_go, without_effect
from retarget.errors import RetargetError
from retarget.geometry.bridging import bridged, is_finite
from retarget.methods.base import Result, Retargeter
from retarget.methods.shape_transfer.flesh import Flesh
from retarget.methods.shape_transfer.shape import PosedShape, ShapeCarrier
from retarget.motion.copy_clip import Copier
from retarget.motion.filter import gaussian
from retarget.motion.touch.goals import ClipGoals, FrameGoals, GoalMaker
from retarget.motion.touch.mend import (
    Before,
    between,
    corrected,
    frames_of,
    one_frame,
    solve_clip,
    solve_next,
    solved_frames,
)
from retarget.motion.touch.report import corrections, remaining
from retarget.motion.touch.solve import Solver

if TYPE_CHECKING:
    from retarget.methods.shape_transfer.method import ShapeTransfer

Array = np.ndarray

PATIENCE = 3
"""Times the steps that `interaction` takes: arms on very heavy bodies are far from where they were copied to."""
SOFT = 0.05
"""Seconds of the Gaussian that dents of a clip are smoothed by."""
ROOM, MOST_ROOM = 60, 4_000_000_000
"""Bytes that a vertex takes on every frame of a clip (source, shape, dents, result, skin), and bytes that a clip may take."""
COLD, WARM = 2, 1
"""Rounds in which skin gives way on the first frame, and on those after it."""


@dataclass(frozen=True, eq=False)
class _Last:
    """What a frame leaves to the next, online."""

    before: Before
    given: Float[Array, "vertices 3"] | None
    """How far its skin gave way, metres."""
    pose: Pose
    vertices: Float[Array, "vertices 3"]
    """The result itself: what a frame without a surface repeats."""


@dataclass(frozen=True, eq=False)
class PreparedShapeTransfer(Retargeter):
    """A matched pair of bodies."""

    takes_surface: ClassVar[bool] = True

    settings: ShapeTransfer
    copier: Copier
    goals: GoalMaker
    solver: Solver
    shape: ShapeCarrier | None
    """None where the surfaces do not match: the target's skin in the copied pose is the shape."""
    flesh: Flesh | None
    note: str = ""
    """What was decided for the pair."""
    last: list[_Last] = field(default_factory=list)
    """What the last online frame left."""
    steps: list[int] = field(default_factory=lambda: [0])
    """How many online frames there were."""

    def __call__(self, motion: Motion, surface: Float[Array, "frames vertices 3"] | None = None) -> Result:
        """Retarget a clip; `surface` are the source's posed vertices (metres) where its skin is not what the motion makes of
        it. Frames that are not finite are bridged and told. Raises `RetargetError` as `Copier.check` does, and for a surface
        of another size or without a finite frame."""
        self.copier.check(motion)
        self._expect_room(len(motion))
        skinner, equations = self.goals.detector.skinner, self.solver.equations
        posed = skinner.vertices(*world_pose(motion)) if surface is None else surface
        if posed.shape != (len(motion), len(skinner.homogeneous), 3):
            raise RetargetError(
                f"the surface must have {len(motion)} frames of {len(skinner.homogeneous)} vertices, received {posed.shape}"
            )
        posed, missing = bridged(posed)
        shapes = self._shapes(posed)
        copied = self.copier.clip(motion, None if self.shape is None else np.stack([each.turned for each in shapes]))
        chosen, fps = solved_frames(motion)
        frames = frames_of(copied.motion, chosen)
        touching = None if copied.contacts is None else copied.contacts.touching[chosen]
        performed = replace(frames_of(motion, chosen), fps=fps, name=motion.name)
        found, goals = self.goals.clip(performed, frames, equations, touching)
        if self.shape is not None:
            goals = replace(goals, surfaces=tuple(shapes[frame].surface for frame in chosen))
        x = solve_clip(self.solver, frames, goals, fps, PATIENCE)
        if self.copier.settings.in_place:
            x[:, [-3, -1]] = 0.0  # across the ground the body stays where it is
        whole = between(x, chosen, len(motion))
        vertices = self._surfaces(copied.motion, whole, shapes, goals, np.searchsorted(chosen, np.arange(len(motion))))
        if self.settings.low_pass > 0:
            vertices = gaussian(vertices, self.settings.low_pass * motion.fps)
        made, seconds = corrected(equations, copied.motion, whole), chosen / motion.fps
        status, left = remaining(equations, goals, seconds, lambda frame: vertices[chosen[frame]])
        stats = copied.stats | {
            "contacts_of_the_source": len(found.tracks.vertex),
            "contacts_of_its_girth": int((found.tracks.pose_probability < 0.5).sum()),
            "contacts_let_go": let_go(found, self.goals.edits.of_clip(motion.name), self.goals.girth_kept),
            **corrections(equations, x, seconds),
            **left,
            **self._residual(made, vertices),
        }
        idle = without_effect(found, self.goals.edits.of_clip(motion.name), fps, len(chosen))
        if idle:
            stats["contacts_file_without_effect"] = idle
        if len(goals.sunk.depth):
            stats["source_inside_itself_cm"] = round(100 * float(goals.sunk.depth.max()) / self.goals.size, 2)
        if self.note:
            stats["shape"] = self.note
        if len(missing):
            stats["bridged_frames"] = missing.tolist()
        mesh = replace(self.copier.target.character.mesh, vertices=vertices[0].astype(np.float64))
        return Result(self.copier.target, made, status, stats, MeshMotion(mesh, vertices, motion.fps, motion.name))

    def step(self, pose: Pose) -> Pose:
        """The next pose online; see `step_surface`, which gives the surface too."""
        return self.step_surface(pose)[0]

    def step_surface(
        self, pose: Pose, surface: Float[Array, "vertices 3"] | None = None
    ) -> tuple[Pose, Float[Array, "vertices 3"]]:
        """The next pose online and the target's vertices in it (metres), without any later frame. `surface` as in a call;
        while it is not finite the last frame's result is repeated. Raises `RetargetError` where a contacts file adds contacts,
        for a pose of another skeleton, a surface of another size, and one that is not finite before any that is."""
        last = self.last[0] if self.last else None
        if surface is not None and not self._is_whole(surface):
            if last is None:
                raise RetargetError("the first frame's surface is not finite, and there is no earlier frame to repeat")
            self.steps[0] += 1
            return last.pose, last.vertices.copy()
        frame, shape = self._shaped(pose, surface)
        equations, seconds = self.solver.equations, self.steps[0] / self.settings.step_fps
        source = one_frame(pose, self.copier.source.skeleton)
        found = self.goals.online(source, frame, equations, seconds, self.copier.floor)
        goals = replace(found.frame(0), surface=None if shape is None else shape.surface)
        now = solve_next(
            self.solver, frame, goals, last.before if last else None, self.settings.step_fps, True, PATIENCE
        )
        offsets = local_positions(frame.skeleton, frame.translations, frame.moved)[0]
        vertices, given = self._turned(frame.rotations[0], offsets, now.x, shape), None
        if self.flesh is not None:
            given = self._given(vertices, goals, last.given if last else None)
            vertices = vertices + given
        made = corrected(equations, frame, now.x[None]).pose(0)
        self.last[:] = [_Last(now, given, made, vertices.copy())]
        self.steps[0] += 1
        return made, vertices

    def forget(self) -> None:
        """Begin anew: the next frame online follows none."""
        self.last.clear()
        self.steps[:] = [0]

    def _expect_room(self, frames: int) -> None:
        """A surface on every frame takes room; refuse what would take more than `MOST_ROOM`."""
        most = MOST_ROOM // (ROOM * len(self.solver.equations.columns))
        if frames > most:
            raise RetargetError(
                f"{frames} frames of {len(self.solver.equations.columns)} vertices are more than shape transfer keeps in memory; "
                f"take at most {most} frames at a time (--start, --end, or a lower --fps)"
            )

    def _is_whole(self, surface: Array) -> bool:
        expected = (len(self.goals.detector.skinner.homogeneous), 3)
        if surface.shape != expected:
            raise RetargetError(f"the surface must have {expected[0]} vertices, received {surface.shape}")
        return bool(is_finite(surface))

    def _shaped(self, pose: Pose, surface: Array | None) -> tuple[Motion, PosedShape | None]:
        """The copied pose as a motion of one frame, and the shape in it."""
        if self.shape is None:
            return one_frame(self.copier.step(pose), self.copier.target.skeleton), None
        if surface is None:
            skeleton = self.copier.source.skeleton
            local = local_positions(skeleton, pose.translations[None], pose.moved)
            world = forward(skeleton.parents, pose.rotations[None], local)
            surface = self.goals.detector.skinner.vertices(*world)[0]
        shape = self.shape.posed(surface)
        return one_frame(self.copier.step(pose, shape.turned), self.copier.target.skeleton), shape

    def _shapes(self, posed: Shaped[Array, "frames vertices 3"]) -> list[PosedShape | None]:
        """The target's shape on every frame, in single precision: a clip has many."""
        if self.shape is None:
            return [None] * len(posed)
        return [each.single() for each in map(self.shape.posed, posed)]

    def _surfaces(
        self,
        copied: Motion,
        x: Float[Array, "frames unknowns"],
        shapes: list[PosedShape | None],
        goals: ClipGoals,
        goal_of: Int[Array, "frames"],
    ) -> Shaped[Array, "frames vertices 3"]:
        """The target's vertices on every frame (float32), whose goals are those numbered `goal_of`. Skin gives way as on the
        frame before, and smoothly over time: nearest points hop from one to another, and dents with them."""
        offsets = local_positions(copied.skeleton, copied.translations, copied.moved)
        vertices = np.empty((len(copied), len(self.solver.equations.columns), 3), dtype=np.float32)
        given, before = np.zeros_like(vertices), None
        for frame in range(len(copied)):
            turned = self._turned(copied.rotations[frame], offsets[frame], x[frame], shapes[frame])
            vertices[frame] = turned
            if self.flesh is not None:
                before = self._given(turned, goals.frame(int(goal_of[frame])), before)
                given[frame] = before
        vertices += gaussian(given, SOFT * copied.fps)
        return vertices

    def _turned(
        self, rotations: Array, offsets: Array, x: Array, shape: PosedShape | None
    ) -> Float[Array, "vertices 3"]:
        """The shape with its joints turned, creases relaxed and parts at their volumes."""
        if shape is None:
            return self.solver.equations.pose(rotations, offsets, x).vertices
        vertices = self.solver.equations.pose(rotations, offsets, x, shape.surface).vertices
        vertices = self.shape.offsets.relaxed(vertices, self.settings.relax)
        return vertices if self.shape.volumes is None else self.shape.volumes.kept(vertices)

    def _given(self, vertices: Array, goals: FrameGoals, before: Array | None) -> Float[Array, "vertices 3"]:
        return self.flesh.given(vertices, goals, COLD if before is None else WARM, before, self.copier.floor)

    def _residual(self, made: Motion, vertices: Shaped[Array, "frames vertices 3"]) -> dict[str, float]:
        """How far the skeletal motion's own skin is from the surface, millimetres."""
        away = 1000 * np.linalg.norm(vertices - skin_motion(self.copier.target.character, made), axis=-1)
        return {
            "skin_rms_mm": round(float(np.sqrt((away**2).mean())), 3),
            "skin_p95_mm": round(float(np.percentile(away, 95)), 3),
            "skin_worst_mm": round(float(away.max()), 3),
        }
