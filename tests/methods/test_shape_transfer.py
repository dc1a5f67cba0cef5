"""Shape transfer: the pose comes from the surface, contacts stay, and what cannot be done is said."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_motions import actor, body, cast_by_names, prepared

from retarget import load
from retarget.body.skinning import skin_motion
from retarget.character import Mesh
from retarget.contact.collide import prepare_collider
from retarget.errors import RetargetError
from retarget.evaluate.touch import observe, prepare_judge
from retarget.methods import CopyRotations, ShapeTransfer
from retarget.methods.shape_transfer.probe import surfaces_agree
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion
from retarget.retargeting import prepare


@cache
def hands_on_hips():
    return cut(embedded_motion("hands_on_hips"), 1.2, 1.4)


def fresh(preset, volumes=True, flesh=True, **settings):
    """A retargeter that has stepped through nothing yet, all made of one that was prepared once."""
    made = prepared(actor(), actor(preset), ShapeTransfer()).retargeter
    return replace(
        made,
        settings=replace(made.settings, **settings),
        shape=made.shape if volumes else replace(made.shape, volumes=None),
        flesh=made.flesh if flesh else None,
        last=[],
        steps=[0],
    )


@cache
def moved(preset, **settings):
    return fresh(preset, **settings)(hands_on_hips())


@cache
def source_surface():
    return skin_motion(body(), hands_on_hips())


def test_the_same_body_keeps_its_surface():
    """Parts keep the volumes of the rest pose, and creases relax, only where asked to: this skin loses a sixth of its
    shoulders' in the pose."""
    for settings, most in (({"volumes": False, "relax": 0}, 0.002), ({}, 0.015)):
        result = moved("thin", **settings)
        away = np.linalg.norm(result.surface.vertices - source_surface(), axis=-1)
        assert away.max() < most
        assert np.linalg.norm(skin_motion(body(), result.motion) - source_surface(), axis=-1).max() < most
        assert result.status == "ok" and "bridged_frames" not in result.stats


def test_contacts_are_kept_and_arms_stay_out():
    target = actor("very_heavy")
    touch = observe(actor(), hands_on_hips())
    judge = prepare_judge(touch, target)
    copied = prepared(actor(), target, CopyRotations()).retargeter(hands_on_hips()).motion
    before, after = judge(touch, copied), judge(touch, moved("very_heavy").motion)
    assert before["contacts_kept"] < 0.1 and before["penetration_percent"] > 10
    assert after["contacts_kept"] > 0.8 and after["penetration_percent"] < 1.0
    depth = judge.collider.depths(moved("very_heavy").surface.vertices)
    assert (depth > 0.005).mean() < 0.001, "nor does the surface itself sink in"


def test_skin_gives_way_where_joints_do_not_suffice():
    firm, soft = (moved("very_heavy", flesh=each).surface.vertices for each in (False, True))
    collider = fresh("very_heavy").solver.equations.collider
    sunk = [np.maximum(collider.depths(each), 0).sum() for each in (firm, soft)]
    assert sunk[1] < 0.85 * sunk[0]
    assert np.abs(firm - soft).max() < 0.06


def test_parts_keep_their_volumes():
    shape = fresh("heavy").shape
    result = moved("heavy", flesh=False).surface.vertices
    change = [np.abs(shape.volumes.of(each.astype(np.float64)) / shape.volumes.volumes - 1).max() for each in result]
    assert max(change) < 0.01


@pytest.mark.parametrize("preset", ["heavy", "child"])
def test_a_held_pose_comes_to_what_the_clip_gives(preset):
    """To a centimetre but for finger tips: online, contacts count by nearness alone."""
    motion = hands_on_hips()
    held = replace(
        motion, rotations=np.repeat(motion.rotations[-1:], 6, 0), translations=np.repeat(motion.translations[-1:], 6, 0)
    )
    retargeter = fresh(preset)
    clip = retargeter(held)
    away = []
    for _ in range(14):
        _, vertices = retargeter.step_surface(held.pose(0))
        away.append(np.linalg.norm(vertices - clip.surface.vertices[-1], axis=1))
    assert away[-1].mean() < 0.75 * away[0].mean()
    assert (away[-1] < 0.01).mean() > 0.98 and away[-1].max() < 0.02


def test_settings_leave_out_what_they_name():
    made = prepare(actor(), actor("child"), "shape-transfer", volumes=False, flesh=False).retargeter
    assert made.shape.volumes is None and made.flesh is None
    assert fresh("child").shape.volumes is not None and fresh("child").flesh is not None


