"""USD written: what is read again stands where it stood, a stage keeps what it had, and equal input gives equal bytes."""

import time
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from gltf_maker import PNG, worm
from usd_maker import animation, man, skeleton, stage, tube_mesh

from retarget.body.kinematics import still_motion, world_pose
from retarget.body.skinning import prepare_skinning
from retarget.character import Material
from retarget.errors import FileError, RetargetError
from retarget.io import load, save

pytest.importorskip("pxr")
from usd_reference import posed_by_usd  # noqa: E402

SUFFIXES = ["usda", "usdc", "usd", "usdz"]


def faults(path):
    """What the validators of usd-core say of a file."""
    from pxr import Usd, UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    return [
        (error.GetName(), error.GetMessage())
        for error in UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(path)))
    ]


def posed(character, motion):
    turns, places = world_pose(motion)
    return places, prepare_skinning(character).vertices(turns, places)


def round_trip_mm(asset, path, clip=None):
    """Largest distance of any joint or vertex of any frame, in millimetres, after writing and reading again."""
    motion = replace(asset.motion(clip), name="new one")
    save(path, asset.character, [motion])
    again = load(path)
    assert again.clips[0].name == "new one" and (again.clips[0].frames, again.clips[0].fps) == (len(motion), motion.fps)
    names = again.character.skeleton.names  # a prim that carries the skeleton is a joint before, and stays in its place after
    assert set(asset.character.skeleton.names) - set(names) <= {"Skeleton"}
    here = [joint for joint, name in enumerate(asset.character.skeleton.names) if name in names]
    order = [names.index(asset.character.skeleton.names[joint]) for joint in here]
    (places, vertices), (new_places, new_vertices) = posed(asset.character, motion), posed(again.character, again.motion())
    joints, points = posed_by_usd(path, 0.0)
    assert np.abs(points - vertices[0]).max() < 1e-5, "usd-core poses it as we do"
    assert max(np.abs(place - places[0, motion.skeleton.index(name)]).max() for name, place in joints.items() if name in motion.skeleton.names) < 1e-5
    return 1000 * max(np.abs(places[:, here] - new_places[:, order]).max(), np.abs(vertices - new_vertices).max())


@pytest.fixture
def tube_glb(tmp_path):
    return load(worm(armature={"rotation": [0.5, 0.5, 0.5, 0.5], "scale": [2, 2, 2]}, prop=True, texture=True).glb(tmp_path / "tube.glb"))


CARRIED = 'double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 5: (1, 2, 3) }\nfloat3 xformOp:rotateXYZ = (10, 20, 30)\nuniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]'
PLACED = "matrix4d xformOp:transform = ( (0, 0, -2, 0), (0, 2, 0, 0), (2, 0, 0, 0), (1, 3, -4, 1) )\nuniform token[] xformOpOrder = [\"xformOp:transform\"]"
SPLIT = stage(skeleton(inside=animation().replace("hips/spine", "spine"), tokens=["hips", "spine", "spine/head"]), tube_mesh())


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_glb_character_goes_through_usd(tube_glb, tmp_path, suffix):
    assert round_trip_mm(tube_glb, tmp_path / f"out.{suffix}") < 0.01
    assert not faults(tmp_path / f"out.{suffix}")


@pytest.mark.parametrize(
    ("text", "suffix"),
    [
        *((man(), suffix) for suffix in SUFFIXES), (man(unit="0.01", up="Z", place=PLACED), "usdc"), (man(rate="24"), "usda"),
        (man(place=CARRIED), "usda"), (man(place=CARRIED, up="Z", unit="0.1"), "usdz"), (SPLIT, "usd"),
    ],
)  # fmt: skip
def test_a_usd_character_goes_through_usd(tmp_path, text, suffix):
    (tmp_path / "man.usda").write_text(text)
    assert round_trip_mm(load(tmp_path / "man.usda"), tmp_path / f"out.{suffix}") < 0.01
    assert not [fault for fault in faults(tmp_path / f"out.{suffix}") if fault[0] != "MissingKindMetadata"]


