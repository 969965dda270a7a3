"""The statue's head, in units of its height: chin at z = 0, crown at 1, face towards -y, eyes half way up."""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import Any

from .clay import CARVE, PAINT
from .reliefs import HAIR, SPIRAL
from .strokes import Clay

SKIN = (0.93, 0.85, 0.76)
LIPS = (0.80, 0.56, 0.50)
GAP = (0.60, 0.38, 0.34)
BLUSH = (0.90, 0.70, 0.61)
EYES = (0.95, 0.93, 0.89)
IRIS = (0.30, 0.36, 0.33)
PUPIL = (0.10, 0.09, 0.09)
BROWS = (0.46, 0.30, 0.20)
TRESSES = (0.56, 0.35, 0.20)
PEARL = (0.93, 0.89, 0.80)
GOLD = (0.80, 0.62, 0.31)

FLESH: dict[str, Any] = {"color": SKIN, "vein": 0.05}


def sculpt_head(clay: Clay) -> None:
    """Model the statue's head from shapes that add or remove clay.

    The hair is first, since its relief must not touch the skin.
    """
    _hair(clay)
    _skull(clay)
    _nose(clay)
    _mouth(clay)
    _eyes(clay)
    _ears(clay)
    _locks(clay)
    _diadem(clay)


def _skull(clay: Clay) -> None:
    clay.ellipsoid((0, -0.035, 0.60), (0.300, 0.345, 0.345), width=0.02, **FLESH)
    clay.ellipsoid((0, -0.13, 0.375), (0.222, 0.240, 0.36), width=0.08, **FLESH)
    clay.tube(
        (0.205, 0.03, 0.33),
        (0.150, -0.15, 0.135),
        (0.028, -0.290, 0.082),
        (0.055, 0.042, 0.0),
        both=True,
        width=0.10,
        **FLESH,
    )
    clay.ellipsoid((0, -0.318, 0.083), (0.066, 0.062, 0.062), width=0.07, **FLESH)
    clay.ellipsoid((0.150, -0.225, 0.405), (0.085, 0.085, 0.078), both=True, width=0.09, **FLESH)
    # sockets, under a straight classical brow
    clay.ellipsoid((0.130, -0.405, 0.495), (0.088, 0.070, 0.052), (0, 0, 14), both=True, op=CARVE, width=0.07)
    clay.tube(
        (0.040, -0.372, 0.555),
        (0.130, -0.350, 0.585),
        (0.222, -0.262, 0.555),
        (0.022, 0.016, 0.006),
        both=True,
        width=0.045,
        **FLESH,
    )
    clay.ellipsoid((0.165, -0.295, 0.345), (0.07, 0.05, 0.06), both=True, op=PAINT, width=0.05, color=BLUSH, share=0.55)


def _nose(clay: Clay) -> None:
    clay.tube((0, -0.352, 0.580), (0, -0.405, 0.470), (0, -0.455, 0.372), (0.030, 0.034, -0.004), width=0.05, **FLESH)
    clay.ellipsoid((0, -0.455, 0.362), (0.043, 0.042, 0.036), width=0.03, **FLESH)
    clay.ellipsoid((0.039, -0.404, 0.352), (0.023, 0.043, 0.025), (0, 0, 16), both=True, width=0.045, **FLESH)
    clay.ellipsoid((0.023, -0.428, 0.326), (0.012, 0.024, 0.014), (0, 0, 14), both=True, op=CARVE, width=0.016)


def _mouth(clay: Clay) -> None:
    lips: dict[str, Any] = {"color": LIPS, "vein": 0.02}
    clay.ellipsoid((0, -0.300, 0.235), (0.125, 0.098, 0.095), width=0.08, **FLESH)
    clay.tube((0, -0.405, 0.312), (0, -0.408, 0.290), (0, -0.414, 0.268), (0.007, 0.010, 0.0), op=CARVE, width=0.03)
    clay.tube(
        (0.004, -0.400, 0.251),
        (0.050, -0.390, 0.251),
        (0.098, -0.345, 0.233),
        (0.019, 0.006, 0.002),
        both=True,
        width=0.014,
        **lips,
    )
    clay.tube(
        (-0.088, -0.350, 0.226), (0, -0.400, 0.207), (0.088, -0.350, 0.226), (0.006, 0.006, 0.019), width=0.014, **lips
    )
    clay.tube(
        (-0.094, -0.370, 0.233),
        (0, -0.428, 0.2295),
        (0.094, -0.370, 0.233),
        (0.005, 0.005, 0.002),
        op=CARVE,
        width=0.012,
    )
    clay.tube(
        (-0.094, -0.370, 0.233),
        (0, -0.428, 0.2295),
        (0.094, -0.370, 0.233),
        (0.010, 0.010, 0.001),
        op=PAINT,
        width=0.010,
        color=GAP,
        share=0.8,
    )
    clay.tube(
        (-0.045, -0.398, 0.158), (0, -0.408, 0.152), (0.045, -0.398, 0.158), (0.008, 0.008, 0.008), op=CARVE, width=0.05
    )


