"""The body drawn into a cloud, step by step."""

import numpy as np

from retarget.methods.scan.fit import _rigid, turn_matrices


def test_turns_stay_rotations_through_thousands_of_frames():
    """As frames follow each other a chain's turns are made relative to the joint above (its transpose) and put together again."""
    draw = np.random.default_rng(0)
    turns = turn_matrices(draw.normal(size=(8, 3)))
    torn = turns.copy()
    for _ in range(2_000):
        step = turn_matrices(0.02 * draw.normal(size=(8, 3)))
        for each, kept in ((turns, _rigid), (torn, lambda every: every)):
            relative = np.concatenate([each[:1], np.matmul(each[:-1].transpose(0, 2, 1), each[1:])])
            for joint in range(1, 8):
                relative[joint] = each[joint - 1] @ relative[joint]
            each[:] = kept(np.matmul(step, relative))
    off = [np.abs(np.matmul(each.transpose(0, 2, 1), each) - np.eye(3)).max() for each in (turns, torn)]
    assert off[0] < 1e-12
    assert not off[1] < 1e-6  # what happens without
