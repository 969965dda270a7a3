"""Smooth minimum and step, because the surface must have a normal everywhere."""

from __future__ import annotations

from ..engine.jit import inline


@inline
def blend(a: float, b: float, width: float) -> float:
    """Return the minimum of a and b, smooth (C2) where they differ by less than the width; never above the minimum."""
    h = max(width - abs(a - b), 0.0) / width
    return min(a, b) - h * h * h * width * (1.0 / 6.0)


@inline
def step(t: float) -> float:
    """Return 0 below t = 0, 1 above t = 1, and a smooth (C1) transition between: smoothstep."""
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)
