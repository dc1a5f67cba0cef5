"""The report's page: what its scene holds poses the body as we do, it is closed to the outside, and equal bytes come out."""

import base64
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from stage_bodies import bare_walk, belly, belly_report

from retarget.errors import FileError
from retarget.evaluate.problems import Problem
from retarget.view.page_curves import curve_panels
from retarget.view.page_data import KINDS, scene_json
from retarget.view.report_page import Sheet, joint_table, report_page, save_report_page

TYPES = {short: np.dtype(name) for name, short in KINDS.items()}


def sheet(**more):
    given = dict(
        title="a from b", subtitle="it", columns=("result", "source"), rows=(("ground", "foot slide", ("1.00", ""), "cm"),),
        problems=(Problem("the hand is in the belly", 2.0, 0.5, ("inside",)),), corrected=("leftHand turned",),
        inferred=("unit: cm",), notes=("resampled",),
    )  # fmt: skip
    return Sheet(**(given | more))


def unpack(packed, *shape):
    return np.frombuffer(base64.b64decode(packed["data"]), TYPES[packed["kind"]]).reshape(*shape)


def posed(body, frame):
    """As the page's shader poses it."""
    skin, joints = body["skin"], len(unpack(body["parents"], -1))
    quaternion = unpack(body["rotations"], -1, joints, 4)[frame].astype(float)
    place = unpack(body["positions"], -1, joints, 3)[frame]
    x, y, z, w = quaternion.T
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]).transpose(2, 0, 1)  # fmt: skip
    of = unpack(body["joints"], -1)
    rows = np.einsum("cij,cjk->cik", turn[of], unpack(body["binds"], -1, 3, 4))
    rows[:, :, 3] += place[of]
    vertices = unpack(skin["vertices"], -1, 3)
    weights = unpack(skin["weights"], -1, 8) / 65535
    blended = np.einsum("vk,vkij->vij", weights, rows[unpack(skin["columns"], -1, 8)])
    return np.einsum("vij,vj->vi", blended, np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1))


@pytest.mark.parametrize("make", [belly, bare_walk])
def test_the_scene_poses_the_body_as_we_do(make):
    shown = make()
    (body,) = json.loads(scene_json([shown]))["bodies"]
    for frame in (0, shown.frames // 2, shown.frames - 1):
        off = posed(body, frame) - shown.vertices(slice(frame, frame + 1))[0]
        assert np.abs(off).max() < 1e-4, "a tenth of a millimetre: weights are kept in sixteen bits"


def test_the_scene_holds_spots_parts_and_both_layouts():
    scene = json.loads(scene_json([belly("heavy"), belly()]))
    shown, body = belly("heavy"), scene["bodies"][0]
    assert scene["frames"] == shown.frames and scene["fps"] == 30
    assert np.array_equal(unpack(body["starts"], -1), shown.spots.starts)
    assert np.array_equal(unpack(body["spot_vertex"], -1), shown.spots.vertex)
    assert np.array_equal(unpack(body["faces"], -1, 3), shown.character.mesh.faces)
    assert len(body["moves"]) == 4 and body["moves"][0] != body["moves"][1]
    heights = [each["height"] * each["size"] for each in scene["bodies"]]
    assert (
        body["size"] == 1
        and np.isclose(*heights, rtol=1e-3)
        and scene["bodies"][0]["height"] != scene["bodies"][1]["height"]
    )
    assert unpack(body["part_colors"], -1, 3).shape == shown.normals.shape


def test_equal_input_gives_equal_bytes_of_sensible_size(tmp_path):
    sizes = [
        save_report_page(tmp_path / f"{name}.html", sheet(), [belly("heavy"), belly()], belly_report()) for name in "ab"
    ]
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
    assert sizes[0] == (tmp_path / "a.html").stat().st_size < 4e6


def test_the_page_loads_nothing_from_anywhere():
    page = report_page(sheet(), [belly("heavy"), belly()], belly_report(), belly_report())
    assert "default-src 'none'" in page
    assert not re.search(r"https?://|\bsrc=|\bhref=|@import|url\(|import\s*\(|fetch\(|XMLHttp", page)
    for told in ("the hand is in the belly", "leftHand turned", "unit: cm", "resampled", "foot slide", "a from b"):
        assert told in page, told


def test_names_cannot_break_out_of_the_page():
    evil = "</script><script>alert(1)</script><b>{{scene}}"
    shown = replace(belly(), label=evil)
    page = report_page(sheet(title=evil, notes=(evil,)), [shown], belly_report())
    assert "<script>alert" not in page and page.count("</script>") == 2
    assert page.count('"bodies":') == 1, "what is put in is not looked at again"


def test_the_mapping_names_each_bodys_joint():
    rows = {name: (told, joints) for name, told, joints in joint_table([belly(), bare_walk()])}
    told, joints = rows["leftHand"]
    assert told[0][0] == "leftHand" and joints[0] == belly().take.actor.humanoid.joints["leftHand"]
    one = belly()
    humanoid = one.take.actor.humanoid
    less = replace(humanoid, joints={name: joint for name, joint in humanoid.joints.items() if name != "neck"})
    actor = replace(one.take.actor, humanoid=less)
    without = replace(one, take=replace(one.take, actor=actor))
    rows = {name: (told, joints) for name, told, joints in joint_table([without, one])}
    assert rows["neck"][0][0] is None and rows["neck"][1][0] == -1


def test_there_is_a_panel_for_each_kind_of_curve_and_a_line_for_what_was_before():
    titles = [title.split(",")[0] for title, _ in curve_panels(belly_report())]
    assert titles == [
        "Contacts (thin grey: the source's)",
        "Deepest penetration",
        "Foot over the floor",
        "Hand speed",
        "Foot speed",
    ]
    plain, more = (
        dict(curve_panels(belly_report(), before))["Deepest penetration, cm"] for before in (None, belly_report())
    )
    assert more.count("<polyline") == plain.count("<polyline") + 1 and plain.count('class="playhead"') == 1


def test_the_page_is_written_whole_or_not_at_all(tmp_path):
    with pytest.raises(FileError, match="cannot be written"):
        save_report_page(tmp_path / "none" / "a.html", sheet(), [belly()], belly_report())
    assert not list(tmp_path.iterdir())
