"""USD files that cannot be read, and those that reach for what is not theirs: one line each."""


import numpy as np
import pytest
from usd_maker import animation, man, skeleton, stage, tube_mesh

from retarget.errors import FileError, RetargetError
from retarget.io import load, save, usd

pytest.importorskip("pxr")


def refused(tmp_path, text, problem, name="man.usda"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(FileError, match=problem) as caught:
        load(path)
    assert "\n" not in str(caught.value) and str(caught.value).startswith(str(path))
    return str(caught.value)


@pytest.mark.parametrize("suffix", ["usd", "usda", "usdc", "usdz"])
@pytest.mark.parametrize("content", [b"", b"#usda 1.0\n(", b"PXR-USDC" + b"\xff" * 400, b"PK\x03\x04" + b"\xff" * 90])
def test_what_is_no_usd(tmp_path, suffix, content):
    refused(tmp_path, content, "cannot be read as USD|holds neither a skeleton nor a mesh", f"man.{suffix}")


def test_the_line_of_a_mistake_is_told_without_usds_own_source(tmp_path):
    told = refused(tmp_path, man().replace("def Mesh", "dof Mesh"), r"man.usda:\d+:\d+")
    assert "pxr" not in told and "textParser" not in told


def test_a_mistake_that_cannot_be_quoted_is_told_too(tmp_path):
    refused(tmp_path, man().encode().replace(b"def Mesh", b"d\xc0f Mesh"), "bytes that are no text")


SKELETON, MESH = skeleton(inside=animation()), tube_mesh()
MATRIX = "uniform matrix4d[] bindTransforms = [( (1, 0, 0, 0)"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("#usda 1.0\n", "holds neither a skeleton nor a mesh"),
        (man(unit="0"), "says that a unit has 0 metres"),
        (man(unit="inf"), "a unit has inf metres"),
        (man(rate="0"), "a second has 0 time codes"),
        (man(up="X"), "'X' points up"),
        (man(place='matrix4d xformOp:transform = ( (0, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1) )\nuniform token[] xformOpOrder = ["xformOp:transform"]'), "scaled to nothing"),
        (stage(SKELETON.replace('"hips/spine/head"]\nuniform matrix', '"hips/spine"]\nuniform matrix'), MESH), "names a joint twice"),
        (stage(skeleton(source="", tokens=[]), MESH), "has 0 joints"),
        (stage(skeleton(source="", tokens=["a", "b"]), MESH), "neither rest nor bind transforms for its 2 joints"),
        (stage(SKELETON.replace(MATRIX, MATRIX.replace("1,", "0,")), MESH), "bindTransforms has a matrix that cannot be inverted"),
        (stage(SKELETON.replace(MATRIX, MATRIX.replace("1,", "nan,")), MESH), "bindTransforms has a matrix that cannot be inverted"),
        (stage(SKELETON, MESH.replace("faceVertexCounts = [3,", "faceVertexCounts = [4,")), "289 corners by their counts, and 288 indices"),
        (stage(SKELETON, MESH.replace("faceVertexCounts = [3, 3", "faceVertexCounts = [-3, 9")), "corners by their counts"),
        (stage(SKELETON, MESH.replace("faceVertexIndices = [0,", "faceVertexIndices = [99,")), "names point 99 of 54"),
        (stage(SKELETON, MESH.replace("faceVertexIndices = [0,", "faceVertexIndices = [-1,")), "names point -1 of 54"),
        (stage(SKELETON, MESH.replace("points = [(0.2,", "points = [(nan,")), "points that are not numbers"),
        (stage(SKELETON, MESH.replace("jointIndices = [0,", "jointIndices = [7,")), "follows joint 7 of 3"),
        (stage(SKELETON, MESH.replace("jointIndices = [0,", "jointIndices = [")), "161 values of skel:jointIndices for 54 points"),
        (stage(SKELETON, MESH.replace("elementSize = 3", "elementSize = 2", 1)), "162 values of skel:jointIndices for 54 points with 2"),
        (stage(SKELETON, MESH.replace("primvars:skel:jointWeights", "primvars:skel:other")), "joints without weights"),
        (stage(SKELETON, tube_mesh(extra='uniform token[] skel:joints = ["tail"]')), "follows the joint 'tail'"),
        (stage(SKELETON, tube_mesh(geometry=np.zeros((4, 4)))), "was bound by a matrix that cannot be inverted"),
        (stage(SKELETON, tube_mesh(extra='def GeomSubset "P" { uniform token elementType = "face"\nuniform token familyName = "materialBind"\nint[] indices = [96]\n}')), "names face 96 of 96"),
        (stage(skeleton(inside=animation().replace("[(1, 0, 0, 0)", "[(0, 0, 0, 0)")), MESH), "rotation of length zero"),
        (stage(skeleton(inside=animation().replace("0: [(0, 0.7", "0: [(nan, 0.7")), MESH), "translations that are no numbers"),
        (stage(skeleton(inside=animation(step=1e9)), MESH), "spans 5000000000 time codes"),
        (stage(skeleton(inside=animation(step=4e6)), MESH), "more than 40000000 transforms"),
        (man(more='subLayers = [@anything.usda@]').replace('def SkelRoot "Man" (', 'def SkelRoot "Man" (\nclips = { dictionary default = { asset[] assetPaths = [@./a.usda@]\nstring primPath = "/a" } }'), "value clips"),
    ],
)  # fmt: skip
def test_what_does_not_fit_together_is_told(tmp_path, text, problem):
    refused(tmp_path, text, problem)


