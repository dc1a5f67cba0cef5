import random
import re
import time

import numpy as np
import pytest
from file_faults import mutated

from retarget.body import rotations as rot
from retarget.body.kinematics import world_pose
from retarget.errors import FileError, RetargetError
from retarget.io import bvh, bvh_hierarchy

WALK = """HIERARCHY
ROOT Hips
{
  OFFSET 0 1 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Left Leg
  {
    OFFSET 0.5 -1 0
    CHANNELS 3 Yrotation Xrotation Zrotation
    End Site
    {
      OFFSET 0 -2 0
    }
  }
  JOINT Spine
  {
    OFFSET 0 2 0
    CHANNELS 1 Xrotation
  }
}
MOTION
Frames: 2
Frame Time: 0.041667
0 1 0 0 0 0 0 0 0 0
1 2 3 10 20 30 40 50 60 70
"""


@pytest.fixture
def read(tmp_path):
    def read(text):
        path = tmp_path / "file.bvh"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return bvh.load(path)

    return read


def decode(asset):
    return asset, asset.motion() if asset.clips else None


def quaternion(order, *degrees):
    return rot.from_euler(np.radians(np.array(degrees, dtype=float)), order)


def test_skeleton_and_motion_of_a_plain_file(read):
    asset, motion = decode(read(WALK))
    skeleton = asset.character.skeleton
    assert asset.kind == "motion" and asset.convention.up is None and asset.convention.metres_per_unit is None
    assert skeleton.names == ("Hips", "Left Leg", "Spine") and skeleton.parents.tolist() == [-1, 0, 0]
    assert skeleton.offsets.tolist() == [[0, 1, 0], [0.5, -1, 0], [0, 2, 0]]
    assert np.array_equal(skeleton.rest_rotations, np.tile(rot.IDENTITY, (3, 1)))
    assert {joint: end.tolist() for joint, end in skeleton.end_offsets.items()} == {1: [0, -2, 0]}
    assert (asset.clips[0].frames, asset.clips[0].fps) == (2, 24.0) == (len(motion), motion.fps)
    assert motion.moved == (0,) and motion.translations.tolist() == [[[0, 1, 0]], [[1, 2, 3]]]
    assert np.allclose(motion.rotations[1, 0], quaternion("ZXY", 10, 20, 30))
    assert np.allclose(motion.rotations[1, 1], quaternion("YXZ", 40, 50, 60))
    assert np.allclose(motion.rotations[1, 2], quaternion("X", 70))


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace(" ", "\t").replace("Left\tLeg", "Left Leg").replace("Frame\tTime", "Frame Time"),
        lambda text: text.rstrip(),
        lambda text: text.replace("\n", "\n\n"),
        lambda text: "\ufeff" + text,
        lambda text: text.replace("0 0 0\n1 2", "0 0 0 \n  1 2"),
        lambda text: re.sub("ROOT|JOINT|OFFSET|CHANNELS|HIERARCHY|MOTION|[XYZ]rot", lambda m: m[0].lower(), text),
        lambda text: text.upper().replace("HIPS", "Hips").replace("LEFT LEG", "Left Leg").replace("SPINE", "Spine"),
        lambda text: re.sub(r"\n *\{", " {", text),
        lambda text: text.replace("Frames:", "Frames :"),
        lambda text: text.replace("1 2 3 10", "1 2 3\n10"),
    ],
    ids="crlf tabs no-final-newline blank-lines bom outer-blanks lower upper brace-on-line colon wrapped".split(),
)
def test_ways_of_writing_the_same_file(read, change):
    expected, motion = decode(read(WALK))
    asset, changed = decode(read(change(WALK)))
    assert asset.character.skeleton.names == expected.character.skeleton.names
    assert np.array_equal(motion.rotations, changed.rotations)
    assert np.array_equal(motion.translations, changed.translations)


@pytest.mark.parametrize(
    "printed, rate",
    [
        (".0083333", 120), ("0.008333", 120), ("0.041667", 24), (".03333", 30), ("0.033", 30), ("0.0333667", 29.97),
        ("0.008342", 119.88), ("0.0166666", 60), ("0.04", 25), ("0.01", 100), ("0.0417", 24), ("8.33333e-03", 120),
        ("0.041708", 23.976), ("1", 1), ("0.02", 50), ("0.0100503", 1 / 0.0100503), ("0.5", 2), ("0.008", 125),
    ],
)  # fmt: skip
def test_frame_rates_that_printed_times_mean(printed, rate):
    assert bvh.frames_per_second(printed) == pytest.approx(rate, rel=1e-12)


