"""Damaged and hostile glTF files: one clear line each, whatever they hold."""

import json
import random
import struct
import sys
import time
import tracemalloc

import numpy as np
import pytest
from gltf_maker import pack, worm
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from retarget.errors import FileError, RetargetError
from retarget.io import gltf


def refused(path, *phrases):
    with pytest.raises(FileError) as caught:
        asset = gltf.load(path)
        for clip in range(len(asset.clips)):
            asset.motion(clip)
    message = str(caught.value)
    assert "\n" not in message and len(message) < 400 + len(str(path)) and str(path) in message
    for phrase in phrases:
        assert phrase in message, message


def changed(path, change, **options):
    """The tube with its JSON changed by hand."""
    m = worm(**options)
    change(m.json)
    return m.glb(path / "bad.glb")


def put(*keys_and_value):
    *keys, value = keys_and_value

    def change(document):
        for key in keys[:-1]:
            document = document[key]
        document[keys[-1]] = value

    return change


def drop(*keys):
    def change(document):
        for key in keys[:-1]:
            document = document[key]
        del document[keys[-1]]

    return change


def test_more_joints_than_any_skeleton_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(gltf, "MOST_JOINTS", 2)
    refused(worm().glb(tmp_path / "bad.glb"), "has 3 joints, more than 2; this is no skeleton")


DAMAGED_JSON = {
    "accessor out of range": (put("meshes", 0, "primitives", 0, "attributes", "POSITION", 99), "names number 99 of"),
    "negative index": (put("nodes", 0, "children", [-1]), "nodes[0].children[0]"),
    "index is true": (put("nodes", 0, "children", [True]), "nodes[0].children[0]"),
    "buffer view out of range": (put("accessors", 0, "bufferView", 99), "accessors[0].bufferView"),
    "huge count": (put("accessors", 0, "count", 10**9), "do not fit into"),
    "count beyond numbers": (put("accessors", 0, "count", 10**30), "accessors[0].count"),
    "huge, no data": (put("accessors", 0, {"componentType": 5126, "count": 10**9, "type": "VEC3"}), "without data"),
    "view beyond its buffer": (put("bufferViews", 0, "byteLength", 10**9), "of a buffer of"),
    "offset beyond its view": (put("accessors", 0, "byteOffset", 10**9), "do not fit into"),
    "stride too small": (put("bufferViews", 0, "byteStride", 4), "byteStride 4"),
    "unknown component type": (put("accessors", 0, "componentType", 5130), "accessors[0].componentType"),
    "unknown type": (put("accessors", 0, "type", "VEC5"), "accessors[0].type"),
    "positions of two numbers": (put("accessors", 0, "type", "VEC2"), "VEC3 is needed"),
    "lacking count": (drop("accessors", 0, "count"), "lacks 'count'"),
    "buffer longer than the file": (put("buffers", [{"byteLength": 10**9}]), "promises 1000000000 bytes"),
    "second buffer without data": (put("buffers", [{"byteLength": 4}] * 2), "neither a uri nor"),
    "cycle": (lambda d: d["nodes"][2].update(children=[1]), "is a child of"),
    "separate cycle": (lambda d: d["nodes"].extend([{"children": [5]}, {"children": [4]}]), "cycle"),
    "two parents": (lambda d: d["nodes"].append({"children": [2]}), "is a child of"),
    "joints in separate trees": (lambda d: d["nodes"][1].pop("children"), "2 separate trees ('hips', 'head')"),
    "no joints in the skin": (put("skins", 0, "joints", []), "skins[0].joints: must not be empty"),
    "rotation of three numbers": (put("nodes", 0, "rotation", [0, 0, 1]), "nodes[0].rotation"),
    "rotation of zeros": (put("nodes", 0, "rotation", [0, 0, 0, 0]), "no unit quaternion"),
    "beyond all measure": (lambda d: [n.update(scale=[1e9] * 3) for n in d["nodes"][:2]], "beyond all measure"),
    "matrix that projects": (put("nodes", 0, "matrix", [1, 0, 0, 1] + [0] * 11 + [1]), "last row"),
    "number too large": (put("nodes", 0, "translation", [1e300, 0, 0]), "nodes[0].translation"),
    "sampler out of range": (put("animations", 0, "channels", 0, "sampler", 9), "animations[0].channels[0].sampler"),
    "fewer values than keys": (put("accessors", 8, "count", 3), "need 5"),
    "no keys": (lambda d: d["accessors"][d["animations"][0]["samplers"][0]["input"]].update(count=0), "no keys"),
    "unknown interpolation": (put("animations", 0, "samplers", 0, "interpolation", "SMOOTH"), "interpolation"),
    "joints that are floats": (lambda d: d["accessors"][1].update(componentType=5126, count=1), "unsigned integers"),
    "fewer joints than vertices": (lambda d: d["accessors"][1].update(count=5), "5 joint and 54 weight rows"),
    "fewer texture coordinates": (lambda d: d["accessors"][3].update(count=5), "5 texture coordinates for 54"),
    "fewer inverse binds": (put("accessors", 5, "count", 2), "2 inverse bind"),
    "unknown required extension": (put("extensionsRequired", ["EXT_magic"]), "'EXT_magic'"),
    "required extensions are no list": (put("extensionsRequired", 3), "extensionsRequired"),
    "required extensions are numbers": (put("extensionsRequired", [3]), "extensionsRequired"),
    "version 1": (put("asset", "version", "1.0"), "version '1.0'"),
    "no asset": (drop("asset"), "no 'asset'"),
    "nodes are no list": (put("nodes", {}), "nodes: must be a list"),
    "primitives are a string": (put("meshes", 0, "primitives", "x"), "meshes[0].primitives"),
    "attributes are a list": (put("meshes", 0, "primitives", 0, "attributes", []), "attributes"),
    "name is a number": (put("nodes", 0, "name", 5), "nodes[0].name"),
    "mode 9": (put("meshes", 0, "primitives", 0, "mode", 9), "mode"),
    "normalised is a word": (put("accessors", 0, "normalized", "yes"), "true or false"),
    "weight is a word": (put("meshes", 0, "weights", ["x"]), "meshes[0].weights[0]"),
}  # fmt: skip


