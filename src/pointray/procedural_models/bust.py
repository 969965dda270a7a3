"""The statue's neck and draped shoulders, and the turned plinth below, in world units, standing on z = 0."""

from __future__ import annotations

from typing import Any

from .clay import CARVE, CUT, PAINT
from .head import FLESH, GOLD
from .reliefs import FLUTES, FOLDS, MEANDER
from .strokes import Clay

CLOTH = (0.37, 0.47, 0.53)
MANTLE = (0.55, 0.27, 0.21)
STONE = (0.20, 0.27, 0.24)
PALE = (0.83, 0.80, 0.74)


def sculpt_plinth(clay: Clay) -> None:
    stone: dict[str, Any] = {"color": STONE, "vein": -0.45}
    pale: dict[str, Any] = {"color": PALE, "vein": 0.35}
    clay.box((0, 0, 0.045), (0.36, 0.36, 0.045), 0.014, width=0.01, **stone)
    clay.drum((0, 0, 0.100), 0.335, 0.02, 0.012, width=0.008, **pale)
    clay.drum((0, 0, 0.160), 0.310, 0.055, 0.010, width=0.008, **stone)
    with clay.part((0, 0, 0.160), scale=0.043):
        clay.relief(MEANDER, (0, 0, 0), (14, 14, 1.20), 0.14, width=0.1, count=18, color=GOLD)
    clay.drum((0, 0, 0.225), 0.330, 0.016, 0.014, width=0.008, **pale)
    clay.drum((0, 0, 0.265), 0.290, 0.042, 0.040, width=0.008, **stone)
    with clay.part((0, 0, 0.275), scale=0.04):
        clay.relief(FLUTES, (0, 0, 0), (12, 12, 1.0), 0.23, width=0.3, count=30)
    clay.drum((0, 0, 0.37), 0.135, 0.10, 0.01, width=0.16, **stone)
    clay.ring((0, 0, 0.415), 0.135, 0.022, width=0.012, color=GOLD)
    clay.drum((0, 0.03, 0.515), 0.190, 0.035, 0.030, width=0.03, **stone)


def _torso(clay: Clay, grow: float, **stroke: Any) -> None:
    """Add chest, shoulders and stumps of the arms to a sculpture made of strokes, shapes that add or remove clay.

    grow : length by which they are enlarged, for a layer of cloth over the body
    stroke : op (ADD, CARVE, CUT or PAINT), width of blending, color, vein (strength of veins)
    """
    g = grow
    clay.ellipsoid((0, 0.03, 0.80), (0.35 + g, 0.19 + g, 0.40 + g), width=0.05, **stroke)
    clay.tube(
        (-0.40, 0.06, 0.975),
        (0, 0.075, 1.050),
        (0.40, 0.06, 0.975),
        (0.095 + g, 0.095 + g, 0.015),
        width=0.12,
        **stroke,
    )
    clay.tube(
        (0.41, 0.06, 0.97),
        (0.46, 0.055, 0.84),
        (0.46, 0.05, 0.66),
        (0.100 + g, 0.090 + g, 0.0),
        both=True,
        width=0.08,
        **stroke,
    )
    clay.ellipsoid((0.145, -0.100, 0.795), (0.115 + g, 0.110 + g, 0.120 + g), both=True, width=0.08, **stroke)


def sculpt_bust(clay: Clay) -> None:
    """Model neck and draped shoulders: cloth, its folds, the neckline, the skin below, and the neck.

    The order matters: the neck comes after the foot of the bust has been rounded by a cut.
    """
    _torso(clay, 0.040, color=GOLD)
    clay.ellipsoid((0.42, 0.05, 0.72), (0.36, 0.60, 0.75), (0, -38, 0), op=CUT, width=0.02)
    clay.ellipsoid((0.42, 0.05, 0.72), (0.34, 0.585, 0.73), (0, -38, 0), op=PAINT, width=0.003, color=MANTLE)
    _torso(clay, 0.016, color=CLOTH, vein=0.0)
    clay.relief(FOLDS, (0, 0.0, 1.12), (0.75, 0.5, 0.75), 0.0165, width=0.02)
    clay.ellipsoid((0, -0.13, 1.12), (0.230, 0.30, 0.185), op=CARVE, width=0.02)
    clay.ellipsoid((0, -0.13, 1.12), (0.248, 0.318, 0.206), op=PAINT, width=0.003, color=GOLD)
    _torso(clay, -0.012, **FLESH)
    clay.ellipsoid((0, 0.06, 0.99), (0.620, 0.42, 0.47), op=CUT, width=0.03)
    clay.tube((0, 0.075, 1.02), (0, 0.065, 1.24), (0, 0.03, 1.46), (0.155, 0.120, -0.022), width=0.11, **FLESH)
    clay.tube(
        (0.125, 0.055, 1.45),
        (0.095, -0.02, 1.28),
        (0.028, -0.078, 1.085),
        (0.016, 0.012, 0.002),
        both=True,
        width=0.06,
        **FLESH,
    )
    clay.tube(
        (0.04, -0.085, 1.065),
        (0.16, -0.055, 1.085),
        (0.30, 0.03, 1.105),
        (0.012, 0.012, 0.003),
        both=True,
        width=0.05,
        **FLESH,
    )