def test_what_is_needed_and_missing_is_said():
    bare = cast_by_names(replace(body(), mesh=None, skin=None))
    with pytest.raises(RetargetError, match="the source has no surface.*use interaction"):
        prepare(bare, actor("heavy"), "shape-transfer")
    with pytest.raises(RetargetError, match="the target has no surface.*use copy-rotations"):
        prepare(actor(), bare, "shape-transfer")
    none = replace(
        hands_on_hips(), rotations=hands_on_hips().rotations[:0], translations=hands_on_hips().translations[:0]
    )
    with pytest.raises(RetargetError, match="no frames"):
        fresh("heavy")(none)
    with pytest.raises(RetargetError, match="6883 vertices, received"):
        fresh("heavy")(hands_on_hips(), source_surface()[:, :5])
    with pytest.raises(RetargetError, match="6883 vertices, received"):
        fresh("heavy").step_surface(hands_on_hips().pose(0), source_surface()[0, :5])


def test_the_surface_leads_not_the_joints():
    """A surface whose head is turned, over a motion whose head is not: the result's head turns."""
    from retarget.body import rotations as rot
    from retarget.body.kinematics import world_pose

    motion = hands_on_hips()
    head, turned = motion.skeleton.index("head"), motion.rotations.copy()
    turned[:, head] = rot.multiply(rot.from_rotation_vector(np.array([0.0, 0.5, 0.0])), turned[:, head])
    surface = skin_motion(body(), replace(motion, rotations=turned))
    result = fresh("child")(motion, surface)
    plain = moved("child")
    angle = rot.angle_between(world_pose(result.motion)[0][:, head], world_pose(plain.motion)[0][:, head])
    assert np.degrees(angle) == pytest.approx(np.degrees(0.5), abs=3.0)


def test_missing_frames_are_bridged_and_told():
    surface = source_surface().copy()
    surface[3] = np.nan
    surface[-1, 7, 1] = np.inf
    result = fresh("child")(hands_on_hips(), surface)
    assert result.stats["bridged_frames"] == [3, len(surface) - 1]
    assert np.isfinite(result.surface.vertices).all() and np.isfinite(result.motion.rotations).all()
    away = np.linalg.norm(result.surface.vertices - moved("child").surface.vertices, axis=-1)
    assert away.max() < 0.015
    with pytest.raises(RetargetError, match="none of the surface's"):
        fresh("child")(hands_on_hips(), np.full_like(surface, np.nan))


def test_online_a_missing_frame_repeats_the_last():
    retargeter, motion, surface = fresh("child"), hands_on_hips(), source_surface()
    gone = np.full_like(surface[0], np.nan)
    with pytest.raises(RetargetError, match="no earlier frame"):
        retargeter.step_surface(motion.pose(0), gone)
    pose, vertices = retargeter.step_surface(motion.pose(0), surface[0])
    kept = vertices.copy()
    again, repeated = retargeter.step_surface(motion.pose(1), gone)
    assert np.array_equal(repeated, kept) and np.array_equal(again.rotations, pose.rotations)
    repeated[:] = 0.0  # the caller's own
    _, next_one = retargeter.step_surface(motion.pose(1), gone)
    assert np.array_equal(next_one, kept) and retargeter.steps == [3]
    assert np.isfinite(retargeter.step_surface(motion.pose(2), surface[2])[1]).all()


def test_results_are_files_twice_alike(tmp_path):
    results = [moved("child"), prepare(actor(), actor("child"), "shape-transfer")(hands_on_hips())]
    for number, result in enumerate(results):
        result.save(tmp_path / f"{number}.glb")
        result.save_surface(tmp_path / f"{number}.npz")
    for suffix in ("glb", "npz"):
        assert (tmp_path / f"0.{suffix}").read_bytes() == (tmp_path / f"1.{suffix}").read_bytes()
    loaded = load(tmp_path / "0.glb").motion()
    assert len(loaded) == len(hands_on_hips())
    surface = load(tmp_path / "0.npz").sequence
    assert np.abs(surface.vertices - results[0].surface.vertices).max() < 1e-5
    assert surface.fps == hands_on_hips().fps


def test_the_surface_can_be_smoothed():
    """The paper's low-pass: jitter goes, the place stays."""
    plain, smooth = (moved("child", low_pass=each).surface.vertices for each in (0.0, 0.1))
    jerk = [np.abs(np.diff(each, n=3, axis=0)).mean() for each in (plain, smooth)]
    assert jerk[1] < 0.5 * jerk[0] and np.abs(plain - smooth).max() < 0.02


def test_contacts_of_the_source_s_girth_are_counted():
    """Arms of a heavy body lie against its flanks; a thin one's hands are put on its hips."""
    heavy = actor("heavy")
    walk = cut(prepared(actor(), heavy, CopyRotations())(embedded_motion("walk")).motion, 0.0, 0.2)
    stats = prepared(heavy, actor(), ShapeTransfer()).retargeter(walk).stats
    assert 0 < stats["contacts_of_its_girth"] <= stats["contacts_of_the_source"]
    assert stats["contacts_let_go"] == stats["contacts_of_its_girth"], "a thin target is slimmer everywhere"
    assert moved("heavy").stats["contacts_of_its_girth"] == 0


