"""Points of PyVista's datasets."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import Any

import numpy as np

from ...cloud.georeference import Georeference
from ...cloud.points import Points
from ..files import read
from .columns import named_points
from .losses import free_name, package, warn_lost

ROLES = ("Normals", "RGB")  # names of arrays by which VTK's filters and writers find normals and colours
KEY = "georeference"  # of the field data: the georeference, as JSON


def points_of_dataset(dataset: Any) -> Points:
    """Return the points of a PyVista dataset, such as `pyvista.PolyData`, with all arrays of its point data."""
    arrays = {name: np.asarray(dataset.point_data[name]) for name in dataset.point_data}
    georeference = Georeference()
    if KEY in dataset.field_data:
        with suppress(ValueError, TypeError):
            georeference = Georeference(**json.loads(str(np.asarray(dataset.field_data[KEY]).ravel()[0])))
    return named_points(np.asarray(dataset.points), arrays, "PyVista dataset", georeference)


def points_of_blocks(blocks: Any) -> Points:
    """Return the points of all datasets in a `pyvista.MultiBlock`, with the arrays that all of them have."""
    return points_of_dataset(blocks.combine())


def read_dataset(path: str, **options: Any) -> Any:
    """Read a scan for `pyvista.read`, which finds this function by its entry point; return `pyvista.PolyData`.

    options : arguments of `pointray.read`, such as max_points
    """
    return to_pyvista(read(path, **options))


def to_pyvista(points: Points) -> Any:
    """Return points as `pyvista.PolyData`; see `Points.to_pyvista`."""
    pyvista = package("pyvista", "to_pyvista")
    lost: list[str] = []
    made = pyvista.PolyData(points.world if points.origin.any() else points.positions)
    if points.normals is not None:
        made.point_data[ROLES[0]] = points.normals
    if points.colors is not None:
        made.point_data[ROLES[1]] = points.colors
    for name, values in points.attributes.items():
        made.point_data[free_name(name, ROLES, lost)] = values
    if facts := points.georeference.facts:
        made.field_data[KEY] = [json.dumps(facts)]
    warn_lost("to_pyvista", lost)
    return made
