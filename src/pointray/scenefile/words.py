"""The words of a table: the parameters of what it makes, and what their annotations say of the values."""

from __future__ import annotations

import difflib
import inspect
import math
import reprlib
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from ..shade.attributes import Attribute
from .lines import Key
from .source import Source

LARGEST = 1e18  # of a number: the square of a larger one is none in float32


class Word(NamedTuple):
    """What a table has by a name."""

    kinds: tuple[str, ...]
    needed: bool


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _are_numbers(value: Any) -> bool:
    return all(map(_are_numbers, value)) if isinstance(value, list) else _is_number(value)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


# Annotation -> how messages call it, and whether a value of TOML is one.
KINDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "bool": ("true or false", lambda value: isinstance(value, bool)),
    "int": ("a whole number", _is_whole),
    "float": ("a number", _is_number),
    "ArrayLike": ("a number or a list of numbers", _are_numbers),
    "tuple[int, int]": ("two whole numbers", lambda value: isinstance(value, list) and all(map(_is_whole, value))),
    "tuple[float, float]": ("two numbers", lambda value: isinstance(value, list) and all(map(_is_number, value))),
    "Color": (
        "a number, a list of three, or a table of an attribute",
        lambda v: isinstance(v, dict) or _are_numbers(v),
    ),
    "str": ("a text", lambda value: isinstance(value, str)),
    "None": ('"none"', lambda value: value == "none"),
    "dict": ("a table", lambda value: isinstance(value, dict)),
    "list": ("a list of tables", lambda value: isinstance(value, list) and all(isinstance(row, dict) for row in value)),
}
TEXT, WHOLE = Word(("str",), True), Word(("int",), True)


def optional(word: Word) -> Word:
    """A word that may be left out."""
    return word._replace(needed=False)


def words_of(make: Callable[..., Any], *without: str) -> dict[str, Word]:
    """The parameters of a class or a function that TOML has values for, without some."""
    words = {}
    for name, parameter in inspect.signature(make).parameters.items():
        kinds = tuple(kind for kind in str(parameter.annotation).split(" | ") if kind in KINDS)
        if name not in without and kinds not in ((), ("None",)):
            words[name] = Word(kinds, parameter.default is parameter.empty)
    return words


def unknown(what: str, name: Any, known: Iterable[str]) -> str:
    """A message: a name that is none of those known."""
    names = list(known)
    near = difflib.get_close_matches(str(name), names, 1)
    guess = f" (did you mean {near[0]!r}?)" if near else ""
    return f"unknown {what} {name!r}{guess}; there are: {', '.join(names) or 'none'}"


def check_table(source: Source, key: Key, words: Mapping[str, Word], what: str = "key") -> dict[str, Any]:
    """The values of a table, of the kinds that its words have; "none" as None."""
    table = value_at(source, key)
    if not isinstance(table, dict):
        raise source.error(key, f"must be a table, not {reprlib.repr(table)}")
    for name in table:
        if name not in words:
            raise source.error((*key, name), unknown(what, name, words))
    for name, word in words.items():
        if word.needed and name not in table:
            raise source.error(key, f"{name} is missing")
    return {name: _value(source, (*key, name), value, words[name].kinds) for name, value in table.items()}


def value_at(source: Source, key: Key) -> Any:
    """What the file has at a key that is there."""
    value: Any = source.data
    for part in key:
        value = value[part]
    return value


def _value(source: Source, key: Key, value: Any, kinds: tuple[str, ...]) -> Any:
    if ("None" in kinds or "Color" in kinds) and value == "none":
        return None
    if not any(KINDS[kind][1](value) for kind in kinds):
        choice = " or ".join(KINDS[kind][0] for kind in kinds)
        raise source.error(key, f"must be {choice}, not {reprlib.repr(value)}")
    if "Color" in kinds and isinstance(value, dict):
        words = check_table(source, key, words_of(Attribute))
        with source.telling(key, words):
            return Attribute(**words)
    for number in _numbers_in(value):
        if number != number:
            raise source.error(key, "must not be NaN")
        if LARGEST < abs(number) < math.inf:  # what may be infinite, the class knows
            raise source.error(key, f"must not be larger than {LARGEST:g}")
    return value


def _numbers_in(value: Any) -> list[Any]:
    if isinstance(value, list):
        return [number for part in value for number in _numbers_in(part)]
    return [value] if _is_number(value) else []
