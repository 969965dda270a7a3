"""Minimum and step without corners: the surface must have a normal everywhere."""

from __future__ import annotations

from ..engine.jit import inline


@inline
def blend(a: float, b: float, width: float) -> float:
    """Minimum of a and b, smooth (C2) where they differ by less than the width; nowhere above the minimum."""
    h = max(width - abs(a - b), 0.0) / width
    return min(a, b) - h * h * h * width * (1.0 / 6.0)


@inline
def step(t: float) -> float:
    """0 below t = 0, 1 above t = 1, smooth (C1) between."""
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)
