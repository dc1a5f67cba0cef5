"""Energies along the solver's rounds fall, and what a start saves is counted to the same energy."""

from functools import cache

import numpy as np
from made_motions import actor

from retarget.evaluate.benches.interaction_learned import _start_figures
from retarget.evaluate.start_gain import problem, rounds
from retarget.methods.interaction.looker import prepare_looker
from retarget.methods.interaction.network import load_network
from retarget.methods.interaction.retargeter import LEARNED_STAYED
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion
from retarget.motion.touch.solve import STAYED


@cache
def asked():
    return problem(actor(), actor("heavy"), cut(embedded_motion("hand_on_belly"), 1.5, 2.2))


def test_energies_fall_from_the_copied_pose_and_differences_add_up():
    (one, few), (last, more) = asked().solved(None, 0, STAYED), asked().solved(None, 3, STAYED)
    still = np.zeros_like(one)
    down, further, whole = asked().energy_above(still, one), asked().energy_above(one, last), asked().energy_above(still, last)
    assert down < 0 and further < 0 and few < more
    assert abs(down + further - whole) < 0.02 * abs(whole)
    assert asked().energy_above(last, still) > 0


def test_both_starts_are_followed():
    found = list(rounds(asked(), prepare_looker(actor(), actor("heavy")), load_network()))
    for stayed in (STAYED, LEARNED_STAYED):
        assert [each["rounds"] for each in found if each["start"] == "keys" and each["stayed"] == stayed] == [0, 1, 2, 3]
    learned = [each for each in found if each["start"] == "network" and each["stayed"] == STAYED]
    finer, coarser = (sum(each["set_ups"] for each in found if each["stayed"] == stayed) for stayed in (STAYED, LEARNED_STAYED))
    assert coarser < finer
    assert learned[0]["set_ups"] == 0 and learned[0]["energy"] < 0
    assert all(later["set_ups"] >= before["set_ups"] for before, later in zip(learned, learned[1:]))
    assert learned[-1]["energy"] < 0.95 * learned[0]["energy"]


def test_what_a_start_saves():
    def row(start, count, set_ups, energy, stayed=STAYED):
        return {"motion": "m", "target": "t", "start": start, "stayed": stayed, "rounds": count, "set_ups": set_ups, "energy": energy}

    keys = [row("keys", 1, 1.4, -99.0), row("keys", 2, 2.4, -99.95), row("keys", 3, 3.0, -100.0)]
    net = row("network", -1, 0.0, -80.0)
    figures = _start_figures([*keys, net, row("network", 1, 1.2, -99.92)], [])
    assert np.isclose(figures["start_iterations_saved"], 1 - 1.2 / 2.4)
    assert np.isclose(figures["start_iterations_saved_of_default"], 1 - 1.2 / 3.0)
    coarser = [row("keys", 2, 1.6, -99.91, LEARNED_STAYED), row("keys", 3, 1.7, -99.92, LEARNED_STAYED)]
    either = _start_figures([*keys, *coarser, net, row("network", 1, 1.2, -99.92)], [])
    assert np.isclose(either["start_iterations_saved"], 1 - 1.2 / 1.6), "key frames may be as coarse"
    assert np.isclose(either["start_iterations_saved_of_default"], 1 - 1.2 / 3.0)
    never = _start_figures([*keys, net, row("network", 3, 3.6, -99.0)], [])
    assert np.isclose(never["start_iterations_saved"], 1 - 3.6 / 2.4)
    early = _start_figures([*keys, net, row("network", 3, 1.1, -99.0, LEARNED_STAYED)], [])
    assert np.isclose(early["start_iterations_saved"], 1 - 3.0 / 2.4), "what stops short has saved nothing"