@pytest.mark.parametrize("case", DAMAGED_JSON)
def test_damaged_json(case, tmp_path):
    change, phrase = DAMAGED_JSON[case]
    refused(changed(tmp_path, change), phrase)


def overwritten(tmp_path, accessor, values, offset=0, **options):
    """The tube with some of an accessor's bytes replaced."""
    m = worm(**options)
    start = m.json["bufferViews"][m.json["accessors"][accessor(m.json)]["bufferView"]]["byteOffset"] + offset
    data = np.asarray(values).tobytes()
    m.binary[start : start + len(data)] = data
    return m.glb(tmp_path / "bad.glb")


def times(document):
    return document["animations"][0]["samplers"][0]["input"]


DAMAGED_DATA = {
    "NaN in a position": (lambda d: 0, np.float32([np.nan]), "element 0 is not a finite number"),
    "NaN in a rotation": (lambda d: d["animations"][0]["samplers"][1]["output"], np.float32([np.nan]), "not a finite"),
    "joint out of range": (lambda d: 1, np.uint8([0, 200]), "follows joint 200 of a skin of 3"),
    "vertex out of range": (lambda d: 4, np.uint16([999]), "names vertex 999 of 54"),
    "time runs backwards": (times, np.float32([5, 4, 3, 2, 1]), "run backwards"),
    "time before zero": (times, np.float32([-1]), "negative"),
    "a clip of years": (times, np.float32([0, 1, 2, 3, 1e8]), "claims 1e+08 seconds, more than its data"),
}  # fmt: skip


@pytest.mark.parametrize("case", DAMAGED_DATA)
def test_damaged_data(case, tmp_path):
    accessor, values, phrase = DAMAGED_DATA[case]
    refused(overwritten(tmp_path, accessor, values), phrase)


