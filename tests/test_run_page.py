"""`retarget run --report`: the account on the terminal, the page beside the result, and both or neither on the disk."""

import json
import re
from dataclasses import replace

import pytest
from made_motions import body, fingerless, stand, walk

from retarget.cli_options import page_named
from retarget.errors import RetargetError
from retarget.io import load, save

QUICK = ("--method", "copy-rotations")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A walk, a file of two clips, a character."""
    folder = tmp_path_factory.mktemp("page")
    save(folder / "walk.bvh", fingerless(body()), [fingerless(walk())])
    save(folder / "two.glb", fingerless(body()), [replace(fingerless(each), name=name) for each, name in ((walk(), "one"), (stand(), "two"))])  # fmt: skip
    save(folder / "heavy.glb", fingerless(body("heavy")), [])
    return folder


def shown(page):
    """What the page says in words: the scene and the script left out."""
    return re.sub(r"(?s)<script.*?</script>", "", page.read_text())


def test_the_page_is_written_beside_the_result_and_equal_input_gives_equal_pages(made, tmp_path, monkeypatch, command):
    for name, output, words in (
        ("a", tmp_path / "a" / "o.glb", ("--report", tmp_path / "a" / "r.html")),
        ("b", "o.glb", ("--report=r.html",)),
    ):
        folder = tmp_path / name
        folder.mkdir()
        monkeypatch.chdir(folder)
        code, out, err = command("run", made / "walk.bvh", made / "heavy.glb", "-o", output, *QUICK, *words)
        assert (code, err) == (0, "") and sorted(path.name for path in folder.iterdir()) == ["o.glb", "r.html"]
        assert re.search(r"r.html: [0-9.]+ MB, 90 frames, 2 bodies, made in [0-9.]+ s$", out, re.M)
    page = shown(folder / "r.html")
    assert "method: copy-rotations, as asked" in page and "o.glb from walk.bvh" in page and "copied only" in page
    for name in ("o.glb", "r.html"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert str(tmp_path) not in (tmp_path / "a" / "r.html").read_text()


def test_it_is_the_page_of_report_and_says_besides_how_the_result_was_made(made, tmp_path, command):
    words = ("run", made / "walk.bvh", made / "heavy.glb", "-o", tmp_path / "o.glb", "--start", "1", "--end", "2")
    assert command(*words, "--report", tmp_path / "run.html")[0] == 0
    assert command("report", tmp_path / "o.glb", made / "walk.bvh", "-o", tmp_path / "report.html")[0] == 0
    run, report = (shown(tmp_path / name) for name in ("run.html", "report.html"))
    assert "method: interaction, since the character has a surface that can touch itself" in run
    assert "made from &#x27;walk.bvh&#x27; [&#x27;walk&#x27;], 1 to 2 s" in run and "1 to 2 s of the source" in report
    figures = [re.findall(r'<td class="number">([^<]*)</td>', page) for page in (run, report)]
    assert len(figures[0]) == len(figures[1]) > 20
    for a, b in zip(*figures):
        assert a == b or float(a) == pytest.approx(float(b), rel=0.02, abs=0.011), "one was read from single precision"


def test_bare_it_prints_the_account_and_writes_no_page(made, tmp_path, command):
    words = ("run", made / "walk.bvh", "--report", made / "heavy.glb", "-o", tmp_path / "o.glb")
    assert command(*words)[0] == 0
    assert [path.name for path in tmp_path.iterdir()] == ["o.glb"]


def test_json_tells_of_the_page(made, tmp_path, command):
    words = ("run", made / "walk.bvh", made / "heavy.glb", "-o", tmp_path / "res", *QUICK, "--json")
    code, out, _ = command(*words, "--report", tmp_path / "res" / "r.html")  # in the folder that is made for results
    page = json.loads(out)["page"]
    assert code == 0 and page["bytes"] == (tmp_path / "res" / "r.html").stat().st_size and page["seconds"] > 0


@pytest.mark.parametrize(
    "words, said",
    [
        (("walk.bvh", "heavy.glb", "-o", "o.glb", "--report=r.pdf"), "r.pdf: reports are written as .html"),
        (("walk.bvh", "heavy.glb", "-o", "o.glb", "--report="), "reports are written as .html"),
        (("walk.bvh", "heavy.glb", "-o", "o.glb", "--report", "no/r.html"), "the folder no does not exist"),
        (("walk.bvh", "heavy.glb", "-o", "o.glb", "--report", "dir.html"), "dir.html: is a folder"),
        (("walk.bvh", "two.glb", "heavy.glb", "-o", "o", "--report", "r.html"), "r.html: is a page on one result, but 2 motions"),
        (("two.glb", "heavy.glb", "-o", "o.glb", "--all-clips", "--report", "r.html"), "but 2 clips are to be retargeted"),
        (("walk.bvh", "two.glb", "heavy.glb", "-o", "o.bvh"), "o.bvh: a .bvh file holds one clip, and 2 are to be written"),
        (("two.glb", "heavy.glb", "-o", "o.bvh", "--all-clips"), "a .bvh file holds one clip, and 2 are to be written"),
        (("walk.bvh", "heavy.glb", "-o", "walk.bvh"), "walk.bvh: is read, as motion or character, and would be replaced"),
        (("walk.bvh", "heavy.glb", "-o", "heavy.glb"), "heavy.glb: is read, as motion or character, and would be replaced"),
        (("walk.bvh", "walk_heavy.glb", "heavy.glb", "-o", "."), "walk_heavy.glb: is read, as motion or character"),
        (("alone", "alone/heavy.glb", "-o", "o.glb"), "alone: holds no motion besides the character"),
        (("two.glb", "heavy.glb", "-o", "o.glb", "--clip", "one", "--all-clips"), "--clip one and --all-clips contradict"),
        (("walk.bvh", "heavy.glb", "-o", "o.glb", "--start", "9"), "walk.bvh: clip 'walk': nothing lies between 9 s and"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_one_line_before_any_work(made, tmp_path, monkeypatch, command, words, said):
    from retarget import commands_run

    monkeypatch.setattr(commands_run, "prepare", None)  # nothing comes that far
    for path in made.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "dir.html").mkdir()
    (tmp_path / "alone").mkdir()
    (tmp_path / "alone" / "heavy.glb").write_bytes((made / "heavy.glb").read_bytes())
    (tmp_path / "walk_heavy.glb").write_bytes((made / "two.glb").read_bytes())
    before = sorted(tmp_path.iterdir())
    monkeypatch.chdir(tmp_path)
    code, out, err = command("run", *words)
    assert (code, out) == (2, "") and said in err and len(err.splitlines()) == 1
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    "words",
    [
        ("run", "walk.bvh", "heavy.glb", "-o", "shut/o.glb"),
        ("run", "walk.bvh", "heavy.glb", "-o", "o.glb", "--report", "shut/r.html"),
        ("report", "two.glb", "-o", "shut/r.html"),
        ("convert", "two.glb", "shut/o.glb"),
        ("evaluate", "two.glb", "--source", "walk.bvh", "-o", "shut/c.png"),
    ],
)
def test_a_folder_that_may_not_be_written_in_is_told_before_any_work(made, monkeypatch, command, words):
    """Permissions do not bind an administrator, so the answer of the system is put in its mouth."""
    from retarget.io import whole_file

    (made / "shut").mkdir(exist_ok=True)
    monkeypatch.setattr(whole_file.os, "access", lambda path, mode: path.name != "shut")
    monkeypatch.chdir(made)
    code, out, err = command(*words)
    assert (code, out) == (2, "") and "the folder shut may not be written in" in err and len(err.splitlines()) == 1


@pytest.mark.parametrize("moment", ["load", "cast", "prepare", "save_results"])
def test_an_interrupt_says_so_and_leaves_nothing(made, tmp_path, monkeypatch, command, moment):
    from retarget import commands_run

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(commands_run, moment, interrupt)
    words = ("run", made / "walk.bvh", made / "heavy.glb", "-o", tmp_path / "o.glb", *QUICK)
    assert command(*words, "--report", tmp_path / "r.html") == (130, "", "retarget: interrupted\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("failing", ["save_results", "evaluate"])
def test_where_one_fails_neither_is_left(made, tmp_path, monkeypatch, command, failing):
    from retarget import commands_run, commands_view

    def refuse(*_, **__):
        raise RetargetError("not today")

    (tmp_path / "r.html").write_text("older")
    monkeypatch.setattr(commands_run if failing == "save_results" else commands_view, failing, refuse)
    words = ("run", made / "walk.bvh", made / "heavy.glb", "-o", tmp_path / "o.glb", *QUICK)
    code, _, err = command(*words, "--report", tmp_path / "r.html")
    assert (code, err) == (2, "retarget: not today\n")
    assert [path.name for path in tmp_path.iterdir()] == ["r.html"] and (tmp_path / "r.html").read_text() == "older"


@pytest.mark.parametrize(
    "words, read",
    [
        ("a --report r.html b", "a --report-page r.html b"),
        ("a --report R.HTM", "a --report-page R.HTM"),
        ("--report a.bvh r.html", "--report a.bvh r.html"),
        ("a --report", "a --report"),
        ("--report=x -- --report r.html", "--report-page=x -- --report r.html"),
        ("--reporter r.html", "--reporter r.html"),
    ],
)
def test_which_words_name_a_page(words, read):
    assert page_named(words.split()) == read.split()


# --- what a result remembers --------------------------------------------------------------------------------------


def test_evaluate_and_report_compare_with_the_part_that_was_taken(made, tmp_path, command):
    result, source = tmp_path / "o.glb", made / "walk.bvh"
    assert command("run", source, made / "heavy.glb", "-o", result, "--start", "1.5", *QUICK)[0] == 0
    assert load(result).clips[-1].made_from.start == pytest.approx(1.5)
    code, out, _ = command("info", result)
    assert code == 0 and "made from 'walk.bvh' ['walk'], 1.5 to 2.96667 s" in out

    def judged(*more):
        code, out, _ = command("evaluate", result, "--source", source, "--json", *more)
        told = json.loads(out)
        assert code == 0
        return told["figures"]["direction_error_deg"], [note for note in told["notes"] if "compared" in note]

    right, said = judged()
    assert right < 1 and said == [
        "compared with 1.5 to 2.96667 s of the source, which the result says it was made from (--start, --end to choose)"
    ]
    assert judged("--start", "1.5") == (right, []), "what was asked needs no note"
    wrong, _ = judged("--start", "0")
    assert wrong > 3 * right, "what is asked counts more than what the result says"
    other = tmp_path / "other.bvh"
    other.write_bytes(source.read_bytes())
    code, out, _ = command("evaluate", result, "--source", other)
    assert code == 0 and "was made from 'walk.bvh' ['walk'], 1.5 to 2.96667 s; it is compared from the start" in out


def test_a_result_of_all_of_a_clip_needs_no_word(made, tmp_path, command):
    assert command("run", made / "walk.bvh", made / "heavy.glb", "-o", tmp_path / "o.glb", *QUICK)[0] == 0
    code, out, _ = command("evaluate", tmp_path / "o.glb", "--source", made / "walk.bvh")
    assert code == 0 and "made from" not in out


def test_clips_belong_together_as_the_result_says(made, tmp_path, command):
    result = tmp_path / "o.glb"
    assert command("run", made / "two.glb", made / "heavy.glb", "-o", result, "--clip", "two", *QUICK)[0] == 0
    asset = load(result)
    save(tmp_path / "named.glb", asset.character, [replace(asset.motion(), name="one")], keep_clips=False)
    code, out, _ = command("evaluate", tmp_path / "named.glb", "--source", made / "two.glb", "--json")
    assert code == 0 and json.loads(out)["clips"] == {"result": "one", "source": "two"}, "names would say otherwise"
    code, out, _ = command("evaluate", tmp_path / "named.glb", "--source", made / "two.glb", "--source-clip", "one", "--json")
    assert json.loads(out)["clips"]["source"] == "one"


def test_a_repaired_clip_is_compared_with_the_one_it_was(made, tmp_path, command):
    save(tmp_path / "two.glb", fingerless(body()), [fingerless(stand()), fingerless(walk())])
    assert command("repair", tmp_path / "two.glb", "-o", tmp_path / "fixed.glb", "--clip", "walk")[0] == 0
    code, out, _ = command("evaluate", tmp_path / "fixed.glb", "--source", tmp_path / "two.glb", "--json")
    assert code == 0 and json.loads(out)["clips"] == {"result": "walk repaired", "source": "walk"}


def test_a_method_sees_nothing_of_where_a_source_came_from(made, tmp_path):
    """A result as the source of another one: the second remembers the first, not what that was made from."""
    from retarget import cast, prepare, retarget

    retarget(made / "walk.bvh", made / "heavy.glb", method="copy-rotations").save(tmp_path / "first.glb")
    assert load(tmp_path / "first.glb").clips[0].made_from.file == "walk.bvh"
    result = retarget(tmp_path / "first.glb", made / "heavy.glb", method="copy-rotations")
    assert result.motion.made_from.file == "first.glb"
    first = load(tmp_path / "first.glb")
    production = prepare(cast(first, motion=first.motion()), cast(made / "heavy.glb"), "copy-rotations")
    assert production(first.motion()).motion.made_from is None
