"""The report's page in a headless Chromium: it loads, shows bodies, moves them and says no error."""

import sys
import time

import numpy as np
import pytest
from chromium import PROGRAM, browser, processor_seconds
from stage_bodies import bare_walk, belly, belly_report
from test_report_page import sheet

from retarget.view.report_page import save_report_page

pytest.importorskip("websockets")
needs_browser = pytest.mark.skipif(PROGRAM is None, reason="Chromium is not installed")


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
def test_bodies_of_one_size_are_as_high_on_the_screen(page):
    def heights(layout):
        """Of the warm result and the cool source, in rows of the picture."""
        red, _, blue = look(page, f"stage.change({{layout: {layout}, spots: false}})").astype(int).transpose(2, 0, 1)
        rows = [np.flatnonzero(mask.sum(axis=1) > 3) for mask in (red - blue > 12, blue - red > 12)]
        return [int(np.ptp(each)) for each in rows]

    page.run("stage.seek(0); stage.bodies[1].given.size = 1.5")
    try:
        own, same = heights(0), heights(2)
        assert 1.35 < (same[1] / same[0]) / (own[1] / own[0]) < 1.65, (own, same)
    finally:
        page.run("stage.bodies[1].given.size = 1; stage.change({layout: 0, spots: true})")


@needs_browser
def test_the_page_follows_the_readers_dark_and_light(page):
    def tones():
        picture = page.picture()
        return [int(picture[at].mean()) for at in ((5, 990), (200, 40))]  # the page's own corner and the stage's

    light = tones()
    page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    time.sleep(0.7)
    dark = tones()
    page.call("Emulation.setEmulatedMedia", features=[])
    time.sleep(0.7)
    assert min(light) > 200 and max(dark) < 60 and tones() == light


@needs_browser
@pytest.mark.parametrize("width", [320, 390, 768, 1600])
def test_the_page_is_as_wide_as_the_window(page, width):
    page.call("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False)
    try:
        assert page.run("document.documentElement.scrollWidth") <= width
        assert page.run("document.getElementById('stage').clientWidth") > 0.75 * min(width, 1240)
        assert page.troubles == []
    finally:
        page.call("Emulation.setDeviceMetricsOverride", width=1000, height=900, deviceScaleFactor=1, mobile=False)


@needs_browser
@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processor time by process")
def test_a_frame_of_the_report_costs_few_milliseconds(page):
    """Of two 7,000-vertex bodies: what the page does itself, in processor time, without the drawing: 4 ms where it was
    measured, and 40 would still be 25 frames a second."""
    page.run("stage.change({playing: true})")
    before, drawn, started = processor_seconds(page), page.run("stage.state.drawn"), time.perf_counter()
    time.sleep(4)
    after, frames = processor_seconds(page), page.run("stage.state.drawn") - drawn
    page.run("stage.change({playing: false})")
    cost = {kind: 1000 * (after[kind] - before[kind]) / frames for kind in before}
    print(f"{frames / (time.perf_counter() - started):.1f} frames a second; ms of processor a frame: {cost}")
    assert 0 < cost["renderer"] < 40


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
