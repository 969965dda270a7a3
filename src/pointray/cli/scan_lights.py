"""The lights of a scan, from the options --light and --fill."""

from __future__ import annotations

from typing import Any

from ..auto_view import HEADLIGHT, LOOKS, STUDIO
from .options import FILL, light_of


class ScanLights:
    """The lights of a scan, from the options --light and --fill. Raises ValueError if an option is invalid.

    Parameters
    ----------
    texts : list of str, or None
        Values of --light; None or empty: "studio", a key light, a weaker light from behind, and a sky.
    fill : float, optional
        Value of --fill: strength of the sky that is added to suns and point lights, as a share of a sun's light.

    Attributes
    ----------
    look : {"studio", "headlight"} or None
        None: suns, point lights or skies.
    """

    def __init__(self, texts: list[str] | None, fill: float | None) -> None:
        given = texts or [STUDIO]
        self.look = next((name for name in LOOKS if name in given), None)
        if self.look is not None and len(given) > 1:
            raise ValueError(f"--light {self.look} cannot be combined with other lights")
        self._lights = [] if self.look is not None else [light_of(text) for text in given]
        self._fill = _fill_of(fill, given, self.look is None)

    def make(self, middle: Any, up: Any, front: float | None = None) -> list[Any]:
        """Return the lights for `Scene.lights`; an empty list for the headlight.

        middle, up : (3,), middle and up direction of the scan
        front : azimuth in degrees of the view for which the key light of the default lights ("studio") is fixed;
            None: the key light follows the camera and is not baked
        """
        from ..auto_view import studio

        if self.look == HEADLIGHT:
            return []
        if self.look == STUDIO:
            return studio.studio(up, front)
        return [*(make(middle) for make in self._lights), *([studio.fill(self._fill, up)] if self._fill > 0 else [])]


def _fill_of(fill: float | None, texts: list[str], single: bool) -> float:
    """Return the strength of the sky that is added to the lights, as a share of a sun's light; ValueError if invalid.

    fill : value of --fill, None for the default; texts : values of --light, 0 is returned if one is a sky
    single : whether the lights are suns, point lights or skies; --fill is not for the studio or the headlight
    """
    if fill is not None and not 0 <= fill <= 1e6:
        raise ValueError(f"--fill must be a number from 0 to 1e6, not {fill}")
    if fill is not None and not single:
        raise ValueError("--fill requires --light sun or point")
    if any(text.startswith("sky") for text in texts):
        if fill:
            raise ValueError("--fill cannot be combined with --light sky")
        return 0.0
    return FILL if fill is None else fill
