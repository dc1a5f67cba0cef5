"""The joint map as a file: TOML that a person can check, edit and use again."""

from __future__ import annotations

import sys
from pathlib import Path

from retarget.character import Skeleton
from retarget.correspond.joints import HUMANOID_JOINTS, Humanoid
from retarget.errors import FileError, unknown_name
from retarget.io.whole_file import written_whole

TABLES = ("source", "target")


def read_map(path: str | Path) -> dict[str, dict[str, str]]:
    """The tables [source] and [target] of a map file, canonical name to joint name; a missing table is empty.

    Empty names mean that the skeleton has no such joint and are left out. Raises `FileError`.
    """
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    path = Path(path)
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise FileError(path, "is not UTF-8 text", f"byte {error.start}") from None
    except tomllib.TOMLDecodeError as error:
        raise FileError(path, f"is not valid TOML: {error}") from None
    for table in content:
        if table not in TABLES:
            raise FileError(path, str(unknown_name("table", table, TABLES, "a map file")))
    found: dict[str, dict[str, str]] = {}
    for table in TABLES:
        rows = content.get(table, {})
        if not isinstance(rows, dict):
            raise FileError(path, f"{table} must be a table, written [{table}]; received {rows!r}")
        for canonical, name in rows.items():
            if canonical not in HUMANOID_JOINTS:
                problem = unknown_name("humanoid joint", canonical, HUMANOID_JOINTS, "VRM 1.0")
                raise FileError(path, str(problem), f"[{table}]")
            if not isinstance(name, str):
                raise FileError(path, f"{canonical} must be a joint name in quotes; received {name!r}", f"[{table}]")
        found[table] = {canonical: name for canonical, name in rows.items() if name}
    return found


def write_map(
    path: str | Path, source: Humanoid, source_skeleton: Skeleton, target: Humanoid, target_skeleton: Skeleton
) -> None:
    """Write both matches, each joint with its confidence; joints that one side lacks are commented out."""
    path = Path(path)
    lines = [
        "# Joint map: humanoid joint (VRM 1.0) = name of the joint in the file.",
        "# Edit what is wrong, delete or comment out what should not be matched, add what is missing.",
    ]
    for table, humanoid, skeleton in (("source", source, source_skeleton), ("target", target, target_skeleton)):
        lines += ["", f"[{table}]  # matched by {humanoid.evidence}"]
        width = max(len(name) for name in HUMANOID_JOINTS)
        for canonical in HUMANOID_JOINTS:
            if canonical in humanoid.joints:
                name = quoted(skeleton.names[humanoid.joints[canonical]])
                lines.append(f"{canonical:<{width}} = {name}  # {humanoid.confidence[canonical]:.2f}")
            elif canonical in source.joints or canonical in target.joints:
                lines.append(f'# {canonical} = ""')
    with written_whole(path) as file:
        file.write(("\n".join(lines) + "\n").encode())


def quoted(text: str) -> str:
    """A TOML basic string."""
    short = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "\r": "\\r"}
    return '"' + "".join(short.get(c, c if c >= " " and c != "\x7f" else f"\\u{ord(c):04X}") for c in text) + '"'
