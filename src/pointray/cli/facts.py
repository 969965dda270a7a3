"""pointray info: facts about files, coordinates and attributes; those about points are in `report`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cloud.georeference import Georeference
from ..cloud.points import Points
from ..io.inputs import stamp
from ..io.remote.remote_file import Location
from ..shade.attributes import ASPRS, is_classification
from .report import describe, describe_model
from .scan_files import ScanFiles, read_scan
from .waiting import Progress, in_background

MOST_CLASSES = 256  # values of a byte


def describe_all(scan: ScanFiles, deep: bool) -> dict[str, Any]:
    """Return all facts that `info` prints about a scan or a saved model, as JSON values.

    deep : whether to search the neighbours of all points, which is slow for large clouds
    """
    with Progress() as progress:
        progress.show("reading", 0.0)
        points, model = in_background(lambda: read_scan(scan, progress.show))
        progress.show("looking", 0.0)
        files = in_background(lambda: describe_files(scan))
        facts = in_background(lambda: describe(points, deep, partial(progress.show, "looking")))
        ranges = in_background(lambda: describe_attributes(points))
        picture = in_background(lambda: describe_picture(points))
    formats = dict.fromkeys(file["format"] for file in files)
    head = {"file": scan.name, "format": ", ".join(formats), **describe_georeference(points.georeference)}
    of_model = {} if model is None else describe_model(model)
    return {**head, **facts, "ranges": ranges, **of_model, "files": files, "first_picture": picture}


def describe_picture(points: Points) -> dict[str, Any]:
    """Return what `render` would choose automatically for a scan, as JSON values.

    These are the up direction and the view, with the reasons, colours, normals, and points left out of the view.
    """
    from ..auto_view.first_view import Scan, ViewChoice

    scan = Scan(points, ViewChoice())
    up = scan.found_up
    assert up is not None  # it is automatic
    color = "from the file" if points.colors is not None else "none: shown in grey"
    facts: dict[str, Any] = {
        "up": f"{up.axis if up.axis.startswith('-') else f'+{up.axis}'} ({up.why})",
        "view": scan.outlook.kind,
    }
    facts |= {"azimuth": scan.outlook.azimuth, "elevation": scan.outlook.elevation, "colors": color}
    normals = "estimated" if points.normals is None else "from the file, if they fit the surface"
    return {**facts, "normals": normals, "ignored": scan.ignored}


def describe_files(scan: ScanFiles) -> list[dict[str, Any]]:
    """Return facts from the headers of a scan's files, one dict per file: file, format, bytes, rows and others.

    rows is None if their number is unknown before the file is read. For a saved model there are no rows.
    """
    if scan.saved is not None:
        return [{"file": str(scan.saved), "format": "saved model", "bytes": _bytes_of(scan.saved)}]
    return list(_headers(scan))


def _bytes_of(saved: Location) -> int:
    """Return the size in bytes of a saved model; for a model in parts, of all its files."""
    files = saved.iterdir() if isinstance(saved, Path) and saved.is_dir() else [saved]
    return sum(stamp(file)[0] for file in files)


def _headers(scan: ScanFiles) -> Iterator[dict[str, Any]]:
    from ..io.files import headers

    for file, format, listing in headers(scan.files, scan.reading.request):
        known = {"file": str(file), "format": format.name, "bytes": stamp(file)[0], "rows": listing.count}
        yield {**known, **{name: value for name, value in listing.facts.items() if name not in known}}


def describe_georeference(georeference: Georeference) -> dict[str, Any]:
    """Return a cloud's coordinate system with name and unit, its resolution and scanner positions, as JSON values."""
    return {
        "crs": georeference.crs,
        "crs_name": None if georeference.crs is None else crs_name(georeference.crs),
        "unit": georeference.unit,
        "projection": georeference.projection,
        "scale": None if georeference.scale is None else list(georeference.scale),
        "stations": [list(station) for station in georeference.stations],
    }


def crs_name(crs: str) -> str:
    """Return the name of a coordinate system in well-known text (WKT), its first quoted string.

    Other descriptions, such as "EPSG:25832", are returned unchanged.
    """
    found = re.search(r'"([^"]+)"', crs)
    return found[1] if found and "[" in crs[: found.start()] else crs


def describe_attributes(points: Points) -> dict[str, dict[str, Any]]:
    """Return dtype and exact minimum and maximum ("low", "high") of each attribute by name.

    Minimum and maximum are lists for an attribute with several numbers per point.

    NaN and infinite values are ignored; "not_finite" counts them. Attributes of LAS classes have "counts" by class.
    """
    return {name: _describe(name, points.attributes[name]) for name in sorted(points.attributes)}


def _describe(name: str, values: NDArray[Any]) -> dict[str, Any]:
    columns = values.T if values.ndim == 2 else [values]
    ends = [_ends(column) for column in columns]
    low, high = ([end[k] for end in ends] for k in range(2))
    is_one = values.ndim == 1
    facts = {"dtype": str(values.dtype), "low": low[0] if is_one else low, "high": high[0] if is_one else high}
    if values.dtype.kind == "f":
        lost = values.size - int(np.isfinite(values).sum())
        facts |= {"not_finite": lost} if lost else {}
    if is_one and is_classification(name):
        found, counts = np.unique(values, return_counts=True)
        if len(found) <= MOST_CLASSES and (np.isfinite(found) & (found == np.rint(found))).all():
            facts["counts"] = {str(int(x)): count for x, count in zip(found, counts.tolist(), strict=True)}
    return facts


def _ends(values: NDArray[Any]) -> tuple[Any, Any]:
    """Return the minimum and maximum of the finite values as Python numbers; None if no value is finite."""
    if values.dtype.kind == "f":
        low, high = np.fmin.reduce(values), np.fmax.reduce(values)  # ignores NaN, without copies
        if not (np.isfinite(low) and np.isfinite(high)):
            finite = values[np.isfinite(values)]
            if not len(finite):
                return None, None
            low, high = finite.min(), finite.max()
    else:
        low, high = values.min(), values.max()
    return low.item(), high.item()


def class_name(value: str) -> str:
    """Return the name of the LAS class with this number, such as "ground" for "2"; "unnamed" if it has none."""
    return ASPRS[int(value)][0] if int(value) in ASPRS else "unnamed"
