"""The line of each key of a TOML text, which tomllib does not report; found in one pass over the tokens.

The text must be valid: tomllib has read it before.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from typing import Any, NamedTuple

Key = tuple[str | int, ...]

# A multi-line string may contain one or two quotes in a row, and may end in five. Possessive quantifiers avoid
# backtracking.
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
    """Return the first line of a key, or of its longest prefix that is in the text; 0 if none is.

    A key of an inline table has the line of that table.
    """
    best, found = 0, 0
    for path, line in _key_lines(text):
        if len(path) > best and key[: len(path)] == path:
            best, found = len(path), line
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


def _key_lines(text: str) -> Iterator[tuple[Key, int]]:
    """Yield the key paths of a text and their lines, in order, enclosing tables first."""
    last_rows: dict[Key, int] = {}  # array of tables -> index of its last table
    table: Key = ()
    tokens = _tokens(text)
    for token in tokens:
        if token.kind == "end":
            continue
        if token.text == "[":
            parts, is_array = _header(tokens)
            table = _resolve(parts[:-1], last_rows)
            yield from _prefixes((), table, token.line)
            table = (*table, parts[-1])
            if is_array:
                last_rows[table] = last_rows.get(table, -1) + 1
                yield table, token.line
            table = _resolve(parts, last_rows)
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
    """Return the parts of a table's name, and whether the table is an element of an array: `[[name]]`."""
    words, is_array = [], False
    for token in tokens:
        if token.kind == "end":
            break
        if token.kind == "mark":
            is_array |= token.text == "["
        else:
            words.append(token.text)
    return _parts("".join(words)), is_array


def _parts(name: str) -> Key:
    """Return the parts of a dotted key, which may be quoted."""
    if _BARE.fullmatch(name):
        return tuple(name.split("."))
    parts: list[str] = []
    data: Any = tomllib.loads(f"{name} = 0")
    while isinstance(data, dict):
        ((part, data),) = data.items()
        parts.append(part)
    return tuple(parts)


def _resolve(parts: Key, last_rows: dict[Key, int]) -> Key:
    """Return the key path of a table's name; the name of an array of tables means its last table."""
    path: Key = ()
    for part in parts:
        path = (*path, part)
        if path in last_rows:
            path = (*path, last_rows[path])
    return path


def _prefixes(outer: Key, path: Key, line: int) -> Iterator[tuple[Key, int]]:
    for length in range(len(outer) + 1, len(path) + 1):
        yield path[:length], line


def _elements(tokens: Iterator[_Token], key: Key) -> Iterator[tuple[Key, int]]:
    """Yield the key paths of array elements of a value, and their lines; inline tables are skipped."""
    path, braces, is_new = key, 0, False  # is_new: the next token begins an element
    depth = len(key)
    for token in tokens:
        if token.kind == "end":
            if len(path) == depth and not braces:
                return
            continue
        mark = token.text if token.kind == "mark" else ""
        if braces:
            braces += (mark == "{") - (mark == "}")
            continue
        if is_new and mark != "]":
            yield path, token.line
            is_new = False
        if mark == "[":
            path, is_new = (*path, 0), True
        elif mark == "]":
            path, is_new = path[:-1], False
        elif mark == "," and len(path) > depth:
            path, is_new = (*path[:-1], int(path[-1]) + 1), True
        elif mark == "{":
            braces = 1
