"""Strokes of clay, given in the axes of a part, then rotated and scaled into the table of `clay`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from ..base.arrays import Doubles
from . import clay

Vector = Sequence[float]

MIRROR = np.diag([-1.0, 1.0, 1.0])
UNPAINTED = (-1.0, -1.0, -1.0)  # a relief that only shades the colour below it


def rotation(turn: Vector) -> Doubles:
    """Return the (3, 3) matrix of rotations about x, then y, then z. turn : the three angles in degrees"""
    (a, b, c), (d, e, f) = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    x = np.array([[1, 0, 0], [0, a, -d], [0, d, a]])
    y = np.array([[b, 0, e], [0, 1, 0], [-e, 0, b]])
    z = np.array([[c, -f, 0], [f, c, 0], [0, 0, 1]])
    return np.asarray(z @ y @ x, np.float64)


class Clay:
    """Collector of strokes: shapes that add, carve, cut, displace or paint clay one after the other.

    Lengths are in units of the current part (`part`), which has its own place, turn and scale. Every stroke except a
    relief takes `op` (ADD, CARVE, CUT, PAINT) and `vein` (strength of the stone's veins). All take the `width` over
    which they blend and a `color` (sRGB, 0 to 1).
    """

    def __init__(self) -> None:
        self._rows: list[Doubles] = []
        self._scale, self._turn, self._place = 1.0, np.eye(3), np.zeros(3)

    def table(self) -> Doubles:
        """Return all strokes (shapes that add or remove clay) so far, (strokes, COLUMNS) float64, one row each."""
        return np.array(self._rows)

    @contextmanager
    def part(self, place: Vector, turn: Vector = (0, 0, 0), scale: float = 1.0) -> Iterator[None]:
        """Place the shapes added within the `with` block in axes of their own: rotated, scaled and moved to `place`.

        turn : angles about x, y and z in degrees. Blocks can be nested.
        """
        before = self._scale, self._turn, self._place
        self._place = self._place + self._scale * self._turn @ np.asarray(place, np.float64)
        self._turn, self._scale = self._turn @ rotation(turn), self._scale * scale
        yield
        self._scale, self._turn, self._place = before

    def _row(
        self, kind: int, op: int = clay.ADD, width: float = 0.02, color: Vector = (0.5, 0.5, 0.5), vein: float = 0.0
    ) -> Doubles:
        row = np.zeros(clay.COLUMNS)
        row[clay.KIND], row[clay.OP], row[clay.VEIN] = kind, op, vein
        row[clay.WIDTH], row[clay.SCALE] = width * self._scale, self._scale
        row[clay.COLOR : clay.COLOR + 3] = color
        return row

    def _solid(
        self, kind: int, center: Vector, size: Vector, turn: Vector, rounding: float, both: bool, **stroke: Any
    ) -> None:
        for mirror in (np.eye(3), MIRROR) if both else (np.eye(3),):
            row = self._row(kind, **stroke)
            row[clay.CENTER : clay.CENTER + 3] = self._place + self._scale * self._turn @ mirror @ np.asarray(
                center, np.float64
            )
            row[clay.AXES : clay.AXES + 9] = (self._turn @ mirror @ rotation(turn)).T.ravel()
            row[clay.SIZE : clay.SIZE + 3] = np.asarray(size, np.float64) * self._scale
            row[clay.ROUND] = rounding
            self._rows.append(row)

    def ellipsoid(
        self,
        center: Vector,
        radii: Vector,
        turn: Vector = (0, 0, 0),
        both: bool = False,
        share: float = 1.0,
        **stroke: Any,
    ) -> None:
        """Add an ellipsoid to the shapes of a sculpture.

        radii : along its axes; turn : angles of the axes about x, y and z in degrees; share : its opacity as paint, 0
            to 1
        both : whether to add its mirror image at x = 0
        stroke : op (ADD, CARVE, CUT or PAINT), width of blending, color, vein (strength of veins)
        """
        self._solid(clay.ELLIPSOID, center, radii, turn, share, both, **stroke)

    def box(self, center: Vector, half: Vector, rounding: float, **stroke: Any) -> None:
        """Add a box with rounded edges to the shapes of a sculpture.

        half : (3,) half of its edges; rounding : radius of its edges
        stroke : op (ADD, CARVE, CUT or PAINT), width of blending, color, vein (strength of veins)
        """
        self._solid(clay.BOX, center, half, (0, 0, 0), rounding * self._scale, False, **stroke)

    def drum(self, center: Vector, radius: float, half: float, rounding: float, **stroke: Any) -> None:
        """Add a cylinder along z with rounded rims to the shapes of a sculpture.

        half : half of its height; rounding : radius of the rims
        stroke : op (ADD, CARVE, CUT or PAINT), width of blending, color, vein (strength of veins)
        """
        self._solid(clay.DRUM, center, (radius, radius, half), (0, 0, 0), rounding * self._scale, False, **stroke)

    def ring(self, center: Vector, radius: float, thickness: float, turn: Vector = (0, 0, 0), **stroke: Any) -> None:
        """Add a torus about z to the shapes of a sculpture.

        radius : of its centre line; thickness : radius of its cross section; turn : angles about x, y and z in degrees
        stroke : op (ADD, CARVE, CUT or PAINT), width of blending, color, vein (strength of veins)
        """
        self._solid(clay.RING, center, (radius, radius, thickness), turn, 1.0, False, **stroke)

    def tube(
        self,
        a: Vector,
        through: Vector,
        c: Vector,
        radii: Vector,
        both: bool = False,
        share: float = 1.0,
        **stroke: Any,
    ) -> None:
        """Add a bent tube from `a` to `c` through a point half way to the shapes of a sculpture.

        radii : at `a`, at `c`, and the excess of the radius at the middle; share : its opacity as paint, 0 to 1
        both : whether to add its mirror image at x = 0
        stroke : op (ADD, CARVE, CUT or PAINT), width of blending, color, vein (strength of veins)
        """
        p, m, q = (np.asarray(v, np.float64) for v in (a, through, c))
        control = 2.0 * m - 0.5 * (p + q)
        # a straight line has no second derivative: bend it by a hundredth
        chord = q - p
        if np.linalg.norm(p - 2 * control + q) < 0.03 * np.linalg.norm(chord):
            control = control + 0.03 * np.cross(chord, [0.3, 0.5, 0.8])
        for mirror in (np.eye(3), MIRROR) if both else (np.eye(3),):
            row = self._row(clay.TUBE, **stroke)
            points = np.stack([p, control, q]) @ mirror
            row[clay.POINTS : clay.POINTS + 9] = (self._place + self._scale * points @ self._turn.T).ravel()
            row[clay.RADII : clay.RADII + 3] = np.asarray(radii, np.float64) * self._scale
            row[clay.ROUND] = share
            self._rows.append(row)

    def relief(
        self, pattern: int, center: Vector, region: Vector, amplitude: float, turn: Vector = (0, 0, 0), **stroke: Any
    ) -> None:
        """Displace the surface of the sculpture by a pattern within an ellipsoid.

        pattern : HAIR, FOLDS, MEANDER, FLUTES or SPIRAL; region : (3,) radii of the ellipsoid
        amplitude : height of the pattern; turn : angles of its axes about x, y and z in degrees
        stroke : blending width at its rim, `count` of repeats, `color` of raised parts
        """
        count = stroke.pop("count", 0)
        stroke.setdefault("color", UNPAINTED)
        self._solid(pattern, center, region, turn, amplitude * self._scale, False, op=clay.RELIEF, vein=count, **stroke)
