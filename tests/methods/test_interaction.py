"""The interaction method: hands come out of bellies and stay on them, and nothing else changes."""

import subprocess
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_bodies import box, with_faces, with_piece
from made_motions import actor, body, cast_by_names, scaled, walk

from retarget.body import rotations as rot
from retarget.body.kinematics import forward, local_positions, rest_pose
from retarget.body.skinning import prepare_skinning
from retarget.character import Motion
from retarget.contact.contact_file import ContactEdit, ContactEdits
from retarget.errors import RetargetError
from retarget.evaluate.touch import judged_body, observe, prepare_judge
from retarget.methods.interaction.method import Interaction
from retarget.motion.filter import cut, resample
from retarget.motion.library import embedded_motion
from retarget.motion.touch.equations import FARTHEST, MOST_CONTACT, MOST_NEAR, SLACK, Linearised, Weights
from retarget.retargeting import prepare


@cache
def hands_on_hips():
    return cut(embedded_motion("hands_on_hips"), 1.2, 2.2)


@cache
def solved(preset):
    return prepare(actor(), actor(preset), Interaction()).retargeter(hands_on_hips())


@cache
def touch():
    return observe(actor(), hands_on_hips())


@pytest.mark.parametrize("preset", ["heavy", "child"])
def test_hands_come_out_and_stay_on(preset):
    judge = prepare_judge(touch(), actor(preset))
    copied = prepare(actor(), actor(preset), "copy-rotations").retargeter(hands_on_hips()).motion
    before, after = judge(touch(), copied), judge(touch(), solved(preset).motion)
    assert before["penetration_percent"] > 5
    assert after["penetration_percent"] < 0.1
    assert after["contacts_kept"] > before["contacts_kept"] - 0.05 and after["contacts_kept"] > 0.8


@pytest.mark.parametrize("factor", [0.3, 3.0])
def test_a_body_in_another_unit_is_corrected_alike(factor):
    target = cast_by_names(scaled(body("heavy"), factor))
    made = prepare(actor(), target, Interaction()).retargeter(hands_on_hips()).motion
    apart = np.degrees(rot.angle_between(made.rotations, solved("heavy").motion.rotations))
    assert apart.max() < 2.0 and apart.mean() < 0.25


def test_feet_and_legs_hardly_move_where_hands_touch():
    copied = prepare(actor(), actor("heavy"), "copy-rotations").retargeter(hands_on_hips()).motion
    mended = solved("heavy").motion
    legs = [mended.skeleton.index(f"left{part}") for part in ("UpperLeg", "LowerLeg", "Foot")]
    assert np.degrees(rot.angle_between(copied.rotations[:, legs], mended.rotations[:, legs])).max() < 2.0
    feet = [mended.skeleton.index(f"{side}Foot") for side in ("left", "right")]
    apart = _world(copied)[1][:, feet] - _world(mended)[1][:, feet]
    assert np.abs(apart).max() < 0.005
    assert solved("heavy").stats["corrected_seconds"] > 0.3


def test_where_nothing_is_wrong_nothing_changes():
    motion = cut(embedded_motion("walk"), 1.0, 2.0)
    result = prepare(actor(), actor(), Interaction()).retargeter(motion)
    copied = prepare(actor(), actor(), "copy-rotations").retargeter(motion).motion
    turned = np.degrees(rot.angle_between(result.motion.rotations, copied.rotations))
    assert turned.max() < 0.5
    assert result.stats["corrections"] == [] and result.status == "ok"


def test_online_steps_stay_finite_and_mend_as_well():
    retargeter = prepare(actor(), actor("heavy"), Interaction()).retargeter
    motion = hands_on_hips()
    poses = [retargeter.step(motion.pose(frame)) for frame in range(20)]
    made = replace(
        motion,
        skeleton=actor("heavy").skeleton,
        rotations=np.stack([pose.rotations for pose in poses]),
        translations=np.stack([pose.translations for pose in poses]),
    )
    assert np.isfinite(made.rotations).all()
    judge = prepare_judge(touch(), actor("heavy"))
    vertices = prepare_skinning(actor("heavy").character)
    depth = judge.collider.depths(vertices.vertices(*_world(made))[10:])
    assert depth.max() < 0.01


