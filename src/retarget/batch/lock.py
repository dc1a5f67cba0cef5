"""One run at a time in a folder."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from retarget.errors import FileError

NAME = ".batch.lock"
PATIENCE = 30.0
"""Seconds to wait for processes of a run that is dead: they end themselves, after what they cannot interrupt."""

COURTESY = 0.5
"""The same for a run that seems to be alive: one that was killed a moment ago may not be buried yet."""


@contextmanager
def held_alone(folder: Path) -> Iterator[int]:
    """Hold the folder's lock file, which names this process; yields its descriptor.

    The operating system lets go of the lock when every process that has the descriptor is gone, so that a killed run
    leaves none behind, while its last processes keep it. Raises `FileError` where another run is at work.
    """
    path, waited = folder / NAME, time.monotonic()
    while (descriptor := _taken(path)) is None:
        owner = _owner(path)
        alive = owner is not None and _alive(owner)
        if time.monotonic() - waited < (COURTESY if alive else PATIENCE):
            time.sleep(0.05)
        elif alive:
            raise FileError(
                folder, f"another batch (process {owner}) is at work there; wait for it, or name another folder"
            )
        else:
            raise FileError(
                folder, f"processes of a run that ended are still at work there (see {path}); try again later"
            )
    try:
        yield descriptor
    finally:
        with suppress(
            OSError
        ):  # while it is held, so that nobody can have taken it meanwhile; Windows refuses, no harm
            path.unlink()
        os.close(descriptor)


def _taken(path: Path) -> int | None:
    """The descriptor of the lock file, or None where another holds it."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise FileError(path, f"cannot be written: {error.strerror or error}") from None
    try:
        _lock(descriptor)
        # Its last holder may have removed it between our two steps; then the name is free or someone else's.
        if os.path.samestat(os.fstat(descriptor), os.stat(path)):
            os.ftruncate(descriptor, 0)
            os.write(descriptor, f"{os.getpid()}\n".encode())
            return descriptor
    except OSError:
        pass
    os.close(descriptor)
    return None


def _lock(descriptor: int) -> None:
    """Raises `OSError` where it is held."""
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        os.lseek(descriptor, 1 << 20, os.SEEK_SET)  # a byte behind the text, which others shall be able to read
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        os.lseek(descriptor, 0, os.SEEK_SET)
    else:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _owner(path: Path) -> int | None:
    try:
        return int(path.read_bytes())
    except (OSError, ValueError):
        return None


def _alive(process: int) -> bool:
    if os.name != "posix":
        return True  # whoever holds the lock is alive: there no other process keeps it
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
