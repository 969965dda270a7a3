"""Messages between page and server. Those of pages are not trusted: invalid ones raise ValueError."""

from __future__ import annotations

import json
import math
import struct
from typing import Any

from ..base.arguments import check_number
from ..rendering.camera import Camera

WIDEST = 3840  # pixels, largest width or height of a view


def parse(text: str) -> dict[str, Any]:
    """Parse a message of the page: a JSON object with a text "type"; raise ValueError if it is anything else."""
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError("not valid JSON") from None
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        raise ValueError("expected an object with a type")
    return message


def number(message: dict[str, Any], name: str, low: float = -math.inf, high: float = math.inf) -> float:
    """Return a finite number from a message; raise ValueError if it is missing or not between `low` and `high`.

    name : key in the message
    """
    value = check_number(message.get(name), name, "a number")
    if not low <= value <= high:
        raise ValueError(f"{name} must lie between {low:g} and {high:g}, not {value!r:.40}")
    return value


def short_text(message: dict[str, Any], name: str) -> str:
    """Return a text from a message; raise ValueError if it is missing or longer than 100 characters. name : its key"""
    value = message.get(name)
    if not isinstance(value, str) or len(value) > 100:
        raise ValueError(f"{name} must be a short text")
    return value


def size_of(message: dict[str, Any]) -> tuple[int, int]:
    """Return width and height of the view in pixels from a message, reduced proportionally to 3840 pixels at most."""
    width, height = (int(number(message, name, 1, 1e6)) for name in ("width", "height"))
    over = max(width, height) / WIDEST
    return (max(1, int(width / over)), max(1, int(height / over))) if over > 1 else (width, height)


def free_of(message: dict[str, Any]) -> tuple[int, int, int, int]:
    """Return the part of the view not covered by the panel from a message: left, top, right, bottom in pixels.

    The default is the whole view. If the view is larger than 3840 pixels, the part is reduced with it.
    """
    width, height = size_of(message)
    if "free" not in message:
        return 0, 0, width, height
    sides = message["free"]
    if not isinstance(sides, list) or len(sides) != 4:
        raise ValueError("free must be four numbers: left, top, right, bottom")
    whole = number(message, "width", 1, 1e6), number(message, "height", 1, 1e6)
    edges = []
    for k, name in enumerate(("left", "top", "right", "bottom")):
        edge = number({f"free's {name}": sides[k]}, f"free's {name}", 0, whole[k % 2])
        edges.append(min((width, height)[k % 2], round(edge * (width, height)[k % 2] / whole[k % 2])))
    left, top, right, bottom = edges
    if left >= right or top >= bottom:
        raise ValueError(f"free must be left, top, right, bottom of a rectangle, not {sides!r:.60}")
    return left, top, right, bottom


def camera_of(message: dict[str, Any], size: tuple[int, int]) -> Camera:
    """Return the camera that a page's message describes. size : width and height of its image in pixels"""
    vectors = {name: message.get(name) for name in ("eye", "target", "up")}
    projection = "orthographic" if message.get("orthographic") is True else "perspective"
    fov = number(message, "fov", 0.01, 179)
    return Camera.look_at(**vectors, fov=fov, size=size, projection=projection)  # type: ignore[arg-type]


def describe(camera: Camera) -> dict[str, Any]:
    """Return a camera as a dict of JSON types, as messages contain it: eye, target, up, fov (degrees), orthographic."""
    fields = {"eye": list(camera.eye), "target": list(camera.target), "up": list(camera.up), "fov": camera.fov}
    return {**fields, "orthographic": camera.projection == "orthographic"}


def pack(header: dict[str, Any], payload: bytes = b"") -> bytes:
    """Pack a binary message: length of the header (4 bytes), header as JSON, payload.

    payload : all of it, or the part available now; the caller sends the rest
    """
    text = json.dumps(header).encode()
    return struct.pack("<I", len(text)) + text + payload