def _world(motion):
    offsets = np.broadcast_to(motion.skeleton.offsets, (len(motion), *motion.skeleton.offsets.shape)).copy()
    offsets[:, 0] = motion.translations[:, 0]
    return forward(motion.skeleton.parents, motion.rotations, offsets)


def test_a_source_without_surface_gets_a_body_that_stands_in():
    bare = cast_by_names(replace(body(), mesh=None, skin=None))
    result = prepare(bare, actor("heavy"), Interaction())(hands_on_hips())
    assert any("stands in" in note for note in result.stats["stand_in"])
    figures = prepare_judge(touch(), actor("heavy"))(touch(), result.motion)
    assert figures["penetration_percent"] < 0.3 and figures["contacts_kept"] > 0.8
    with pytest.raises(RetargetError, match="the target has no surface"):
        prepare(actor(), bare, Interaction())


def test_stepping_is_the_causal_clip():
    few = cut(hands_on_hips(), 0.4, 0.7)
    stepping = prepare(actor(), actor("heavy"), Interaction()).retargeter
    poses = [stepping.step(few.pose(frame)) for frame in range(len(few))]
    clip = prepare(actor(), actor("heavy"), Interaction(causal=True)).retargeter(few).motion
    assert np.abs(np.stack([pose.translations for pose in poses]) - clip.translations).max() < 1e-12
    turned = rot.angle_between(np.stack([pose.rotations for pose in poses]), clip.rotations)
    assert turned.max() < 1e-7


def test_a_faster_clip_is_mended_between_the_solved_frames_too():
    fast = resample(hands_on_hips(), 120.0)
    result = prepare(actor(), actor("heavy"), Interaction()).retargeter(fast)
    assert len(result.motion) == len(fast)
    depth = judged_body(actor("heavy")).collider.depths(
        prepare_skinning(actor("heavy").character).vertices(*_world(result.motion))[30:60]
    )
    assert depth.max() < 0.006


def test_released_contacts_let_go():
    release = ContactEdits((ContactEdit(("leftHand", "pelvis"), does="release"), ContactEdit(("leftHand", "abdomen"), does="release")))
    free = prepare(actor(), actor("child"), Interaction(contacts=release)).retargeter(hands_on_hips()).motion
    judge = prepare_judge(touch(), actor("child"))
    lost = [int(judge.lost(touch(), motion, None)[0].sum()) for motion in (free, solved("child").motion)]
    assert lost[0] > 3 * lost[1]


def test_a_timed_entry_acts_online_as_over_a_clip():
    """Both let go of the left hand from half a second on, and not before."""
    parts = [("leftHand", other) for other in ("pelvis", "abdomen", "leftThigh")]
    settings = Interaction(contacts=ContactEdits(tuple(ContactEdit(pair, 0.5, None, "release") for pair in parts)))
    released, plain = (prepare(actor(), actor("child"), each).retargeter for each in (settings, Interaction()))
    motion = hands_on_hips()
    arm = [plain.copier.target.skeleton.index(f"left{part}") for part in ("UpperArm", "LowerArm", "Hand")]
    for clip in (lambda each: each(motion).motion.rotations, lambda each: stepped(each, motion)):
        turned = rot.angle_between(clip(released)[:, arm], clip(plain)[:, arm]).max(axis=1)
        assert turned[:9].max() < 0.03 < 0.1 < turned[18:].max()


def stepped(retargeter, motion):
    return np.stack([retargeter.step(motion.pose(number)).rotations for number in range(len(motion))])


