"""Who waits is told what happens; who does not watch hears nothing."""

from retarget.progress import progress_line


def test_it_says_what_is_done_and_leaves_nothing_behind(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    with progress_line(True, 3) as tell:
        tell("reading walk[1].bvh")
        tell("retargeting", 1)
    heard = capsys.readouterr()
    assert heard.out == ""
    assert "retargeting" in heard.err and "1/3" in heard.err
    assert heard.err.rstrip().endswith("\x1b[2K")  # the line is erased at the end


def test_it_is_silent_when_nobody_watches(capsys):
    with progress_line(False) as tell:
        tell("reading", 1)
    assert capsys.readouterr() == ("", "")
