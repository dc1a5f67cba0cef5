"""`retarget report` and `retarget view` from the command line."""

import json
import os
import signal
import subprocess
import sys

import pytest
from made_motions import body

from retarget.io import save
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A source and a result with skin, and the source's skeleton alone."""
    folder = tmp_path_factory.mktemp("view")
    motion = cut(embedded_motion("hand_on_belly"), 1.5, 2.0)
    save(folder / "source.glb", body(), [motion])
    save(folder / "result.glb", body("heavy"), [motion])
    save(folder / "source.bvh", body(), [motion])
    return folder


def test_a_report_with_skin_on_both_sides_tells_what_was_before(command, files, tmp_path):  # noqa: F811
    code, out, _ = command("report", files / "result.glb", files / "source.glb", "-o", tmp_path / "r.html", "--json")
    told = json.loads(out)
    page = (tmp_path / "r.html").read_text()
    assert code == 0 and told["bytes"] == (tmp_path / "r.html").stat().st_size
    for words in ("copied only", "the source&#x27;s contacts kept", "metres per unit", "leftUpperArm"):
        assert words in page, words


def test_a_report_of_a_bare_source_and_one_without_source(command, files, tmp_path):  # noqa: F811
    code, out, _ = command("report", files / "result.glb", files / "source.bvh", "-o", tmp_path / "a.html")
    assert code == 0 and "the source has no surface" in out
    code, out, _ = command("report", files / "result.glb", "-o", tmp_path / "b.html", "--end", "0.3")
    page = (tmp_path / "b.html").read_text()
    assert code == 0 and "1 bodies" not in out and "1 body" in out and "10 frames" in page
    assert "limb direction" not in page and "limb vertices inside other parts" in page and "copied only" not in page


def test_a_report_is_html_in_a_folder_that_exists(command, files, tmp_path):  # noqa: F811
    code, _, err = command("report", files / "result.glb", "-o", tmp_path / "r.pdf")
    assert code == 2 and "reports are written as .html" in err
    code, _, err = command("report", files / "result.glb", "-o", tmp_path / "none" / "r.html")
    assert code == 2 and "does not exist" in err and not list(tmp_path.iterdir())


def test_a_report_is_on_one_source(files, tmp_path):
    from retarget.commands_view import Showing, write_report
    from retarget.errors import RetargetError

    with pytest.raises(RetargetError, match="one source; received 2"):
        write_report(Showing(files / "result.glb", (files / "source.glb",) * 2), tmp_path / "r.html")


def test_without_viser_the_viewer_says_what_to_install(command, files, monkeypatch):  # noqa: F811
    monkeypatch.setitem(sys.modules, "viser", None)
    code, out, err = command("view", files / "result.glb", "--no-browser")
    assert code == 2 and out == "" and err.strip().splitlines()[-1].endswith("pip install retarget[view]")


def test_the_viewer_prints_its_address_and_ends_on_interrupt(files, interruptible):
    pytest.importorskip("viser")
    words = ["view", files / "result.glb", files / "source.glb", files / "source.bvh", "--no-browser"]
    running = subprocess.Popen(
        [sys.executable, "-m", "retarget", *map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    try:
        address = next(line for line in running.stdout if line.startswith("http"))
        assert address.startswith("http://127.0.0.1:") and "Ctrl-C" in address
        running.send_signal(signal.SIGINT)
        out, err = running.communicate(timeout=300)
        assert running.returncode == 0 and err == "" and out == ""
    finally:
        running.kill()


def test_bodies_that_cannot_be_copied_get_a_report_without_what_was_before(command, files, tmp_path, monkeypatch):  # noqa: F811
    from retarget import commands_view
    from retarget.errors import MatchError

    def refuse(*_):
        raise MatchError("the bodies share no arms")

    monkeypatch.setattr(commands_view, "copied_take", refuse)
    code, out, _ = command("report", files / "result.glb", files / "source.glb", "-o", tmp_path / "r.html")
    assert code == 0 and "what was corrected is not known: the bodies share no arms" in out
    assert "copied only" not in (tmp_path / "r.html").read_text()