def test_position_channels_replace_the_offset_of_any_joint(read):
    text = WALK.replace("CHANNELS 3 Yrotation", "CHANNELS 5 Yposition Zposition Yrotation")
    text = text.replace("0 1 0 0 0 0 0", "0 1 0 0 0 0 -1 0 0").replace("20 30 40", "20 30 -1.5 0.25 40")
    asset, motion = decode(read(text))
    assert motion.moved == (0, 1)
    assert motion.translations[:, 1].tolist() == [[0.5, -1, 0], [0.5, -1.5, 0.25]]
    assert not any("added" in note for note in asset.notes)


def test_position_channels_that_vanish_beside_the_offsets_are_added(read):
    text = WALK.replace("CHANNELS 3 Yrotation", "CHANNELS 6 Xposition Yposition Zposition Yrotation")
    text = text.replace("0 1 0 0 0 0 0", "0 1 0 0 0 0 0 0 0 0").replace("20 30 40", "20 30 0 0.25 0 40")
    asset, motion = decode(read(text))
    assert motion.translations[:, 1].tolist() == [[0.5, -1, 0], [0.5, -0.75, 0]]
    assert any("added" in note for note in asset.notes)
    # The root's replace its offset nevertheless.
    assert motion.translations[:, 0].tolist() == [[0, 1, 0], [1, 2, 3]]


def test_a_joint_that_keeps_its_offset_is_not_moved(read):
    text = WALK.replace("CHANNELS 3 Yrotation", "CHANNELS 6 Xposition Yposition Zposition Yrotation")
    text = text.replace("0 1 0 0 0 0 0", "0 1 0 0 0 0 .5 -1 0 0").replace("20 30 40", "20 30 .5 -1 0 40")
    assert decode(read(text))[1].moved == (0,)


def test_the_position_of_the_root_always_replaces_its_offset(read):
    asset, motion = decode(read(WALK.replace("0 1 0 0 0", "0 0 0 0 0").replace("1 2 3 10", "0 0 0 10")))
    assert motion.translations.tolist() == [[[0, 0, 0]]] * 2 and not any("added" in note for note in asset.notes)


def test_a_root_without_position_channels_stays_at_its_offset(read):
    text = WALK.replace("6 Xposition Yposition Zposition", "3").replace("0 1 0 0 0", "0 0", 1).replace("1 2 3 10", "10")
    assert decode(read(text))[1].translations.tolist() == [[[0, 1, 0]]] * 2


@pytest.mark.parametrize(
    "old, new, word",
    [
        ("JOINT Spine", "JOINT Left Leg", "numbered: Left Leg_2"),
        ("OFFSET 0 2 0", "OFFSET 0 0 0", "length zero: Spine"),
        ("    CHANNELS 1 Xrotation\n", "", "keep still: Spine"),
        ("    End Site\n", "    End Site\n{\nOFFSET 1 1 1\n}\n End Site\n", "several End Sites"),
        ("Frame Time: 0.041667", "Frame Time: 0.042", "24 frames a second"),
    ],
)
def test_oddities_are_read_and_noted(read, old, new, word):
    text = WALK.replace(old, new)
    if "CHANNELS 1" in old:
        text = text.replace("0 0 0 0\n", "0 0 0\n").replace(" 70\n", "\n")
    asset, motion = decode(read(text))
    assert len(motion) == 2 and any(word in note for note in asset.notes), asset.notes


def test_what_follows_the_frames_is_passed_over_and_noted(read):
    _, expected = decode(read(WALK))
    for junk in ("0 0 0 0 0 0 0 0 0 0\n", "the end\n", "\n\n\x00\x7f"):
        asset, motion = decode(read(WALK + junk))
        assert np.array_equal(motion.rotations, expected.rotations)
        assert any("passed over" in note for note in asset.notes)


