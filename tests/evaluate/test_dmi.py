"""Ye 2024's field as the only thing that is minimised: what the paper's rows are worth under one solver."""

from functools import cache

import pytest
from made_motions import actor

from retarget.evaluate.reference.dmi import ROWS, FieldOnly
from retarget.evaluate.touch import observe, prepare_judge
from retarget.methods.copy_rotations import CopyRotations
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion


@cache
def kept_and_penetration(kind):
    """Contacts kept and penetrating limb vertices (per cent) of hands on hips on a heavy body."""
    method = CopyRotations() if kind == "copy" else FieldOnly(kind)
    motion = cut(embedded_motion("hands_on_hips"), 1.2, 1.8)
    touch = observe(actor(), motion)
    result = method.prepare(actor(), actor("heavy"))(motion).motion
    figures = prepare_judge(touch, actor("heavy"))(touch, result)
    return figures["contacts_kept"], figures["penetration_percent"]


def test_the_nearest_entries_keep_contacts_and_push_limbs_apart():
    kept, penetration = kept_and_penetration("nearest")
    copied_kept, copied_penetration = kept_and_penetration("copy")
    assert kept > copied_kept + 0.05
    assert penetration < 0.8 * copied_penetration


@pytest.mark.parametrize("kind", sorted(set(ROWS) - {"nearest"}))
def test_what_the_paper_compares_with_keeps_less(kind):
    """Table 1 and 5 of the paper: farthest targets alone and the distance matrix keep fewer contacts."""
    assert kept_and_penetration(kind)[0] < kept_and_penetration("nearest")[0] + 0.01