def _eyes(clay: Clay) -> None:
    clay.ellipsoid((0.128, -0.270, 0.497), (0.066, 0.066, 0.066), both=True, width=0.010, color=EYES, vein=0.02)
    clay.ellipsoid((0.128, -0.345, 0.498), (0.025, 0.03, 0.025), both=True, op=PAINT, width=0.003, color=IRIS)
    clay.ellipsoid((0.128, -0.345, 0.499), (0.011, 0.03, 0.011), both=True, op=PAINT, width=0.003, color=PUPIL)
    clay.ellipsoid((0.128, -0.344, 0.501), (0.011, 0.011, 0.011), both=True, op=CARVE, width=0.010)
    lid: dict[str, Any] = {"both": True, "width": 0.012, **FLESH}
    clay.tube((0.064, -0.322, 0.488), (0.126, -0.343, 0.5265), (0.196, -0.270, 0.489), (0.009, 0.010, 0.008), **lid)
    clay.tube((0.066, -0.322, 0.486), (0.130, -0.332, 0.4685), (0.192, -0.270, 0.487), (0.008, 0.008, 0.004), **lid)
    clay.ellipsoid((0.062, -0.328, 0.487), (0.012, 0.012, 0.010), both=True, width=0.012, **FLESH)
    clay.tube(
        (0.052, -0.385, 0.566),
        (0.135, -0.362, 0.594),
        (0.222, -0.272, 0.566),
        (0.011, 0.005, 0.004),
        both=True,
        op=PAINT,
        width=0.007,
        color=BROWS,
        share=0.75,
    )


def _ears(clay: Clay) -> None:
    with clay.part((0, 0, 0)):
        clay.ellipsoid((0.272, 0.035, 0.425), (0.035, 0.058, 0.092), (12, 0, -18), both=True, width=0.02, **FLESH)
        clay.ellipsoid((0.305, 0.015, 0.415), (0.020, 0.030, 0.052), (12, 0, -18), both=True, op=CARVE, width=0.018)
        clay.tube(
            (0.290, -0.015, 0.455),
            (0.312, 0.055, 0.515),
            (0.300, 0.088, 0.420),
            (0.011, 0.010, 0.003),
            both=True,
            width=0.014,
            **FLESH,
        )
        clay.tube(
            (0.300, 0.088, 0.420),
            (0.295, 0.060, 0.370),
            (0.280, 0.015, 0.345),
            (0.010, 0.016, 0.0),
            both=True,
            width=0.014,
            **FLESH,
        )
        clay.ellipsoid((0.283, 0.015, 0.300), (0.020, 0.020, 0.020), both=True, width=0.010, color=GOLD)


def _hair(clay: Clay) -> None:
    hair: dict[str, Any] = {"color": TRESSES}
    clay.ellipsoid((0, 0.075, 0.640), (0.345, 0.405, 0.375), width=0.02, **hair)
    clay.ellipsoid((0, 0.19, 0.440), (0.285, 0.255, 0.300), width=0.12, **hair)
    # a roll of hair around the face, from the parting to the ears
    clay.tube(
        (0.030, -0.255, 0.865),
        (0.205, -0.235, 0.775),
        (0.296, -0.095, 0.600),
        (0.062, 0.055, 0.012),
        both=True,
        width=0.05,
        **hair,
    )
    clay.tube(
        (0.296, -0.095, 0.600),
        (0.300, 0.030, 0.500),
        (0.260, 0.150, 0.430),
        (0.055, 0.045, 0.0),
        both=True,
        width=0.05,
        **hair,
    )
    clay.relief(HAIR, (0, 0.10, 0.62), (0.42, 0.48, 0.46), 0.022, turn=(-11, 0, 0), width=0.05, count=18)
    # the knot
    clay.ellipsoid((0, 0.500, 0.520), (0.150, 0.125, 0.150), (-22, 0, 0), width=0.035, **hair)
    clay.relief(SPIRAL, (0, 0.560, 0.510), (0.150, 0.10, 0.150), 0.022, turn=(-22, 0, 0), width=0.06, count=5)


def _locks(clay: Clay) -> None:
    """Add a loose curl of hair before each ear."""
    hair: dict[str, Any] = {"color": TRESSES, "both": True, "width": 0.012}
    clay.tube((0.262, -0.090, 0.560), (0.288, -0.120, 0.470), (0.272, -0.075, 0.400), (0.016, 0.010, 0.004), **hair)


def _arc(clay: Clay, points: list[tuple[float, float, float]], radius: float, **stroke: Any) -> None:
    """Add a curved rod: a chain of bent tubes through an odd number of points.

    Each tube begins where the last one ends.

    radius : of the rod
    stroke : op (ADD, CARVE, CUT or PAINT), width of blending, color, vein (strength of veins)
    """
    for k in range(0, len(points) - 2, 2):
        clay.tube(points[k], points[k + 1], points[k + 2], (radius, radius, 0.0), **stroke)


def _diadem(clay: Clay) -> None:
    """Add a diadem: two gilded hoops with beads between them, from ear to ear over the hair."""

    def hoop(angle: float, lean: float) -> tuple[float, float, float]:
        y, rise = 0.0, 0.0
        for _ in range(8):  # on the ellipsoid of the hair, in a plane that leans forward
            width = sqrt(1.0 - ((y - 0.075) / 0.405) ** 2)
            rise = 0.385 * width * cos(angle)
            y = 0.045 - lean * max(rise, 0.0)
        return 0.353 * width * sin(angle), y, 0.64 + rise

    steps = [1.75 * (k / 6.0 - 1.0) for k in range(13)]
    gold: dict[str, Any] = {"color": GOLD, "width": 0.022}
    for lean in (0.33, 0.47):
        _arc(clay, [hoop(angle, lean) for angle in steps], 0.017, **gold)
    for k in range(-12, 13):
        clay.ellipsoid(hoop(1.55 * k / 12.0, 0.40), (0.022, 0.022, 0.022), width=0.022, color=PEARL)
