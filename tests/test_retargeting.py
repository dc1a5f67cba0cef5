"""The verb: files and nouns in, a result out, mistakes in one line."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from made_motions import actor, body, cast_by_names, scaled, stand, walk

import retarget as package
from retarget.body import rotations as rot
from retarget.body.kinematics import world_pose
from retarget.casting import Hints, cast
from retarget.character import Character, Skeleton
from retarget.errors import FileError, MatchError, RetargetError
from retarget.io import load, save
from retarget.methods import METHODS, CopyRotations, Interaction
from retarget.methods.base import save_results
from retarget.methods.interaction.retargeter import PreparedInteraction
from retarget.motion.align import Similarity
from retarget.motion.chains import path_up
from retarget.retargeting import choose_method, prepare, retarget


def without(character, *names):
    """The bare skeleton less the named joints and all below them."""
    skeleton = character.skeleton
    keep = [j for j in range(len(skeleton)) if not any(skeleton.names[k] in names for k in path_up(skeleton, j))]
    new = {old: i for i, old in enumerate(keep)}
    parents = np.array([new.get(int(skeleton.parents[j]), -1) for j in keep])
    return Character(
        Skeleton(
            tuple(skeleton.names[j] for j in keep), parents, skeleton.offsets[keep], skeleton.rest_rotations[keep]
        ),
        name="part",
    )


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    save(folder / "walk.bvh", body(), [walk()])
    save(folder / "heavy.glb", body("heavy"), [])
    save(folder / "two.glb", body(), [replace(walk(), name="one"), replace(stand(), name="two")])
    return folder


def test_files_and_nouns_give_the_same(files):
    by_files = retarget(files / "walk.bvh", files / "heavy.glb", method="copy-rotations", foot_lock=False)
    by_nouns = retarget(walk(), body("heavy"), method="copy-rotations", foot_lock=False)
    order = [
        by_files.motion.skeleton.index(name) for name in body().skeleton.names
    ]  # the file lists its joints in its own order
    gap = np.abs(world_pose(by_files.motion)[1][:, order] - world_pose(by_nouns.motion)[1])
    assert gap.max() < 1e-4
    assert by_files.status == "ok" and by_files.motion.fps == 30.0
    assert package.retarget is retarget


def test_a_clip_by_name_and_by_number(files):
    assert len(retarget(files / "two.glb", body(), clip="two").motion) == len(stand())
    assert len(retarget(files / "two.glb", body(), clip=1).motion) == len(stand())
    with pytest.raises(RetargetError, match="'one'"):
        retarget(files / "two.glb", body(), clip="onee")


def test_a_result_goes_back_into_the_files_own_space(tmp_path):
    """A character in centimetres that stands along +Z: what is written fits the file, not the house."""
    space = Similarity(rot.from_rotation_vector(np.array([np.pi / 2, 0, 0])), 100.0)
    strange = space.character(body("heavy"))
    target = cast_by_names(strange)
    assert target.house_from_file.scale == pytest.approx(0.01)
    production = prepare(actor(), target)
    result = production(walk())
    plain = prepare(actor(), actor("heavy"))(walk())
    assert np.abs(world_pose(result.motion)[1] - world_pose(plain.motion)[1]).max() < 1e-3
    back = result.file_motion
    assert np.abs(world_pose(back)[1] - space.points(world_pose(plain.motion)[1])).max() < 0.1
    result.save(tmp_path / "out.glb")
    written = load(tmp_path / "out.glb")
    again = written.motion()
    order = [again.skeleton.index(name) for name in strange.skeleton.names]
    assert np.abs(world_pose(again)[1][:, order] - world_pose(back)[1]).max() < 0.01


def test_results_of_one_target_share_a_file(tmp_path):
    production = prepare(actor(), actor("heavy"))
    results = [production(replace(motion, name=name)) for motion, name in ((walk(), "one"), (stand(), "two"))]
    save_results(tmp_path / "both.glb", results)
    assert [clip.name for clip in load(tmp_path / "both.glb").clips] == ["one", "two"]
    with pytest.raises(RetargetError, match="different targets"):
        save_results(tmp_path / "none.glb", [*results, prepare(actor(), actor("child"))(stand())])
    assert not (tmp_path / "none.glb").exists()


def test_the_performer_may_come_apart_from_its_motion():
    alone = retarget(walk(), body("heavy"), source=body(), foot_lock=False)
    known = prepare(actor(), actor("heavy"), foot_lock=False)(walk())
    assert np.abs(world_pose(alone.motion)[1] - world_pose(known.motion)[1]).max() < 1e-9
    with pytest.raises(RetargetError, match="another skeleton"):
        retarget(walk(), body("heavy"), source=body("child"))


def test_hints_override_matching():
    names = {name: name for name in body().skeleton.names}
    crossed = names | {"leftHand": "rightHand", "rightHand": "leftHand"}
    assert cast(body(), Hints(joints=crossed)).humanoid.joints["leftHand"] == body().skeleton.index("rightHand")
    assert cast(body(), Hints(unit=2.0)).house_from_file.scale == 2.0


@pytest.mark.parametrize(
    "lost", [("leftLowerArm",), ("leftFoot",), ("neck",), ("leftHand",), ("head",)], ids=lambda names: names[0]
)
def test_a_body_with_a_limb_missing_works_or_says_what_is_missing(lost):
    """Never an error of another kind, whatever matching makes of it."""
    part = without(body(), *lost)
    try:
        result = retarget(walk(), part)
    except MatchError as error:
        assert str(error).startswith("part: ") and error.missing
        assert all(f'{name} = "' in str(error) for name in error.missing[:1])
    else:
        assert np.isfinite(result.motion.rotations).all()


@pytest.mark.parametrize("lost", ["hips", "head", "leftFoot", "rightHand", "leftUpperArm"])
def test_a_map_without_a_needed_joint_names_it(lost):
    names = {name: name for name in body().skeleton.names if name != lost}
    with pytest.raises(MatchError, match=f'{lost} = "name of the joint"'):
        cast(body(), Hints(joints=names))


def test_a_map_may_leave_out_spine_neck_toes_and_fingers():
    needed = (
        "hips",
        "head",
        *(s + p for s in ("left", "right") for p in "UpperLeg LowerLeg Foot UpperArm LowerArm Hand".split()),
    )
    target = cast(body("heavy"), Hints(joints={name: name for name in needed}))
    result = prepare(actor(), target)(walk()).motion
    assert np.isfinite(result.rotations).all()


def test_files_that_are_no_characters_say_so(tmp_path):
    (tmp_path / "bare.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(FileError, match="a body needs a surface"):
        retarget(walk(), tmp_path / "bare.obj")
    with pytest.raises(FileError, match="no such file"):
        retarget(tmp_path / "none.bvh", body())


def test_no_frames_no_result():
    empty = replace(walk(), rotations=walk().rotations[:0], translations=walk().translations[:0])
    with pytest.raises(RetargetError, match="no frames"):
        retarget(empty, body("heavy"))


def test_methods_by_name():
    assert isinstance(choose_method("auto", {"foot_lock": False}), Interaction)
    assert isinstance(prepare(actor(), actor("heavy")).retargeter, PreparedInteraction)
    bare = cast(replace(body(), mesh=None, skin=None))
    assert not isinstance(prepare(actor(), bare).retargeter, PreparedInteraction)
    assert not choose_method("copy-rotations", {"foot_lock": False}).foot_lock
    with pytest.raises(RetargetError, match="copy-rotations"):
        choose_method("copy-rotation")
    given = CopyRotations(in_place=True)
    assert prepare(actor(), actor(), given).retargeter.copier.settings is given


def test_an_unknown_setting_is_the_users_mistake():
    with pytest.raises(RetargetError, match="foot_lock"):
        choose_method("copy-rotations", {"footlock": False})


def test_a_new_method_is_one_entry(monkeypatch):
    @dataclass(frozen=True)
    class Slow(CopyRotations):
        pass

    monkeypatch.setitem(METHODS, "slow", Slow)
    assert retarget(stand(), body("child"), method="slow").status == "ok"


def test_bodies_of_any_size_are_in_the_house():
    small = retarget(
        walk(), scaled(body(), 0.01), target_hints=Hints(unit=1.0, joints={n: n for n in body().skeleton.names})
    )
    path = world_pose(small.motion)[1][:, 0, 2]
    assert np.ptp(path) == pytest.approx(0.01 * np.ptp(walk().translations[:, 0, 2]), rel=0.01)
