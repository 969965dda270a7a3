"""The surface point under the mouse, with its coordinates and the attributes of the file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.arrays import Doubles
from ..cloud.georeference import RESIDUAL
from ..model.model import Model
from ..rendering.camera import Camera
from ..scene.scene import Scene
from ..shade.attributes import Attribute, category_name

MAX_LINES = 24
WHOLE = 1e15  # integral floats below this limit are written without decimals or exponent


@dataclass(frozen=True)
class Found:
    """A point on a surface that the user has clicked.

    position : (3,), world; lines : its coordinates, normal and attributes as text
    """

    position: Doubles
    lines: list[str]


def prepare(scene: Scene) -> None:
    """Trace a ray that misses, to load or compile the kernel that finds clicked points before the first click."""
    scene.intersect(np.zeros(3), np.full(3, np.nan))


def pick(scene: Scene, camera: Camera, x: float, y: float) -> Found | None:
    """Return the surface point at a position of the view, with its description; None if nothing is hit.

    x, y : position, 0 to 1 from left and from top
    """
    hits = scene.intersect(*camera.rays_through(2 * x - 1, 1 - 2 * y))
    if hits.instance < 0:
        return None
    position = hits.position
    distance = float(hits.t)
    if camera.projection == "orthographic":
        distance = float(np.linalg.norm(np.subtract(camera.target, camera.eye)))
    pixel = distance * 2 * math.tan(math.radians(camera.fov) / 2) / camera.size[1]
    lines = [f"{name} {_format_coordinate(value, pixel)}" for name, value in zip("xyz", position, strict=True)]
    lines.append("normal " + " ".join(f"{c:.3f}" for c in hits.normal))
    return Found(position, [*lines, *_point_lines(scene, int(hits.instance), int(hits.point))])


def _point_lines(scene: Scene, instance: int, row: int) -> list[str]:
    """Return row number, colour and attributes of a point as text, one a line; none if a plane was hit.

    instance : number that `Scene.add` returned; row : of the point in its model
    """
    model = scene.shapes[instance]
    if not isinstance(model, Model):
        return []
    points, lines = model.points, [f"point {row:,}"]
    if points.colors is not None:
        lines.append("colour " + " ".join(str(c) for c in points.colors[row]))
    for name, values in points.attributes.items():
        if name != RESIDUAL:
            lines.append(f"{name} {_format_value(name, values[row])}")
    if len(lines) > MAX_LINES:
        lines = [*lines[:MAX_LINES], f"and {len(lines) - MAX_LINES} more"]
    return lines


def _format_value(name: str, value: Any) -> str:
    """Format an attribute's value, one or several numbers: exact, as short as possible, with names of LAS classes.

    name : of the attribute
    """
    return " ".join(_format_number(name, number) for number in np.atleast_1d(value))


def _format_number(name: str, number: Any) -> str:
    if number.dtype.kind == "f" and not (number == np.rint(number) and abs(number) < WHOLE):
        return str(number)
    return category_name(Attribute(name), bool(number) if number.dtype == np.bool_ else int(number))


def _format_coordinate(value: float, pixel: float) -> str:
    """Format a coordinate, rounded to about a tenth of a pixel. pixel : size of a pixel there, in world units"""
    decimals = max(0, min(9, 1 - math.floor(math.log10(max(pixel, 1e-300)))))
    return f"{value:.{decimals}f}"
