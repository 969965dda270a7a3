"""`Spooled`: description of a cloud in columns on disk."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...base.arrays import Doubles
from ...base.disk_columns import Columns
from ...cloud.georeference import Georeference
from .raw import RAW

FACTS = "spooled"
POSITIONS, NORMALS, COLORS = "positions", "normals", "colors"
ATTRIBUTE = "attribute."  # followed by the number of the attribute


class Spooled(NamedTuple):
    """Description of a cloud in columns on disk.

    The columns are "positions", (n, 3) float32, optionally "normals" and "colors", and "attribute.0" and so on.

    Attributes
    ----------
    rows : int
        n, all of them finite.
    origin : (3,) float64
        World coordinates = origin + positions.
    georeference : Georeference
    attributes : list of str
        Names, in the order of the column numbers.
    normals, colors : bool
        Whether there are normals, (n, 3) float32, and colours, (n, 3) uint8.
    lost : int
        Number of rows left out because they are not finite.
    """

    rows: int
    origin: Doubles
    georeference: Georeference
    attributes: list[str]
    normals: bool
    colors: bool
    lost: int

    @property
    def facts(self) -> dict[str, Any]:
        """The fields as JSON values. The georeference is stored as "survey", its name in the first releases."""
        fields = {"survey" if name == "georeference" else name: value for name, value in self._asdict().items()}
        return {**fields, "origin": self.origin.tolist(), "survey": self.georeference.facts}


def spooled_in(columns: Columns) -> Spooled | None:
    """Return the description of the cloud in a folder of columns; None if there is none.

    Raise ValueError if the stored description is damaged.
    """
    facts = columns.get(FACTS)
    if facts is None:
        return None
    try:
        georeference, origin = Georeference(**facts["survey"]), np.array(facts["origin"], np.float64)
        others = {name: value for name, value in facts.items() if name not in ("survey", "origin")}
        return Spooled(**others, georeference=georeference, origin=origin)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{columns.folder / FACTS}.json: is damaged: {error}") from error


def clear(columns: Columns) -> None:
    """Remove all columns and files of a cloud on disk, finished or not, from the folder `columns`."""
    columns.drop(FACTS)
    for name in columns.names:
        if name in (POSITIONS, NORMALS, COLORS) or name.startswith((RAW, ATTRIBUTE)):
            columns.drop(name)