def test_names_that_appear_again_never_collide_with_others(read):
    asset = read(WALK.replace("Left Leg", "a").replace("Spine", "a").replace("Hips", "a_2"))
    assert len(set(asset.character.skeleton.names)) == 3 and asset.character.skeleton.names[:2] == ("a_2", "a")


def test_a_hierarchy_alone_is_a_skeleton_without_clips(read):
    asset = read(WALK[: WALK.index("MOTION")])
    assert len(asset.character.skeleton) == 3 and asset.clips == ()
    with pytest.raises(FileError, match="no animation clip"):
        asset.motion()


def swap(old, new):
    return lambda text: text.replace(old, new)


def until(word):
    return lambda text: text[: text.index(word)]


REJECTED = {
    "empty": (lambda text: "", "is empty"),
    "blank": (lambda text: " \n\n", "is empty"),
    "another format": (lambda text: "glTF" + text, "is not a BVH file.*'glTFHIERARCHY'"),
    "binary": (lambda text: bytes(range(256)) * 10, "is not a BVH file"),
    "a line without end": (lambda text: "HIERARCHY\n" + "x" * 100_000, "line 2: a line of more than"),
    "no root": (lambda text: "HIERARCHY\nMOTION\nFrames: 1", "line 2: the hierarchy has no ROOT"),
    "several roots": (swap("JOINT Spine", "ROOT Spine"), "line 15: a second ROOT 'Spine' beside 'Hips'"),
    "unknown word": (swap("OFFSET 0 2", "OFSET 0 2"), "line 17: 'OFSET' is no word"),
    "no brace": (swap("  {\n    OFFSET 0 2", "    OFFSET 0 2"), r"line 16: expected '\{' after joint 'Spine'"),
    "brace without joint": (swap("ROOT Hips\n", ""), r"line 2: '\{' without a ROOT"),
    "brace too many": (swap("MOTION", "}\nMOTION"), "line 21: '}' closes nothing"),
    "brace missing": (swap("}\nMOTION", "MOTION"), "line 20: .* inside joint 'Hips'; 1 closing braces"),
    "cut in the hierarchy": (until("JOINT Spine"), "line 14: .*the file is cut off"),
    "cut before a brace": (lambda text: text[: text.index("Spine") + 6], "line 15: .*inside joint 'Spine'"),
    "joint outside": (swap("ROOT Hips", "JOINT Hips"), "line 2: JOINT 'Hips' stands outside"),
    "joint in end site": (swap("OFFSET 0 -2 0", "JOINT a"), "line 12: JOINT 'a' stands inside an End Site"),
    "no name": (swap("JOINT Spine", "JOINT"), "line 15: a joint without a name"),
    "end site outside": (swap("ROOT Hips", "End Site"), "line 2: an End Site outside"),
    "no offset": (swap("    OFFSET 0 2 0\n", ""), "line 18: joint 'Spine' has no OFFSET"),
    "no end offset": (swap("OFFSET 0 -2 0", ""), "line 13: the end site has no OFFSET"),
    "two offsets": (swap("OFFSET 0 2 0", "OFFSET 0 2 0\nOFFSET 0 2 0"), "line 18: a second OFFSET"),
    "short offset": (swap("OFFSET 0 2 0", "OFFSET 0 2"), "line 17: OFFSET takes three finite numbers"),
    "nan offset": (swap("OFFSET 0 2 0", "OFFSET 0 nan 0"), "line 17: OFFSET takes three finite numbers"),
    "huge offset": (swap("OFFSET 0 2 0", "OFFSET 0 1e300 0"), "line 17: OFFSET takes three"),
    "offset outside": (swap("ROOT Hips", "OFFSET 1 2 3"), "line 2: OFFSET stands outside"),
    "channels outside": (swap("ROOT Hips", "CHANNELS 0"), "line 2: CHANNELS stands outside"),
    "channel count": (swap("CHANNELS 1", "CHANNELS 2"), "line 18: CHANNELS gives the count '2' and then 1"),
    "no channel count": (swap("CHANNELS 1 Xrotation", "CHANNELS"), "line 18: CHANNELS gives the count ''"),
    "unknown channel": (swap("CHANNELS 1 X", "CHANNELS 1 W"), "line 18: 'Wrotation' is no channel"),
    "double channel": (swap("3 Yrotation", "3 Zrotation"), "line 9: a channel of joint 'Left Leg'"),
    "no channels": (lambda text: re.sub(" *CHANNELS.*\n", "", text), "names no CHANNELS"),
    "nothing below MOTION": (until("Frames"), "ends where 'Frames: COUNT' should stand"),
    "no frames line": (swap("Frames: 2\n", ""), "line 22: expected 'Frames: COUNT'"),
    "no frame time": (until("Frame Time"), "ends where 'Frame Time: SECONDS'"),
    "frames no number": (swap("Frames: 2", "Frames: 2.5"), "line 22: the number of frames must be"),
    "negative frames": (swap("Frames: 2", "Frames: -2"), "line 22: the number of frames must be"),
    "no frame": (swap("Frames: 2", "Frames: 0"), "line 22: there is no frame"),
    "frame time zero": (swap("0.041667", "0"), "line 23: the frame time must be a positive"),
    "frame time behind a wide space": (swap("0.041667", "\xa00.041667"), "line 23: the frame time must be a positive"),
    "frame time words": (swap("0.041667", "fast"), "line 23: the frame time must be .* 'fast'"),
    "frame time nan": (swap("0.041667", "nan"), "line 23: the frame time must be a positive"),
    "a million frames": (swap("Frames: 2", "Frames: 1000000"), "declares 1000000 frames and ends after 2"),
    "cut between frames": (until("1 2 3 10"), "line 25: declares 2 frames and ends after 1"),
    "cut inside a frame": (until("60 70"), "line 25: ends inside frame 2 of 2, after 8 of its 10"),
    "number missing": (swap("0 1 0 0", "0 1 0"), "line 24: frame 1 has 9 numbers; .* 10 channels"),
    "number too many": (swap(" 70\n", " 70 1\n"), "line 25: frame 2 has 11 numbers"),
    "no number": (swap(" 70\n", " x\n"), "line 25: 'x' is no finite number"),
    "decimal comma": (swap(" 70\n", " 7,0\n"), "line 25: '7,0' is no finite number"),
    "nan": (swap(" 70\n", " nan\n"), "line 25: 'nan' is no finite number"),
    "infinity": (swap(" 70\n", " 1e999\n"), "line 25: '1e999' is no finite number"),
    "minus glued": (swap("0 0 0 0\n", "0 0 0 0-1\n"), "line 24: '0-1' is no finite number"),
    "zero byte": (swap(" 70\n", " \x00\n"), "line 25: ends inside frame 2"),
}  # fmt: skip


