"""`Points`: the point cloud that all stages share, with shape, dtype, unit and missing value of each array."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arguments import check_kind, check_mapping, vector
from ..base.deprecation import accept_renamed, warn_renamed
from .convertible import Convertible
from .georeference import SCAN, Georeference
from .shifting import shift_rows

FARTHEST = 1e12  # a coordinate beyond this is a scanner's 'no return' marker: its square is useless in float32
MOST = 2**31 - 1  # greatest number of rows: trees index them by int32
SAMPLE = 20_000  # rows from which the spacing is estimated
FAR = 16  # sizes of the cloud from zero beyond which doubles lose digits that an origin keeps
MOST_CATEGORIES = 32  # distinct values
FEWEST_ROWS = 10  # rows per category, on average: a few points with integer values prove nothing
LABELS = "classification", "point_source_id", SCAN  # names whose integers are always categories
MEASURES = "intensity", "reflectance", "reflectivity", "amplitude"  # names whose integers are never categories
MOST_LABELS = 256  # distinct labels: as many classes as LAS has
PROBE = 1000  # rows that are tested first
CHUNK = 1 << 20  # rows that are tested at a time
SPREAD, RANGES = 1 << 18, 256  # sampled rows of a mapped file, and the number of contiguous ranges they form


@dataclass(frozen=True, slots=True, init=False, repr=False, eq=False)
class Points(Convertible):
    """A point cloud, one row per point.

    Rows with a NaN or infinite position are kept, so that row numbers do not change; see `finite`.

    Parameters
    ----------
    positions : (n, 3) array_like, float or int
        World coordinates.
    normals : (n, 3) array_like, optional
        Stored as given: not normalised; zero or NaN where unknown.
    colors : (n, 3) or (n, 4) array_like, optional
        sRGB, uint8 (0 to 255), uint16 (0 to 65535) or float (0 to 1); alpha is dropped. Pass 8-bit values stored in
        uint16, as in some LAS files, as uint8.
    attributes : dict of str to (n,) or (n, k) array_like, optional
        Other values of each point: integers, floats or bools.
    origin : (3,) array_like, optional
        The point that stored positions are relative to. None: zero, unless float32 would lose a ten-thousandth of the
        spacing (maps: millions of metres), or digits of doubles that lie farther from zero than 16 times the cloud's
        size; then a rounded point near the centre.
    georeference : Georeference, optional
        Georeference: reference system, unit, scanner positions.

    Attributes
    ----------
    positions : (n, 3) float32
        C-contiguous, relative to `origin`: world = origin + positions.
    origin : (3,) float64
    normals : (n, 3) float32 or None
    colors : (n, 3) uint8 or None
    attributes : dict of str to (n,) or (n, k) array
        In the given dtypes, native byte order; floats of other than 4 or 8 bytes become float32 or float64.
    georeference : Georeference

    Raises
    ------
    TypeError
        If `attributes`, `origin` or `georeference` has the wrong type.
    ValueError
        If a shape, dtype or value is wrong, or no row has a finite position.

    Examples
    --------
    >>> points = pr.Points([[0, 0, 0], [1, 0, 0], [0, 1, 0]], attributes={"class": [2, 2, 6]})
    >>> len(points), points.positions.dtype, points.attributes["class"].tolist()
    (3, dtype('float32'), [2, 2, 6])
    >>> points.bounds.tolist()
    [[0.0, 0.0, 0.0], [1.0, 1.0, 0.0]]
    """

    positions: NDArray[np.float32]
    origin: NDArray[np.float64]
    normals: NDArray[np.float32] | None
    colors: NDArray[np.uint8] | None
    attributes: dict[str, NDArray[Any]]
    georeference: Georeference

    @accept_renamed("survey", "georeference")
    def __init__(
        self,
        positions: ArrayLike,
        normals: ArrayLike | None = None,
        colors: ArrayLike | None = None,
        attributes: Mapping[str, ArrayLike] | None = None,
        origin: ArrayLike | None = None,
        georeference: Georeference | None = None,
    ) -> None:
        world = _check_positions(positions)
        about = choose_origin(world) if origin is None else vector(origin, "origin")
        self._fill(_localise(world, about), about, normals, colors, attributes, georeference)

    @classmethod
    @accept_renamed("survey", "georeference")
    def about(
        cls,
        origin: ArrayLike,
        positions: NDArray[np.float32],
        normals: ArrayLike | None = None,
        colors: ArrayLike | None = None,
        attributes: Mapping[str, ArrayLike] | None = None,
        georeference: Georeference | None = None,
    ) -> Points:
        """Create points from positions that are already relative to an origin.

        Parameters
        ----------
        origin : (3,) array_like
            World coordinates.
        positions : (n, 3) float32
            Relative to the origin.
        normals : (n, 3) array_like, optional
            Stored as given.
        colors : (n, 3) or (n, 4) array_like, optional
            sRGB, uint8, uint16 or float (0 to 1); alpha is dropped.
        attributes : dict of str to (n,) or (n, k) array_like, optional
            Other values of each point.
        georeference : Georeference, optional
            Reference system, unit, scanner positions.

        Returns
        -------
        Points

        Raises
        ------
        TypeError
            If `attributes`, `origin` or `georeference` has the wrong type.
        ValueError
            If a shape, dtype or value is wrong, or no row has a finite position.

        Examples
        --------
        >>> points = pr.Points.about((500000, 5400000, 300), np.zeros((1, 3), np.float32))
        >>> points.world.tolist()
        [[500000.0, 5400000.0, 300.0]]
        """
        points = cls.__new__(cls)
        positions = _check_positions(positions)
        points._fill(
            _localise(positions, np.zeros(3)), vector(origin, "origin"), normals, colors, attributes, georeference
        )
        return points

    def _fill(
        self,
        positions: NDArray[np.float32],
        origin: NDArray[np.float64],
        normals: ArrayLike | None,
        colors: ArrayLike | None,
        attributes: Mapping[str, ArrayLike] | None,
        georeference: Georeference | None,
    ) -> None:
        n = len(positions)
        fields = {
            "positions": positions,
            "origin": origin,
            "normals": None if normals is None else _check_normals(normals, n),
            "colors": None if colors is None else _check_colors(colors, n),
            "attributes": _check_attributes(attributes, n),
            "georeference": Georeference()
            if georeference is None
            else check_kind(georeference, "georeference", Georeference, "a Georeference"),
        }
        for name, value in fields.items():
            object.__setattr__(self, name, value)
        if not (are_finite(positions[:PROBE]).any() or are_finite(positions).any()):
            check_any_finite(0, n)

    @property
    def crs(self) -> str | None:
        """The coordinate reference system, as well-known text or as a code like "EPSG:25832"; None if unknown."""
        return self.georeference.crs

    @property
    def survey(self) -> Georeference:
        """Deprecated alias of `georeference`: reference system, unit, scanner positions."""
        warn_renamed("Points.survey", "Points.georeference")
        return self.georeference

    @property
    def world(self) -> NDArray[np.float64]:
        """World coordinates, (n, 3) float64. A new array."""
        world = np.empty(self.positions.shape)
        shift_rows(self.positions, self.origin, world)
        return world

    @property
    def finite(self) -> NDArray[np.bool_]:
        """Mask of the rows with a usable position, neither NaN nor infinite nor beyond 1e12, (n,) bool."""
        return are_finite(self.positions)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Minimum and maximum world coordinates of the finite rows, (2, 3) float64."""
        finite = self.finite
        rows = self.positions if finite.all() else self.positions[finite]
        # Column by column: 1/8 of the time for rows of three.
        least, greatest = [column.min() for column in rows.T], [column.max() for column in rows.T]
        return np.stack([least, greatest]) + self.origin

    def select(self, rows: NDArray[np.integer[Any]] | NDArray[np.bool_]) -> Points:
        """Return some of the points, with the same origin.

        Parameters
        ----------
        rows : (m,) int or (n,) bool
            Indices, negative ones from the end, or a mask.

        Returns
        -------
        Points

        Raises
        ------
        ValueError
            If `rows` is neither indices nor a mask, an index is out of range, or no finite row is selected.

        Examples
        --------
        >>> points = pr.procedural("sphere", 1000)
        >>> upper = points.select(points.positions[:, 2] > 0)
        >>> bool(upper.bounds[0, 2] > 0)
        True
        """
        rows = _check_rows(rows, len(self))
        return Points.about(
            self.origin,
            self.positions[rows],
            None if self.normals is None else self.normals[rows],
            None if self.colors is None else self.colors[rows],
            {name: values[rows] for name, values in self.attributes.items()},
            self.georeference,
        )

    @accept_renamed("survey", "georeference")
    def changed(self, **fields: Any) -> Points:
        """Return the points with some arrays replaced; the other arrays are shared with the original.

        Parameters
        ----------
        **fields
            `positions` (n, 3) float32, relative to `origin`; `normals` (n, 3); `colors` (n, 3) or (n, 4); `attributes`,
            a dict of (n,) or (n, k) arrays; `georeference`.

        Returns
        -------
        Points

        Raises
        ------
        TypeError
            If another field is given.
        ValueError
            If a shape, dtype or value is wrong, or no row has a finite position.

        Examples
        --------
        >>> points = pr.procedural("sphere", 1000)
        >>> grey = points.changed(colors=np.full((1000, 3), 128, np.uint8))
        >>> grey.positions is points.positions
        True
        """
        kept = {name: getattr(self, name) for name in ("positions", "normals", "colors", "attributes", "georeference")}
        return Points.about(self.origin, **{**kept, **fields})

    def with_normals(self, normals: ArrayLike | None) -> Points:
        """Return the points with other normals; the other arrays are shared.

        Parameters
        ----------
        normals : (n, 3) array_like or None
            None: no normals.

        Returns
        -------
        Points

        Raises
        ------
        ValueError
            If the shape or dtype is wrong.

        Examples
        --------
        >>> points = pr.procedural("sphere", 1000)
        >>> inward = points.with_normals(-points.normals)
        >>> points.with_normals(None).normals is None
        True
        """
        return self.changed(normals=normals)

    def __len__(self) -> int:
        return len(self.positions)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickle and copy need: `Points.about` and the arrays, which are validated again."""
        arrays = self.origin, self.positions, self.normals, self.colors, self.attributes
        return Points.about, (*arrays, self.georeference)

    def __repr__(self) -> str:
        low, high = self.bounds
        size = " x ".join(f"{extent:.4g}" for extent in high - low)
        held = [name for name in ("normals", "colors") if getattr(self, name) is not None] + list(self.attributes)
        about = f", about ({', '.join(f'{x:.10g}' for x in self.origin)})" if self.origin.any() else ""
        return f"<Points: {len(self):,}, size {size}{about}, with {', '.join(held) or 'positions only'}>"


def check_count(n: int) -> None:
    """Raise a ValueError if a cloud of `n` points is too large for int32 row numbers, which trees use."""
    if n > MOST:
        raise ValueError(f"{n:,} points are too many: at most {MOST:,} are supported")


def _numbers(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return `values` as an array of ints, floats or bools; else raise a ValueError, whose text begins with `name`."""
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:  # rows of different lengths
        raise ValueError(f"{name} is not a regular array of numbers: {error}") from None
    if array.dtype.kind not in "biuf":
        raise ValueError(f"{name} must hold ints or floats, not {array.dtype} (shape {array.shape})")
    return array


