"""Work in a process of its own: what it tells comes back, whatever else it does is one line, and limits hold."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from retarget.io import child
from retarget.io.child import ChildFailed, ChildTimeout, Refused, run_child, run_program

HERE = {"PATH": os.environ.get("PATH", "")}


def test_what_the_work_tells_comes_back_with_its_arguments_as_text(own_child):
    own_child("own", "def work(*given): return {'given': given, 'deep': [1, 2.5, None, 'ü']}")
    assert run_child("own", ["a b", Path("c"), "--d"], 20.0) == {"given": ["a b", "c", "--d"], "deep": [1, 2.5, None, "ü"]}


@pytest.mark.parametrize(
    ("script", "kind", "said"),
    [
        ("from retarget.io.child import Refused\ndef work(): raise Refused('has no\\nface')", Refused, "has no face"),
        ("def work(): raise ValueError('bad value')", ChildFailed, "bad value"),
        ("def work(): raise KeyError('a')", ChildFailed, "KeyError: 'a'"),
        ("def work(): return object()", ChildFailed, "TypeError: Object of type object is not JSON serializable"),
        ("import nothing_of_that_name", ChildFailed, "ModuleNotFoundError: No module named 'nothing_of_that_name'"),
        ("def nothing(): pass", ChildFailed, "AttributeError: module 'retarget.io.own' has no attribute 'work'"),
        ("def work(): return 'x' * 2000", ChildFailed, "it told more than 1000 bytes"),
        ("import os, sys\nsys.stderr.write('first\\nlast words\\n')\nos._exit(7)", ChildFailed, "last words (exit code 7)"),
        ("import os, sys\nsys.stderr.write('why\\n####\\n# a banner #\\n####\\n')\nos._exit(7)", ChildFailed, "why (exit code 7)"),
        ("import os\nos._exit(9)", ChildFailed, "the process stopped without a word (exit code 9)"),
        ("import os\nos._exit(0)", ChildFailed, "the process stopped in the middle of its answer"),
        ("import os, sys\nopen(sys.argv[2], 'w').write('{')\nos._exit(0)", ChildFailed, "the process stopped in the middle of its answer"),
    ],
)  # fmt: skip
def test_refusal_and_failure_are_told_apart(own_child, monkeypatch, script, kind, said):
    own_child("own", script)
    monkeypatch.setattr(child, "LARGEST_REPLY", 1000)
    with pytest.raises(kind) as caught:
        run_child("own", [], 20.0)
    assert type(caught.value) is kind and str(caught.value) == said


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_a_crash_names_its_signal(own_child):
    own_child("own", "import os, signal\ndef work(): os.kill(os.getpid(), signal.SIGSEGV)")
    with pytest.raises(ChildFailed, match=r"without a word \(SIGSEGV\)"):
        run_child("own", [], 20.0)


@pytest.mark.parametrize("script", ["import time\ndef work(): time.sleep(60)", "import os\ndef work():\n    os.close(2)\n    while True: pass"])
def test_who_takes_too_long_is_stopped(own_child, script):
    own_child("own", script)
    started = time.monotonic()
    with pytest.raises(ChildTimeout, match="takes longer than 0.5 s"):
        run_child("own", [], 0.5)
    assert time.monotonic() - started < 5.0


def test_endless_complaints_fill_no_memory(own_child):
    own_child("own", "import os, sys\nfor _ in range(300): sys.stderr.write('x' * 100_000 + '\\n')\nsys.stderr.write('the end')\nsys.stderr.flush()\nos._exit(1)")
    with pytest.raises(ChildFailed, match="^the end "):
        run_child("own", [], 20.0)


def test_it_starts_isolated_in_an_empty_folder_without_what_could_steer_it(own_child, monkeypatch, tmp_path):
    monkeypatch.setenv("PXR_AR_DEFAULT_SEARCH_PATH", "/somewhere")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("KEPT", "yes")
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    own_child("own", """
import os, sys
def work():
    return {"files": os.listdir("."), "path": sys.path, "steered": "PXR_AR_DEFAULT_SEARCH_PATH" in os.environ,
            "kept": os.environ["KEPT"], "threads": os.environ["OMP_NUM_THREADS"], "isolated": sys.flags.isolated,
            "read": sys.stdin.read(), "here": os.getcwd()}
""")
    told = run_child("own", [], 20.0)
    assert told["files"] == [] and not told["steered"] and told["isolated"] == 1 and told["read"] == ""
    assert str(tmp_path) not in told["path"] and told["kept"] == "yes" and told["threads"] == "1"
    assert not os.path.exists(told["here"])


@pytest.mark.skipif(os.name != "posix", reason="no such limits here")
def test_limits_of_memory_file_and_core_hold(own_child, tmp_path):
    own_child("own", "def work(): return len(bytearray(8 << 30))")
    with pytest.raises(ChildFailed, match="MemoryError"):
        run_child("own", [], 20.0)
    own_child("own", "import resource as r\ndef work(): return [r.getrlimit(each)[0] for each in (r.RLIMIT_AS, r.RLIMIT_FSIZE, r.RLIMIT_CORE)]")
    assert run_child("own", [], 20.0) == [child.MEMORY, child.LARGEST_FILE, 0]


def test_what_libraries_do_at_exit_does_not_matter(own_child):
    own_child("own", "import atexit, os\natexit.register(lambda: os.abort())\ndef work(): return 1")
    assert run_child("own", [], 20.0) == 1


def test_children_load_their_module_and_not_the_packages_around_it():
    """The nouns and their types take as long to load as numpy; no reader's child needs them."""
    for module in ("fbx_child", "draco_child", "usd_child", "usd_write_child"):
        start = child.START.replace(".answer(*sys.argv[2:])", "")
        code = f"{start}\nimport json\nimportlib.import_module('retarget.io.{module}')\nprint(json.dumps([*sys.modules]))"
        command = [sys.executable, "-I", "-c", code, str(child.PACKAGES)]
        loaded = set(json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout))
        assert f"retarget.io.{module}" in loaded
        assert not loaded & {"retarget.character", "jaxtyping", "scipy", "subprocess", "tempfile"}, module


def test_programs_of_others(tmp_path):
    run_program([sys.executable, "-c", "print('quiet')"], 20.0, HERE)
    with pytest.raises(ChildFailed, match="cannot be started: No such file"):
        run_program([tmp_path / "nothing"], 20.0, HERE)
    with pytest.raises(ChildFailed, match=r"SystemExit|no luck \(exit code 1\)"):
        run_program([sys.executable, "-c", "raise SystemExit('no luck')"], 20.0, HERE)
    with pytest.raises(ChildTimeout, match="takes longer than 0.3 s"):
        run_program([sys.executable, "-c", "import time; time.sleep(60)"], 0.3, HERE)


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_a_stopped_caller_leaves_no_process_behind(own_child, tmp_path, monkeypatch):
    own_child("own", f"import os, time\ndef work():\n    open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid()))\n    time.sleep(60)")

    def interrupted(process, seconds):
        while not (tmp_path / "pid").exists() or not (tmp_path / "pid").read_text():
            time.sleep(0.01)
        raise KeyboardInterrupt

    monkeypatch.setattr(child, "_last_words", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_child("own", [], 20.0)
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)