@pytest.mark.parametrize("change, message", REJECTED.values(), ids=REJECTED.keys())
def test_faulty_files_are_refused_in_one_line(read, tmp_path, change, message):
    with pytest.raises(FileError, match=f"file.bvh.*{message}") as caught:
        decode(read(change(WALK)))
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


def test_few_channels_do_not_make_a_small_file_fill_the_memory(read):
    joints = "".join(f"JOINT {i}\n{{\nOFFSET 0 1 0\n}}\n" for i in range(2_000))
    text = "HIERARCHY\nROOT r\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n" + joints + "}\n"
    text += "MOTION\nFrames: 100000\nFrame Time: 1\n"
    with pytest.raises(FileError, match="leave out joints that keep still"):
        read(text + "0\n" * 100_000)


@pytest.mark.parametrize("size", [5, 7, 20, 64])
def test_numbers_and_faults_are_the_same_wherever_a_block_of_the_file_ends(read, monkeypatch, size):
    faulty = [REJECTED[name][0](WALK) for name in ("no number", "cut inside a frame", "number missing", "nan")]
    _, expected = decode(read(WALK))
    told = [str(pytest.raises(FileError, decode_text, read, text).value) for text in faulty]
    monkeypatch.setattr(bvh, "BLOCK", size)
    for text in (WALK, WALK.rstrip(), WALK.replace("1 2 3 10", "1 2 3\n10"), WALK + "junk"):
        motion = decode(read(text))[1]
        assert np.array_equal(motion.rotations, expected.rotations)
        assert np.array_equal(motion.translations, expected.translations)
    assert told == [str(pytest.raises(FileError, decode_text, read, text).value) for text in faulty]


def decode_text(read, text):
    return decode(read(text))


