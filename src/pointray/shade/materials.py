"""Materials: how a surface reflects. Colours are linear RGB; None takes the points' own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..records import BASE_COLOR, DIFFUSE, EXPONENT, MATERIAL_KIND, MATERIAL_SIZE, OWN_COLOR, PHONG, SPECULAR
from .lights import rgb


def _record(kind: int, color: ArrayLike | None) -> NDArray[np.float64]:
    out = np.zeros(MATERIAL_SIZE)
    out[MATERIAL_KIND], out[OWN_COLOR] = kind, color is None
    out[BASE_COLOR : BASE_COLOR + 3] = 1.0 if color is None else rgb(color, "color")
    return out


@dataclass(frozen=True)
class Diffuse:
    """Reflects evenly: BRDF color / pi."""

    color: ArrayLike | None = None

    def record(self) -> NDArray[np.float64]:
        """The material as kernels read it, (8,) float64."""
        return _record(DIFFUSE, self.color)


@dataclass(frozen=True)
class Phong:
    """Diffuse with a highlight: BRDF (1 - specular) color / pi + specular (exponent + 2) / 2 pi cos^exponent.

    Parameters
    ----------
    color : float or (3,) float, optional
    specular : float
        Share of the light that the highlight reflects, 0 to 1.
    exponent : float
        How narrow the highlight is.
    """

    color: ArrayLike | None = None
    specular: float = 0.2
    exponent: float = 20

    def record(self) -> NDArray[np.float64]:
        """The material as kernels read it, (8,) float64."""
        if not 0 <= self.specular <= 1:
            raise ValueError(f"specular must lie between 0 and 1, not {self.specular!r}")
        if not 0 <= self.exponent < np.inf:
            raise ValueError(f"exponent must be finite and not negative, not {self.exponent!r}")
        out = _record(PHONG, self.color)
        out[SPECULAR], out[EXPONENT] = self.specular, self.exponent
        return out


Material = Diffuse | Phong
