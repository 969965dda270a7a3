"""The lights of a scan, from the options --light and --fill."""

from __future__ import annotations

from typing import Any

from ..auto_view import HEADLIGHT, LOOKS, STUDIO
from .options import FILL, light_of


class ScanLights:
    """The lights of a scan. Raises ValueError if an option is invalid.

    Parameters
    ----------
    texts : list of str, or None
        Values of --light; None or empty: the studio.
    fill : float, optional
        Strength of the sky that is added to lights.
    """

    def __init__(self, texts: list[str] | None, fill: float | None) -> None:
        given = texts or [STUDIO]
        self.look = next((name for name in LOOKS if name in given), None)
        if self.look is not None and len(given) > 1:
            raise ValueError(f"--light {self.look} cannot be combined with other lights")
        self._lights = [] if self.look is not None else [light_of(text) for text in given]
        self._fill = _fill_of(fill, given, self.look is None)

    def make(self, middle: Any, up: Any, front: float | None = None) -> list[Any]:
        """Return the lights of a scan.

        middle : (3,) middle of the scan
        front : azimuth in degrees of the view for which the studio's key light is fixed; None: the key light follows
            the camera and is not baked
        """
        from ..auto_view import studio

        if self.look == HEADLIGHT:
            return []
        if self.look == STUDIO:
            return studio.studio(up, front)
        return [*(make(middle) for make in self._lights), *([studio.fill(self._fill, up)] if self._fill > 0 else [])]


def _fill_of(fill: float | None, texts: list[str], single: bool) -> float:
    """Return the strength of the sky that is added to lights, 0 if one is a sky. single : whether there are lights"""
    if fill is not None and not 0 <= fill <= 1e6:
        raise ValueError(f"--fill must be a number from 0 to 1e6, not {fill}")
    if fill is not None and not single:
        raise ValueError("--fill requires --light sun or point")
    if any(text.startswith("sky") for text in texts):
        if fill:
            raise ValueError("--fill cannot be combined with --light sky")
        return 0.0
    return FILL if fill is None else fill
