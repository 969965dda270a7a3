"""The keys of a table: the parameters of a class or function, with the types that their annotations allow."""

from __future__ import annotations

import inspect
import math
import reprlib
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from ..base.spelling import did_you_mean
from ..shade.attributes import Attribute
from .lines import Key
from .source import Source

LARGEST = 1e18  # the square of a larger number overflows float32


class Word(NamedTuple):
    """What a scene file may contain at a key: one parameter of the Python class or function that a table stands for.

    Attributes
    ----------
    types : tuple of str
        Type annotations, such as "float" and "ArrayLike"; the value must fit one.
    required : bool
    """

    types: tuple[str, ...]
    required: bool


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _are_numbers(value: Any) -> bool:
    return all(map(_are_numbers, value)) if isinstance(value, list) else _is_number(value)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


# Annotation -> name in messages, and a test whether a TOML value has that type.
TYPES: dict[str, tuple[str, Callable[[Any], bool]]] = {
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
    """Return the description of a key with `required` set to False: it may be omitted."""
    return word._replace(required=False)


def words_of(make: Callable[..., Any], *without: str) -> dict[str, Word]:
    """Return the keys of a table in a scene file, each with its types: the parameters of a class or function.

    Parameters whose annotation has no TOML type are left out.

    make : the class or function; without : names of parameters that are no keys
    """
    words = {}
    for name, parameter in inspect.signature(make).parameters.items():
        types = tuple(part for part in str(parameter.annotation).split(" | ") if part in TYPES)
        if name not in without and types not in ((), ("None",)):
            words[name] = Word(types, parameter.default is parameter.empty)
    return words


def unknown(what: str, name: Any, known: Iterable[str]) -> str:
    """Return a message such as "unknown kind 'sum' (did you mean 'sun'?); available: ...".

    what : what the name stands for, such as "kind"; known : the valid names
    """
    names = list(known)
    return f"unknown {what} {name!r}{did_you_mean(str(name), names)}; available: {', '.join(names) or 'none'}"


def check_table(source: Source, key: Key, words: Mapping[str, Word], what: str = "key") -> dict[str, Any]:
    """Check the keys and types of a table in a scene file and return its values by key; "none" becomes None.

    key : path of the table in the file, such as ("models", "bust"); () is the whole file
    words : the keys it may have; what : what messages call a key
    """
    table = value_at(source, key)
    if not isinstance(table, dict):
        raise source.error(key, f"must be a table, not {reprlib.repr(table)}")
    for name in table:
        if name not in words:
            raise source.error((*key, name), unknown(what, name, words))
    for name, word in words.items():
        if word.required and name not in table:
            raise source.error(key, f"{name} is missing")
    return {name: _value(source, (*key, name), value, words[name].types) for name, value in table.items()}


def value_at(source: Source, key: Key) -> Any:
    """Return the value of a key in a scene file. key : names and row numbers, such as ("instances", 0, "model")"""
    value: Any = source.data
    for part in key:
        value = value[part]
    return value


def _value(source: Source, key: Key, value: Any, types: tuple[str, ...]) -> Any:
    if ("None" in types or "Color" in types) and value == "none":
        return None
    if not any(TYPES[name][1](value) for name in types):
        choice = " or ".join(TYPES[name][0] for name in types)
        raise source.error(key, f"must be {choice}, not {reprlib.repr(value)}")
    if "Color" in types and isinstance(value, dict):
        values = check_table(source, key, words_of(Attribute))
        with source.errors_at(key, values):
            return Attribute(**values)
    for number in _numbers_in(value):
        if number != number:
            raise source.error(key, "must not be NaN")
        if LARGEST < abs(number) < math.inf:  # the class checks infinity
            raise source.error(key, f"must not be larger than {LARGEST:g}")
    return value


def _numbers_in(value: Any) -> list[Any]:
    if isinstance(value, list):
        return [number for part in value for number in _numbers_in(part)]
    return [value] if _is_number(value) else []