def test_an_entry_for_another_clip_does_nothing_and_one_without_effect_is_told():
    few = replace(cut(hands_on_hips(), 0.4, 0.7), name="hips")
    edits = tuple(
        ContactEdit(("leftHand", part), does="release", clip=clip)
        for part, clip in (("pelvis", "walk"), ("abdomen", "walk"), ("rightFoot", "hips"))
    )
    plain, edited = (
        prepare(actor(), actor("heavy"), Interaction(contacts=each)).retargeter(few) for each in (None, ContactEdits(edits))
    )
    assert np.array_equal(plain.motion.rotations, edited.motion.rotations)
    assert edited.stats["contacts_file_without_effect"] == ["release leftHand-rightFoot from 0 s to the end"]
    assert "contacts_file_without_effect" not in plain.stats


def test_without_ground_strength_nothing_is_held_down():
    prepared = prepare(actor(), actor("heavy"), Interaction(contacts=ContactEdits(strength=(("ground", 0.0),)))).retargeter
    assert prepared.solver.equations.weights.support == 0.0 and not prepared.copier.settings.foot_lock
    half = prepare(actor(), actor("heavy"), Interaction(contacts=ContactEdits(strength=(("ground", 0.5),)))).retargeter
    usual = Weights().sized(actor("heavy").height).support
    assert half.solver.equations.weights.support == pytest.approx(0.5 * usual) and half.copier.settings.foot_lock


def test_contacts_are_added_to_whole_clips_only():
    settings = Interaction(contacts=ContactEdits((ContactEdit(("leftHand", "head"), does="add"),)))
    with pytest.raises(RetargetError, match="only be added where the whole clip is known"):
        prepare(actor(), actor("child"), settings).retargeter.step(hands_on_hips().pose(0))


def test_where_the_copy_has_no_fault_it_is_the_result():
    """Onto the performer's own body nothing needs mending; onto a heavier one the frames before the hands arrive do not."""
    motion = cut(embedded_motion("hands_on_hips"), 0.0, 2.0)
    same = prepare(actor(), actor(), Interaction()).retargeter
    assert np.degrees(rot.angle_between(same(motion).motion.rotations, same.copier.clip(motion).motion.rotations)).max() < 0.2
    onto = prepare(actor(), actor("muscular"), Interaction()).retargeter
    turned = np.degrees(rot.angle_between(onto(motion).motion.rotations, onto.copier.clip(motion).motion.rotations)).max(axis=1)
    assert turned[:10].max() < 0.3 and turned[-10:].max() > 3.0


def test_a_body_repairs_itself():
    """Copied onto a heavy body, the hands sink in; the same body as its own source comes out clean."""
    copied = prepare(actor(), actor("heavy"), "copy-rotations").retargeter(hands_on_hips()).motion
    fixed = prepare(actor("heavy"), actor("heavy"), Interaction(keep_depth=False)).retargeter(copied)
    depths = [
        judged_body(actor("heavy")).collider.depths(prepare_skinning(actor("heavy").character).vertices(*_world(motion)))
        for motion in (copied, fixed.motion)
    ]
    assert (depths[0] > 0.001).sum() > 20 * max((depths[1] > 0.001).sum(), 1)


def test_what_the_source_has_inside_itself_is_made_no_deeper_and_left():
    sunk = prepare(actor(), actor("heavy"), "copy-rotations").retargeter(hands_on_hips()).motion
    kept = prepare(actor("heavy"), actor("heavy"), Interaction()).retargeter(sunk).motion
    turned = np.degrees(rot.angle_between(kept.rotations, sunk.rotations))
    assert turned.max() < 0.5


