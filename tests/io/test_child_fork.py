"""Forks do a child's work: the same answers, the same ends, many files to a fork."""

import os
import sys
import types

import pytest

from retarget.io import child, child_fork
from retarget.io.child import ChildFailed, ChildTimeout, Refused, run_child
from retarget.io.child_fork import forking, in_this_process

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")


@pytest.fixture
def own(monkeypatch):
    """Puts a function in the place of a child's work."""

    def put(work):
        module = types.ModuleType("retarget.io.own")
        module.work = work
        monkeypatch.setitem(sys.modules, "retarget.io.own", module)

    return put


def test_a_fork_serves_until_it_is_renewed(own, monkeypatch):
    monkeypatch.setattr(child_fork, "RENEWED", 3)
    own(lambda *given: [os.getpid(), *given])
    with forking():
        told = [run_child("own", ["a b\n", str(number)], 20.0) for number in range(7)]
    assert [words[1:] for words in told] == [["a b\n", str(number)] for number in range(7)]
    numbers = [words[0] for words in told]
    assert len(set(numbers)) == 3 and numbers[0] == numbers[2] != numbers[3] and os.getpid() not in numbers
    assert child.start is child._new_python
    for number in set(numbers):
        with pytest.raises(ProcessLookupError):
            os.kill(number, 0)


def refuse():
    raise Refused("has no\nface")


def down():
    os.abort()


def late():
    import time

    time.sleep(60)


@pytest.mark.parametrize(
    ("work", "kind", "said"),
    [
        (refuse, Refused, "has no face"),
        (lambda: 1 / 0, ChildFailed, "ZeroDivisionError: division by zero"),
        (down, ChildFailed, "the process stopped without a word (SIGABRT)"),
        (lambda: os._exit(7), ChildFailed, "the process stopped without a word (exit code 7)"),
        (late, ChildTimeout, "takes longer than 0.5 s; it is damaged, or larger than any we know"),
    ],
)
def test_every_end_is_told_and_the_next_is_served(own, work, kind, said):
    with forking():
        own(work)
        with pytest.raises(kind) as caught:
            run_child("own", [], 0.5)
        assert type(caught.value) is kind and str(caught.value) == said
    with forking():
        own(lambda: "fine")
        assert run_child("own", [], 20.0) == "fine"


def test_the_next_file_gets_a_new_fork_where_one_went_down(own):
    own(lambda word: os.abort() if word == "down" else word)
    with forking():
        for _ in range(3):
            with pytest.raises(ChildFailed):
                run_child("own", ["down"], 20.0)
            assert run_child("own", ["up"], 20.0) == "up"


def test_limits_hold_in_forks_and_the_work_is_done_here_where_asked(own):
    def limits():
        import resource

        return [os.getpid(), resource.getrlimit(resource.RLIMIT_CORE)[1]]

    own(limits)
    with forking():
        number, core = run_child("own", [], 20.0)
    assert number != os.getpid() and core == 0
    own(lambda: os.getpid())
    with in_this_process():
        assert run_child("own", [], 20.0) == os.getpid()
    assert child.start is child._new_python


@pytest.mark.parametrize("way", ["a new Python", "a fork"])
def test_work_may_ask_for_less_memory(own_child, way, monkeypatch, tmp_path):
    text = (
        "def memory(most): return int(most)\n"
        "def work(most):\n"
        "    import resource\n"
        "    return list(resource.getrlimit(resource.RLIMIT_AS))\n"
    )
    most = 3 << 30
    if way == "a new Python":
        own_child("own", text)
        assert run_child("own", [str(most)], 20.0) == [most, child.MEMORY]
        return
    module = types.ModuleType("retarget.io.own")
    exec(text, module.__dict__)
    monkeypatch.setitem(sys.modules, "retarget.io.own", module)
    with forking():
        assert [run_child("own", [str(each)], 20.0)[0] for each in (most, most + 4096, 1 << 40)] == [most, most + 4096, child.MEMORY]
