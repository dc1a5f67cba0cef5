"""Damaged files: what happens to files on their way, and what an attacker would do, to any bytes and to what they mean.

The same name, number and content give the same damage, on every machine.
"""

from __future__ import annotations

import io
import json
import random
import re
import struct
import zipfile
from collections.abc import Callable
from typing import Any

Random = random.Random

NUMBERS = (
    "nan", "inf", "-inf", "1e400", "-1e308", "1e308", "1e39", "-1", "0", "1", "0.5", "-0.0", "255", "65536", "2147483647", "2147483648",
    "4294967295", "99999999999", "18446744073709551616", "1" + "0" * 400, "1_0", "0x10", "", "-", ".", "{", "}", "[", "]", '"', "None",
)  # fmt: skip
"""What takes the place of a word of text."""
VALUES: tuple[Any, ...] = (
    -1, 0, 1, 2, 3, 5120, 5126, 255, 65536, 10**9, 2**31, 2**32 - 1, 2**63, 10**30, 0.5, -0.0, 1e39, 1e308, float("nan"), float("inf"),
    None, True, False, "", "x", "\n", "\x1b[2J", "data:,", "../x", "VEC3", "SCALAR", "MAT4", [], [0], [[]], [None], {}, {"x": {}}, {"extras": 0},
)  # fmt: skip
"""What takes the place of a value of JSON."""
WHOLE = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF, 0x7F800000, 0x7FC00000, 0x7F7FFFFF)
"""What takes the place of four bytes: counts and places at their ends, floats that are none."""
EDGE = 256
"""Bytes at both ends of a file that are hit more often: headers, and the directory of a zip."""
GLTF_JSON, GLB_HEAD = 0x4E4F534A, 20


def damage(content: bytes, name: str, number: int, suffix: str = "") -> bytes:
    """The damage of a number to the content of a file: half of them to its bytes, half to what a file of the suffix means."""
    chance = Random(f"{name}:{number}")
    own = WAYS.get(suffix.lower())
    if own is None or chance.random() < 0.5:
        return damaged_bytes(content, chance)
    return own(content, chance)


def damaged_bytes(content: bytes, chance: Random) -> bytes:
    """One to three faults: bits and bytes changed, pieces lost, doubled, moved or overwritten, the end cut off."""
    changed = bytearray(content)
    for _ in range(chance.choice((1, 1, 2, 3))):
        if not changed:
            break
        place, length = _place(len(changed), chance), chance.choice((1, 2, 4, 8, 40, 400))
        kind = chance.randrange(9)
        if kind == 0:
            changed[place] = chance.randrange(256)
        elif kind == 1:
            changed[place] ^= 1 << chance.randrange(8)
        elif kind == 2:
            del changed[place : place + length]
        elif kind == 3:
            changed[place:place] = changed[place : place + length]
        elif kind == 4:
            changed[place : place + length] = chance.randbytes(length)
        elif kind == 5:
            changed[place & ~3 : (place & ~3) + 4] = struct.pack(chance.choice("<>") + "I", chance.choice(WHOLE))
        elif kind == 6:
            other = _place(len(changed), chance)
            changed[other : other + length] = changed[place : place + length]
        elif kind == 7:
            changed[place : place + length] = bytes(length)
        elif chance.random() < 0.3:
            del changed[place:]
    return bytes(changed)


def _place(size: int, chance: Random) -> int:
    kind = chance.randrange(6)
    return (chance.randrange(min(EDGE, size)) if kind < 2 else size - 1 - chance.randrange(min(EDGE, size)) if kind == 2 else chance.randrange(size))


def damaged_text(content: bytes, chance: Random) -> bytes:
    """One to three faults: numbers and words replaced, lost, or changed for another of the file, lines lost, doubled or moved."""
    for _ in range(chance.choice((1, 1, 2, 3))):
        if not content:
            break
        if chance.random() < 0.3:
            start, stop = _around(content, chance.randrange(len(content)), rb"\n")
            first, last = _around(content, chance.randrange(len(content)), rb"\n")
            new = chance.choice((b"", content[start:stop] * 2, content[first:last]))
        else:
            start, stop = _around(content, chance.randrange(len(content)), rb"\s,\[\]():")
            first, last = _around(content, chance.randrange(len(content)), rb"\s,\[\]():")
            new = content[first:last] if chance.random() < 0.3 else chance.choice(NUMBERS).encode()
        content = content[:start] + new + content[stop:]
    return content


