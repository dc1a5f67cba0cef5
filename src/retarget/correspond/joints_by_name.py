"""What the names of joints say: part and side, from the alias table alone."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.correspond.aliases import (
    ALIASES,
    AMBIGUOUS,
    ANIMAL,
    AUXILIARY,
    CENTRAL_PARTS,
    FINGERS,
    FOREIGN,
    METACARPALS,
    NOISE,
    SIDED_PARTS,
    SIDES,
    TWISTS,
)

Array = np.ndarray

PARTS = CENTRAL_PARTS + SIDED_PARTS + FINGERS


@dataclass(frozen=True)
class Spelling:
    """One name taken apart."""

    word: str
    """What is left without side, digits and noise: 'upperarm'."""
    side: int
    """+1 left, -1 right, 0 none."""
    number: int | None
    """The first number: 2 in 'Spine2'."""
    auxiliary: bool
    """It names an end, a control, a garment, a prop."""
    twist: bool
    foreign: bool
    """It names a limb that no human has."""
    animal: bool
    metacarpal: bool
    """It names a bone of the palm."""
    last_number: int | None
    """The last number: 3 in 'finger2-3'."""


@dataclass(frozen=True, eq=False)
class NameScores:
    """How well each joint's name fits each part of a body."""

    parts: dict[str, Float[Array, "joints"]]
    """Per part, 0 (does not) to 1 (names exactly this part)."""
    sides: Int[Array, "joints"]
    auxiliary: Bool[Array, "joints"]
    twists: Bool[Array, "joints"]
    foreign: Bool[Array, "joints"]
    animal: Bool[Array, "joints"]
    metacarpals: Bool[Array, "joints"]
    numbers: Int[Array, "joints"]
    """The last number in each name, -1 where there is none."""

    def best(self, joint: int, but: str = "") -> float:
        """The highest score of a joint for any part but one."""
        return max(float(score[joint]) for part, score in self.parts.items() if part != but)


@lru_cache(maxsize=1)
def _vocabulary() -> dict[str, dict[str, float]]:
    words: dict[str, dict[str, float]] = {}
    for part, aliases in ALIASES.items():
        for alias in aliases.split():
            words.setdefault(alias, {})[part] = 1.0
    words.update(AMBIGUOUS)
    return words


def _tokens(name: str) -> list[str]:
    """Lower-case words and numbers of a name: 'J_Bip_L_UpperArm' -> j bip l upper arm."""
    name = re.sub(r"FBXASC(\d{3})", lambda code: chr(int(code[1])), name)
    name = re.split(r"[:|]", unicodedata.normalize("NFKC", name))[-1]
    name = name.replace("ß", "ss").replace("ü", "ue").replace("ä", "ae").replace("ö", "oe")
    name = "".join(c for c in unicodedata.normalize("NFD", name) if not "\u0300" <= c <= "\u036f")
    name = unicodedata.normalize("NFC", name)
    name = re.sub(r"([左右])", r" \1 ", name)
    name = re.sub(r"(?<![A-Za-z])([LR])(?=[A-Z][A-Z]?[a-z])", r"\1 ", name)  # LFArm, LThigh
    name = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name)
    name = re.sub(r"(?<=[^\W\d_])(?=\d)|(?<=\d)(?=[^\W\d_])", " ", name)
    return [word.lower() for word in re.split(r"[\W_]+", name) if word]


def _split_side(token: str) -> tuple[str, int]:
    """A side glued to a known word: 'lthumb' -> thumb, left."""
    known = _vocabulary()
    for side in ("left", "right"):
        for rest in (token.removeprefix(side), token.removesuffix(side)):
            if rest != token and rest:
                return rest, SIDES[side]
    if token not in known and token not in AUXILIARY and token[:1] in ("l", "r") and token[1:] in known:
        return token[1:], SIDES[token[0]]
    if token not in known and token not in AUXILIARY and token[-1:] in ("l", "r") and token[:-1] in known:
        return token[:-1], SIDES[token[-1]]
    return token, 0


