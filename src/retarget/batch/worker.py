"""What runs in a process of a crew: reads tasks, calls one function, writes answers; a line of JSON each."""

from __future__ import annotations

import importlib
import json
import os
import queue
import signal
import sys
import threading
import traceback

ONE_THREAD = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS", "NUMBA_NUM_THREADS", "RETARGET_THREADS",
)  # fmt: skip
"""Processes share the cores; threads of theirs would only get into each other's way. Set before numpy is loaded."""


def serve(work: str) -> None:
    """Call `work` ("module:function") on every task from standard input until it ends; then so does this process.

    The input ends when the process at its other end closes it or dies: a task at work then is left as it stands. What
    the function prints goes to standard error, for standard output carries the answers.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever gives the tasks decides when to stop
    for name in ONE_THREAD:
        os.environ[name] = "1"
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    tasks: queue.Queue[bytes] = queue.Queue()
    threading.Thread(target=_read, args=(tasks,), daemon=True).start()
    module, _, function = work.partition(":")
    perform = getattr(importlib.import_module(module), function)
    _say(answers, {"ready": True})
    while True:
        _say(answers, _answer(perform, json.loads(tasks.get())))


def _read(tasks: queue.Queue) -> None:
    for line in sys.stdin.buffer:
        tasks.put(line)
    os._exit(0)


def _answer(perform, task) -> dict:
    from retarget.errors import RetargetError

    try:
        return {"answer": perform(task)}
    except RetargetError as error:
        return {"error": str(error)}
    except BaseException as error:  # a fault of ours; the next task may do better
        return {"error": f"{type(error).__name__}: {error}".strip().splitlines()[0], "trace": traceback.format_exc()}


def _say(answers, message: dict) -> None:
    try:
        answers.write(json.dumps(message).encode() + b"\n")
        answers.flush()
    except BrokenPipeError:
        os._exit(0)
