"""The report's page and the live viewer in a headless Chromium: they load, show a body, move it and say no error."""

import socket
import sys
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest
from chromium import PROGRAM, browser
from stage_bodies import bare_walk, belly, belly_report
from test_report_page import sheet

from retarget.errors import RetargetError
from retarget.view.report_page import save_report_page

pytest.importorskip("websockets")
needs_browser = pytest.mark.skipif(PROGRAM is None, reason="Chromium is not installed")
BACK = np.array([241, 242, 244])


def different(one, other, least=24):
    """How many pixels differ visibly."""
    return int((np.abs(one.astype(int) - other.astype(int)).max(axis=2) > least).sum())


# --- the report ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    if PROGRAM is None:
        pytest.skip("Chromium is not installed")
    path = tmp_path_factory.mktemp("report") / "report.html"
    save_report_page(path, sheet(), [belly("heavy"), belly()], belly_report())
    with browser(1000, 900) as opened:
        opened.open(f"{path.as_uri()}#t=0")
        opened.wait("window.stage && stage.state.drawn > 0")
        yield opened


def look(page, script=""):
    """The canvas alone, drawn anew."""
    page.run(f"{script}; stage.draw()")
    top = page.run("Math.ceil(document.getElementById('stage').getBoundingClientRect().top + scrollY)")
    high = page.run("document.getElementById('stage').clientHeight")
    time.sleep(0.2)
    return page.picture()[top : top + high]


