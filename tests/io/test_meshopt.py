"""meshopt: streams as the reference decoder reads them, whole files, and nothing that damage does is more than one line."""

import json
import random
import struct
from pathlib import Path

import numpy as np
import pytest
from gltf_maker import pack, worm

from retarget.body.kinematics import world_pose
from retarget.body.skinning import rest_vertices
from retarget.errors import FileError, RetargetError
from retarget.io import gltf, meshopt
from retarget.io.meshopt_streams import MeshoptError

DATA = Path(__file__).resolve().parents[1] / "data"
EXT, KHR = meshopt.EXTENSIONS


def streams():
    """Name, stream, count, stride, mode, filter and the reference's result of all streams."""
    held = np.load(DATA / "meshopt_streams.npz", allow_pickle=False)
    for key in held.files:
        if not key.endswith("|decoded"):
            name, count, stride, mode, filter_ = key.split("|")
            yield name, held[key].tobytes(), int(count), int(stride), mode, filter_, held[key + "|decoded"].tobytes()


STREAMS = list(streams())


def read_glb(path):
    """JSON and binary chunk."""
    raw = path.read_bytes()
    length = struct.unpack_from("<I", raw, 12)[0]
    return json.loads(raw[20 : 20 + length]), raw[28 + length :]


@pytest.mark.parametrize("stream", STREAMS, ids=lambda stream: stream[0])
def test_streams_are_read_as_the_reference_reads_them(stream):
    _, data, count, stride, mode, filter_, expected = stream
    found = meshopt.unfold(data, count, stride, mode, filter_)
    if filter_ in ("OCTAHEDRAL", "QUATERNION"):  # the text allows one unit in the last place
        kind = "i1" if stride == 4 else "<i2"
        apart = np.frombuffer(found, kind).astype(int) - np.frombuffer(expected, kind)
        assert np.abs(apart).max() <= 1 and np.mean(apart != 0) < 0.02
    else:
        assert found == expected


