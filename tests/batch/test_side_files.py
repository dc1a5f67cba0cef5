"""What is read beside a file (pictures, buffers, layers) counts as the file; and mesh sequences where characters are wanted."""

import json
import os

import pytest
from fbx_maker import Picture, document
from gltf_maker import PNG
from made_folders import short
from made_motions import body, fingerless, walk

from retarget.batch.plan import content_hash, stamps, unchanged
from retarget.batch.run import Batch, run_batch
from retarget.batch.work import Settings
from retarget.body.skinning import bake
from retarget.errors import FileError
from retarget.io import load, save, save_sequence
from retarget.motion.filter import cut


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """One motion and one character."""
    folder = tmp_path_factory.mktemp("side")
    for name in "mc":
        (folder / name).mkdir()
    save(folder / "m" / "walk.bvh", fingerless(body()), [short(walk(), "walk")])
    save(folder / "c" / "heavy.glb", fingerless(body("heavy")), [])
    return folder


def _gltf(folder):
    """A character whose picture lies in a folder below, and another that is not there yet."""
    save(folder / "x.gltf", fingerless(body("heavy")), [])
    text = json.loads((folder / "x.gltf").read_text())
    text["images"] = [{"uri": "tex/a%20b.png"}, {"uri": "data:,x"}, {"uri": "no.png"}, {"uri": "../outside.png"}]
    (folder / "x.gltf").write_text(json.dumps(text))
    return "x.gltf", ["x.bin", "tex/a b.png", "no.png"]


def _fbx(folder):
    (folder / "x.fbx").write_text(document(picture=Picture(relative="tex/a b.png")))
    return "x.fbx", ["tex/a b.png"]


def _usd(folder):
    pytest.importorskip("pxr")
    save(folder / "base.usda", fingerless(body("heavy")), [])
    (folder / "tex" / "more.usda").write_text('#usda 1.0\ndef Xform "More" {\n asset shown = @./a b.png@\n}\n')
    (folder / "x.usda").write_text("#usda 1.0\n(\n subLayers = [@./tex/more.usda@, @./base.usda@, @./no.usda@]\n)\n")
    return "x.usda", ["base.usda", "tex/more.usda", "tex/a b.png", "no.usda"]


@pytest.mark.parametrize("make", [_gltf, _fbx, _usd])
def test_what_is_read_beside_a_file_counts_as_the_file(tmp_path, make):
    """Changed, taken away, or there at last: each is noticed, and told apart."""
    (tmp_path / "tex").mkdir()
    (tmp_path / "tex" / "a b.png").write_bytes(PNG)
    name, beside = make(tmp_path)
    path = tmp_path / name
    asset = load(path)
    marks = stamps(path, asset.beside)
    assert [each for each, _, _ in marks][0] == name and set(beside) <= {each for each, _, _ in marks}
    assert not any(each.startswith((".", "/")) for each, _, _ in marks)
    assert unchanged(path, json.loads(json.dumps(marks)))
    seen = {content_hash(path, asset.beside)}
    for other in beside:
        file = tmp_path / other
        if file.exists():
            kept, times = file.read_bytes(), file.stat()
            file.write_bytes(kept + b" ")
            assert not unchanged(path, marks), other
            seen.add(content_hash(path, asset.beside))
            file.unlink()
            assert not unchanged(path, marks), other
            seen.add(content_hash(path, asset.beside))
            file.write_bytes(kept)
            os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
        else:
            file.write_bytes(b"new")
            assert not unchanged(path, marks), other
            seen.add(content_hash(path, asset.beside))
            file.unlink()
        assert unchanged(path, marks)
    there = sum((tmp_path / other).exists() for other in beside)
    assert len(seen) == 1 + 2 * there + (len(beside) - there)


@pytest.mark.parametrize("marks", [None, [], [["other.bvh", 1, 1]], [["x"]], 5, [[5, 1, 1]]])
def test_marks_that_are_none_match_nothing(tmp_path, marks):
    (tmp_path / "x.bvh").write_text("")
    assert not unchanged(tmp_path / "x.bvh", marks)


def test_a_changed_layer_makes_its_results_again(made, tmp_path):
    """The character's picture changes between two runs; then only that is looked at and made again."""
    pytest.importorskip("pxr")
    folder = tmp_path / "c"
    (folder / "parts").mkdir(parents=True)
    save(folder / "parts" / "heavy.usda", fingerless(body("heavy")), [])
    (folder / "x.usda").write_text("#usda 1.0\n(\n subLayers = [@./parts/heavy.usda@]\n)\n")
    batch = Batch(made / "m" / "walk.bvh", folder / "x.usda", tmp_path / "o", Settings(method="copy-rotations"))
    assert run_batch(batch).done_before == 0
    assert run_batch(batch).done_before == 1
    with open(folder / "parts" / "heavy.usda", "a") as layer:
        layer.write("# changed\n")
    summary = run_batch(batch)
    assert summary.done_before == 0 and len(summary.done) == 1 and not summary.failures


def test_a_mesh_sequence_is_no_character(made, tmp_path):
    save_sequence(tmp_path / "wave.npz", bake(body("heavy"), cut(walk(), 0.0, 0.2)))
    summary = run_batch(
        Batch(made / "m" / "walk.bvh", tmp_path / "wave.npz", tmp_path / "o", Settings(method="copy-rotations"))
    )
    said = "holds a mesh sequence, whose surface moves without joints"
    assert [said in each.error and "`convert` writes it" in each.error for each in summary.failures] == [True]
    save_sequence(tmp_path / "frames", bake(body("heavy"), cut(walk(), 0.0, 0.2)))
    with pytest.raises(FileError, match=r"holds frames \(.obj, .ply, .pcd, .npz\) and no motion of joints; as a mesh sequence"):
        run_batch(Batch(made / "m", tmp_path / "frames", tmp_path / "o"))
