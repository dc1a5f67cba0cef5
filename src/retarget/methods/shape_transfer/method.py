"""Contact-preserving shape transfer: the posed source is given the target's shape, its contacts kept (after Basset 2019)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from retarget.contact.contact_file import ContactEdits
from retarget.contact.slim import girth_kept, girths
from retarget.errors import RetargetError
from retarget.methods.base import Method
from retarget.methods.shape_transfer.flesh import prepare_flesh
from retarget.methods.shape_transfer.probe import surfaces_agree
from retarget.methods.shape_transfer.retargeter import PreparedShapeTransfer
from retarget.methods.shape_transfer.shape import prepare_shape
from retarget.motion.align import Actor
from retarget.motion.copy_clip import CopySettings, prepare_copier
from retarget.motion.touch.equations import Weights
from retarget.motion.touch.prepare import prepare_touch


@dataclass(frozen=True)
class ShapeTransfer(CopySettings, Method):
    """The target's shape in the pose of the source's surface: every vertex turns as the source's skin does there, parts keep
    the target's volumes, contacts of the pose are kept and nothing sinks in.

    The pose comes from the surface, not from joints, so performances are carried that no skeleton holds: the source's joints
    only say where its path leads and what rests on the ground. Where the surfaces do not match (a doll of loose pieces, a
    figure with another build), the target's own skin in the copied pose takes the place of that shape, which is said. Turns of the target's joints settle contacts, as in
    `interaction`; what is then left, the skin itself gives way to. The result has a surface of its own (`Result.surface`)
    beside the skeletal motion that fits it best.
    """

    laws: ClassVar[frozenset[str]] = frozenset({"equal results for equal input"})
    """As for `interaction`: nearest points of surfaces hop from vertex to vertex."""

    weights: Weights = Weights(near=0.0)
    """What each term weighs."""
    contacts: ContactEdits | None = None
    """What a contacts file asks for."""
    volumes: bool = True
    """Keep the volume of every part of the target."""
    relax: int = 6
    """Steps towards the target's local offsets, each as wide as two of the paper's, against creases; with none, a body given its
    own shape keeps every crease of its skin."""
    flesh: bool = True
    """Let skin give way where turning joints is not enough."""
    low_pass: float = 0.0
    """Seconds of a Gaussian low-pass over the result's surface, the paper's filter (section 6); 0 for none."""
    step_fps: float = 30.0
    """Frames a second that `step` is called with: what the times of a contacts file mean there."""

    def prepare(self, source: Actor, target: Actor) -> PreparedShapeTransfer:
        """Match the bodies. Raises `RetargetError` for a source or a target without a surface."""
        if target.character.skin is None:
            raise RetargetError("the target has no surface; shape transfer needs one (use copy-rotations)")
        if source.character.skin is None:
            raise RetargetError("the source has no surface; shape transfer starts from one (use interaction)")
        edits = self.contacts or ContactEdits()
        goals, solver = prepare_touch(source, target, self.weights, edits)
        equations = solver.equations
        parts = goals.detector.collider.parts, equations.collider.parts
        girth = [girths(each.character, each.humanoid, own) for each, own in zip((source, target), parts)]
        goals = replace(goals, girth_kept=girth_kept(*girth))
        shape = prepare_shape(source, target, equations.collider, self.volumes)
        flesh = None
        if self.flesh:
            mesh, rest = target.character.mesh, shape.isometric.target
            flesh = prepare_flesh(equations.collider, rest, mesh.faces, target.height, equations.threshold)
        copier = prepare_copier(replace(self, foot_lock=self.foot_lock and edits.kind("ground") > 0), source, target)
        if shape.onto_source.by_sensors is not None:
            agree, away = surfaces_agree(shape, copier, equations)
            if not agree:
                note = f"the surfaces do not match ({100 * away:.0f} % of the height off): the target's skin follows its joints"
                return PreparedShapeTransfer(self, copier, goals, solver, None, flesh, note)
        return PreparedShapeTransfer(self, copier, goals, solver, shape, flesh)
