"""Skin that gives way: the least displacement, and on which surface contacts are looked at."""

from dataclasses import replace

import numpy as np
import pytest
from made_motions import actor, prepared

from retarget.body.kinematics import local_positions
from retarget.body.skinning import skin_motion
from retarget.contact.collide import prepare_collider
from retarget.geometry.topology import vertex_normals
from retarget.methods import CopyRotations, ShapeTransfer
from retarget.methods.shape_transfer.flesh import _assembled, prepare_flesh
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion
from retarget.motion.touch.mend import one_frame


@pytest.fixture(scope="module")
def flesh():
    body = actor("heavy")
    collider = prepare_collider(body.character, body.humanoid)
    mesh = body.character.mesh
    return prepare_flesh(collider, mesh.vertices, mesh.faces, body.height, 0.012 * body.height)


def rows_of(flesh, count=40):
    draw = np.random.default_rng(3)
    first = draw.integers(0, len(flesh.area), size=(count, 1))
    second = flesh.faces[draw.integers(0, len(flesh.faces), size=count)]
    shares = draw.dirichlet(np.ones(3), size=count)
    normals = draw.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    block = (
        first,
        np.ones((count, 1)),
        second,
        shares,
        normals,
        draw.uniform(0, 0.01, count),
        60.0 * flesh.area[first[:, 0]],
    )
    return _assembled([block], flesh.collider.parts.welded)


def test_enough_steps_find_the_least_displacement(flesh):
    """At the solution of the least squares, with A = D times normals: K x = -Aᵀ W (A (x - at) - missing). With x sought in the
    span of K⁻¹ Aᵀ, that is a small dense system."""
    rows = rows_of(flesh)
    count, size = len(rows.missing), len(flesh.area)
    spread = np.stack([rows.spread(np.eye(count)[row]) for row in range(count)])
    inverse = np.stack([flesh.stiffness.solve(each) for each in spread]).astype(np.float64)
    at = 1e-3 * np.random.default_rng(5).normal(size=(size, 3))
    stiff = 2.0
    gram = np.stack([rows.along(each) for each in inverse], axis=1) / stiff
    wanted = rows.missing + rows.along(at)
    amounts = np.linalg.solve(np.diag(1.0 / rows.weight) + gram, wanted)
    truth = np.einsum("r,rvx->vx", amounts, inverse) / stiff
    found = flesh._solved(rows, at, stiff, 200)
    assert np.abs(found - truth).max() < 0.02 * np.abs(truth).max()


def test_what_is_inside_comes_out_and_the_rest_stays(flesh):
    target = actor("heavy")
    copied = prepared(actor(), target, CopyRotations())(cut(embedded_motion("hand_on_belly"), 1.7, 1.7)).motion
    posed = skin_motion(target.character, copied)[0].astype(np.float64)
    retargeter = prepared(actor(), target, ShapeTransfer()).retargeter
    frame = one_frame(copied.pose(0), target.skeleton)
    performed = cut(embedded_motion("hand_on_belly"), 1.7, 1.7)
    goals = retargeter.goals.online(performed, frame, retargeter.solver.equations, 0.0, 0.0).frame(0)
    before = flesh.collider.depths(posed[None])[0]
    moved = flesh.given(posed, goals, 3)
    after = flesh.collider.depths((posed + moved)[None])[0]
    shallow = (before > 0.001) & (before < 0.02)
    assert shallow.sum() > 20
    assert after[shallow].mean() < 0.3 * before[shallow].mean()
    far = np.abs(posed[:, 1] - posed[before > 0.001, 1].mean()) > 0.5
    assert np.abs(moved[far]).max() < 1e-3


def test_what_is_below_the_floor_comes_up(flesh):
    target = actor("heavy")
    rest = target.character.mesh.vertices
    floor = rest[:, 1].min() + 0.004
    retargeter = prepared(actor(), target, ShapeTransfer()).retargeter
    still = cut(embedded_motion("walk"), 0.0, 0.0)
    copied = prepared(actor(), target, CopyRotations())(still).motion
    goals = retargeter.goals.online(still, copied, retargeter.solver.equations, 0.0, 0.0).frame(0)
    low = rest[:, 1] < floor
    moved = flesh.given(rest, replace(goals, weight=goals.weight[:0], first=goals.first[:0]), 2, floor=floor)
    assert low.sum() > 5 and (rest + moved)[low, 1].min() > floor - 0.0015


def test_a_displacement_stays_near_the_one_before(flesh):
    """Steady frames: nothing new is asked, the old displacement fades."""
    rest = actor("heavy").character.mesh.vertices
    retargeter = prepared(actor(), actor("heavy"), ShapeTransfer()).retargeter
    still = cut(embedded_motion("walk"), 0.0, 0.0)
    goals = retargeter.goals.online(
        still, prepared(actor(), actor("heavy"), CopyRotations())(still).motion, retargeter.solver.equations, 0.0, 0.0
    ).frame(0)
    before = 0.002 * vertex_normals(rest, actor("heavy").character.mesh.faces)
    after = flesh.given(rest, replace(goals, weight=goals.weight[:0]), 1, before)
    share = (after * before).sum() / (before**2).sum()
    assert 0.2 < share < 0.9


def test_contacts_are_looked_at_on_the_frame_s_own_surface():
    retargeter = prepared(actor(), actor("heavy"), ShapeTransfer()).retargeter
    performed = cut(embedded_motion("hand_on_belly"), 1.7, 1.7)
    equations = retargeter.solver.equations
    frame, shape = retargeter._shaped(performed.pose(0), None)
    goals = retargeter.goals.online(performed, frame, equations, 0.0, 0.0).frame(0)
    offsets = local_positions(frame.skeleton, frame.translations, frame.moved)[0]
    still = np.zeros(equations.size)
    own = equations.pose(frame.rotations[0], offsets, still, shape.surface).vertices
    skin = equations.pose(frame.rotations[0], offsets, still).vertices
    assert 0.001 < np.abs(own - skin).max() < 0.1
    whole, rigid = (
        equations.linearise(frame.rotations[0], offsets, replace(goals, surface=each), still)
        for each in (shape.surface, None)
    )
    assert np.abs(whole.right - rigid.right).max() > 1e-3 * np.abs(rigid.right).max()
