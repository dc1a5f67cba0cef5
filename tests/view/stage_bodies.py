"""Bodies on a stage for the tests of views: a hand that comes to lie on the belly, and a walk."""

from functools import cache

from made_motions import actor, body, cast_by_names, walk

from retarget.character import Character
from retarget.evaluate.report import evaluate
from retarget.evaluate.take import Take
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion
from retarget.view.stage import stage_body


@cache
def belly_take(preset="thin"):
    """The moments around which the right hand comes to lie on the belly."""
    return Take(actor(preset), cut(embedded_motion("hand_on_belly"), 1.0, 2.0))


@cache
def belly(preset="thin"):
    return stage_body(f"{preset}: belly", belly_take(preset))


@cache
def bare_walk():
    """A walk of a skeleton without skin."""
    return stage_body("bones", Take(cast_by_names(Character(body().skeleton)), walk()))


@cache
def belly_report():
    """The heavy body's own joint angles against the thin body's."""
    return evaluate(belly_take("thin"), belly_take("heavy"))