@pytest.mark.parametrize("turned", [0.0, 0.2])
def test_the_gradient_is_that_of_the_energy(turned):
    """Right-hand sides against central differences along random directions: contacts, near sensors, resting feet."""
    prepared = prepare(actor(), actor("heavy"), Interaction(weights=Weights(repulsion=0.0, orientation=0.0))).retargeter
    equations, motion = prepared.solver.equations, cut(hands_on_hips(), 0.5, 0.5)
    copied = prepared.copier.clip(motion).motion
    _, goals = prepared.goals.clip(motion, copied, equations, None)
    goals = replace(goals.frame(0), resting=np.ones(6))
    goals = replace(goals, weight=np.full(len(goals.weight), 0.1))
    offsets = copied.skeleton.offsets.copy()
    offsets[0] = copied.translations[0, 0]
    random = np.random.default_rng(3)
    x = random.normal(scale=turned, size=equations.size)
    x[-3:] *= 0.1

    def energy(at):
        body = equations.pose(copied.rotations[0], offsets, at)
        place = lambda corners, shares: np.einsum("pc,pci->pi", shares, body.vertices[corners])  # noqa: E731
        first, second = place(goals.first, goals.first_shares), place(goals.second, goals.second_shares)
        corners = body.vertices[goals.faces]
        normals = rot.unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        missing = second + goals.gap[:, None] * normals - first
        off = np.linalg.norm(missing, axis=1)
        slack, most = SLACK * equations.threshold, FARTHEST * equations.threshold
        assert most > off.max() or turned, "far contacts have another energy"
        along = (missing * normals).sum(axis=1)
        share = np.maximum(0.0, 1.0 - slack / off) * np.minimum(1.0, most / off)
        weights = equations.weights
        counted = goals.weight * goals.count
        total = min(1.0, MOST_CONTACT / counted.sum()) * counted
        forces = total[:, None] * share[:, None] * (
            weights.across * missing + (weights.contact - weights.across) * along[:, None] * normals
        )
        near = [place(equations.sensors[own], equations.sensor_shares[own]) for own in goals.near]
        gap = goals.apart - np.linalg.norm(near[0] - near[1], axis=1)
        closeness = weights.near * goals.closeness * min(1.0, MOST_NEAR / max(goals.closeness.sum(), 1e-12))
        points = equations._support(body)
        return forces, first, second + goals.gap[:, None] * normals, 0.5 * (closeness * gap**2).sum() + 0.5 * (
            weights.support * ((goals.support - points) ** 2).sum()
        )

    found = equations.linearise(copied.rotations[0], offsets, goals, x)
    forces = energy(x)[0]
    for _ in range(8):
        direction = random.normal(size=equations.size)
        step = 1e-5 * direction
        after, before = energy(x + step), energy(x - step)
        work = (forces * ((after[1] - after[2]) - (before[1] - before[2]))).sum() / 2e-5
        slope = work - (after[3] - before[3]) / 2e-5
        size = np.linalg.norm(found.right) * np.linalg.norm(direction)
        assert found.right @ direction == pytest.approx(slope, abs=2e-3 * size)


def test_a_contact_pulls_gradually_after_it_began():
    prepared = prepare(actor(), actor("heavy"), Interaction()).retargeter
    motion = hands_on_hips()
    copied = prepared.copier.clip(motion).motion
    _, goals = prepared.goals.clip(motion, copied, prepared.solver.equations, None)
    sums = np.array([goals.frame(number).weight.sum() for number in range(len(motion))])
    assert sums.max() > 0
    assert np.abs(np.diff(sums)).max() < 0.5 * sums.max()


def test_a_sword_in_the_hand_is_neither_moved_out_of_the_way_nor_taken_for_fingers():
    hand = rest_pose(actor("heavy").skeleton)[1][actor("heavy").skeleton.index("leftHand")]
    blade = box(hand - [0.03, 0.03, 0.1], hand + [0.03, 0.03, 1.2])
    armed = cast_by_names(with_piece(body("heavy"), blade, {"leftHand": 1.0}))
    result = prepare(actor(), armed, Interaction()).retargeter(hands_on_hips())
    assert result.status == "ok"
    places = [_world(each)[1][15, actor("heavy").skeleton.index("leftHand")] for each in (result.motion, solved("heavy").motion)]
    assert np.linalg.norm(places[0] - places[1]) < 0.03, "the hand lies where it would without the sword"