def _check_positions(positions: ArrayLike) -> NDArray[Any]:
    world = _numbers(positions, "positions")
    if world.ndim != 2 or world.shape[1] != 3:
        raise ValueError(f"positions must have the shape (n, 3), not {world.shape}")
    if len(world) == 0:
        raise ValueError("positions holds no points: its shape is (0, 3)")
    check_count(len(world))
    return world


def _check_rows(rows: Any, n: int) -> NDArray[Any]:
    array = _numbers(rows, "rows")
    if array.ndim != 1 or array.dtype.kind == "f" or (array.dtype == bool and len(array) != n):
        raise ValueError(f"rows must be integers or a mask of {n:,}, not {array.dtype} of shape {array.shape}")
    if len(array) == 0 or (array.dtype == bool and not array.any()):
        raise ValueError("rows selects no points")
    if array.dtype != bool and (array.min() < -n or array.max() >= n):
        raise ValueError(f"rows must be from 0 to {n - 1}, not up to {array.max()}")
    return array


def _float32(array: NDArray[Any]) -> NDArray[np.float32]:
    """Convert an array to writable, C-contiguous float32, without a copy if possible; huge numbers become infinite."""
    with np.errstate(over="ignore"):  # too large a number becomes infinite: the row is not finite
        return _native(np.require(array, np.float32, ["C", "W", "A"]))


