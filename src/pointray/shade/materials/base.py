"""Base class of materials. Parameters are validated on construction."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ...base.arguments import reflectance
from ...base.arrays import Doubles
from ...engine.kernels.records import BASE_COLOR, MATERIAL_KIND, MATERIAL_SIZE, OWN_COLOR
from ..attributes import Attribute

Color = ArrayLike | Attribute | None


def record_of(kind: int, color: Color, name: str = "color") -> Doubles:
    """Return the record for kernels of a material, (10,) float64, with kind and colour set; validate the colour.

    kind : such as `records.DIFFUSE`; color : 0 to 1, None or an Attribute for the surface's own; name : for messages
    """
    out = np.zeros(MATERIAL_SIZE)
    out[MATERIAL_KIND], out[OWN_COLOR] = kind, color is None or isinstance(color, Attribute)
    out[BASE_COLOR : BASE_COLOR + 3] = reflectance(1.0 if out[OWN_COLOR] else color, name)
    return out


class Material:
    """Base class of materials, which define how a surface scatters light."""

    def __post_init__(self) -> None:
        self.record()

    def record(self) -> Doubles:
        """Return the material's record for kernels, (10,) float64, see `records.MATERIAL_SIZE`.

        Raises
        ------
        ValueError
            If a parameter is out of range.
        """
        raise NotImplementedError

    @property
    def attribute(self) -> Attribute | None:
        """Attribute of the points that colours the material, or None."""
        color = getattr(self, "base_color", getattr(self, "color", None))
        return color if isinstance(color, Attribute) else None
