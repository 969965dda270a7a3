"""Texts from files, on a terminal."""

from __future__ import annotations

import re

# Control characters, which move the cursor, clear the screen or set colours, and marks that turn the direction of text.
UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    """Return a text with U+FFFD in place of what a terminal would obey; tabs and ends of lines stay."""
    return UNPRINTABLE.sub("\ufffd", text)