def test_missing_file_and_file_that_changes_after_loading(read, tmp_path):
    with pytest.raises(FileError, match="cannot be read"):
        bvh.load(tmp_path / "absent.bvh")
    asset = read(WALK)
    asset.path.write_text(WALK[:-20])
    with pytest.raises(FileError, match="has the file changed"):
        asset.motion()
    asset.path.unlink()
    with pytest.raises(FileError, match="cannot be read"):
        asset.motion()


def test_nesting_of_any_depth(read):
    depth = 3_000
    text = "HIERARCHY\nROOT r\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n"
    text += "".join(f"JOINT {i}\n{{\nOFFSET 0 1 0\n" for i in range(depth)) + "}\n" * (depth + 1)
    assert len(read(text).character.skeleton) == depth + 1


def test_more_joints_than_any_skeleton_are_refused_soon(read, monkeypatch):
    monkeypatch.setattr(bvh_hierarchy, "MOST_JOINTS", 2)
    text = "HIERARCHY\nROOT r\n{\nOFFSET 0 0 0\nJOINT a\n{\nOFFSET 0 1 0\n%s}\n}\n"
    assert len(read(text % "").character.skeleton) == 2
    with pytest.raises(FileError, match="line 8: more than 2 joints; this is no skeleton"):
        read(text % "JOINT b\n{\nOFFSET 0 1 0\n}\n")


WORDS = [b"{", b"}", b"MOTION", b"ROOT", b"JOINT", b"End"]


def expect_read_or_refused(read, raw):
    """Whether it was refused; anything but a finite motion or a `RetargetError` in one line fails."""
    start = time.perf_counter()
    try:
        motion = decode(read(raw))[1]
        assert motion is None or np.isfinite(world_pose(motion)[1]).all()
        refused = False
    except RetargetError as error:
        assert "\n" not in str(error)
        refused = True
    assert time.perf_counter() - start < 2
    return refused


def test_mutated_files_are_read_or_refused_but_never_crash(read):
    rng = random.Random(0)
    refused = sum(expect_read_or_refused(read, mutated(WALK.encode(), rng, WORDS)) for _ in range(1000))
    assert 300 < refused < 950  # both happen, or the mutations are too mild or too wild


def test_mutated_real_files_are_read_or_refused_but_never_crash(read, data):
    rng = random.Random(1)
    for path in ("pybvh/bvh_test1.bvh", "makehuman/tpose.bvh", "makehuman/walk1.bvh"):
        raw = (data / "motions" / path).read_bytes()
        for _ in range(40):
            expect_read_or_refused(read, mutated(raw, rng, WORDS))


def long_file(path, joints, frames):
    channels = 3 * joints + 3
    with open(path, "w") as file:
        file.write("HIERARCHY\nROOT j0\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition ")
        file.write("Zrotation Xrotation Yrotation\n")
        for joint in range(1, joints):
            file.write(f"JOINT j{joint}\n{{\nOFFSET 0 1 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n")
        file.write("}\n" * joints + f"MOTION\nFrames: {frames}\nFrame Time: 0.008333\n")
        block = np.random.default_rng(0).uniform(-180, 180, size=(100, channels))
        text = "".join(("%.5f " * channels + "\n") % tuple(row) for row in block.tolist())
        for _ in range(frames // 100):
            file.write(text)


@pytest.mark.slow
def test_a_hundred_thousand_frames_of_sixty_joints_are_read_in_six_seconds(tmp_path):
    long_file(tmp_path / "long.bvh", 60, 100_000)
    text = (tmp_path / "long.bvh").read_bytes()[-20_000_000:]
    start = time.process_time()
    parsed = len(np.fromstring(text, sep=" "))
    # Six seconds on a core that parses ten million numbers a second; a busier or slower one gets its share more.
    slower = max(1.0, (time.process_time() - start) / parsed * 1e7)

    start = time.process_time()
    asset = bvh.load(tmp_path / "long.bvh")
    loaded = time.process_time() - start
    motion = asset.motion()
    seconds = time.process_time() - start
    (tmp_path / "long.bvh").unlink()
    assert motion.rotations.shape == (100_000, 60, 4)
    assert loaded < slower and seconds < 6 * slower, f"layout {loaded:.2f} s, all {seconds:.2f} s, x {slower:.2f}"