def spell(name: str, prefix: tuple[str, ...] = ()) -> Spelling:
    """Take a name apart. `prefix` holds leading words that most joints of the skeleton share."""
    tokens = _tokens(name)
    if prefix and tuple(tokens[: len(prefix)]) == prefix and len(tokens) > len(prefix):
        tokens = tokens[len(prefix) :]
    side, numbers, words = 0, [], []
    for token in tokens:
        if token.isdigit():
            numbers.append(int(token[:6]))
        elif token in SIDES and not side:
            side = SIDES[token]
        else:
            token, glued = _split_side(token)
            side = side or glued
            words.append(token)
    number, last = (numbers[0], numbers[-1]) if numbers else (None, None)
    flags = set(words) | {"".join(words)}
    core = [word for word in words if word not in TWISTS]
    kept = core if "".join(core) in _vocabulary() else [word for word in core if word not in NOISE]
    return Spelling(
        "".join(kept or core),
        side,
        number,
        bool(flags & AUXILIARY),
        bool(flags & TWISTS),
        bool(flags & FOREIGN),
        bool(flags & ANIMAL),
        bool(flags & METACARPALS),
        last,
    )


def shared_prefix(names: tuple[str, ...]) -> tuple[str, ...]:
    """Leading words that more than half of the names begin with, and which say no side and no part."""
    prefix: tuple[str, ...] = ()
    listed = [tuple(_tokens(name)) for name in names]
    for length in (1, 2, 3):
        longer = [tokens for tokens in listed if len(tokens) > length and tokens[: length - 1] == prefix]
        counts = Counter(tokens[:length] for tokens in longer)
        if not counts:
            break
        common, count = counts.most_common(1)[0]
        if count <= 0.5 * len(names) or common[-1] in SIDES or common[-1] in _vocabulary():
            break
        prefix = common
    return prefix


def part_scores(spelling: Spelling) -> dict[str, float]:
    """Parts that a spelling may mean, with scores up to 1."""
    known = _vocabulary()
    word = spelling.word
    scores = dict(known.get(word, {}))
    if not scores and word.startswith("hand") and word[4:] in known:  # Mixamo: LeftHandThumb1
        scores = dict(known[word[4:]])
    if not scores and word.startswith("inhand") and word[6:] in known:
        scores = dict(known[word[6:]])
    if not scores:  # the longest alias inside the word, so that 'thighdeform' is still a thigh
        inside = [alias for alias in known if len(alias) >= 4 and alias in word]
        if inside:
            longest = max(inside, key=len)
            scores = {part: 0.6 * score * len(longest) / len(word) for part, score in known[longest].items()}
    sided = spelling.side != 0
    for part in list(scores):
        if part in CENTRAL_PARTS and sided or part in SIDED_PARTS and not sided:
            scores[part] *= 0.35
        if part in SIDED_PARTS and spelling.number is not None and spelling.number > 1:
            scores[part] *= 0.7  # upperarm02 is the second half of upperarm01
        if spelling.auxiliary or spelling.twist:
            scores[part] *= 0.15
    return scores


def score_names(names: tuple[str, ...]) -> NameScores:
    """Score every joint name of a skeleton against every part."""
    prefix = shared_prefix(names)
    spellings = [spell(name, prefix) for name in names]
    spellings = _without_wrists(spellings)
    parts = {part: np.zeros(len(names)) for part in PARTS}
    for joint, spelling in enumerate(spellings):
        for part, score in part_scores(spelling).items():
            parts[part][joint] = score
    return NameScores(
        parts,
        np.array([each.side for each in spellings]),
        np.array([each.auxiliary for each in spellings]),
        np.array([each.twist for each in spellings]),
        np.array([each.foreign for each in spellings]),
        np.array([each.animal for each in spellings]),
        np.array([each.metacarpal for each in spellings]),
        np.array([-1 if each.last_number is None else each.last_number for each in spellings]),
    )


def _without_wrists(spellings: list[Spelling]) -> list[Spelling]:
    """Where a side has both a wrist and a hand, only one of them is the hand.

    Skeletons that name joints (elbow, wrist, knee) mean by 'hand' its middle; those that name bones (lowerarm, hand)
    put the wrist between as a helper.
    """
    names_joints = any(each.word in ("elbow", "knee", "ankle") for each in spellings)
    helper, real = ("hand", "wrist") if names_joints else ("wrist", "hand")
    sides = {each.side for each in spellings if each.word == real and not each.auxiliary}
    doubled = [each.word == helper and each.side in sides for each in spellings]
    return [replace(each, auxiliary=True) if twice else each for each, twice in zip(spellings, doubled)]
