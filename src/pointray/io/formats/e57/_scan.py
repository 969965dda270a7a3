"""Scans of an E57 file: their columns, poses and colour limits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ....base.arrays import Doubles
from .._source import Faults
from ._header import HEADER, Node, to_number, to_whole

CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
COLORS = ("colorRed", "colorGreen", "colorBlue")
INVALID_COLOR = "isColorInvalid"
NORMALS = ("normalX", "normalY", "normalZ")  # of the extension for surface normals, with any prefix
STATES = ("cartesianInvalidState", "sphericalInvalidState")
DTYPES = [np.dtype(kind) for kind in ("u1", "i1", "u2", "i2", "u4", "i4")]


class Field(NamedTuple):
    """A column of a scan.

    Attributes
    ----------
    name : str
        Its name in the file, with the prefix of an extension.
    dtype : dtype
        Type that holds all its values.
    bits : int
        Bits per value in the file.
    grid : (float, float) or None
        Scale and offset of scaled integers: value = scale * integer + offset.
    largest : float
        Largest integer or float that the file allows; for scaled integers the largest absolute integer.
    """

    name: str
    dtype: np.dtype[Any]
    bits: int
    grid: tuple[float, float] | None = None
    largest: float = 0.0


@dataclass(frozen=True)
class Scan:
    """A scan with points, as the XML section describes it.

    Attributes
    ----------
    index : int
        Number of the scan in the file, from 0.
    count, announced : int
        Maximum number of points in the file, and the announced number.
    fields : dict of str to Field
        Columns by name.
    rotation : (3, 3) float64
    station : (3,) tuple of float
        Scanner position: world = rotation @ point + station for a point in the coordinates of the scan.
    posed : bool
        Whether the file states a pose.
    turned : bool
        Whether the pose differs from the identity.
    scale : (3,) tuple of (float, float)
        For red, green and blue: the value of black, and 255 / (white - black).
    facts : dict
        Information for `pointray info`.
    """

    index: int
    count: int
    announced: int
    fields: dict[str, Field]
    rotation: Doubles
    station: tuple[float, float, float]
    posed: bool
    turned: bool
    scale: tuple[tuple[float, float], ...]
    facts: dict[str, Any]

    @property
    def bits(self) -> int:
        """Bits per row in the file, at least 1."""
        return max(sum(field.bits for field in self.fields.values()), 1)

    @property
    def places(self) -> tuple[str, ...]:
        """Names of the three columns with coordinates, cartesian or else spherical."""
        return CARTESIAN if set(CARTESIAN) <= self.fields.keys() else SPHERICAL

    def named(self, names: tuple[str, ...]) -> list[str]:
        """Return the columns with these names, whatever their namespace prefix; [] unless all exist."""
        found = {name.rpartition(":")[2]: name for name in reversed(self.fields)}
        return [found[name] for name in names] if found.keys() >= set(names) else []

    @property
    def normals(self) -> list[str]:
        return self.named(NORMALS)

    @property
    def colors(self) -> list[str]:
        return self.named(COLORS)

    @property
    def invalid_color(self) -> str:
        """Name of the column that marks rows without a colour; "" if there is none."""
        return next(iter(self.named((INVALID_COLOR,))), "")


def scans_of(root: Node, size: int, faults: Faults) -> list[Scan]:
    """Return the scans with points in the XML of a file of `size` bytes; raise ValueError if no scan has points.

    If they announce more points than the file can hold, their counts are reduced to what fits, or ValueError is raised
    if `faults.strict`.
    """
    nodes = list(root.find("data3D") or ())
    scans = [scan for k, node in enumerate(nodes) if (scan := _scan(node, k, size)) is not None]
    if not scans:
        raise ValueError(f"contains no points: {len(nodes)} scans found" + (", all empty" if nodes else ""))
    need = sum(scan.count * scan.bits for scan in scans)
    if need <= 8 * size:
        return scans
    if faults.strict:
        count = sum(scan.count for scan in scans)
        raise ValueError(f"is damaged: {count:,} points of {need // 8:,} bytes expected, {size:,} bytes found")
    return [replace(scan, count=max(min(scan.count, 8 * size // scan.bits), 1)) for scan in scans]


def _scan(node: Node, index: int, size: int) -> Scan | None:
    points = node.find("points")
    if points is None or points.attributes.get("type") != "CompressedVector":
        return None
    count, offset = to_whole(points, "recordCount"), to_whole(points, "fileOffset")
    if count == 0:
        return None
    if count < 0 or not HEADER.size <= offset < size:
        raise ValueError(f"is damaged: scan {index} announces {count:,} points from byte {offset:,} of {size:,}")
    fields = {field.name: field for child in points.find("prototype") or () if (field := _field(child)) is not None}
    if not (set(CARTESIAN) <= fields.keys() or set(SPHERICAL) <= fields.keys()):
        raise ValueError(f"scan {index} has no positions; available: {', '.join(fields) or 'none'}")
    rotation, station, posed = _pose(node, index)
    turned = bool(np.any(station) or (rotation != np.eye(3)).any())
    scale = tuple(_scale(node, name, fields[name]) for name in COLORS if name in fields)
    return Scan(
        index,
        count,
        count,
        fields,
        rotation,
        station,
        posed,
        turned,
        scale,
        _facts(node, count, fields, station if posed else None),
    )


def _field(node: Node) -> Field | None:
    """Return the column that an XML element describes; None for a text or a structure."""
    kind = node.attributes.get("type")
    if kind == "Float":
        single = node.attributes.get("precision", "double") == "single"
        largest = to_number(node.attributes.get("maximum", "inf"), f"maximum of {node.name}")
        return Field(node.name, np.dtype("f4" if single else "f8"), 32 if single else 64, None, largest)
    if kind not in ("Integer", "ScaledInteger"):
        return None
    low, high = to_whole(node, "minimum", -(2**63)), to_whole(node, "maximum", 2**63 - 1)
    if low > high:
        raise ValueError(f"is damaged: {node.name} has the limits {low} to {high}")
    bits = (high - low).bit_length()
    if kind == "Integer":
        fitting = (t for t in DTYPES if np.iinfo(t).min <= low and high <= np.iinfo(t).max)
        return Field(node.name, next(fitting, np.dtype("i8")), bits, None, float(high))
    scale, offset = (
        to_number(node.attributes.get(key, "1" if key == "scale" else "0"), f"{key} of {node.name}")
        for key in ("scale", "offset")
    )
    if not (np.isfinite((scale, offset)).all() and scale):
        raise ValueError(f"is damaged: {node.name} has the scale {scale} and the offset {offset}")
    return Field(node.name, np.dtype("f8"), bits, (scale, offset), float(max(abs(low), abs(high))))


def _pose(node: Node, index: int) -> tuple[Doubles, tuple[float, float, float], bool]:
    """Return the rotation of a scan, (3, 3), its translation, (3,), and whether the file states them.

    node : XML element of the scan; index : its number, for messages
    """
    pose = node.find("pose")
    if pose is None:
        return np.eye(3), (0.0, 0.0, 0.0), False
    w, x, y, z = (pose.number_at(f"rotation/{axis}", 0.0) for axis in "wxyz")
    a, b, c = (pose.number_at(f"translation/{axis}", 0.0) for axis in "xyz")
    length = float(np.linalg.norm((w, x, y, z)))
    if not np.isfinite((length, a, b, c)).all():
        raise ValueError(f"is damaged: the pose of scan {index} is not finite: {(w, x, y, z)}, {(a, b, c)}")
    if length == 0:  # written by programs without rotations
        return np.eye(3), (a, b, c), True
    w, x, y, z = w / length, x / length, y / length, z / length
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rotation), (a, b, c), True


def _scale(node: Node, name: str, field: Field) -> tuple[float, float]:
    """Return the value of black in a colour column of a scan, and 255 / (white - black).

    The limits should be those of the camera, but some programs write those of the image. Therefore white is rounded up
    to a full number of bits, so that an image of dark colours stays dark.

    node : XML element of the scan; name : of the column
    """
    low = node.number_at(f"colorLimits/{name}Minimum", 0.0)
    missing = field.largest * field.grid[0] + field.grid[1] if field.grid else field.largest
    high = node.number_at(f"colorLimits/{name}Maximum", missing)
    if not high < 2**32:  # no usable limits
        high = 255.0
    if low < 0:
        return low, 255 / (high - low) if high > low else 1.0
    if field.dtype.kind == "f":  # limits are often missing or wrong: the range is found from the values
        return 0.0, 1.0
    return 0.0, 255 / (2 ** max(int(np.ceil(high)).bit_length(), 8) - 1)


def _facts(node: Node, count: int, fields: dict[str, Field], station: tuple[float, ...] | None) -> dict[str, Any]:
    """Return what `pointray info` shows about a scan, by name; empty values are left out.

    node : XML element of the scan; count : number of points; station : scanner position, None without a pose
    """
    sensor = " ".join(filter(None, (node.text_at(f"sensor{part}") for part in ("Vendor", "Model", "SerialNumber"))))
    facts = {"name": node.text_at("name"), "guid": node.text_at("guid"), "sensor": sensor, "points": count}
    facts |= {"description": node.text_at("description"), "fields": list(fields)}
    if station is not None:
        facts["station"] = list(station)
        facts["rotation"] = [node.number_at(f"pose/rotation/{axis}", 0.0) for axis in "wxyz"]
    for box, name in (("intensityLimits", "intensity"), ("colorLimits", "colorRed")):
        if node.find(f"{box}/{name}Maximum") is not None:
            facts[box] = [node.number_at(f"{box}/{name}{end}", 0.0) for end in ("Minimum", "Maximum")]
    return {key: value for key, value in facts.items() if value}
