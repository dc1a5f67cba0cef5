"""Ogawa containers for the tests: a root group with its six parts, of which metadata and time samplings are filled."""

import struct

METADATA = b"FramesPerTimeUnit=25.000000;_ai_Application=Maker;_ai_DateWritten=Fri Nov 26 19:43:50 2027;_ai_Description=x"
ACYCLIC = 1.7976931348623157e308 / 32


def sampling(count, cycle, *times):
    return struct.pack("<IdI", count, cycle, len(times)) + struct.pack(f"<{len(times)}d", *times)


def container(*samplings, metadata=METADATA, parts=6, finished=0xFF):
    """The bytes of a file without meshes."""
    times = b"".join((sampling(1, 1.0, 0.0), *samplings))
    content, places = bytearray(16), []
    for part in (b"\0" * 4, b"3*\0\0", None, metadata, times, b"")[:parts]:
        places.append((len(content) if part is None else len(content) | 1 << 63) if part != b"" else 1 << 63)
        content += struct.pack("<Q", len(part or b"")) + (part or b"")
    root = len(content)
    content += struct.pack(f"<Q{len(places)}Q", len(places), *places)
    content[:16] = b"Ogawa" + bytes([finished]) + b"\0\1" + struct.pack("<Q", root)
    return bytes(content)