def test_surfaces_that_do_not_match_leave_the_target_its_own_skin():
    """A match in which the source has none of the target's edges gives no shape."""
    retargeter = prepare(actor(), actor("heavy"), ShapeTransfer()).retargeter
    agree, away = surfaces_agree(retargeter.shape, retargeter.copier, retargeter.solver.equations)
    assert agree and away < 0.02
    isometric = retargeter.shape.isometric
    broken = replace(retargeter.shape, isometric=replace(isometric, ratios=0.0 * isometric.ratios))
    agree, away = surfaces_agree(broken, retargeter.copier, retargeter.solver.equations)
    assert not agree and away > 0.06
    plain = replace(retargeter, shape=None, note="as told", last=[], steps=[0])
    made = plain(cut(embedded_motion("hands_on_hips"), 1.2, 1.25))
    assert made.stats["shape"] == "as told" and np.isfinite(made.surface.vertices).all()
    pose, vertices = plain.step_surface(embedded_motion("hands_on_hips").pose(36))
    assert np.isfinite(vertices).all() and len(pose.rotations) == len(body("heavy").skeleton)


def test_surfaces_with_seams_stay_whole():
    """Files double vertices along texture seams: the copies move as one, dents included, and nothing else changes."""
    source, target = (with_seam(body(name)) for name in ("thin", "heavy"))
    made = prepare(cast_by_names(source), cast_by_names(target), ShapeTransfer()).retargeter(hands_on_hips())
    count = len(body("heavy").mesh.vertices)
    copies = np.arange(count, len(target.mesh.vertices))
    assert len(copies) > 50
    firsts = prepare_collider(target, cast_by_names(target).humanoid).parts.welded[copies]
    assert np.abs(made.surface.vertices[:, copies] - made.surface.vertices[:, firsts]).max() < 1e-6
    assert np.abs(made.surface.vertices[:, :count] - moved("heavy").surface.vertices).max() < 0.001


def with_seam(character):
    """The same body cut open along its midline."""
    mesh, skin = character.mesh, character.skin
    left = mesh.vertices[mesh.faces].mean(axis=1)[:, 0] > 0
    shared = np.intersect1d(mesh.faces[left], mesh.faces[~left])
    copy = np.arange(len(mesh.vertices))
    copy[shared] = len(mesh.vertices) + np.arange(len(shared))
    faces = np.where(left[:, None], copy[mesh.faces], mesh.faces)
    doubled = Mesh(np.concatenate([mesh.vertices, mesh.vertices[shared]]), faces)
    columns, weights = (np.concatenate([each, each[shared]]) for each in (skin.columns, skin.weights))
    return replace(character, mesh=doubled, skin=replace(skin, columns=columns, weights=weights), origin=None)


@pytest.mark.parametrize("fault", ["holes", "no feet", "needles"])
def test_poor_meshes_are_finite(fault):
    character, draw = body("heavy"), np.random.default_rng(1)
    vertices, faces = character.mesh.vertices.copy(), character.mesh.faces
    if fault == "holes":
        faces = faces[draw.random(len(faces)) > 0.05]
    elif fault == "no feet":
        parts = prepare_collider(character, actor("heavy").humanoid).parts
        faces = faces[~np.isin(parts.face_parts, [parts.index("leftFoot"), parts.index("rightFoot")])]
    else:
        vertices[faces[100:120, 1]] = vertices[faces[100:120, 0]]
    poor = replace(character, mesh=Mesh(vertices, faces), origin=None)
    made = prepare(actor(), cast_by_names(poor), ShapeTransfer()).retargeter(cut(hands_on_hips(), 0.0, 0.1))
    assert np.isfinite(made.surface.vertices).all() and np.isfinite(made.motion.rotations).all()


def test_what_the_source_has_inside_itself_is_told_and_no_deeper():
    heavy = actor("very_heavy")
    sunk = prepared(actor(), heavy, CopyRotations()).retargeter(cut(embedded_motion("hands_on_hips"), 2.0, 2.0)).motion
    made = prepared(heavy, actor("heavy"), ShapeTransfer()).retargeter(sunk)
    collider = made_collider("heavy")
    before = made_collider("very_heavy").depths(skin_motion(body("very_heavy"), sunk).astype(np.float64))
    after = collider.depths(made.surface.vertices.astype(np.float64))
    assert made.stats["source_inside_itself_cm"] > 1.0
    assert (after > 0.001).sum() <= (before > 0.001).sum() and after.max() <= 1.1 * before.max()


def made_collider(preset):
    return prepare_collider(body(preset), actor(preset).humanoid)


def test_more_than_memory_holds_is_refused(monkeypatch):
    monkeypatch.setattr("retarget.methods.shape_transfer.retargeter.MOST_ROOM", 1_000_000)
    with pytest.raises(RetargetError, match="take at most 2 frames at a time"):
        fresh("heavy")(hands_on_hips())
