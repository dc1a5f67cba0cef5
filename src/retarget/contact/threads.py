"""Work dealt out to a few threads that are kept: compiled loops let go of the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

THREADS = 2
"""Threads that share a query; more gain little on a body."""

_pool: ThreadPoolExecutor | None = None


def _forget_threads() -> None:
    """A forked process has none of the threads of the one it came from."""
    global _pool
    _pool = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_threads)


def shared_out(work: Callable[[Any], Any], shares: Sequence[Any]) -> list[Any]:
    """The work on every share, by threads where the process has more than one core: on one, handing over costs more than
    a share itself."""
    global _pool
    usable = cores()
    if usable == 1:
        return [work(share) for share in shares]
    if _pool is None:
        _pool = ThreadPoolExecutor(max_workers=min(THREADS, usable))
    return list(_pool.map(work, shares))


def cores() -> int:
    """Cores that this process may use, and at most as many as `RETARGET_THREADS` says."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    allowed = os.environ.get("RETARGET_THREADS", "")
    return min(usable, max(1, int(allowed))) if allowed.isdecimal() else usable