def test_sparse_data_is_checked(tmp_path):
    def sparse(document):
        return document["accessors"][0]["sparse"]

    refused(changed(tmp_path, lambda d: sparse(d).update(count=10**8), sparse=True), "do not fit into")
    refused(
        changed(tmp_path, lambda d: sparse(d)["indices"].update(componentType=5126), sparse=True), "unsigned integers"
    )
    m = worm(sparse=True)
    start = m.json["bufferViews"][sparse(m.json)["indices"]["bufferView"]]["byteOffset"]
    m.binary[start : start + 2] = b"\xff\xff"
    refused(m.glb(tmp_path / "far.glb"), "index 65535 of 54")


def test_small_files_do_not_fill_the_memory(tmp_path):
    """The same data named many times over."""

    def vertices(document):
        document["accessors"][0].pop("bufferView")
        document["accessors"][0]["count"] = 3_000_000
        part = {"attributes": {"POSITION": 0}}
        document["meshes"][0]["primitives"] = [part, {"attributes": {"POSITION": 0, "NORMAL": 0}}]
        document["nodes"][3].pop("skin")
        document["nodes"][2]["children"] = [3]

    def triangles(document):
        document["accessors"].append({"componentType": 5125, "type": "SCALAR", "count": 3_000_000})
        part = dict(document["meshes"][0]["primitives"][0], indices=len(document["accessors"]) - 1)
        document["meshes"][0]["primitives"] = [part] * 5

    refused(changed(tmp_path, vertices), "6000000 vertices")
    refused(changed(tmp_path, triangles), "5000000 triangles")


def test_containers_that_lie(tmp_path):
    whole = worm().glb(tmp_path / "good.glb").read_bytes()
    size = struct.unpack_from("<I", whole, 12)[0]

    def case(data, *phrases):
        (tmp_path / "bad.glb").write_bytes(data)
        refused(tmp_path / "bad.glb", *phrases)

    case(b"", "is empty")
    case(b"glTF", "inside the GLB header", "byte 4")
    case(whole[:100], "the header promises", "byte 8")
    case(whole[:8] + struct.pack("<I", len(whole) - 4) + whole[12:], "the header promises")
    case(whole[:4] + struct.pack("<I", 1) + whole[8:], "GLB version 1", "byte 4")
    case(whole[:12] + struct.pack("<I", 2**32 - 1) + whole[16:], "a chunk promises 4294967295 bytes", "byte 12")
    case(whole[:16] + b"BLOB" + whole[20:], "first chunk is not JSON")
    binary = 20 + size
    case(whole[:binary] + struct.pack("<I", 2**31) + whole[binary + 4 :], "a chunk promises", f"byte {binary}")
    case(whole[:binary] + struct.pack("<I", 16) + whole[binary + 4 :], "chunk")
    case(pack(b"{") + b"", "JSON cannot be parsed", "line 1")
    case(pack(b"[]"), "must be an object")
    case(pack(b'{"asset": NaN}'), "NaN")
    case(pack(b'{"a": ' + b"9" * 5000 + b"}"), "JSON cannot be parsed" if sys.version_info >= (3, 11) else "")
    case(pack(b"\xff\xfe{}"), "not UTF-8")
    case(pack(b'{"asset":' + b"[" * 200_000 + b"]" * 200_000 + b"}"), "nested too deeply")
    case(pack(b'{"asset":{"version":"2.0"}}'), "neither a skeleton nor a mesh")
    case(b"solid stl", "does not begin with 'glTF'")


URIS = [
    "../secret.bin", "..%2fsecret.bin", "%2e%2e/secret.bin", "/etc/passwd", "%2fetc/passwd", "file:///etc/passwd",
    "http://x/y.bin", "C:\\secret.bin", "c:/secret.bin", "sub/../../secret.bin", "..\\secret.bin", "link.bin",
    "folder/secret.bin", "a\u0000b",
]  # fmt: skip


@pytest.mark.parametrize("uri", URIS)
def test_uris_never_leave_the_folder(uri, tmp_path):
    (tmp_path / "secret.bin").write_bytes(b"x" * 100_000)
    home = tmp_path / "home"
    home.mkdir()
    (home / "link.bin").symlink_to(tmp_path / "secret.bin")
    (home / "folder").symlink_to(tmp_path)
    m = worm(texture=True)
    for kind in ("buffers", "images"):
        document = json.loads(m.gltf(home / "bad.gltf").read_text())
        entry = document[kind][0]
        entry.pop("bufferView", None)
        entry["uri"] = uri
        (home / "bad.gltf").write_text(json.dumps(document))
        refused(home / "bad.gltf", "points outside the file's own folder")


