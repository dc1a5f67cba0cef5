"""Faults as files get them, for the tests of readers."""

import re

TOKENS = [b"nan", b"inf", b"-1", b"0", b"1e308", b"99999999999", b"4294967295", b"", b"\xff", b"\x00", b"-"]


def mutated(raw, rng, words=()):
    """`raw` with one to three faults: bytes flipped, lost or added, a cut, words and lines lost, doubled or swapped.

    `rng` is a `random.Random`; `words` are the format's own, to be set where they do not belong.
    """
    for _ in range(rng.randrange(1, 4)):
        raw = _fault(raw, rng, TOKENS + list(words)) or raw
    return raw


def _fault(raw, rng, words):
    kind, at = rng.randrange(8), rng.randrange(len(raw))
    if kind == 0:
        return raw[:at] + bytes([rng.randrange(256)]) + raw[at + 1 :]
    if kind == 1:
        return raw[:at] + raw[at + rng.randrange(1, 30) :]
    if kind == 2:
        return raw[:at] + rng.randbytes(rng.randrange(1, 8)) + raw[at:]
    if kind == 3:
        return raw[:at]
    if kind == 4:
        return raw[:at] + bytes([raw[at] ^ 1 << rng.randrange(8)]) + raw[at + 1 :]
    if kind == 5:
        lines = raw.split(b"\n")
        i = rng.randrange(len(lines))
        lines[i : i + 1] = rng.choice([[], [lines[i]] * 2, [lines[i], rng.choice(lines)]])
        return b"\n".join(lines)
    pieces = re.split(rb"(\s+)", raw)
    i, j = (2 * rng.randrange((len(pieces) + 1) // 2) for _ in range(2))
    if kind == 6:
        pieces[i] = rng.choice(words)
    else:
        pieces[i], pieces[j] = pieces[j], pieces[i]
    return b"".join(pieces)
