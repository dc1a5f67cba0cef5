"""Dense interaction: what touches in the source touches in the result, and nothing sinks into anything (after Ye 2024)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from retarget.contact.contact_file import ContactEdits
from retarget.errors import RetargetError
from retarget.methods.base import Method
from retarget.methods.interaction.looker import prepare_looker
from retarget.methods.interaction.network import load_network
from retarget.methods.interaction.retargeter import PreparedInteraction
from retarget.motion.align import Actor
from retarget.motion.copy_clip import CopySettings, prepare_copier
from retarget.motion.stand_in import fit_stand_in
from retarget.motion.touch.equations import Weights
from retarget.motion.touch.prepare import prepare_touch


@dataclass(frozen=True)
class Interaction(CopySettings, Method):
    """Copied rotations, corrected where the body would sink into itself or lose a contact of the source's pose.

    Where the copied pose has no fault it is the result. A source without a surface gets one: the embedded human, fitted to
    its skeleton, stands in for it. Surfaces that the source has inside each other may stay so, no deeper; those of a body
    that stands in are taken out.
    """

    laws: ClassVar[frozenset[str]] = frozenset({"equal results for equal input"})
    """The nearest points of surfaces hop from vertex to vertex, so that turning the world changes results by up to a
    millimetre; of the other laws, those about paths and joints are the copied pose's."""

    weights: Weights = Weights()
    """What each term weighs."""
    contacts: ContactEdits | None = None
    """What a contacts file asks for."""
    keep_depth: bool = True
    """Leave inside each other, no deeper, what the source has inside itself; else it is taken out."""
    causal: bool = False
    """Solve clips frame by frame without a look ahead, exactly as `step` does."""
    step_fps: float = 30.0
    """Frames a second that `step` is called with: what the times of a contacts file mean there."""
    learned_start: bool = False
    """Start clips from what the network of `learned-interaction` says, and solve fewer rounds. Online every frame starts from
    the one before."""

    def prepare(self, source: Actor, target: Actor) -> PreparedInteraction:
        """Match the bodies. Raises `RetargetError` for a target without a surface."""
        if target.character.skin is None:
            raise RetargetError("the target has no surface; the method 'interaction' needs one (use copy-rotations)")
        edits = self.contacts or ContactEdits()
        stand_in = fit_stand_in(source) if source.character.skin is None else None
        performer = stand_in.actor if stand_in else source
        may_sink = stand_in is None and self.keep_depth
        goals, solver = prepare_touch(performer, target, self.weights, edits, stand_in is not None, may_sink)
        copier = prepare_copier(replace(self, foot_lock=self.foot_lock and edits.kind("ground") > 0), source, target)
        start = (prepare_looker(performer, target), load_network()) if self.learned_start else None
        return PreparedInteraction(copier, stand_in, goals, solver, self.causal, self.step_fps, start)