@needs_browser
def test_the_report_shows_two_bodies_without_error_or_request(page):
    full = look(page, "stage.change({shown: [true, true]})")
    page.run("stage.state.shown[0] = stage.state.shown[1] = false")
    empty = look(page)
    page.run("stage.state.shown[0] = stage.state.shown[1] = true")
    assert different(full, empty) > 0.02 * full[:, :, 0].size, "bodies cover some of the picture"
    covered = np.abs(full.astype(int) - empty).max(axis=2) > 24
    assert min(half.sum() for half in np.array_split(covered, 2, axis=1)) > 3000, "one on each side"
    middle = covered.shape[1] // 2
    assert covered[: covered.shape[0] // 2, middle - 10 : middle + 10].sum() == 0, "and nobody between"
    assert page.troubles == [] and all(each.startswith("file:") for each in page.requests)


@needs_browser
def test_the_timeline_moves_the_body_and_the_playhead(page):
    early, late = look(page, "stage.seek(0)"), look(page, "stage.seek(stage.seconds)")
    assert different(early, late) > 800
    assert different(late, look(page, "stage.seek(stage.seconds)")) == 0
    page.run(
        "document.getElementById('scrub').value = 5000; document.getElementById('scrub').oninput({target: {value: 5000}}); stage.draw()"
    )
    assert abs(page.run("stage.state.time") - page.run("stage.seconds") / 2) < 0.01
    moved = page.run("document.querySelector('.playhead').getAttribute('transform')")
    assert float(moved[10:].split()[0]) > 300


@needs_browser
def test_contacts_are_blue_on_the_skin(page):
    def blue(picture):
        r, g, b = picture.astype(int).transpose(2, 0, 1)
        return int(((b > r + 60) & (b > g + 30)).sum())

    end = "stage.seek(stage.seconds)"
    on, off = look(page, f"stage.change({{spots: true}}); {end}"), look(page, f"stage.change({{spots: false}}); {end}")
    assert blue(on) > 150 and blue(off) == 0
    page.run("stage.change({spots: true})")


@needs_browser
@pytest.mark.parametrize("layer", ["bones", "sensors"])
def test_layers_show_and_hide(page, layer):
    off, on = look(page), look(page, f"stage.change({{{layer}: true}})")
    assert different(off, on) > 400 and different(off, look(page, f"stage.change({{{layer}: false}})")) == 0


@needs_browser
def test_colours_by_part_and_laying_over_change_the_picture(page):
    clay = look(page)
    page.run(
        "document.getElementById('color').value = 'parts'; document.getElementById('color').onchange({target: {value: 'parts'}})"
    )
    assert different(clay, look(page)) > 5000
    assert different(look(page), look(page, "stage.change({layout: 1})")) > 5000
    page.run("stage.change({layout: 0})")
    page.run("document.getElementById('color').onchange({target: {value: 'clay'}})")
    assert different(clay, look(page)) == 0


@needs_browser
def test_it_plays_by_itself_and_stops_on_space(page):
    key = "document.dispatchEvent(new KeyboardEvent('keydown', {key: ' '}))"
    page.run("stage.change({playing: true}); stage.seek(0)")
    page.wait("stage.state.time > 0.1")
    page.run(key)
    stopped = page.run("stage.state.time")
    time.sleep(0.5)
    assert page.run("stage.state.time") == stopped and page.run("stage.state.playing") is False
    assert page.troubles == []


@needs_browser
def test_a_finding_leads_to_its_moment(page):
    page.run("document.querySelector('.moment').click()")
    assert page.run("stage.state.time") == 0.5


@needs_browser
def test_a_report_without_source_and_skin_opens(tmp_path):
    from retarget.evaluate.report import evaluate

    shown = bare_walk()
    save_report_page(tmp_path / "bones.html", sheet(), [shown], evaluate(shown.take, shown.take))
    with browser(800, 700) as page:
        page.open((tmp_path / "bones.html").as_uri() + "#t=1")
        page.wait("window.stage && stage.state.drawn > 0")
        assert different(look(page), look(page, "stage.state.shown[0] = false")) > 800
        assert page.troubles == []


# --- the viewer ---------------------------------------------------------------------------------------------------


@contextmanager
def viewing(bodies, **options):
    from retarget.view.viewer import Viewer

    viewer, over = Viewer(bodies, **options), threading.Event()
    playing = threading.Thread(target=viewer.play, args=(over.is_set,))
    playing.start()
    try:
        yield viewer
    finally:
        over.set()
        playing.join(timeout=10)
        viewer.close()


@needs_browser
@pytest.mark.slow
def test_the_viewer_shows_and_moves_the_bodies():
    pytest.importorskip("viser")
    with viewing([belly("heavy"), belly()]) as viewer, browser(640, 480) as page:
        viewer.clock = viewer.clock.at(0.0)
        viewer._changed.set()
        page.open(viewer.address)
        page.wait("document.querySelector('canvas')")

        def settled():
            """The picture when it no longer changes."""
            end, before = time.monotonic() + 40, page.picture()
            while time.monotonic() < end:
                time.sleep(1.5)
                now = page.picture()
                if different(now, before) == 0 and now.std() > 5:
                    return now
                before = now
            raise AssertionError(f"the picture never came to rest; console: {page.troubles}")

        early = settled()
        viewer.clock = viewer.clock.at(viewer.clock.seconds)
        viewer._changed.set()
        time.sleep(1)
        late = settled()
        assert different(early[:, :300], late[:, :300]) > 200, "the arm moved"
        for box in viewer._who:
            box.value = False
        viewer._changed.set()
        time.sleep(1)
        assert different(late, settled()) > 5000, "without the bodies there is only the ground"
        assert page.troubles == []
        outside = [each for each in page.requests if not each.startswith((viewer.address, "data:", "blob:"))]
        assert outside == []


def test_the_viewer_listens_on_the_loopback_address_only():
    pytest.importorskip("viser")
    with viewing([belly()]) as viewer:
        port = viewer.server.get_port()
        socket.create_connection(("127.0.0.1", port), timeout=5).close()
        if sys.platform == "linux":  # where every address of 127.0.0.0/8 is this machine
            with pytest.raises(OSError):
                socket.create_connection(("127.0.0.2", port), timeout=5)


def test_a_taken_port_is_one_clear_line():
    pytest.importorskip("viser")
    from retarget.view.viewer import Viewer

    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(RetargetError, match=f"port {port} is taken"):
            Viewer([bare_walk()], port)


def test_frames_are_sent_at_the_clips_rate():
    """Of two bodies with skin; what a browser can draw of them is another matter."""
    pytest.importorskip("viser")
    with viewing([belly("heavy"), belly()]) as viewer:
        time.sleep(0.3)
        before, started = viewer.sent, time.perf_counter()
        time.sleep(1.5)
        rate = (viewer.sent - before) / (time.perf_counter() - started)
    assert rate > 20, "30, with room for a busy machine"


@pytest.mark.parametrize("by_vertices", [False, True])
def test_every_layer_can_be_shown(by_vertices):
    pytest.importorskip("viser")
    from retarget.view.viewer import OVERLAID, Viewer

    viewer = Viewer([belly("heavy"), bare_walk()], by_vertices=by_vertices)
    try:
        for box in viewer._boxes.values():
            box.value = True
        viewer._layout.value = OVERLAID
        viewer.clock = viewer.clock.at(viewer.clock.seconds)
        viewer._place()
        viewer.show()
        names = {name for name in viewer.server.scene._handle_from_node_name if name.startswith("/world/body0")}
        assert {"/world/body0/bones", "/world/body0/sensors", "/world/body0/touch", "/world/body0/part0"} <= names
        for box in viewer._boxes.values():
            box.value = False
        viewer._place()
        viewer.show()
        names = {name for name in viewer.server.scene._handle_from_node_name if name.startswith("/world/body0/")}
        assert names == {"/world/body0/skin", "/world/body0/label"}
    finally:
        viewer.close()


def test_a_skin_that_rigid_joints_cannot_move_is_sent_as_vertices():
    pytest.importorskip("viser")
    from dataclasses import replace

    from retarget.view.viewer import Viewer

    shown = belly()
    skin = shown.character.skin
    binds = skin.inverse_binds.copy()
    binds[3, :3, :3] *= 1.3
    odd = replace(shown, character=replace(shown.character, skin=replace(skin, inverse_binds=binds)))
    viewer = Viewer([odd, shown])
    try:
        assert [each._bones for each in viewer._shown] == [False, True]
        viewer.clock = viewer.clock.at(0.5)
        viewer.show()
        assert np.allclose(viewer._shown[0]._mesh.vertices, odd.vertices(slice(15, 16))[0], atol=1e-6)
    finally:
        viewer.close()
