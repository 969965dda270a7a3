"""Text of files, safe for a terminal."""

from __future__ import annotations

import re

# Control characters, which move the cursor, clear the screen or set colours, and marks of text direction.
UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    """Return a text with U+FFFD in place of control characters, so that names in files cannot control the terminal.

    Tabs and line ends stay.
    """
    return UNPRINTABLE.sub("\ufffd", text)