def test_bytes_are_the_same_for_the_same_input(tube_glb, tmp_path):
    (tmp_path / "man.usda").write_text(man())
    assets = {"tube": tube_glb, "man": load(tmp_path / "man.usda")}

    def written():
        found = {}
        for name, asset in assets.items():
            for suffix in SUFFIXES:
                save(tmp_path / f"out.{suffix}", asset.character, [asset.motion(0)])
                found[name, suffix] = (tmp_path / f"out.{suffix}").read_bytes()
        return found

    first = written()
    time.sleep(2.1)  # a zip tells time by two seconds
    again = written()
    assert [key for key in first if again[key] != first[key]] == []


def test_several_clips_stand_beside_the_one_that_plays(tube_glb, tmp_path):
    motion = tube_glb.motion()
    fast = replace(motion, fps=60.0, name="fast one")
    save(tmp_path / "out.usda", tube_glb.character, [motion, fast, replace(fast, name=motion.name)])
    again = load(tmp_path / "out.usda")
    assert [(clip.name, clip.fps) for clip in again.clips] == [(motion.name, 30.0), ("fast one", 60.0), (motion.name + "_2", 60.0)]
    assert np.abs(world_pose(again.motion(1))[1] - world_pose(fast)[1][:, : len(again.character.skeleton)]).max() < 1e-5
    text = (tmp_path / "out.usda").read_text()
    assert "startTimeCode = 0" in text and f"endTimeCode = {len(motion) - 1}\n" in text and "timeCodesPerSecond = 30" in text


def test_the_stage_is_kept_with_all_it_had(tmp_path):
    from pxr import Usd

    (tmp_path / "man.usda").write_text(
        man(rate="24").replace("#usda 1.0\n(", '#usda 1.0\n(\ndoc = "ours"') + 'def Camera "Eye" {\ncustom string note = "keep"\n}\n'
    )
    asset = load(tmp_path / "man.usda")
    new = replace(asset.motion(), name="dance.01", fps=30.0)
    save(tmp_path / "out.usda", asset.character, [new])
    kept = Usd.Stage.Open(str(tmp_path / "out.usda"))
    before = Usd.Stage.Open(str(tmp_path / "man.usda"))
    for prim in before.TraverseAll():
        same = kept.GetPrimAtPath(prim.GetPath())
        for attribute in prim.GetAuthoredAttributes():
            if attribute.GetName() != "extent":
                assert same.GetAttribute(attribute.GetName()).Get(1.0) == attribute.Get(1.0), attribute
    assert kept.GetRootLayer().documentation == "ours" and kept.GetTimeCodesPerSecond() == 24
    assert kept.GetEndTimeCode() == pytest.approx(5 * 24 / 30)
    again = load(tmp_path / "out.usda")
    assert [(clip.name, clip.frames, clip.fps) for clip in again.clips] == [("dance.01", 6, 30.0), ("bend", 6, 24.0)]
    save(tmp_path / "bare.usda", asset.character, [new], keep_clips=False)
    assert [clip.name for clip in load(tmp_path / "bare.usda").clips] == ["dance.01"]


def test_a_usd_file_may_be_written_over_itself(tmp_path):
    path = tmp_path / "man.usda"
    path.write_text(man())
    asset = load(path)
    save(path, asset.character, [replace(asset.motion(), name="again")])
    assert [clip.name for clip in load(path).clips] == ["again", "bend"]


