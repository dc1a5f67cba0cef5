"""Patches over what touches, the skin by parts, and the clock of the viewer."""

import numpy as np
from made_bodies import ball

from retarget.view.patches import LIFT, Clock, padded, part_surfaces, patches

VERTICES, FACES = ball()
NONE = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.uint8)


def test_patches_are_divided_by_depth_and_lie_above_the_skin():
    vertex = np.array([100, 400, 700])
    found = patches(VERTICES, FACES, vertex, np.array([1, 5, 40], dtype=np.uint8))
    for name, middle in zip(("touch", "shallow", "deep"), vertex):
        patch = found[name]
        assert len(patch.faces) == (FACES == middle).any(axis=1).sum() > 0
        assert np.linalg.norm(patch.vertices - VERTICES[middle], axis=1).min() < 2 * LIFT
        radii = np.linalg.norm(patch.vertices, axis=1)
        assert radii.min() > 1 and np.median(radii) > 1 + 0.9 * LIFT


def test_where_nothing_touches_there_is_no_patch():
    assert all(len(patch.faces) == 0 for patch in patches(VERTICES, FACES, *NONE).values())


def test_the_deeper_code_has_a_face_that_both_mark():
    a, b, _ = FACES[50]
    found = patches(VERTICES, FACES, np.array([a, b]), np.array([1, 200], dtype=np.uint8))
    shared = ((FACES == a).any(axis=1) & (FACES == b).any(axis=1)).sum()
    assert len(found["deep"].faces) == (FACES == b).any(axis=1).sum()
    assert len(found["touch"].faces) == (FACES == a).any(axis=1).sum() - shared


def test_a_padded_patch_is_the_patch_and_keeps_its_size_while_it_fits():
    patch = patches(VERTICES, FACES, np.arange(40, 90), np.full(50, 1, dtype=np.uint8))["touch"]
    vertices, faces = padded(patch, 0, 0)
    assert np.array_equal(faces[: len(patch.faces)], patch.faces) and not faces[len(patch.faces) :].any()
    assert np.allclose(vertices[: len(patch.vertices)], patch.vertices)
    assert (vertices[len(patch.vertices) :] == vertices[0]).all() and len(vertices) < 1.2 * len(patch.vertices)
    room = len(vertices) + 7, len(faces) + 7
    assert tuple(map(len, padded(patch, *room))) == room, "what fits stays"
    assert tuple(map(len, padded(patch, 5000, 5000))) == (len(vertices), len(faces)), "far too large is given up"


def test_the_skin_by_parts_is_the_whole_skin():
    parts = (VERTICES[:, 1] > 0).astype(int)
    found = part_surfaces(FACES, parts)
    together = np.concatenate([kept[faces] for kept, faces in found.values()])
    assert set(found) == {0, 1} and sorted(map(tuple, together.tolist())) == sorted(map(tuple, FACES.tolist()))


def test_the_clock_plays_at_its_speed_and_starts_again():
    clock = Clock(2.0)
    assert clock.after(0.5).time == 0.5
    assert np.isclose(Clock(2.0, 1.8, True, 2.0).after(0.25).time, 0.3)
    assert Clock(2.0, 1.0, playing=False).after(5.0).time == 1.0
    assert Clock(0.0).after(5.0).time == 0.0, "a single frame"


def test_scrubbing_stops_the_clock_within_the_clip():
    assert Clock(2.0).at(1.5) == Clock(2.0, 1.5, playing=False)
    assert Clock(2.0).at(9.0).time == 2.0 and Clock(2.0).at(-1.0).time == 0.0
