"""The lights of a scan, from the options --light and --fill; and whether its light is baked without being asked for."""

from __future__ import annotations

from typing import Any

import typer

from ..auto_view import HEADLIGHT, LOOKS, STUDIO
from .options import FILL, Integrator, light_of

UNBAKED = ("glass",)  # materials that show little of what is baked


class ScanLights:
    """The lights of a scan. A wrong option raises ValueError.

    Parameters
    ----------
    texts : list of str, or None
        Texts of --light; none: the studio.
    fill : float, optional
        The sky's strength beside lights.
    """

    def __init__(self, texts: list[str] | None, fill: float | None) -> None:
        given = texts or [STUDIO]
        self.look = next((name for name in LOOKS if name in given), None)
        if self.look is not None and len(given) > 1:
            raise ValueError(f"--light {self.look} is alone: no other light goes with it")
        self._lights = [] if self.look is not None else [light_of(text) for text in given]
        self._fill = _fill_of(fill, given, self.look is None)

    def make(self, middle: Any, up: Any, front: float | None = None) -> list[Any]:
        """The lights of a scan.

        middle : (3,) the scan's
        front : azimuth in degrees of a viewer before whom the studio's key light stands still; None: it follows the
            camera, and is not baked
        """
        from ..auto_view import studio

        if self.look == HEADLIGHT:
            return []
        if self.look == STUDIO:
            return studio.studio(up, front)
        return [*(make(middle) for make in self._lights), *([studio.fill(self._fill, up)] if self._fill > 0 else [])]


def picture_options(context: typer.Context) -> dict[str, Any]:
    """All options of a command that makes pictures, with the integrator that they imply.

    `quick` among them: whether light is baked although nobody chose that.
    """
    options = dict(context.params)
    chosen = options["integrator"]
    if options["bake"] is not None and chosen not in (None, "baked"):
        raise ValueError(f"--bake is for --integrator baked, not {chosen.value}")
    quick = chosen is None and options["bake"] is None and _is_quick_look(options)
    baked = quick or options["bake"] is not None
    options["integrator"] = chosen or Integrator["baked" if baked else "phong"]
    return {**options, "quick": quick}


def _is_quick_look(options: dict[str, Any]) -> bool:
    """Whether light is baked although nobody chose an integrator: it is the studio's, and it is seen on the scan."""
    texts, material = options["light"] or [STUDIO], options.get("material", "own")
    return texts == [STUDIO] and options.get("color_by") is None and material not in UNBAKED


def _fill_of(fill: float | None, texts: list[str], single: bool) -> float:
    """The strength of the sky that is added to lights; 0 if one of them is a sky. single : whether there are any"""
    if fill is not None and not 0 <= fill <= 1e6:
        raise ValueError(f"--fill must be a number from 0 on, not {fill}")
    if fill is not None and not single:
        raise ValueError("--fill is for --light sun or point, which is not given")
    if any(text.startswith("sky") for text in texts):
        if fill:
            raise ValueError("--fill is for --light sun or point: there is a sky already")
        return 0.0
    return FILL if fill is None else fill