def test_a_stage_of_several_layers_becomes_one(tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    (home / "part.usda").write_text(man())
    (home / "whole.usda").write_text('#usda 1.0\n( upAxis = "Y"\n metersPerUnit = 1\n timeCodesPerSecond = 30 )\ndef "All" ( references = @./part.usda@</Man> ) {}\n')
    asset = load(home / "whole.usda")
    for suffix in SUFFIXES:
        assert round_trip_mm(asset, tmp_path / f"out.{suffix}") < 0.01


def test_an_instance_is_opened_for_its_animation(tmp_path):
    text = man().replace('def SkelRoot "Man"', 'class SkelRoot "Man"', 1)
    (tmp_path / "man.usda").write_text(text + '\ndef "Copy" ( instanceable = true\n references = </Man> ) {}\n')
    asset = load(tmp_path / "man.usda")
    assert asset.kind == "character"
    assert round_trip_mm(asset, tmp_path / "out.usda") < 0.01


TEXTURED = """def Material "Look" {
 def Shader "Picture" {
  uniform token info:id = "UsdUVTexture"
  asset inputs:file = @./textures/skin.png@
  asset inputs:away = @%s@
 }
}
"""


def test_pictures_go_where_the_stage_goes(tmp_path):
    """A package takes them in (and none from outside the folder); other files lead back to them."""
    from pxr import Usd

    home, there = tmp_path / "home", tmp_path / "there"
    (home / "textures").mkdir(parents=True)
    there.mkdir()
    (home / "textures" / "skin.png").write_bytes(PNG)
    (tmp_path / "secret.png").write_bytes(b"\x89PNG not yours")
    (home / "man.usda").write_text(stage(TEXTURED % "../secret.png", skeleton(inside=animation()), tube_mesh()))
    asset = load(home / "man.usda")
    save(there / "out.usda", asset.character, [asset.motion()])
    written = Usd.Stage.Open(str(there / "out.usda"))
    file = written.GetAttributeAtPath("/Man/Look/Picture.inputs:file").Get().path
    assert (there / file).read_bytes() == PNG
    save(there / "out.usdz", asset.character, [asset.motion()])
    with zipfile.ZipFile(there / "out.usdz") as package:
        assert package.testzip() is None and len(package.namelist()) == 2
        assert package.namelist()[0] == "out.usdc" and package.read(package.namelist()[1]) == PNG
        assert all((entry.header_offset + 30 + len(entry.filename) + len(_extra(there / "out.usdz", entry))) % 64 == 0 for entry in package.infolist())
    packed = load(there / "out.usdz")
    save(home / "again.usdz", packed.character, [packed.motion()])
    save(home / "again.usda", packed.character, [packed.motion()])
    with zipfile.ZipFile(home / "again.usdz") as package:
        assert package.read(package.namelist()[1]) == PNG
    assert "../there/out.usdz[textures/0_skin.png]" in (home / "again.usda").read_text()


def _extra(path, entry):
    raw = path.read_bytes()[entry.header_offset :]
    length = int.from_bytes(raw[28:30], "little")
    return raw[30 + len(entry.filename) : 30 + len(entry.filename) + length]


def test_a_picture_of_ours_goes_into_the_package_only(tube_glb, tmp_path):
    save(tmp_path / "out.usdz", tube_glb.character, [])
    with zipfile.ZipFile(tmp_path / "out.usdz") as package:
        assert package.namelist() == ["out.usdc", "textures/0_skin.png"] and package.read("textures/0_skin.png") == PNG
    again, ours = load(tmp_path / "out.usdz").character.mesh, tube_glb.character.mesh
    assert [look.image for look in again.materials].count(PNG) == 1 and again.uvs == pytest.approx(ours.uvs, abs=1e-6)
    save(tmp_path / "out.usda", tube_glb.character, [])
    assert "png" not in (tmp_path / "out.usda").read_text() and [path.name for path in tmp_path.glob("*.png")] == []


def test_colours_and_names_come_back(tube_glb, tmp_path):
    looks = (Material("Skin tone 1", (0.1, 0.2, 0.3, 1.0)), Material("2nd", (0.5, 0.25, 0.125, 0.5), double_sided=True))
    mesh = tube_glb.character.mesh
    mesh = replace(mesh, materials=looks, face_materials=np.arange(len(mesh.faces)) % 2)
    named = replace(tube_glb.character.skeleton, names=tuple(f"{n}:joint é" for n in range(len(tube_glb.character.skeleton))))
    save(tmp_path / "out.usda", replace(tube_glb.character, mesh=mesh, skeleton=named, origin=None), [])
    again = load(tmp_path / "out.usda").character
    assert again.skeleton.names == named.names
    colors = np.array([again.mesh.materials[number].base_color for number in again.mesh.face_materials])
    ordered = {tuple(sorted(face)): color for face, color in zip(again.mesh.faces.tolist(), colors)}
    assert all(np.allclose(ordered[tuple(sorted(face))], looks[n % 2].base_color) for n, face in enumerate(mesh.faces.tolist()))


def test_usd_becomes_glb_with_all_that_was_read(tmp_path):
    (tmp_path / "man.usda").write_text(man(unit="0.01", up="Z"))
    asset = load(tmp_path / "man.usda")
    save(tmp_path / "out.glb", asset.character, [asset.motion()])
    again = load(tmp_path / "out.glb")
    ours, theirs = posed(asset.character, asset.motion()), posed(again.character, again.motion(1))
    assert all(np.abs(a - b).max() < 1e-6 for a, b in zip(ours, theirs))


def test_animation_only_leaves_the_surface_out(tmp_path):
    (tmp_path / "man.usda").write_text(man())
    asset = load(tmp_path / "man.usda")
    save(tmp_path / "out.usda", asset.character, [asset.motion()], animation_only=True)
    again = load(tmp_path / "out.usda")
    assert again.kind == "motion" and len(again.clips) == 1
    assert np.abs(world_pose(again.motion())[1] - world_pose(asset.motion())[1]).max() < 1e-6


def test_a_still_motion_and_none_at_all(tube_glb, tmp_path):
    save(tmp_path / "out.usdc", tube_glb.character, [still_motion(tube_glb.character.skeleton, 4)])
    assert load(tmp_path / "out.usdc").clips[0].frames == 4
    save(tmp_path / "none.usdc", tube_glb.character, [])
    assert not load(tmp_path / "none.usdc").clips


def test_what_cannot_be_written_leaves_nothing(tube_glb, tmp_path):
    motion, own = tube_glb.motion(), tmp_path / "man.usda"
    own.write_text(man())
    asset = load(own)
    out, other = tmp_path / "out.usda", replace(motion.skeleton, names=("a", "b", "c"))
    with pytest.raises(RetargetError, match="another skeleton"):
        save(out, asset.character, [replace(motion, skeleton=other)])
    with pytest.raises(RetargetError, match="another skeleton"):
        save(out, replace(asset.character, skeleton=other), [replace(motion, skeleton=other)])
    with pytest.raises(RetargetError, match="has no frames"):
        save(out, tube_glb.character, [replace(motion, rotations=motion.rotations[:0], translations=motion.translations[:0])])
    bare = replace(tube_glb.character.mesh, faces=np.zeros((0, 3), int), face_materials=None)
    with pytest.raises(RetargetError, match="no faces"):
        save(out, replace(tube_glb.character, mesh=bare), [motion])
    own.write_text(man() + "\n")
    with pytest.raises(FileError, match="has changed since it was read"):
        save(out, asset.character, [asset.motion()])
    own.unlink()
    with pytest.raises(FileError, match="the file is gone"):
        save(out, asset.character, [asset.motion()])
    assert not list(tmp_path.glob("*out*"))


def test_a_joint_that_is_sheared_at_rest_is_refused(tmp_path):
    sheared = skeleton(inside=animation()).replace("(0, 1, 0, 0), (0, 0, 1, 0), (0, 0.69", "(0.5, 1, 0, 0), (0, 0, 1, 0), (0, 0.69", 1)
    (tmp_path / "man.usda").write_text(stage(sheared, tube_mesh()))
    asset = load(tmp_path / "man.usda")
    assert any("sheared" in note for note in asset.notes)
    with pytest.raises(FileError, match="'spine' has a sheared rest transform"):
        save(tmp_path / "out.usda", asset.character, [still_motion(asset.character.skeleton)])