def _around(content: bytes, place: int, ends: bytes) -> tuple[int, int]:
    """Where the run of bytes around a place begins and ends that holds none of the `ends`; with the line's own end."""
    before, after = content[max(0, place - 4000) : place], content[place : place + 4000]
    start = place - len(re.search(rb"[^" + ends + rb"]*\Z", before).group())
    stop = place + len(re.match(rb"[^" + ends + rb"]*", after).group())
    return start, stop + (ends == rb"\n" and stop < len(content))


def damaged_json(content: bytes, chance: Random) -> bytes:
    """One to three faults of a JSON document: values and entries replaced, lost, doubled, or changed for another's."""
    try:
        document = json.loads(content)
    except ValueError:
        return damaged_bytes(content, chance)
    for _ in range(chance.choice((1, 1, 2, 3))):
        places = _places(document)
        if not places:
            break
        within, key = chance.choice(places)
        kind = chance.randrange(7)
        if kind < 4 or (kind == 4 and isinstance(within, dict)):
            within[key] = _near(within[key], chance) if kind == 3 else chance.choice(VALUES)
        elif kind == 4:
            within.insert(key, json.loads(json.dumps(within[key])))
        elif kind == 5:
            del within[key]
        else:
            other, name = chance.choice(places)
            within[key] = json.loads(json.dumps(other[name]))  # a copy: a place within itself would have no end
    return json.dumps(document).encode()


def _places(document: Any) -> list[tuple[Any, Any]]:
    """Every place of a value in a document: the list or object that holds it, and where."""
    found, waiting = [], [document]
    while waiting:
        within = waiting.pop()
        if isinstance(within, (list, dict)):
            for key, value in within.items() if isinstance(within, dict) else enumerate(within):
                found.append((within, key))
                waiting.append(value)
    return found


def _near(value: Any, chance: Random) -> Any:
    """A number beside another: the reader's checks are off by one, if they are."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return value + chance.choice((-1, 1, 2, 4)) if chance.random() < 0.7 else value * chance.choice((-1, 2, 1000))
    return value[: len(value) // 2] if isinstance(value, (str, list)) else value


def damaged_glb(content: bytes, chance: Random) -> bytes:
    """Damage to the document of a GLB, whose chunks and lengths stay right."""
    if len(content) < GLB_HEAD or struct.unpack_from("<I", content, 16)[0] != GLTF_JSON:
        return damaged_bytes(content, chance)
    length = struct.unpack_from("<I", content, 12)[0]
    document = damaged_json(content[GLB_HEAD : GLB_HEAD + length], chance)
    document += b" " * (-len(document) % 4)
    rest = content[GLB_HEAD + length :]
    head = struct.pack("<4sIIII", b"glTF", 2, GLB_HEAD + len(document) + len(rest), len(document), GLTF_JSON)
    return head + document + rest


def damaged_zip(content: bytes, chance: Random) -> bytes:
    """Damage to a member of a zip, zipped again; sometimes a member is lost, or another stands in for it."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            members = {info.filename: file.read(info) for info in file.infolist()}
    except (zipfile.BadZipFile, EOFError, OSError, ValueError):
        return damaged_bytes(content, chance)
    if not members:
        return damaged_bytes(content, chance)
    name, other = chance.choice(list(members)), chance.choice(list(members))
    kind = chance.randrange(10)
    if kind == 0:
        del members[name]
    elif kind == 1:
        members[name] = members[other]
    else:
        way = damaged_text if kind < 4 else damaged_bytes
        head = members[name][:EDGE]
        members[name] = way(head, chance) + members[name][EDGE:] if kind < 6 else way(members[name], chance)
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", chance.choice((zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as file:
        for name, member in members.items():
            file.writestr(zipfile.ZipInfo(name), member)
    return whole.getvalue()


def _damaged_ascii(content: bytes, chance: Random) -> bytes:
    """Damage to the words of a file that is text in one of its two forms."""
    return damaged_bytes(content, chance) if b"\0" in content else damaged_text(content, chance)


def _damaged_head(content: bytes, chance: Random) -> bytes:
    """Damage to the words of a header that says what the rest means: its last line begins with DATA."""
    end = content.find(b"\n", content.find(b"\nDATA ") + 1) + 1
    if end and chance.random() < 0.7:
        return damaged_text(content[:end], chance) + content[end:]
    return _damaged_ascii(content, chance)


WAYS: dict[str, Callable[[bytes, Random], bytes]] = {
    ".bvh": damaged_text, ".obj": damaged_text, ".usda": damaged_text, ".ply": _damaged_ascii, ".fbx": _damaged_ascii,
    ".pcd": _damaged_head,
    ".gltf": damaged_json, ".glb": damaged_glb, ".vrm": damaged_glb, ".vrma": damaged_glb, ".npz": damaged_zip, ".usdz": damaged_zip,
}  # fmt: skip
"""What is done to files by their suffix, beside damage to their bytes."""
