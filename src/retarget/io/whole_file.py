"""Files that appear whole or not at all: every writer goes through here."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from retarget.errors import FileError


def check_folder(path: Path) -> None:
    """Raise `FileError` unless the folder of a file to write is there and may be written in: told before any work."""
    if not path.absolute().parent.is_dir():
        raise FileError(path, f"the folder {path.parent} does not exist")
    if not os.access(path.absolute().parent, os.W_OK):
        raise FileError(path, f"the folder {path.parent} may not be written in")


@contextmanager
def written_whole(path: str | Path) -> Iterator[BinaryIO]:
    """A file to write bytes into; it takes the place of `path` when the block ends, and is removed when it fails.

    It lies in the folder of `path`, so that the last step is a rename within one file system. Raises `FileError` where
    it cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as file:
            yield file
        os.replace(temporary, path)
    except OSError as error:
        raise FileError(path, f"cannot be written: {error.strerror or error}") from None
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def folder_written_whole(path: str | Path) -> Iterator[Path]:
    """A new folder to write frames into; it takes the name `path` when the block ends, and is removed when it fails.

    Raises `FileError` where there is such a folder or file already, and where it cannot be written.
    """
    path = Path(path)
    check_new_folder(path)
    try:
        made = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.absolute().parent))
    except OSError as error:
        raise FileError(path, f"cannot be written: {error.strerror or error}") from None
    try:
        yield made
        made.chmod(0o755)
        os.rename(made, path)
    except OSError as error:
        raise FileError(path, f"cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(made, ignore_errors=True)


def check_new_folder(path: Path) -> None:
    """Raise `FileError` unless a folder of that name can be made: told before any work."""
    if path.exists():
        raise FileError(path, "is there already; frames of two sequences in one folder would be mixed")
    check_folder(path)
