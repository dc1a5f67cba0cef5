"""What worker processes are told to do in the tests: answer, fail, crash and hang."""

import os
import signal
import sys
import time

from retarget.errors import RetargetError


def perform(task):
    word = task["word"]
    if word == "crash":
        print("something broke", file=sys.stderr, flush=True)
        os._exit(3)
    if word == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if word == "hang":
        time.sleep(600)
    if word == "refuse":
        raise RetargetError("not this one")
    if word == "bug":
        return 1 / 0
    if word == "leave":
        sys.exit(4)
    if word == "print":
        print("noise on standard output", flush=True)
        os.write(1, b"more noise\n")
    if word == "threads":
        from retarget.batch.worker import ONE_THREAD

        return [os.environ.get(name) for name in ONE_THREAD]
    return {"word": word, "process": os.getpid()}


def flaky(task):
    """The real work, except that some motions bring the process down."""
    from retarget.batch.work import perform as work

    if task["do"] == "clip" and "crash" in task["motion"]:
        os._exit(3)
    if task["do"] == "clip" and "hang" in task["motion"]:
        time.sleep(600)
    return work(task)


def known_bodies(task):
    """The real work, except that it is known at once whom a sequence or capture shows."""
    from made_folders import follows_at_once, known_rig

    from retarget import performing
    from retarget.batch.work import perform as work

    performing.rig, performing.cast_scan = known_rig, follows_at_once
    return work(task)