@pytest.mark.parametrize("parts", [("LowerArm", "Hand", "Thumb", "Index", "Middle", "Ring", "Little"), ("Leg", "Foot", "Toes"), ("ip", "pine", "hest")])
def test_bones_without_a_surface_are_no_trouble(parts):
    """Forearms and hands, legs, the trunk: as the target, and as the source."""
    few = cut(hands_on_hips(), 0.4, 0.7)
    bare = cast_by_names(_without_surface(body("heavy"), parts))
    for source, target in ((actor(), bare), (bare, actor("average"))):
        prepared = prepare(source, target, Interaction()).retargeter
        result = prepared(few if source is actor() else Motion(bare.skeleton, few.rotations, few.translations, few.fps, few.moved))
        assert np.isfinite(result.motion.rotations).all() and np.isfinite(result.motion.translations).all()


def _without_surface(character, parts):
    skin, names = character.skin, character.skeleton.names
    lead = skin.joints[np.take_along_axis(skin.columns, skin.weights.argmax(1)[:, None], 1)[:, 0]]
    gone = np.isin(lead, [joint for joint, name in enumerate(names) if any(part in name for part in parts)])
    return with_faces(character, character.mesh.faces[~gone[character.mesh.faces].any(axis=1)])


def test_what_cannot_be_reached_is_told_and_bounded():
    far = ContactEdits((ContactEdit(("leftHand", "rightFoot"), does="add"),))
    result = prepare(actor(), actor("heavy"), Interaction(contacts=far)).retargeter(hands_on_hips())
    assert "not everything could hold" in result.status
    assert any({"leftHand", "rightFoot"} == set(row["parts"]) for row in result.stats["not_reached"])
    assert np.isfinite(result.motion.rotations).all()
    assert result.stats["largest_correction_degrees"] < 100


def test_knuckles_bend_around_a_rounder_body():
    names = {row["joint"] for row in solved("heavy").stats["corrections"]}
    copied = prepare(actor(), actor("heavy"), "copy-rotations").retargeter(hands_on_hips()).motion
    knuckle = copied.skeleton.index("leftMiddleProximal")
    turned = np.degrees(rot.angle_between(copied.rotations[:, knuckle], solved("heavy").motion.rotations[:, knuckle]))
    assert 1.0 < turned.max() < 45.0 and "leftUpperArm" in names


def test_online_a_clip_without_faults_stays_as_copied():
    free = cut(walk(), 0.0, 0.5)
    copied = prepare(actor(), actor(), "copy-rotations").retargeter
    online = prepare(actor(), actor(), Interaction()).retargeter
    for frame in range(len(free)):
        apart = rot.angle_between(copied.step(free.pose(frame)).rotations, online.step(free.pose(frame)).rotations)
        assert np.degrees(apart).max() < 0.05


def test_online_feet_on_the_floor_hold():
    """Hands that come out of a heavy body must not push its feet along."""
    few = cut(hands_on_hips(), 0.2, 0.7)
    copied = prepare(actor(), actor("heavy"), "copy-rotations").retargeter
    online = prepare(actor(), actor("heavy"), Interaction()).retargeter
    feet = [actor("heavy").skeleton.index(f"{side}Foot") for side in ("left", "right")]
    for frame in range(len(few)):
        poses = [each.step(few.pose(frame)) for each in (copied, online)]
        here, there = (
            _world(Motion(actor("heavy").skeleton, pose.rotations[None], pose.translations[None], 30.0, pose.moved))[1]
            for pose in poses
        )
        assert np.abs(here[0, feet] - there[0, feet]).max() < 0.003


def test_a_joint_beyond_its_limit_is_turned_back():
    """A knee that a correction bends forward: the equations ask for the turn back, of that joint alone."""
    target = actor("heavy")
    motion = cut(embedded_motion("walk"), 0.0, 0.1)
    copied = prepare(actor(), target, "copy-rotations")(motion).motion
    offsets = local_positions(copied.skeleton, copied.translations, copied.moved)[0]
    asked = []
    for weights in (Weights(limits=0.0), Weights()):
        prepared = prepare(actor(), target, Interaction(weights=weights)).retargeter
        equations = prepared.solver.equations
        _, goals = prepared.goals.clip(motion, copied, equations, None)
        x = np.zeros(equations.size)
        knee = equations.levers.names.index("leftLowerLeg")
        x[3 * knee] = -1.2
        asked.append(equations.linearise(copied.rotations[0], offsets, goals.frame(0), x).right)
    difference = (asked[1] - asked[0])[:-3].reshape(-1, 3)
    assert difference[knee, 0] > 0.3 * Weights().limits, "back by more than a third of a radian"
    others = np.delete(difference, knee, axis=0)
    assert np.abs(others).max() < 1e-6


