"""Validation of arguments: each function returns the converted value, or raises an error that names the parameter.

Arguments of the wrong type raise `ArgumentTypeError`, a TypeError; invalid values raise a ValueError.

NumPy scalars and 0-dimensional arrays are accepted as numbers, bools are not.
"""

from __future__ import annotations

import operator
import os
import reprlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Number
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .arrays import Doubles

T = TypeVar("T")
Vector = tuple[float, float, float]

LEAST_LENGTH = 1e-100  # the squared length of shorter vectors underflows in float64


class ArgumentTypeError(TypeError, ValueError):
    """Error for an argument of the wrong type. Also a ValueError, which earlier releases raised."""


def wrong(name: str, wanted: str, value: Any) -> ValueError:
    """Return the error for an invalid argument, with the message "`name` must be `wanted`, not `value`".

    It is an ArgumentTypeError unless `value` is a number, a sequence such as a string, or an array.
    """
    if not isinstance(value, np.ndarray | np.generic | Sequence | Number):
        return wrong_type(name, wanted, value)
    return ValueError(f"{name} must be {wanted}, not {_shown(value)}")


def wrong_type(name: str, wanted: str, value: Any) -> ArgumentTypeError:
    """Return the error for an argument of the wrong type, with the message "`name` must be `wanted`, not `value`"."""
    return ArgumentTypeError(f"{name} must be {wanted}, not {_shown(value)}")


def _shown(value: Any) -> str:
    large = isinstance(value, np.ndarray) and value.size > 8
    return f"{value.dtype} of shape {value.shape}" if large else reprlib.repr(value)


def check_kind(value: Any, name: str, kind: type[T] | tuple[type[T], ...], wanted: str) -> T:
    """Return a value that is an instance of a class, or of one of several; otherwise raise an ArgumentTypeError.

    kind : the class or classes; wanted : their description in the message "`name` must be `wanted`"
    """
    if not isinstance(value, kind):
        raise wrong_type(name, wanted, value)
    return value


def check_callback(value: Any, name: str = "progress") -> None:
    """Raise an ArgumentTypeError that names the argument `name` if its value is neither callable nor None."""
    if value is not None and not callable(value):
        raise wrong_type(name, "callable or None", value)


def check_flag(value: Any, name: str) -> bool:
    """Return an argument as a bool; raise an ArgumentTypeError that names it if it is not a Python or NumPy bool."""
    return bool(check_kind(value, name, (bool, np.bool_), "True or False"))


def check_text(value: Any, name: str) -> str:
    """Return an argument that is a non-empty string; otherwise raise an error that names it."""
    if not check_kind(value, name, str, "a non-empty string"):
        raise wrong(name, "a non-empty string", value)
    return str(value)


def check_choice(value: Any, name: str, choices: Iterable[str]) -> str:
    """Return an argument that is one of the strings `choices`; otherwise raise an error that lists them."""
    known = tuple(choices)
    if not isinstance(value, str) or value not in known:
        error = ValueError if isinstance(value, str) else ArgumentTypeError
        raise error(f"unknown {name} {reprlib.repr(value)}; available: {', '.join(known)}")
    return str(value)


def check_path(value: Any, name: str = "path") -> Path:
    """Return an argument, a string or a path object, as a Path; otherwise raise an ArgumentTypeError that names it."""
    if not isinstance(value, str | os.PathLike) or isinstance(os.fspath(value), bytes):
        raise wrong_type(name, "a path", value)
    return Path(value)


def check_mapping(value: Any, name: str) -> Mapping[Any, Any]:
    """Return an argument that is a dict or another mapping; otherwise raise an ArgumentTypeError that names it."""
    return check_kind(value, name, Mapping, "a dict")


def _plain(value: Any) -> Any:
    """Convert NumPy scalars and 0-dimensional arrays to Python scalars; return other values unchanged."""
    return (
        value.item() if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and not value.ndim) else value
    )


def check_whole(value: Any, name: str, low: int, high: int | None = None, or_none: bool = False) -> int:
    """Return an argument that is an integer from `low` to `high`; otherwise raise an error that names it.

    high : None means no upper limit; or_none : whether the message lists None as valid; None is rejected all the same
    """
    span = f"from {low}" if high is None else f"from {low} to {high}"
    wanted = f"a whole number {span}{', or None' if or_none else ''}"
    plain = _plain(value)
    try:
        number = None if isinstance(plain, bool) else operator.index(plain)
    except TypeError:
        number = None
    if number is None and not isinstance(plain, float):
        raise wrong_type(name, wanted, value)
    if number is None or number < low or (high is not None and number > high):
        raise wrong(name, wanted, value)
    return int(number)