def test_every_mode_filter_and_channel_is_among_the_streams():
    assert {(mode, filter_) for _, _, _, _, mode, filter_, _ in STREAMS} == {
        *(("ATTRIBUTES", each) for each in meshopt.FILTERS), ("TRIANGLES", "NONE"), ("INDICES", "NONE")
    }  # fmt: skip
    new = [(data, stride) for _, data, _, stride, _, _, _ in STREAMS if data[0] == 0xA1]
    channels = {each & 15 for data, stride in new for each in data[-(stride // 4) :]}
    assert channels == {0, 1, 2}


def test_the_example_of_the_specification():
    """Sixteen deltas in four bits, two of them behind; the sums are what one byte of 16 elements becomes."""
    group = bytes.fromhex("175ff0bc77a9210034b5")
    deltas = [-1, -4, -3, 26, -91, 0, -6, 6, -4, -4, 5, -5, 1, -1, 0, 0]
    stream = b"\xa0" + b"\x02" + group + b"\x00" * 3 + bytes(32)
    elements = np.frombuffer(meshopt.unfold(stream, 16, 4, "ATTRIBUTES", "NONE"), np.uint8).reshape(16, 4)
    assert elements[:, 0].tolist() == (np.cumsum(deltas) % 256).tolist() and not elements[:, 1:].any()


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ((b"\xa0" + bytes(40), 1, 6, "ATTRIBUTES", "NONE"), "byteStride 6 is no multiple of 4"),
        ((b"\xa0" + bytes(40), 1, 0, "ATTRIBUTES", "NONE"), "byteStride 0 is no multiple of 4"),
        ((b"\xa0" + bytes(40), 1, 260, "ATTRIBUTES", "NONE"), "up to 256"),
        ((b"\xe1" + bytes(40), 3, 1, "TRIANGLES", "NONE"), "byteStride of 2 or 4"),
        ((b"\xd1" + bytes(40), 3, 4, "INDICES", "EXPONENTIAL"), "no filter"),
        ((b"\xe1" + bytes(40), 4, 4, "TRIANGLES", "NONE"), "4 indices make no whole triangles"),
        ((b"\xa0" + bytes(40), 1, 12, "ATTRIBUTES", "OCTAHEDRAL"), "does not go with a byteStride of 12"),
        ((b"\xa0" + bytes(40), 1, 4, "ATTRIBUTES", "QUATERNION"), "does not go with a byteStride of 4"),
        ((b"", 1, 4, "ATTRIBUTES", "NONE"), "begins with nothing where a0 or a1 is needed"),
        ((b"\xa2" + bytes(40), 1, 4, "ATTRIBUTES", "NONE"), "begins with a2"),
        ((b"\xa0" + bytes(40), 10**12, 4, "ATTRIBUTES", "NONE"), "too few for its elements"),
        ((b"\xa1" + bytes(40), 10**12, 4, "ATTRIBUTES", "NONE"), "too few for its elements"),
        ((b"\xe1" + bytes(40), 3 * 10**12, 4, "TRIANGLES", "NONE"), "too few for its elements"),
        ((b"\xd1" + bytes(40), 10**12, 4, "INDICES", "NONE"), "too few for its elements"),
        ((b"\xa0" + b"\x03" * 4 + bytes(32), 16, 4, "ATTRIBUTES", "NONE"), "ends inside its deltas"),
        ((b"\xa0" + bytes(4 + 32 + 5), 16, 4, "ATTRIBUTES", "NONE"), "5 bytes are left behind its elements"),
        ((b"\xa1\xaa" + bytes(23) + b"\x03", 16, 4, "ATTRIBUTES", "NONE"), "channel is of the unknown mode 0x03"),
        ((b"\xd1" + bytes(3 + 4), 2, 4, "INDICES", "NONE"), "holds 3 indices, 2 are declared"),
        ((b"\xd1" + b"\x80" * 5 + b"\x01" + bytes(4), 1, 4, "INDICES", "NONE"), "more than five bytes"),
        ((b"\xd1" + b"\xff\xff\x7f" + bytes(4), 1, 2, "INDICES", "NONE"), "does not fit into 2 bytes"),
        ((b"\xe1\xf0" + b"\xf0" + bytes(15), 3, 4, "TRIANGLES", "NONE"), "table of codes is damaged"),
        ((b"\xe1\x00" + bytes(16), 3, 4, "TRIANGLES", "NONE"), "edge or vertex that was never there"),
        ((b"\xe1\xfe" + bytes(16), 3, 4, "TRIANGLES", "NONE"), "a triangle is cut off"),
        ((b"\xe1\xff\x11\x80" + bytes(16), 3, 4, "TRIANGLES", "NONE"), "an index is cut off"),
        ((b"\xe1\xf0\x00\x00" + bytes(16), 3, 4, "TRIANGLES", "NONE"), "2 bytes are left behind its triangles"),
    ],
)
def test_what_is_no_such_stream_is_refused(arguments, problem):
    with pytest.raises(MeshoptError, match=problem):
        meshopt.unfold(*arguments)


def test_no_elements_are_no_bytes():
    assert meshopt.unfold(b"\xa0" + bytes(32), 0, 4, "ATTRIBUTES", "NONE") == b""
    assert meshopt.unfold(b"\xe1" + bytes(16), 0, 4, "TRIANGLES", "NONE") == b""
    assert meshopt.unfold(b"\xd1" + bytes(4), 0, 4, "INDICES", "NONE") == b""


def test_damaged_streams_are_read_or_refused():
    rng, outcomes = random.Random(1), {"read": 0, "refused": 0}
    for _ in range(4000):
        _, data, count, stride, mode, filter_, _ = rng.choice(STREAMS)
        data = bytearray(data)
        for _ in range(rng.randrange(1, 4)):
            at = rng.randrange(len(data))
            data[at : at + rng.choice((0, 1, 1, 1, 9))] = rng.randbytes(rng.choice((1, 1, 1, 0, 5)))
        count += rng.choice((0, 0, 0, 3, -3, 10**9)) * (count > 3)
        try:
            found = meshopt.unfold(bytes(data), count, stride, mode, filter_)
            assert len(found) == count * stride
            outcomes["read"] += 1
        except MeshoptError as error:
            assert "\n" not in str(error)
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 80, outcomes


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The worm that the files in `data` were made of."""
    path = tmp_path_factory.mktemp("plain") / "worm.glb"
    return gltf.load(worm(texture=True, keys=24, clips=2, stretchy=True).glb(path))


def compare(asset, plain):
    """Joints in every frame and vertices at rest stand where those of the uncompressed file stand, but for quantisation."""
    theirs, ours = asset.character.skeleton, plain.character.skeleton
    order = [theirs.index(name) for name in ours.names]
    assert [clip.name for clip in asset.clips] == [clip.name for clip in plain.clips]
    for number in range(len(plain.clips)):
        found, expected = world_pose(asset.motion(number))[1][:, order], world_pose(plain.motion(number))[1]
        assert np.abs(found - expected).max() < 1e-4
    apart = np.linalg.norm(rest_vertices(asset.character)[:, None] - rest_vertices(plain.character), axis=-1)
    assert apart.min(axis=0).max() < 1e-4 and apart.min(axis=1).max() < 1e-4
    assert len(asset.character.mesh.faces) == len(plain.character.mesh.faces)


@pytest.mark.parametrize("kind", ["ext", "khr"])
def test_compressed_characters_and_their_clips_are_read(kind, plain):
    compare(gltf.load(DATA / f"worm_meshopt_{kind}.glb"), plain)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("kind", ["ext", "khr"])
def test_the_compressed_data_stay_as_they_are(kind, suffix, plain, tmp_path):
    source = DATA / f"worm_meshopt_{kind}.glb"
    asset = gltf.load(source)
    gltf.save(tmp_path / f"out{suffix}", asset.character, [asset.motion(1)])
    again = gltf.load(tmp_path / f"out{suffix}")
    assert [clip.name for clip in again.clips] == ["clip0", "clip1", "clip1_2"]
    assert np.abs(world_pose(again.motion(2))[1] - world_pose(asset.motion(1))[1]).max() < 1e-5
    (old, held) = read_glb(source)
    if suffix == ".glb":
        new, kept = read_glb(tmp_path / "out.glb")
    else:
        new, kept = json.loads((tmp_path / "out.gltf").read_text()), (tmp_path / "out.bin").read_bytes()
    size = old["buffers"][0]["byteLength"]
    assert kept[:size] == held[:size] and len(new["buffers"]) == 2 and new["buffers"][1] == old["buffers"][1]
    for key in ("bufferViews", "accessors", "meshes", "skins", "extensionsRequired"):
        assert new[key][: len(old[key])] == old[key]


def with_stand_in_first(path):
    """The compressed worm as JSON whose first buffer holds nothing."""
    document, binary = read_glb(DATA / "worm_meshopt_ext.glb")
    document["buffers"] = [document["buffers"][1], {**document["buffers"][0], "uri": "worm.bin"}]
    for view in document["bufferViews"]:
        view["buffer"] = 1 - view["buffer"]
        if "extensions" in view:
            view["extensions"][EXT]["buffer"] = 1 - view["extensions"][EXT]["buffer"]
    (path.parent / "worm.bin").write_bytes(binary)
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_a_first_buffer_that_holds_nothing_makes_way_for_what_is_written(suffix, plain, tmp_path):
    asset = gltf.load(with_stand_in_first(tmp_path / "worm.gltf"))
    compare(asset, plain)
    gltf.save(tmp_path / f"out{suffix}", asset.character, [asset.motion(0)])
    again = gltf.load(tmp_path / f"out{suffix}")
    assert len(again.clips) == 3
    assert np.array_equal(rest_vertices(again.character), rest_vertices(asset.character))
    assert np.abs(world_pose(again.motion(2))[1] - world_pose(asset.motion(0))[1]).max() < 1e-5


def changed(tmp_path, change):
    """The compressed worm with its JSON changed by hand."""
    document, binary = read_glb(DATA / "worm_meshopt_ext.glb")
    change(document)
    path = tmp_path / "bad.glb"
    path.write_bytes(pack(json.dumps(document).encode(), binary))
    return path


def view_of(document):
    return next(view for view in document["bufferViews"] if "extensions" in view)


def packed(document):
    return view_of(document)["extensions"][EXT]


def set_mode(document):
    packed(document)["mode"] = "CIRCLES"


def set_reach(document):
    packed(document)["byteOffset"] = 10**9


def set_count(document):
    packed(document)["count"] += 1


def set_bomb(document):
    view, held = view_of(document), packed(document)
    held["count"] = 10**12
    view["byteLength"] = held["count"] * held["byteStride"]


def set_stream(document):
    packed(document)["byteOffset"] = 1 + packed(document).get("byteOffset", 0)


def drop_stride(document):
    del packed(document)["byteStride"]


def set_plain(document):
    view_of(document).pop("extensions")


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (set_mode, r"extensions.EXT_meshopt_compression.mode: must be one of ATTRIBUTES"),
        (drop_stride, "lacks 'byteStride'"),
        (set_reach, "of a buffer of 2420 bytes"),
        (set_count, "are not what the view describes"),
        (set_bomb, "unfold to more than they can hold"),
        (set_stream, "its meshopt data are damaged"),
        (set_plain, "has neither a uri nor a binary chunk"),
    ],
)
def test_faults_of_the_description_are_told_with_their_place(tmp_path, change, problem):
    with pytest.raises(FileError, match=problem) as caught:
        gltf.load(changed(tmp_path, change))
    assert "\n" not in str(caught.value) and str(tmp_path / "bad.glb") in str(caught.value)


def test_damaged_files_are_read_or_refused(tmp_path):
    raw, rng = (DATA / "worm_meshopt_ext.glb").read_bytes(), random.Random(2)
    path, outcomes = tmp_path / "bad.glb", {"read": 0, "refused": 0}
    for _ in range(200):
        data = bytearray(raw)
        for _ in range(rng.randrange(1, 4)):
            at = rng.randrange(20, len(data)) if rng.random() < 0.3 else rng.randrange(len(raw) - 2420, len(raw))
            data[at] = rng.randrange(256)
        path.write_bytes(data)
        try:
            asset = gltf.load(path)
            for clip in range(len(asset.clips)):
                asset.motion(clip)
            outcomes["read"] += 1
        except RetargetError as error:
            assert "\n" not in str(error)
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 12, outcomes
