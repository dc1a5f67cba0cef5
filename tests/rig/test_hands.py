"""Fingers: curled hands are found curled; what has no fingers is left alone."""

import numpy as np
import pytest

from retarget.geometry.resample import Surface
from retarget.rig import hands
from retarget.rig.fit import prepare_skin
from retarget.rig.fit_model import BodyState, pose_body
from retarget.rig.hands import fit_fingers
from retarget.rig.templates import human_template


def _hand_points(template):
    fingers = [j for j, name in enumerate(template.names) if j >= template.model.fingers]
    return template.model.weights[:, fingers].sum(axis=1) > 0.5


def _resting(template):
    shape = np.zeros(len(template.model.spread))
    return BodyState(shape, np.tile(np.eye(3), (len(template.names), 1, 1)), template.model.joints[0].copy())


def _with_turned_fingers(template, degrees):
    """Every finger but the thumb bent at its first two joints, towards the palm (down, in the template's rest pose)."""
    from scipy.spatial.transform import Rotation

    state = _resting(template)
    turns = state.turns.copy()
    for joint, name in enumerate(template.names):
        if joint < template.model.fingers:
            continue
        side = "left" if name.startswith("left") else "right"
        index, little = (
            template.model.joints[template.names.index(side + each)] for each in ("IndexProximal", "LittleProximal")
        )
        axis = (index - little) / np.linalg.norm(index - little) * (-1 if side == "left" else 1)
        bend = degrees if "Proximal" in name or "Intermediate" in name else 0.0
        own = Rotation.from_rotvec(np.radians(0.0 if "Thumb" in name else bend) * axis).as_matrix()
        turns[joint] = turns[template.model.parents[joint]] @ own
    return BodyState(state.shape, turns, state.root)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 55.0])
def test_a_hand_is_found_as_it_is_bent(degrees):
    template = human_template()
    truth = pose_body(template.model, _with_turned_fingers(template, degrees)).points
    skin = prepare_skin(Surface(truth, template.faces))
    model, state = fit_fingers(template.names, template.model, _resting(template), skin)
    away = np.linalg.norm(pose_body(model, state).points - truth, axis=1)[_hand_points(template)]
    assert away.mean() < 0.006


def test_from_a_straight_hand_alone_a_fist_is_not_found(monkeypatch):
    template = human_template()
    truth = pose_body(template.model, _with_turned_fingers(template, 55.0)).points
    monkeypatch.setattr(hands, "CURLS", (0.0,))
    model, state = hands.fit_fingers(
        template.names, template.model, _resting(template), prepare_skin(Surface(truth, template.faces))
    )
    away = np.linalg.norm(pose_body(model, state).points - truth, axis=1)[_hand_points(template)]
    assert away.mean() > 0.012


def test_only_hands_and_fingers_turn():
    template = human_template()
    truth = pose_body(template.model, _with_turned_fingers(template, 40.0)).points
    before = _resting(template)
    _, after = fit_fingers(template.names, template.model, before, prepare_skin(Surface(truth, template.faces)))
    turned = [name for j, name in enumerate(template.names) if not np.allclose(after.turns[j], before.turns[j])]
    assert turned and all(
        name.endswith("Hand") or template.names.index(name) >= template.model.fingers for name in turned
    )
    assert np.array_equal(after.shape, before.shape) and np.array_equal(after.root, before.root)


def test_a_body_without_fingers_is_left_as_it_is():
    template = human_template()
    state = BodyState(
        _resting(template).shape, _resting(template).turns[: len(template.body.parents)], _resting(template).root
    )
    skin = prepare_skin(Surface(template.model.points, template.faces))
    model, after = fit_fingers(template.names[: template.body.fingers], template.body, state, skin)
    assert model is template.body and after is state
