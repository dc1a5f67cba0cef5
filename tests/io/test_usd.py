"""USD: what files say is read as usd-core itself poses it."""

import subprocess
import sys

import numpy as np
import pytest
from gltf_maker import PNG, tube
from usd_maker import LOOK, animation, man, skeleton, stage, tube_mesh, tuples

from retarget.body.kinematics import rest_pose, world_pose
from retarget.body.skinning import prepare_skinning, rest_vertices
from retarget.errors import FileError
from retarget.io import load
from retarget.io.glb import fan_triangles
from retarget.io.usd_transforms import split

pxr = pytest.importorskip("pxr")
from usd_reference import posed_by_usd  # noqa: E402


@pytest.fixture
def written(tmp_path):
    def write(text, name="man.usda"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


def apart(path, clip=None, first=0.0, step=1.0):
    """Largest distance, in metres, of joints and vertices from where usd-core puts them, over all frames of a clip."""
    asset = load(path)
    motion = asset.motion(clip)
    turns, places = world_pose(motion)
    vertices = prepare_skinning(asset.character).vertices(turns, places)
    worst = 0.0
    for frame in range(len(motion)):
        joints, points = posed_by_usd(path, first + frame * step)
        shared = [name for name in joints if name in motion.skeleton.names]
        ours = places[frame, [motion.skeleton.index(name) for name in shared]]
        worst = max(worst, np.abs(ours - [joints[name] for name in shared]).max(), np.abs(vertices[frame] - points).max())
    assert shared
    return worst


PLACED = "matrix4d xformOp:transform = ( (0, 0, -2, 0), (0, 2, 0, 0), (2, 0, 0, 0), (1, 3, -4, 1) )\nuniform token[] xformOpOrder = [\"xformOp:transform\"]"
CARRIED = 'double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 5: (1, 2, 3) }\nuniform token[] xformOpOrder = ["xformOp:translate"]'
GEOMETRY = np.array([[0, 0, 1, 0], [0, 2, 0, 0], [-1, 0, 0, 0], [0.3, 0.1, 0.2, 1.0]])


def inverse_stored():
    points, _, _ = tube()
    return (np.c_[points, np.ones(len(points))] @ np.linalg.inv(GEOMETRY))[:, :3]


@pytest.mark.parametrize(
    "text",
    [
        man(),
        man(up="Z"),
        man(unit="0.01"),
        man(unit="0.0254", up="Z", place=PLACED),
        man(place=PLACED),
        man(rate="24", range_=(0, 5)),
        stage(skeleton(inside=animation()), tube_mesh(geometry=GEOMETRY, stored=inverse_stored())),
        stage(skeleton(inside=animation(), posed=35), tube_mesh(geometry=GEOMETRY, stored=inverse_stored()), place=PLACED),
        stage(skeleton(inside=animation(joints=(0, 1, 2))), tube_mesh()),
        stage(skeleton(inside=animation(joints=(2,))), tube_mesh()),
        stage(skeleton(inside=animation()), tube_mesh(), tube_mesh("Twin", stored=tube()[0] + [1, 0, 0])),
        stage(skeleton(inside=animation()), tube_mesh(binding="rel skel:skeleton = </Man/Skeleton>"), inherited=False),
        stage(skeleton(inside=animation()), tube_mesh(quads=True)),
        stage(skeleton(inside=animation()), tube_mesh(extra='uniform token[] skel:joints = ["hips/spine", "hips/spine/head", "hips"]')),
        man(place=CARRIED),
    ],
)  # fmt: skip
def test_joints_and_vertices_stand_where_usd_puts_them(written, text):
    assert apart(written(text)) < 5e-6


def test_a_rigid_mesh_follows_its_joint(written):
    rigid = 'int[] primvars:skel:jointIndices = [2] ( interpolation = "constant"\n elementSize = 1 )\nfloat[] primvars:skel:jointWeights = [1] ( interpolation = "constant"\n elementSize = 1 )'
    path = written(stage(skeleton(inside=animation()), tube_mesh(extra=rigid, influences=False)))
    assert apart(path) < 5e-6
    skin = load(path).character.skin
    assert set(skin.joints[skin.columns[skin.weights > 0]].tolist()) == {2}


def test_units_axes_and_rate_are_said(written):
    asset = load(written(man(unit="0.01", up="Z", rate="24")))
    assert asset.notes[0] == "USD, 0.01 m a unit, up z, 24 time codes a second"
    assert (asset.convention.metres_per_unit, asset.convention.up) == (1.0, "+y")
    _, places = rest_pose(asset.character.skeleton)
    assert places[-1] == pytest.approx([0, 0, -0.014], abs=1e-7), "y of the file is depth where z is up"
    silent = load(written(man(unit="")))
    assert "0.01 m a unit (it states none)" in silent.notes[0] and silent.convention.metres_per_unit is None


def test_clips_have_the_stages_rate_and_range(written):
    clip = lambda text: [(each.name, each.frames, each.fps) for each in load(written(text)).clips]  # noqa: E731
    assert clip(man(rate="24")) == [("bend", 6, 24.0)]
    assert clip(man(rate="24", range_=(2, 100))) == [("bend", 4, 24.0)], "what the stage does not play is left out"
    assert clip(man(rate="24", range_=(50, 100))) == [("bend", 6, 24.0)], "a range beside all samples means nothing"
    slow = stage(skeleton(inside=animation(step=40)), tube_mesh(), rate="1200")
    assert clip(slow) == [("bend", 6, 30.0)], "ticks are no frames"


def test_the_bound_animation_comes_first_and_others_by_name(written):
    both = skeleton(inside=animation("first", 90.0, 3) + animation("bend") + animation("odd").replace("hips", "tail"))
    asset = load(written(stage(both, tube_mesh())))
    assert [(clip.name, clip.frames) for clip in asset.clips] == [("bend", 6), ("first", 3)] and asset.plays == 0
    free = load(written(stage(skeleton(source="", inside=animation("first") + animation("second")), tube_mesh())))
    assert [clip.name for clip in free.clips] == ["first", "second"] and free.plays is None
    tips = [world_pose(asset.motion(name))[1][-1, -1] for name in ("first", "bend")]
    assert np.linalg.norm(tips[0] - tips[1]) > 0.3


def test_a_stage_without_animation_and_one_without_mesh(written):
    still = load(written(stage(skeleton(source=""), tube_mesh())))
    assert still.kind == "character" and not still.clips
    bare = load(written(stage(skeleton(inside=animation()))))
    assert bare.kind == "motion" and len(bare.motion()) == 6 and bare.character.mesh is None


def test_a_stage_without_skeleton_is_a_mesh(written):
    asset = load(written(stage(tube_mesh(influences=False), kind="Xform", inherited=False, place=PLACED, unit="0.1")))
    points = (np.c_[tube()[0], np.ones(54)] @ np.array([[0, 0, -2, 0], [0, 2, 0, 0], [2, 0, 0, 0], [1, 3, -4, 1.0]]))[:, :3]
    assert asset.kind == "mesh" and asset.mesh.vertices == pytest.approx(points * 0.1, abs=1e-6)


def test_rest_and_bind_stand_in_for_each_other(written):
    for missing in ("rest", "bind"):
        path = written(stage(skeleton(inside=animation(), **{missing: False}), tube_mesh()))
        asset = load(path)
        assert any(missing in note for note in asset.notes)
        assert rest_vertices(asset.character) == pytest.approx(tube()[0], abs=1e-6)


def test_colours_of_materials_subsets_and_the_display(written):
    subset = """def GeomSubset "Part" ( prepend apiSchemas = ["MaterialBindingAPI"] ) { uniform token elementType = "face"
 uniform token familyName = "materialBind"
 int[] indices = [1, 3]
 rel material:binding = </Man/Red>
 }
 color3f[] primvars:displayColor = [(0.25, 0.5, 0.75)]
 uniform bool doubleSided = 1"""
    mesh = load(written(stage(LOOK, skeleton(inside=animation()), tube_mesh(extra=subset)))).character.mesh
    looks = [mesh.materials[number] for number in mesh.face_materials]
    red = [look for look in looks if look.name == "Red"]
    assert len(red) == 2 and red[0].base_color == pytest.approx((0.9, 0.1, 0.2, 0.5), abs=1e-6)
    assert len(looks) == 96 and mesh.materials[0].base_color == pytest.approx((0.25, 0.5, 0.75, 1), abs=1e-6)
    assert mesh.materials[0].double_sided
    whole = load(written(stage(LOOK, skeleton(inside=animation()), tube_mesh(extra="rel material:binding = </Man/Red>"))))
    assert {look.name for look in whole.character.mesh.materials} == {"Red"}


PICTURED = """def Material "Worn" { token outputs:surface.connect = </Man/Worn/S.outputs:surface>
 def Shader "S" { uniform token info:id = "UsdPreviewSurface"
  color3f inputs:diffuseColor.connect = </Man/Worn/P.outputs:rgb>
  token outputs:surface
 }
 def Shader "P" { uniform token info:id = "UsdUVTexture"
  asset inputs:file = @%s@
  float4 inputs:scale = (1, 0.5, 0.25, 1)
  float2 inputs:st.connect = </Man/Worn/R.outputs:result>
  color3f outputs:rgb
 }
 def Shader "R" { uniform token info:id = "UsdPrimvarReader_float2"
  string inputs:varname = "map1"
  float2 outputs:result
 }
}
"""


def test_a_picture_comes_with_its_coordinates(written, tmp_path):
    (tmp_path / "skin.png").write_bytes(PNG)
    (tmp_path.parent / "away.png").write_bytes(PNG)
    points, faces, _ = tube()

    def mesh(file, values, kind):
        uvs = f'texCoord2f[] primvars:map1 = {tuples(values)} ( interpolation = "{kind}" )\nrel material:binding = </Man/Worn>'
        return load(written(stage(PICTURED % file, skeleton(inside=animation()), tube_mesh(extra=uvs))))

    corners = points[faces.ravel(), :2]
    for values, kind in ((points[:, :2], "vertex"), (corners, "faceVarying")):
        worn = mesh("./skin.png", values, kind).character.mesh
        assert worn.materials[0].image == PNG and worn.materials[0].base_color == pytest.approx((1, 0.5, 0.25, 1))
        assert worn.uvs == pytest.approx(np.stack([points[:, 0], 1 - points[:, 1]], axis=1), abs=1e-6)
    torn = corners.copy()
    torn[0] += 1
    for asset in (mesh("./skin.png", torn, "faceVarying"), mesh("../away.png", corners, "faceVarying"), mesh("./man.usda", corners, "faceVarying")):
        assert asset.character.mesh.materials[0].image is None and any("textures are left out" in note for note in asset.notes)


def test_hidden_meshes_guides_and_other_skeletons_are_left_out_with_a_note(written):
    hidden = tube_mesh("Hidden", extra='token visibility = "invisible"') + tube_mesh("Guide", extra='uniform token purpose = "guide"')
    other = skeleton("Other", source="") + tube_mesh("Free", influences=False)
    asset = load(written(stage(skeleton(inside=animation()), tube_mesh(), hidden, other)))
    assert len(asset.character.mesh.vertices) == 54 and len(asset.character.skeleton) == 3
    assert any("of 2 skeletons 'Skeleton' is read" in note for note in asset.notes)
    assert any("1 meshes are moved by no skeleton" in note for note in asset.notes)


def test_what_is_left_out_is_said(written):
    shapes = 'rel skel:blendShapeTargets = </Man/Body/Smile>\nuniform token[] skel:blendShapes = ["smile"]\nuniform token primvars:skel:skinningMethod = "dualQuaternion"\ndef BlendShape "Smile" {}'
    asset = load(written(stage(skeleton(inside=animation()), tube_mesh(extra=shapes))))
    assert any("blend shapes" in note for note in asset.notes) and any("dual quaternions" in note for note in asset.notes)


def test_left_handed_faces_are_turned_and_holes_left_open(written):
    faces = load(written(man())).character.mesh.faces
    turned = load(written(stage(skeleton(inside=animation()), tube_mesh(extra='uniform token orientation = "leftHanded"'))))
    assert np.array_equal(turned.character.mesh.faces, faces[:, ::-1])
    open_ = load(written(stage(skeleton(inside=animation()), tube_mesh(extra="int[] holeIndices = [0, 5]"))))
    assert np.array_equal(open_.character.mesh.faces, np.delete(faces, [0, 5], axis=0))


def test_joint_names_are_the_files_own(written):
    asset = load(written(stage(skeleton(inside=animation(), extra='uniform token[] jointNames = ["mixamo:Hips", "b", "c"]'))))
    assert asset.character.skeleton.names == ("mixamo:Hips", "b", "c")
    double = [*("hips", "hips/arm", "hips/arm/arm")]
    assert load(written(stage(skeleton(source="", tokens=double)))).character.skeleton.names == ("hips", "arm", "arm_2")


def test_several_roots_hang_from_the_skeleton(written):
    path = written(stage(skeleton(inside=animation().replace("hips/spine", "spine"), tokens=["hips", "spine", "spine/head"]), tube_mesh()))
    assert apart(path) < 5e-6 and load(path).character.skeleton.names[0] == "Skeleton"


def test_references_inside_the_folder_are_followed(written):
    written(man(), "part.usda")
    path = written('#usda 1.0\n( upAxis = "Y"\n metersPerUnit = 1\n timeCodesPerSecond = 30 )\ndef "All" ( references = @./part.usda@</Man> ) {}\n', "whole.usda")
    assert apart(path) < 5e-6
    (path.parent / "part.usda").unlink()
    with pytest.raises(FileError, match="holds neither a skeleton nor a mesh"):
        load(path)


def test_instances_are_looked_into(written):
    text = man() + '\ndef "Copy" ( instanceable = true\n references = </Man> ) {}\n'
    asset = load(written(text))
    assert any("of 2 skeletons" in note for note in asset.notes)


def test_all_spellings_of_the_format_are_read(written, tmp_path):
    from pxr import Sdf, UsdUtils

    text = written(man())
    for name in ("man.usdc", "man.usd"):
        Sdf.Layer.FindOrOpen(str(text)).Export(str(tmp_path / name))
    UsdUtils.CreateNewUsdzPackage(str(tmp_path / "man.usdc"), str(tmp_path / "man.usdz"))
    for name in ("man.usdc", "man.usd", "man.usdz"):
        assert apart(tmp_path / name) < 5e-6


def test_this_process_never_loads_usd(written):
    code = f"import sys; from retarget import load; load({str(written(man()))!r}); assert 'pxr' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_fans_keep_the_order_of_polygons():
    counts, corners = np.array([3, 2, 4, 0, 5]), np.array([5, 6, 7, 8, 8, 0, 1, 2, 3, 4, 5, 6, 7, 8])
    triangles, owners = fan_triangles(counts, np.cumsum(counts) - counts, corners)
    assert triangles.tolist() == [[5, 6, 7], [0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [4, 7, 8]]
    assert owners.tolist() == [0, 2, 2, 4, 4, 4]


def test_splitting_transforms_is_exact_for_all_rotations_and_mirrors():
    from retarget.body.rotations import to_matrix

    random = np.random.default_rng(0)
    turns = random.normal(size=(200, 4))
    turns[:50] = np.eye(4)[random.integers(4, size=50)]  # half turns, where formulas lose their digits
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    scales = np.exp(random.normal(size=(200, 3))) * np.where(random.random((200, 1)) < 0.3, -1, 1)
    matrices = np.tile(np.eye(4), (200, 1, 1))
    matrices[:, :3, :3] = to_matrix(turns) * scales[:, None]
    matrices[:, :3, 3] = random.normal(size=(200, 3))
    translations, rotations, found, straight = split(matrices)
    assert straight.all() and translations == pytest.approx(matrices[:, :3, 3])
    assert to_matrix(rotations) * found[:, None] == pytest.approx(matrices[:, :3, :3], abs=1e-12)
    sheared = np.eye(4)
    sheared[0, 1] = 0.5
    assert not split(sheared[None])[3][0]
