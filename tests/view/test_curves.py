"""The picture of a report's curves: what it shows, and that it can be read."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from retarget.errors import FileError
from retarget.evaluate.report import Report
from retarget.view.curves import MOST_BARS, bar_rows, draw_curves, save_curves

FRAMES, FPS = 60, 30.0


def on(*spans):
    values = np.zeros(FRAMES, dtype=bool)
    for start, stop in spans:
        values[start:stop] = True
    return values


def report(**more):
    time = np.arange(FRAMES) / FPS
    curves = {"time_s": time}
    for who in ("result", "source"):
        for side in ("left", "right"):
            curves[f"foot_height_cm/{who}/{side} foot"] = 3 * np.sin(4 * time)
            for part in ("hand", "foot"):
                curves[f"speed_m_s/{who}/{side} {part}"] = np.abs(np.sin(3 * time))
            curves[f"ground/{who}/{side} foot"] = on((0, 30))
            curves[f"ground/{who}/{side} hand"] = on()
    curves |= more
    return Report(
        {"fps": FPS}, curves, {"deepest": "right hand in the abdomen, 3.2 cm at 0.67 s (frame 20)"}, (), (), 1.7, 1.7
    )


def with_skin(**more):
    depth = np.zeros(FRAMES)
    depth[20] = 3.2
    touch = {
        "touch/result/right hand – abdomen": on((10, 40)),
        "touch/source/right hand – abdomen": on((12, 30)),
        "touch/result/left forearm – chest": on((0, 60)),
        "depth_cm/result": depth,
        "depth_cm/source": depth / 8,
    }
    return report(**(touch | more))


def axes_of(figure):
    return {axis.get_ylabel().replace("\n", " "): axis for axis in figure.axes}


def test_rows_are_ground_then_the_sources_contacts_then_the_results_own():
    rows = list(bar_rows(with_skin()))
    labels = [label for label, *_ in rows]
    assert labels == ["left foot – floor", "right foot – floor", "right hand – abdomen", "left forearm – chest"]
    assert rows[2][2].sum() == 18 and rows[3][2].sum() == 0, (
        "a contact that the source lacks has an empty row of its own"
    )


def test_where_the_source_has_no_surface_no_row_says_that_it_does_not_touch():
    curves = {name: curve for name, curve in with_skin().curves.items() if not name.startswith("touch/source")}
    rows = {label: source for label, _, source in bar_rows(replace(with_skin(), curves=curves))}
    assert rows["right hand – abdomen"] is None and rows["left foot – floor"] is not None


def test_there_are_never_more_rows_than_can_be_read():
    many = {f"touch/result/part {n} – chest": on((0, n + 1)) for n in range(40)}
    labels = [label for label, *_ in bar_rows(with_skin(**many))]
    assert len(labels) == MOST_BARS and "part 39 – chest" in labels and "part 0 – chest" not in labels
    assert "right hand – abdomen" in labels, "the source's contacts come before longer ones of the result alone"


def test_every_axis_is_labelled_with_its_unit_and_bars_lie_where_contacts_are():
    figure = draw_curves(with_skin(), "knight from dance")
    axes = axes_of(figure)
    assert {"deepest penetration (cm)", "foot over the floor (cm)", "hand speed (m/s)", "foot speed (m/s)"} <= set(axes)
    assert figure.axes[-1].get_xlabel() == "time (s)" and figure.get_suptitle() == "knight from dance"
    bars = figure.axes[0]
    assert [text.get_text() for text in bars.get_yticklabels()] == [label for label, *_ in bar_rows(with_skin())]
    spans = [path.get_extents().intervalx for bar in bars.collections for path in bar.get_paths()]
    assert any(np.allclose(span, [10 / FPS, 40 / FPS]) for span in spans)
    assert any(np.allclose(span, [12 / FPS, 30 / FPS]) for span in spans), "the source's own"
    legend = figure.legends[0]
    assert {"left", "right"} <= {text.get_text() for text in legend.get_texts()}


def test_the_deepest_frame_is_pointed_at():
    axis = axes_of(draw_curves(with_skin()))["deepest penetration (cm)"]
    (note,) = axis.texts
    assert note.xy == (pytest.approx(20 / FPS), pytest.approx(3.2)) and "right hand in the abdomen" in note.get_text()


def test_without_skin_there_is_no_panel_of_depth():
    assert "deepest penetration (cm)" not in axes_of(draw_curves(report()))


def test_noise_on_standing_feet_does_not_fill_a_panel():
    still = {f"foot_height_cm/result/{side} foot": np.full(FRAMES, 1e-5) for side in ("left", "right")}
    still |= {name.replace("result", "source"): curve for name, curve in still.items()}
    low, high = axes_of(draw_curves(report(**still)))["foot over the floor (cm)"].get_ylim()
    assert high >= 4 and low <= -1


def test_the_picture_is_written_whole_or_not_at_all(tmp_path):
    save_curves(tmp_path / "curves.png", with_skin(), "title")
    width, height = Image.open(tmp_path / "curves.png").size
    assert width > 1000 and height > 600
    with pytest.raises(FileError, match=".png"):
        save_curves(tmp_path / "curves.jpg", with_skin())
    assert [path.name for path in tmp_path.iterdir()] == ["curves.png"]


def test_a_single_frame_can_be_drawn(tmp_path):
    curves = {name: curve[:1] for name, curve in with_skin().curves.items()}
    save_curves(tmp_path / "one.png", replace(with_skin(), curves=curves))
    assert (tmp_path / "one.png").exists()
