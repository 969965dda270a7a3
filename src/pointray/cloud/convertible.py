"""Methods of `Points` that return objects of other libraries; the conversions themselves are in `io/exchange/`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..base.arguments import check_flag
from ..base.registered import registered


class Convertible:
    """Methods of `Points` that return its data as objects of other libraries."""

    __slots__ = ()

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return world coordinates as a new array, (n, 3), float64 unless another dtype is given."""
        if copy is False:
            raise ValueError("Points as an array: a copy is needed, as positions are stored relative to an origin")
        world = self.world  # type: ignore[attr-defined]  # of Points
        return np.asarray(world) if dtype is None else np.asarray(world, dtype)

    def to_open3d(self, legacy: bool = False) -> Any:
        """Return the points as a point cloud of Open3D.

        Parameters
        ----------
        legacy : bool
            Whether to return an `open3d.geometry.PointCloud`, which holds positions, normals and colours only.

        Returns
        -------
        open3d.t.geometry.PointCloud or open3d.geometry.PointCloud
            Float64 world coordinates; float32, without a copy, if `origin` is zero. Attributes of (n,) become (n, 1). A
            warning names what it cannot store: coordinate system, unit, scanner positions.

        Raises
        ------
        TypeError
            If `legacy` is no bool.
        ImportError
            If Open3D is not installed.

        Examples
        --------
        >>> cloud = pr.procedural("sphere", 1000).to_open3d()
        >>> len(pr.as_points(cloud))
        1000
        """
        return registered("exchange").to_open3d(self, check_flag(legacy, "legacy"))

    def to_pyvista(self) -> Any:
        """Return the points as a PyVista dataset.

        Returns
        -------
        pyvista.PolyData
            A vertex for each point. Normals are the point data "Normals", colours "RGB"; the field data "georeference"
            is the georeference as JSON. Float64 world coordinates; float32 if `origin` is zero.

        Raises
        ------
        ImportError
            If PyVista is not installed.

        Examples
        --------
        >>> mesh = pr.procedural("sphere", 1000).to_pyvista()
        >>> mesh.n_points
        1000
        """
        return registered("exchange").to_pyvista(self)

    def to_laspy(self) -> Any:
        """Return the points as laspy's object, with the dimensions and the coordinate system of a LAS file.

        Returns
        -------
        laspy.LasData
            As `write` stores it: integers with the scale of the points' file, or a fine one, attributes as dimensions
            or extra bytes. A warning names what LAS cannot store. Rows without a finite position are left out.

        Raises
        ------
        ValueError
            If LAS cannot store the points.

        Examples
        --------
        >>> data = pr.procedural("sphere", 1000).to_laspy()
        >>> len(data.points)
        1000
        """
        return registered("exchange").to_laspy(self)

    def to_pandas(self) -> Any:
        """Return the points as a table of pandas.

        Returns
        -------
        pandas.DataFrame
            Columns x, y, z (float64 world coordinates), nx, ny, nz, red, green, blue, and the attributes with their
            dtypes; an attribute of (n, k) becomes k columns name_0, name_1, ... `DataFrame.attrs` holds the
            georeference, from which `as_points` restores it.

        Raises
        ------
        ImportError
            If pandas is not installed.

        Examples
        --------
        >>> table = pr.procedural("sphere", 1000).to_pandas()
        >>> table.shape[0], list(table.columns[:3])
        (1000, ['x', 'y', 'z'])
        """
        return registered("exchange").to_pandas(self)

    def to_structured(self) -> NDArray[Any]:
        """Return the points as a structured array.

        Returns
        -------
        (n,) structured array
            Fields x, y, z (float64 world coordinates), nx, ny, nz (float32), red, green, blue (uint8), and the
            attributes with their dtypes and widths. A warning names what it cannot store: coordinate system, unit,
            scanner positions.

        Examples
        --------
        >>> rows = pr.procedural("sphere", 1000).to_structured()
        >>> rows.shape, rows.dtype["x"]
        ((1000,), dtype('float64'))
        """
        return registered("exchange").to_structured(self)
