"""`Layers`, the result of `render_layers`, and its conversion to a dataset of xarray."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene.hit_tables import require_package
from .camera import Camera

# Name of the last axis, its coordinates, unit and description of each layer.
ABOUT: dict[str, tuple[str, tuple[str, ...], str, str]] = {
    "radiance": ("channel", ("red", "green", "blue", "alpha"), "W m-2 sr-1", "linear RGB, premultiplied, and alpha"),
    "depth": ("", (), "scene units", "distance along the view, in a panorama from the eye; inf for a miss"),
    "normal": ("axis", ("x", "y", "z"), "1", "unit normal in world space; 0 for a miss"),
    "position": ("axis", ("x", "y", "z"), "scene units", "world position; NaN for a miss"),
    "albedo": ("band", ("red", "green", "blue"), "1", "linear colour of the surface; 0 for a miss"),
    "instance": ("", (), "1", "number of the instance; -1 for a miss"),
    "point": ("", (), "1", "row in the model's points; -1 for planes and for a miss"),
}


class Layers(dict[str, NDArray[Any]]):
    """Layers of an image by name, as `render_layers` returns them: a dict of arrays.

    Attributes
    ----------
    camera : Camera

    Examples
    --------
    >>> scene = pr.Scene()
    >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
    >>> layers = pr.render_layers(scene, pr.frame(scene, size=(32, 24)))
    >>> isinstance(layers, dict), layers.camera.size
    (True, (32, 24))
    """

    camera: Camera

    def __init__(self, layers: Mapping[str, NDArray[Any]], camera: Camera) -> None:
        super().__init__(layers)
        self.camera = camera

    def __reduce__(self) -> tuple[Any, ...]:
        return Layers, (dict(self), self.camera)

    def to_xarray(self) -> Any:
        """Return the layers as a dataset with labelled axes.

        Returns
        -------
        xarray.Dataset
            A variable for each layer. Its axes are `y` and `x`, with the pixels' centres as coordinates, in pixels from
            the upper left corner (0.5, 1.5, ...), and `channel`, `axis` or `band` with the names of components. Each
            variable has the attributes `units` and `long_name`, the dataset those of the camera (`camera_eye`, ...).
            The arrays are shared, not copied.

        Raises
        ------
        ImportError
            If xarray is not installed.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> data = pr.render_layers(scene, pr.frame(scene, size=(32, 24))).to_xarray()
        >>> dict(data.depth.sizes), int(data.instance.sel(x=16, y=12, method="nearest"))
        ({'y': 24, 'x': 32}, 0)
        """
        xarray = require_package("xarray", "Layers.to_xarray")
        width, height = self.camera.size
        about = {"units": "pixels"}
        coordinates: dict[str, Any] = {
            "y": ("y", np.arange(height) + 0.5, {**about, "long_name": "row of the image, downwards"}),
            "x": ("x", np.arange(width) + 0.5, {**about, "long_name": "column of the image"}),
        }
        variables = {}
        for name, values in self.items():
            axis, labels, units, meaning = ABOUT.get(name, ("", (), "", name))
            axes = ("y", "x", axis) if axis else ("y", "x", *(f"{name}_{k}" for k in range(values.ndim - 2)))
            variables[name] = (axes, values, {"units": units, "long_name": meaning})
            if axis:
                coordinates[axis] = list(labels)
        # Attributes of a file are numbers, texts and arrays of these.
        camera = {f"camera_{key}": value for key, value in asdict(self.camera).items() if value is not None}
        return xarray.Dataset(variables, coordinates, camera)