def test_a_window_follows_the_one_before():
    """A long clip is solved in windows; their seams must not show."""
    prepared = prepare(actor(), actor("heavy"), Interaction()).retargeter
    solver, equations = prepared.solver, prepared.solver.equations
    random = np.random.default_rng(0)
    frames = 260
    wave = np.sin(np.arange(frames) / 9.0)[:, None] * random.normal(size=equations.size)
    found = [Linearised(np.zeros(equations.size), np.eye(equations.size), row, 0, 0.0) for row in wave]
    x = solver.together(np.zeros((frames, equations.size)), found, 30.0, np.ones(frames))
    jumps = np.linalg.norm(np.diff(x, n=3, axis=0), axis=1)
    seam = jumps[130:142].max()
    assert seam < 1.5 * jumps[60:120].max()


def test_equations_may_be_linearised_elsewhere():
    """The solution of a quadratic problem does not depend on where its equations were made."""
    prepared = prepare(actor(), actor("heavy"), Interaction()).retargeter
    solver, size = prepared.solver, prepared.solver.equations.size
    random = np.random.default_rng(1)
    lows = random.normal(size=(5, size, size)) / size
    matrices, right = lows @ lows.transpose(0, 2, 1), 1e-4 * random.normal(size=(5, size))
    at = 0.01 * random.normal(size=(5, size))
    here = [Linearised(np.zeros(size), m, r, 0, 0.0) for m, r in zip(matrices, right)]
    there = [Linearised(a, m, r - m @ a, 0, 0.0) for a, m, r in zip(at, matrices, right)]
    solutions = [solver.together(np.zeros((5, size)), found, 30.0, np.ones(5)) for found in (here, there)]
    assert np.abs(solutions[0]).max() > 1e-6
    assert solutions[1] == pytest.approx(solutions[0], abs=1e-9)


def test_kernels_are_compiled_at_set_up():
    """After the set-up's calls nothing compiles while a clip is solved: a first user must not wait."""
    code = (
        "from retarget.contact import collide, kernels, pair_kernels, skin_kernels\n"
        "from retarget.geometry import turn_kernels\n"
        "from retarget.motion import limit_kernels\n"
        "[each.compile_kernels() for each in (collide, pair_kernels, skin_kernels, turn_kernels, limit_kernels)]\n"
        "all_kernels = (kernels, pair_kernels, skin_kernels, turn_kernels, limit_kernels)\n"
        "made = lambda: {(m.__name__, n): len(f.signatures) for m in all_kernels\n"
        "                for n, f in vars(m).items() if hasattr(f, 'signatures')}\n"
        "before = made()\n"
        "from retarget import cast, embedded_motion, human, prepare\n"
        "from retarget.body.human import PRESETS\n"
        "from retarget.motion.filter import cut\n"
        "thin, heavy = (cast(human(**PRESETS[name])) for name in ('thin', 'heavy'))\n"
        "few = cut(embedded_motion('hands_on_hips'), 1.2, 1.5)\n"
        "made_heavy = prepare(thin, heavy, 'interaction')(few).motion\n"
        "prepare(heavy, thin, 'interaction', causal=True)(made_heavy)\n"
        "carried = prepare(thin, heavy, 'shape-transfer').retargeter\n"
        "carried(few), carried.step(few.pose(0)), prepare(thin, heavy, 'deformation-transfer')(few)\n"
        "assert before == made(), {k: (before[k], v) for k, v in made().items() if v != before[k]}\n"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stderr == ""
