"""On which line of a TOML text a key stands, which tomllib does not tell: one walk over its tokens.

The text is one that tomllib has read: what is no TOML does not come here.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from typing import Any, NamedTuple

Key = tuple[str | int, ...]

# Strings of several lines may hold one or two quotes in a row, and end in five. Possessive: no text is looked at twice.
_TOKENS = re.compile(
    r"""
    (?P<string> \"{3} (?: [^"\\]++ | \\. | "{1,2}(?!") )*+ "{3,5}
              | '{3} (?: [^']++ | '{1,2}(?!') )*+ '{3,5}
              | " (?: [^"\\\n]++ | \\. )*+ "
              | ' [^'\n]*+ ' )
    | (?P<comment> \#[^\n]*+ )
    | (?P<space> [ \t\r]++ )
    | (?P<end> \n )
    | (?P<mark> [][{},=] )
    | (?P<word> [^][{},=\s"'\#]++ )
    """,
    re.VERBOSE | re.DOTALL,
)
_BARE = re.compile(r"[A-Za-z0-9_-]+(?:\.[A-Za-z0-9_-]+)*")


class _Token(NamedTuple):
    kind: str
    text: str
    line: int


def line_of(text: str, key: Key) -> int:
    """The line on which a key that is there begins: the first that holds a part of it; 0 for the empty key.

    Within a table in braces it is the line on which that begins.
    """
    best, found = 0, 0
    for place, line in _places(text):
        if len(place) > best and key[: len(place)] == place:
            best, found = len(place), line
            if best == len(key):
                break
    return found


def _tokens(text: str) -> Iterator[_Token]:
    line = 1
    for match in _TOKENS.finditer(text):
        kind, token = match.lastgroup, match[0]
        if kind not in ("comment", "space"):
            yield _Token(str(kind), token, line)
        line += token.count("\n")


def _places(text: str) -> Iterator[tuple[Key, int]]:
    """The keys of a text in its order, and their lines; what encloses a key comes before it."""
    tables: dict[Key, int] = {}  # of each array of tables, the number of its last one
    table: Key = ()
    tokens = _tokens(text)
    for token in tokens:
        if token.kind == "end":
            continue
        if token.text == "[":
            parts, twice = _header(tokens)
            table = _inside(parts[:-1], tables)
            yield from _prefixes((), table, token.line)
            table = (*table, parts[-1])
            if twice:
                tables[table] = tables.get(table, -1) + 1
                yield table, token.line
            table = _inside(parts, tables)
            yield table, token.line
            continue
        words = [token.text]
        for part in tokens:
            if part.text == "=" and part.kind == "mark":
                break
            words.append(part.text)
        key = (*table, *_parts("".join(words)))
        yield from _prefixes(table, key, token.line)
        yield from _elements(tokens, key)


def _header(tokens: Iterator[_Token]) -> tuple[Key, bool]:
    """The parts of the name of a table, and whether it is one of an array."""
    words, twice = [], False
    for token in tokens:
        if token.kind == "end":
            break
        if token.kind == "mark":
            twice |= token.text == "["
        else:
            words.append(token.text)
    return _parts("".join(words)), twice


def _parts(name: str) -> Key:
    """A key with dots, perhaps in quotes, as its parts."""
    if _BARE.fullmatch(name):
        return tuple(name.split("."))
    parts: list[str] = []
    data: Any = tomllib.loads(f"{name} = 0")
    while isinstance(data, dict):
        ((part, data),) = data.items()
        parts.append(part)
    return tuple(parts)


def _inside(parts: Key, tables: dict[Key, int]) -> Key:
    """Where a name leads: of an array of tables into the last one."""
    place: Key = ()
    for part in parts:
        place = (*place, part)
        if place in tables:
            place = (*place, tables[place])
    return place


def _prefixes(outer: Key, place: Key, line: int) -> Iterator[tuple[Key, int]]:
    for length in range(len(outer) + 1, len(place) + 1):
        yield place[:length], line


def _elements(tokens: Iterator[_Token], key: Key) -> Iterator[tuple[Key, int]]:
    """The places of the elements of arrays, up to the end of a value; braces are passed over."""
    place, braces, fresh = key, 0, False  # fresh: the next token begins an element
    depth = len(key)
    for token in tokens:
        if token.kind == "end":
            if len(place) == depth and not braces:
                return
            continue
        mark = token.text if token.kind == "mark" else ""
        if braces:
            braces += (mark == "{") - (mark == "}")
            continue
        if fresh and mark != "]":
            yield place, token.line
            fresh = False
        if mark == "[":
            place, fresh = (*place, 0), True
        elif mark == "]":
            place, fresh = place[:-1], False
        elif mark == "," and len(place) > depth:
            place, fresh = (*place[:-1], int(place[-1]) + 1), True
        elif mark == "{":
            braces = 1
