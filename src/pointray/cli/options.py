"""What the options' texts mean; ValueError says what is wrong with one."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import replace
from typing import Any

SUN = 3.0  # irradiance of a light without a strength
SAVED = ".pointray"  # how the name of a saved model ends


def numbers(text: str, name: str) -> tuple[float, float, float]:
    """`x,y,z`."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{name} must be three numbers like 0,-5,1.5, not {text!r}") from None
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError(f"{name} must be finite, not {text!r}")
    return x, y, z


def positive(value: float, name: str) -> float:
    """A finite number greater than 0."""
    if not 0 < value < math.inf:
        raise ValueError(f"{name} must be a positive number, not {value}")
    return value


def size_of(text: str) -> tuple[int, int]:
    """`640x480`."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise ValueError(f"--size must be like 640x480, not {text!r}") from None
    return width, height


def light_of(text: str) -> Callable[[Any], Any]:
    """`sun:dx,dy,dz` (direction of travel) or `point:x,y,z`, either with a strength behind another colon.

    Returns what makes the light, given the scan's middle: a point light without a strength is there as bright as a sun.
    """
    import pointray as pr

    kind, _, rest = text.partition(":")
    place, _, strength = rest.partition(":")
    if kind not in ("sun", "point"):
        raise ValueError(f"--light must be like sun:1,1,-2 or point:0,-3,4:20, not {text!r}")
    at = numbers(place, "--light")
    try:
        power = float(strength) if strength else None
    except ValueError:
        raise ValueError(f"--light: {strength!r} is no strength") from None
    if kind == "sun":
        sun = pr.SunLight(at, SUN if power is None else power)
        sun.record()  # raises what is wrong
        return lambda middle: sun
    pr.PointLight(at, power or 1.0).record()
    return lambda middle: pr.PointLight(at, SUN * math.dist(at, middle) ** 2 if power is None else power)


class View:
    """Where the camera is: where the options say, else where the whole scan is seen. Raises what is wrong at once."""

    def __init__(
        self,
        size: str,
        fov: float = 40.0,
        up: str = "0,0,1",
        eye: str | None = None,
        target: str | None = None,
        projection: str = "perspective",
        aperture: float = 0.0,
        focus: float | None = None,
    ) -> None:
        self.up = numbers(up, "--up")
        if not any(self.up):
            raise ValueError("--up must not be zero")
        self.size = size_of(size)
        self._eye = None if eye is None else numbers(eye, "--eye")
        self._target = None if target is None else numbers(target, "--target")
        if focus is not None and not aperture:
            raise ValueError("--focus is for --aperture, which is not given")
        self._lens: dict[str, Any] = {"fov": fov, "projection": projection, "aperture": aperture, "focus": focus}
        near = self._eye or (0.0, 0.0, 0.0)
        self.camera([near, [x + 1 + abs(x) for x in near]])  # some box that the eye is not in the middle of

    def camera(self, bounds: Any) -> Any:
        """The camera for a box."""
        from ..camera import Camera

        fov, projection = self._lens["fov"], self._lens["projection"]
        framed = Camera.frame(bounds, fov=fov, size=self.size, up=self.up, projection=projection)
        if self._eye is None and self._target is None:
            return replace(framed, **self._lens)
        target = self._target or [(low + high) / 2 for low, high in zip(*bounds, strict=True)]
        # Without an eye: as far away, and on the same side, as to frame the box.
        eye = self._eye or [e + a - t for e, a, t in zip(framed.eye, target, framed.target, strict=True)]
        return Camera.look_at(eye, target, self.up, size=self.size, **self._lens)


def ground_under(bounds: Any, up: tuple[float, float, float]) -> Any:
    """A plane under a box."""
    from ..instances import Plane

    return Plane([low if u >= 0 else high for u, low, high in zip(up, *bounds, strict=True)], up)


def use_threads(threads: int | None) -> int:
    """The number of threads, for all stages."""
    from ..jit import thread_count

    count = thread_count(threads)
    os.environ["POINTRAY_THREADS"] = str(count)
    return count
