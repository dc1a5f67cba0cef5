"""Numbers written as text: many at once, fast, or one word at a time, strictly."""

from __future__ import annotations

import re
import warnings

import numpy as np
from jaxtyping import Float

Array = np.ndarray

LARGEST = 1e12
"""Lengths and angles beyond this are faults of the file: their squares and sums would leave the range of numbers."""

DECIMAL = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


def number(word: bytes) -> float | None:
    """The value of a decimal number; None for anything else, infinities and absurdly large ones among them."""
    if len(word) > 400 or not DECIMAL.fullmatch(word):
        return None
    value = float(word)
    return value if abs(value) < LARGEST else None


def numbers(text: bytes) -> Float[Array, "values"] | None:
    """All numbers of a text, or None where a word is not one. NaN and infinity count as numbers here."""
    if not text.strip():
        return np.empty(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # older numpy only warns of a word that is no number, and stops
        try:
            return np.fromstring(text, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


def workable(values: Float[Array, "*shape"]) -> bool:
    """Whether all are finite and of a size that can be calculated with."""
    return bool(np.abs(values).max(initial=0.0) < LARGEST)  # false for NaN too


def shown(text: bytes) -> str:
    """A piece of a file for a message: quoted, short, printable."""
    return repr(text[:40].decode("latin-1")) + ("..." if len(text) > 40 else "")