def _native(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array in native byte order with a dtype that says so: other libraries refuse an explicit "<"."""
    return array if array.dtype.byteorder in "=|" else array.view(array.dtype.newbyteorder("="))


def _localise(world: NDArray[Any], origin: NDArray[np.float64]) -> NDArray[np.float32]:
    if not origin.any():
        return _float32(world)
    local = np.empty(world.shape, np.float32)
    shift_rows(world, -origin, local)
    return local


def check_any_finite(finite: int, n: int) -> None:
    """Raise a ValueError if `finite`, the number of finite rows of a cloud of `n`, is 0."""
    if not finite:
        raise ValueError(f"positions: none of the {n:,} rows is finite and below {FARTHEST:g}")


def are_finite(positions: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which positions, (n, 3), are usable, (n,) bool: neither NaN nor infinite nor beyond 1e12."""
    x, y, z = positions.T
    limit = np.float32(FARTHEST)
    return np.asarray((np.abs(x) <= limit) & (np.abs(y) <= limit) & (np.abs(z) <= limit))


def choose_origin(world: NDArray[Any], count: int | None = None) -> NDArray[np.float64]:
    """Choose the point that float32 positions are stored relative to, (3,) float64, from world coordinates, (m, 3).

    It is zero, unless float32 about zero is too coarse for the point spacing or for the digits of doubles; then a
    rounded point near the centre.

    count : the number of points, if `world` holds only some of them
    """
    rows = world[:: -(-len(world) // SAMPLE)].astype(np.float64)
    rows = rows[(np.abs(rows) <= FARTHEST).all(axis=1) & rows.any(axis=1)]  # 0, 0, 0 marks a missing return
    if len(rows) == 0:
        return np.zeros(3)
    # The inner 96%: an outlier, often at 0, 0, 0, must not decide the size of the model.
    low, high = np.quantile(rows, [0.02, 0.98], axis=0)
    spacing = _spacing(high - low, count or len(world))
    distance = np.maximum(-low, high).max()
    is_exact = (rows.astype(np.float32) == rows).all()  # about an origin they could lose their last bit
    if distance * 2.0**-24 <= 1e-4 * spacing and (is_exact or distance <= FAR * (high - low).max()):
        return np.zeros(3)
    step = 10.0 ** np.floor(np.log10(max((high - low).max(), spacing)))
    return np.asarray(np.round((low + high) / 2 / step) * step)


def _spacing(size: NDArray[np.float64], n: int) -> float:
    """Return the point spacing if n points cover the six sides of a box; one unit if the box has no size.

    size : (3,) lengths of its edges
    """
    x, y, z = size
    area = x * y + y * z + z * x
    return float(np.sqrt(area / n) or size.max() / n or 1.0)


def _check_normals(normals: ArrayLike, n: int) -> NDArray[np.float32]:
    array = _numbers(normals, "normals")
    if array.shape != (n, 3):
        raise ValueError(f"normals must have the shape ({n}, 3), a row for each position, not {array.shape}")
    return _float32(array)


def _check_colors(colors: ArrayLike, n: int) -> NDArray[np.uint8]:
    array = _numbers(colors, "colors")
    if array.shape not in ((n, 3), (n, 4)):
        raise ValueError(f"colors must have the shape ({n}, 3) or ({n}, 4), a row for each position, not {array.shape}")
    array = array[:, :3]
    if array.dtype.kind == "f":
        good = (array >= 0) & (array <= 1)  # false for NaN
        if not good.all():
            row = int(np.flatnonzero(~good.all(axis=1))[0])
            raise ValueError(f"float colors must lie between 0 and 1; row {row} is {array[row].tolist()}")
        array = np.rint(array * 255).astype(np.uint8)
    if array.dtype == np.uint16:
        array = np.rint(array / np.float32(65535 / 255)).astype(np.uint8)
    if array.dtype != np.uint8:
        raise ValueError(f"colors must be uint8 (0 to 255), uint16 (0 to 65535) or float (0 to 1), not {array.dtype}")
    return np.require(array, np.uint8, ["C", "W"])


def _check_attributes(attributes: Mapping[str, ArrayLike] | None, n: int) -> dict[str, NDArray[Any]]:
    if attributes is None:
        return {}
    return {name: check_attribute(name, values, n) for name, values in check_mapping(attributes, "attributes").items()}


def check_attribute(name: str, values: ArrayLike, n: int) -> NDArray[Any]:
    """Return an attribute's values for n points, (n,) or (n, k), in the dtype that is stored; ValueError if invalid."""
    if not isinstance(name, str) or not name:
        raise ValueError(f"attributes: a name must be a non-empty string, not {name!r}")
    array = _numbers(values, f"attributes: attribute {name!r}")
    if array.ndim not in (1, 2) or len(array) != n:
        raise ValueError(
            f"attributes: attribute {name!r} must have the shape ({n},) or ({n}, k), one row per position, "
            f"not {array.shape}"
        )
    dtype = array.dtype.newbyteorder("=")
    if dtype.kind == "f" and dtype not in (np.float32, np.float64):
        dtype = np.dtype(np.float32 if dtype.itemsize < 4 else np.float64)
    return _native(np.require(array, dtype, ["C", "W", "A"]))


def spread_rows(n: int, most: int = SPREAD) -> NDArray[np.int64]:
    """Return at most `most` of n rows, in evenly spaced ranges, for a sample that reads few pages of a mapped file."""
    if n <= most:
        return np.arange(n)
    each = most // RANGES
    starts = np.linspace(0, n - each, RANGES).astype(np.int64)
    return np.asarray((starts[:, None] + np.arange(each)).reshape(-1))


def is_label(name: str) -> bool:
    """Return whether integers in an attribute of this name are categories, as in "classification" or "scan"."""
    return _plain(name) in LABELS


def _plain(name: str) -> str:
    """Return an attribute's name in lower case, without the prefix "scalar_" that CloudCompare adds."""
    return name.lower().removeprefix("scalar_")


def categories_of(values: NDArray[Any], name: str = "") -> tuple[int, ...] | None:
    """Return the categories of a column: its distinct values, if it holds bools or few different integers; else None.

    values : (n,) or (n, k)
    name : of the attribute; labels such as "classification" may have more values and fewer points, and measures such as
        "intensity" have no categories
    """
    if values.ndim != 1 or _plain(name) in MEASURES:
        return None
    sure = values.dtype == np.bool_ or is_label(name)
    most, found = MOST_LABELS if sure else MOST_CATEGORIES, values[:0]
    chunks = (values[start : start + CHUNK] for start in range(0, len(values), CHUNK))
    for rows in itertools.chain([values[:: max(len(values) // PROBE, 1)]], chunks):
        if rows.dtype.kind == "f" and not (np.isfinite(rows).all() and (rows == np.rint(rows)).all()):
            return None
        found = np.union1d(found, rows)
        if len(found) > most:
            return None
    if not sure and len(values) < FEWEST_ROWS * len(found):
        return None
    return tuple(found.tolist() if values.dtype == np.bool_ else map(int, found))