def check_number(value: Any, name: str, wanted: str, fits: Callable[[float], bool] = np.isfinite) -> float:
    """Return an argument as a float; raise an error that names it if it is not a number, is NaN or does not fit.

    fits : returns whether a number is valid

    wanted : description of valid numbers in the message "`name` must be `wanted`"
    """
    plain = _plain(value)
    if isinstance(plain, bool) or not isinstance(plain, int | float):
        raise wrong_type(name, wanted, value)
    try:
        number = float(plain)
    except OverflowError:  # an int of 400 digits
        number = np.nan
    if number != number or not fits(number):
        raise wrong(name, wanted, value)
    return number


def check_positive(value: Any, name: str, wanted: str = "a positive number") -> float:
    """Return an argument as a finite float greater than 0; raise an error that names it if it is invalid.

    wanted : description of valid numbers in the message "`name` must be `wanted`"
    """
    return check_number(value, name, wanted, lambda x: 0 < x < np.inf)


def check_range(value: Any, name: str, low: float, high: float = np.inf) -> float:
    """Return an argument as a finite float from `low` to `high`; raise an error that names it if it is invalid."""
    wanted = f"a number from {low:g} to {high:g}" if high < np.inf else f"a finite number, at least {low:g}"
    return check_number(value, name, wanted, lambda x: low <= x <= high and x < np.inf)


def check_numbers(value: Any, name: str, wanted: str = "numbers") -> NDArray[Any]:
    """Return an argument as an array of integers or floats of any shape; raise an error that names it if it is invalid.

    Python ints beyond 64 bits are converted to float64. wanted : description in the message "`name` must be `wanted`"
    """
    try:
        array = np.asarray(value)
        if array.dtype == object and all(_is_int(item) for item in array.flat):  # beyond int64
            array = array.astype(np.float64)
    except (TypeError, ValueError, OverflowError):  # rows of different lengths, or an int of 400 digits
        raise wrong(name, wanted, value) from None
    if array.dtype.kind not in "iuf":
        raise (wrong_type if isinstance(value, str) else wrong)(name, wanted, value)
    return array


def real_numbers(value: Any, name: str) -> NDArray[Any]:
    """Return an argument as an array of integers or floats of any shape; raise a ValueError if it is invalid.

    Python ints beyond 64 bits are invalid. name : the argument, for the message
    """
    try:
        array = np.asarray(value)
    except ValueError:
        raise ValueError(f"{name} must be a regular array of numbers, but its rows have different lengths") from None
    check_real(array.dtype, name)
    return array


def check_real(dtype: Any, name: str) -> None:
    """Raise a ValueError that names an argument if its dtype is neither integer nor float."""
    if dtype.kind not in "iuf":
        raise ValueError(f"{name} must contain real numbers, not {dtype}")


def _is_int(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def vector(value: Any, name: str) -> Doubles:
    """Return an argument, three finite numbers, as (3,) float64; raise an error that names it if it is invalid."""
    array = check_numbers(value, name, "three finite numbers").astype(np.float64)
    if isinstance(value, list | tuple) and any(isinstance(part, bool | np.bool_) for part in value):
        raise wrong(name, "three finite numbers", value)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise wrong(name, "three finite numbers", value)
    return array


def check_position(value: Any, name: str) -> Vector:
    """Return an argument, three finite numbers, as Python floats; raise an error that names it if it is invalid."""
    x, y, z = vector(value, name).tolist()
    return x, y, z


def check_direction(value: Any, name: str) -> Vector:
    """Return an argument, three finite numbers that are not all zero, as Python floats, without normalizing them.

    Raise an error that names it if it is invalid.
    """
    numbers = check_position(value, name)
    if not any(numbers):
        raise ValueError(f"{name} must not be zero")
    return numbers


def unit_vector(value: Any, name: str) -> Doubles:
    """Normalize an argument, three finite numbers that are not all zero, to a unit vector, (3,) float64.

    Raise an error that names it if it is invalid.
    """
    array = vector(value, name)
    most = np.abs(array).max()
    if most < LEAST_LENGTH:
        raise ValueError(f"{name} must not be zero")
    array = array / most
    return np.asarray(array / np.linalg.norm(array))


def rgb(value: Any, name: str) -> Doubles:
    """Return an argument, one number (grey) or three, finite and not negative, as RGB, (3,) float64.

    Raise an error that names it if it is invalid.
    """
    wanted = "a number or three (red, green, blue)"
    array = check_numbers(value, name, wanted)
    if array.shape not in ((), (1,), (3,)):
        raise wrong(name, wanted, value)
    color = np.broadcast_to(array.astype(np.float64), (3,)).copy()
    if not np.isfinite(color).all() or (color < 0).any():
        raise ValueError(f"{name} must be finite and not negative, not {value!r}")
    return color


def reflectance(value: Any, name: str) -> Doubles:
    """Return an argument, one number (grey) or three, from 0 to 1, as RGB, (3,) float64.

    Raise an error that names it if it is invalid.
    """
    color = rgb(value, name)
    if (color > 1).any():
        raise ValueError(f"{name} must be a reflectance from 0 to 1, not {value!r}")
    return color
