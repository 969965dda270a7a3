"""NaN and infinity as Microsoft's C library writes them: 1.#QNAN, -1.#IND, 1.#INF; later -nan(ind), nan(snan)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

_WORD = r"([+-]?)(?:1\.#(?:(INF)|QNAN|SNAN|IND)0*|nan\(\w*\))"
_WHOLE = re.compile(_WORD, re.IGNORECASE | re.ASCII)
_WITHIN = re.compile(rf"(?<!\S){_WORD}(?!\S)", re.IGNORECASE | re.ASCII)


def odd_number(text: str) -> float | None:
    """Return the value of a word by which Microsoft's C library writes NaN or infinity; None for other words.

    Such words are 1.#QNAN, -1.#IND, 1.#INF and nan(ind).
    """
    found = _WHOLE.fullmatch(text)
    return None if found is None else float(_plain(found))


def plain_lines(lines: Iterable[str]) -> Iterator[str]:
    """Yield lines with `nan` and `inf`, which NumPy reads, in place of words like 1.#QNAN, -1.#INF and nan(ind)."""
    return (_WITHIN.sub(_plain, line) if "#" in line or "(" in line else line for line in lines)


def _plain(found: re.Match[str]) -> str:
    return found[1] + "inf" if found[2] else "nan"