def test_translations_of_another_number_are_left_out_with_a_note(tmp_path):
    path = tmp_path / "man.usda"
    path.write_text(stage(skeleton(inside=animation().replace("0: [(0.0", "0: [(0, 0, 0), (0.0").replace("float3[] translations.timeSamples = { 0: [", "float3[] translations.timeSamples = { 0: [(1, 1, 1), ")), MESH))
    assert any("translations of the animation 'bend'" in note for note in load(path).notes)


REFERENCE = '#usda 1.0\n( {sub} )\ndef "Man" ( {arc} ) {{}}\n'


@pytest.mark.parametrize("asset", ["../secret.usda", "{out}/secret.usda", "./link.usda", "./sub/../../secret.usda", "file:///etc/passwd", "http://x/y.usda", "./in.usda:SDF_FORMAT_ARGS:a=b", "`${WHERE}`", "./notes.txt", "anon:0x1:x.usda"])  # fmt: skip
@pytest.mark.parametrize("arc", ["references = @{0}@</Man>", "payload = @{0}@</Man>", "subLayers", "variant"])
def test_layers_outside_the_folder_are_not_opened(tmp_path, asset, arc):
    home = tmp_path / "home"
    (home / "sub").mkdir(parents=True)
    (tmp_path / "secret.usda").write_text(man())
    (home / "in.usda").write_text(man())
    (home / "notes.txt").write_text("no layer")
    (home / "link.usda").symlink_to(tmp_path / "secret.usda")
    asset = asset.replace("{out}", str(tmp_path))
    if arc == "variant":
        arcs = 'variants = { string look = "off" }\nprepend variantSets = "look"'
        text = REFERENCE.format(sub="", arc=arcs).replace("{}", '{\nvariantSet "look" = { "on" ( references = @ASSET@</Man> ) { } "off" { } }\n}'.replace("ASSET", asset))
    elif arc == "subLayers":
        text = REFERENCE.format(sub=f"subLayers = [@{asset}@]", arc="")
    else:
        text = REFERENCE.format(sub="", arc=arc.format(asset))
    refused(home, text, "is not inside its folder|is no USD file", "man.usda")


def test_what_a_reference_refers_to_is_looked_at_too(tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    (tmp_path / "secret.usda").write_text(man())
    (home / "middle.usda").write_text(REFERENCE.format(sub="", arc="references = @../secret.usda@</Man>"))
    refused(home, REFERENCE.format(sub="", arc="references = @./middle.usda@</Man>"), "'../secret.usda', which is not inside")


def test_a_package_reaches_for_nothing_beside_it(tmp_path):
    from retarget.io.usd_assets import write_package

    (tmp_path / "secret.usda").write_text(man())
    for asset in (str(tmp_path / "secret.usda"), "../secret.usda", "./../secret.usda"):
        (tmp_path / "root.usda").write_text(REFERENCE.format(sub="", arc=f"references = @{asset}@</Man>"))
        write_package(str(tmp_path / "man.usdz"), str(tmp_path / "root.usda"), {})
        with pytest.raises(FileError, match="is not inside|holds neither"):
            load(tmp_path / "man.usdz")


def test_the_folder_one_works_in_is_not_searched(tmp_path, monkeypatch):
    """USD looks for `name.usda` there, and in folders that the environment names, when it is not beside the file."""
    (tmp_path / "home").mkdir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "secret.usda").write_text(man())
    monkeypatch.chdir(tmp_path / "elsewhere")
    monkeypatch.setenv("PXR_AR_DEFAULT_SEARCH_PATH", str(tmp_path / "elsewhere"))
    refused(tmp_path / "home", REFERENCE.format(sub="", arc="references = @secret.usda@</Man>"), "holds neither")


def test_references_that_multiply_without_end_are_refused(tmp_path, monkeypatch):
    levels = "".join(f'def "L{n}" {{ def "a" ( references = </L{n - 1}> ) {{}}\ndef "b" ( references = </L{n - 1}> ) {{}} }}\n' for n in range(1, 20))
    refused(tmp_path, '#usda 1.0\ndef "L0" {}\n' + levels, "more than 500000 prims|takes longer|cannot be read")


def test_a_child_that_crashes_or_hangs_is_one_line(tmp_path, monkeypatch, own_child):
    path = tmp_path / "man.usda"
    path.write_text(man())
    character = load(path).character
    own_child("usd_child", "import os, signal\ndef work(*_): os.kill(os.getpid(), signal.SIGSEGV)\n")
    with pytest.raises(FileError, match=r"cannot be read as USD \(the process stopped without a word"):
        load(path)
    own_child("usd_write_child", "from retarget.io.child import Refused\ndef work(*_): raise Refused('never')\n")
    with pytest.raises(FileError, match="out.usda: never"):
        save(tmp_path / "out.usda", character, [])
    own_child("usd_write_child", "def work(*_): raise ValueError('not now')\n")
    with pytest.raises(FileError, match=r"cannot be written as USD \(not now\)"):
        save(tmp_path / "out.usda", character, [])
    assert not (tmp_path / "out.usda").exists()
    monkeypatch.setattr(usd, "SECONDS", 1.0)
    own_child("usd_child", "import time\ndef work(*_): time.sleep(60)\n")
    with pytest.raises(FileError, match="takes longer than 1 s"):
        load(path)


def test_too_large_files_are_refused_before_anything_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr(usd, "LARGEST", 100)
    refused(tmp_path, man(), "USD files of up to 100 are read")


def test_without_usd_core_the_cure_is_told(tmp_path, monkeypatch):
    path = tmp_path / "man.usda"
    path.write_text(man())
    character = load(path).character
    monkeypatch.setattr(usd.importlib.util, "find_spec", lambda name: None)
    for act in (lambda: load(path), lambda: save(tmp_path / "out.usdz", character, [])):
        with pytest.raises(RetargetError, match=r"pip install retarget\[usd\]"):
            act()
    assert not (tmp_path / "out.usdz").exists()
