"""Processes that crash, hang and err take nothing with them but their own task."""

import subprocess
import sys
import time

import pytest

from retarget.batch.crew import Crew
from retarget.errors import RetargetError


def outcomes(words, size=2, seconds=None, work="crew_tasks:perform"):
    tasks = iter([{"word": word, "number": number} for number, word in enumerate(words)])
    with Crew(size, work) as crew:
        found = list(crew.outcomes(lambda last: next(tasks, None), seconds))
    assert sorted(each.task["number"] for each in found) == list(range(len(words)))  # every task once
    return sorted(found, key=lambda each: each.task["number"])


def test_every_task_is_answered_once_by_one_of_the_processes():
    found = outcomes(["a", "b", "c", "print", "d"])
    assert [each.answer["word"] for each in found] == ["a", "b", "c", "print", "d"]
    assert 1 <= len({each.answer["process"] for each in found}) <= 2
    assert all(each.error is None for each in found)


def test_a_process_that_dies_is_named_and_replaced():
    found = outcomes(["a", "crash", "b", "killed", "c", "leave", "d"])
    assert found[1].error == "its process stopped (exit code 3: something broke)"
    assert found[3].error.startswith("its process stopped (signal 9, SIGKILL")
    assert found[5].error == "SystemExit: 4"  # an exception like any other: the process lives on
    assert [found[n].answer["word"] for n in (0, 2, 4, 6)] == ["a", "b", "c", "d"]


def test_a_task_that_takes_too_long_is_given_up():
    started = time.monotonic()
    found = outcomes(["a", "hang", "b", "c"], size=2, seconds=2.0)
    assert found[1].error == "took longer than 2 s and was given up"
    assert [found[n].answer["word"] for n in (0, 2, 3)] == ["a", "b", "c"]
    assert time.monotonic() - started < 30


def test_mistakes_and_faults_are_one_line_and_faults_have_a_trace():
    refused, bug = outcomes(["refuse", "bug"], size=1)
    assert (refused.error, refused.trace) == ("not this one", "")
    assert bug.error == "ZeroDivisionError: division by zero" and "crew_tasks.py" in bug.trace


def test_each_process_keeps_to_one_thread():
    (found,) = outcomes(["threads"], size=1)
    assert set(found.answer) == {"1"}


def test_the_last_task_tells_what_a_process_has_at_hand():
    seen, words = [], iter(["a", "b", "c"])

    def choose(last):
        seen.append(last and last["word"])
        word = next(words, None)
        return word and {"word": word}

    with Crew(1, "crew_tasks:perform") as crew:
        assert [each.answer["word"] for each in crew.outcomes(choose)] == ["a", "b", "c"]
    assert seen == [None, "a", "b", "c"]


def test_no_process_is_started_for_nothing():
    with Crew(4, "nowhere:nothing") as crew:
        assert list(crew.outcomes(lambda last: None)) == []


@pytest.mark.parametrize("work", ["nowhere:nothing", "crew_tasks:nothing"])
def test_processes_that_cannot_start_are_said_so(work):
    with pytest.raises(RetargetError, match="a worker process cannot start .*nothing|nowhere"):
        outcomes(["a"], work=work)


def test_processes_end_when_their_master_is_gone():
    """Also at work, and also when it was killed: the input of each ends."""
    code = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from retarget.batch.worker import serve; serve('crew_tasks:perform')"
    import json

    process = subprocess.Popen(
        [sys.executable, "-c", code, json.dumps(sys.path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert process.stdout.readline() == b'{"ready": true}\n'
    process.stdin.write(b'{"word": "hang"}\n')
    process.stdin.close()
    assert process.wait(timeout=20) == 0
    process.stdout.close()