@pytest.mark.parametrize(
    "uri, phrase",
    [
        ("missing.bin", "is not in its folder"),
        (".", "is not in its folder"),
        ("x" * 5000, "is not in its folder"),
        ("loop.bin", "is not in its folder"),
        ("data:application/octet-stream;base64,@@@", "not valid base64"),
        ("data:text/plain,hello", "only base64"),
        ("data:;base64,AAAA", "promises"),
    ],
)
def test_uris_that_lead_nowhere(uri, phrase, tmp_path):
    (tmp_path / "loop.bin").symlink_to(tmp_path / "loop.bin")
    m = worm()
    document = json.loads(m.gltf(tmp_path / "bad.gltf").read_text())
    document["buffers"][0]["uri"] = uri
    (tmp_path / "bad.gltf").write_text(json.dumps(document))
    refused(tmp_path / "bad.gltf", phrase)


def test_names_with_spaces_may_be_escaped(tmp_path):
    m = worm()
    (tmp_path / "my data.bin").write_bytes(m.binary)
    m.json["buffers"] = [{"byteLength": len(m.binary), "uri": "my%20data.bin"}]
    (tmp_path / "a.gltf").write_text(json.dumps(m.json))
    assert gltf.load(tmp_path / "a.gltf").kind == "character"


def test_a_missing_picture_is_no_reason_to_refuse(tmp_path):
    m = worm(texture=True)
    m.json["images"][0] = {"uri": "gone.png"}
    asset = gltf.load(m.glb(tmp_path / "a.glb"))
    assert asset.character.mesh.materials[0].image is None
    assert any("gone.png" in note for note in asset.notes)


def swap(document, rng):
    """Put some value of the document in the place of another, or something alien."""
    places = []
    stack = [document]
    while stack:
        here = stack.pop()
        for key in here if isinstance(here, dict) else range(len(here)):
            places.append((here, key))
            if isinstance(here[key], (dict, list)):
                stack.append(here[key])
    for _ in range(rng.randint(1, 3)):
        here, key = rng.choice(places)
        there, other = rng.choice(places)
        alien = [None, -1, 0, 1, 2**31, 10**40, 1e308, -0.5, "x", "", [], {}, True, [[]], {"a": 1}, 5125, "VEC4"]
        try:
            here[key] = rng.choice(alien) if rng.random() < 0.6 else json.loads(json.dumps(there[other]))
        except (ValueError, KeyError, IndexError):
            pass


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    m = worm(
        sparse=True, prop=True, texture=True, skins=2, mode="CUBICSPLINE", armature={"scale": [0.01] * 3}, between=True
    )
    return m.glb(tmp_path_factory.mktemp("good") / "good.glb").read_bytes()


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32), kind=st.sampled_from(["flip", "cut", "swap", "swap", "swap"]))
def test_mutations_raise_nothing_but_our_own(good, tmp_path, seed, kind):
    rng = random.Random(seed)
    size = struct.unpack_from("<I", good, 12)[0]
    text, binary = good[20 : 20 + size], good[28 + size :]
    if kind == "flip":
        data = bytearray(good)
        for _ in range(rng.randint(1, 20)):
            data[rng.randrange(len(data))] = rng.randrange(256)
    elif kind == "cut":
        cut = rng.randrange(len(good))
        data = good[:cut]
        if cut > 12 and rng.random() < 0.5:
            data = data[:8] + struct.pack("<I", cut) + data[12:]
    else:
        document = json.loads(text)
        swap(document, rng)
        data = pack(json.dumps(document).encode(), binary)
    path = tmp_path / "mutant.glb"
    path.write_bytes(data)
    began = time.perf_counter()
    tracemalloc.start()
    try:
        asset = gltf.load(path)
        motions = [asset.motion(clip) for clip in range(len(asset.clips))]
        if asset.character is not None:
            gltf.save(tmp_path / "out.glb", asset.character, motions)
    except RetargetError as error:
        assert "\n" not in str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 200e6 and time.perf_counter() - began < 5
