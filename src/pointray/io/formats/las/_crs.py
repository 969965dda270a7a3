"""Coordinate system of a LAS file: well-known text, or GeoTIFF keys with an EPSG code."""

from __future__ import annotations

import re
import struct
from typing import Any

from ._header import Header
from ._rows import unpack_u16

USER = "LASF_Projection"
WKT, KEYS = 2112, 34735  # record numbers
MODEL, GEOGRAPHIC, ANGLE, PROJECTED, UNIT = 1024, 2048, 2054, 3072, 3076  # GeoTIFF keys
CODES = range(1024, 32767)  # EPSG codes that keys can store; 32767 means user-defined
UNITS = {9001: "metre", 9002: "foot", 9003: "US survey foot", 9102: "degree"}
TOKEN = re.compile(r'"([^"]*+)"|\b(\w++)\s*+[\[(]|([\])])')  # possessive ++ and *+ keep matching linear in time
PLANE = {"PROJCS", "PROJCRS", "PROJECTEDCRS"}
OTHERS = {"GEOGCS", "GEOGCRS", "GEOGRAPHICCRS", "GEODCRS", "GEODETICCRS", "GEOCCS", "LOCAL_CS", "ENGCRS", "LOCALCRS"}
WORDS = {
    "meter": "metre",
    "metres": "metre",
    "meters": "metre",
    "m": "metre",
    "ft": "foot",
    "feet": "foot",
    "international foot": "foot",
    "foot us": "US survey foot",
    "us foot": "US survey foot",
    "us survey feet": "US survey foot",
    "us survey foot": "US survey foot",
    "u.s. survey foot": "US survey foot",
    "ftus": "US survey foot",
}


def crs_of(header: Header) -> tuple[str | None, str | None]:
    """Return the coordinate system of a file, well-known text or an EPSG code, and the name of the unit of x and y.

    Either is None if the file does not state it.
    """
    keys = keys_of(header.data_of(USER, KEYS) or b"")
    text = _wkt_of(header.data_of(USER, WKT) or b"")
    if text:
        return text, unit_of(text) or UNITS.get(keys.get(UNIT, 0))
    code = next((keys[key] for key in (PROJECTED, GEOGRAPHIC) if keys.get(key) in CODES), None)
    unit = UNITS.get(keys.get(UNIT, 0)) or (UNITS.get(keys.get(ANGLE, 0)) if PROJECTED not in keys else None)
    return (None if code is None else f"EPSG:{code}"), unit


def _wkt_of(data: bytes) -> str:
    try:
        return data.decode().rstrip("\0")
    except UnicodeDecodeError:
        return data.decode("latin-1").rstrip("\0")


def keys_of(data: bytes) -> dict[int, int]:
    """Return the GeoTIFF keys with integer values, by key number. data : of the record that lists the keys"""
    numbers = unpack_u16(data)
    found = zip(numbers[4::4], numbers[5::4], numbers[6::4], numbers[7::4], strict=False)
    return {key: value for key, place, _, value in found if place == 0}


def unit_of(text: str) -> str | None:
    """Return the name of the unit of x and y in well-known text; None if it states none."""
    stack: list[str] = []
    found: dict[bool, str] = {}
    for quoted, word, bracket in TOKEN.findall(text):
        if word:
            stack.append(word.upper())
        elif bracket:
            del stack[-1:]
        elif stack and stack[-1] in ("UNIT", "LENGTHUNIT", "ANGLEUNIT"):
            above = stack[-3:-1]
            owner = "" if not above else above[0] if above[-1] == "AXIS" else above[-1]
            if owner in PLANE | OTHERS:
                found.setdefault(owner in PLANE, quoted)
    unit = found.get(True, found.get(False))
    return None if unit is None else WORDS.get(unit.lower().replace("_", " "), unit.lower())


def records_for(crs: str | None, unit: str | None, losses: list[str]) -> list[tuple[int, bytes]]:
    """Return number and data of the records that state a coordinate system; append to `losses` what cannot be stored.

    crs : well-known text or an EPSG code; unit : of x and y
    """
    if crs is None:
        key = next((k for k, name in UNITS.items() if name == unit and unit != "degree"), None)
        return [(KEYS, _directory([(UNIT, key)]))] if key else []
    if "[" in crs:
        return [(WKT, crs.encode() + b"\0")]
    match = re.fullmatch(r"EPSG:(\d{1,9})", crs.strip(), re.IGNORECASE)
    code = int(match[1]) if match else 0
    if code not in CODES:
        losses.append(f"cannot store the coordinate system {crs[:40]!r}: only well-known text or an EPSG code")
        return []
    flat = not 4000 < code < 5000  # EPSG codes of geographic systems
    keys: list[tuple[int, int]] = [(MODEL, 1 if flat else 2), (PROJECTED if flat else GEOGRAPHIC, code)]
    known: Any = next((k for k, name in UNITS.items() if name == unit), None)
    if known:
        keys.append((UNIT if flat else ANGLE, known))
    return [(KEYS, _directory(keys))]


def _directory(keys: list[tuple[int, int]]) -> bytes:
    numbers = [1, 1, 0, len(keys)]
    for key, value in sorted(keys):
        numbers += [key, 0, 1, value]
    return struct.pack(f"<{len(numbers)}H", *numbers)
