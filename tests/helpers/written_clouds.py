"""Clouds with all that files can store, to be written and read again."""

import warnings

import numpy as np

import pointray as pr
from pointray.io.files import write_points

N = 400
FAR = (512_350.0, 5_412_350.0, 250.0)  # the centre of 100 units beyond is far from where its rounding changes
STATIONS = ((512_340.25, 5_412_340.5, 251.0), (512_390.5, 5_412_300.125, 252.5), (512_300.0, 5_412_390.0, 260.0))


def all_dtypes(rng, n=N):
    """An attribute of each dtype, with its extremes."""
    found = {}
    for kind in ("u1", "i1", "u2", "i2", "u4", "i4", "i8", "u8"):
        limits = np.iinfo(kind)
        found[f"in_{kind}"] = rng.integers(limits.min, limits.max, n, kind, endpoint=True)
        found[f"in_{kind}"][:2] = limits.min, limits.max
    found["in_u8"] >>= np.uint64(1)  # E57 has signed integers only
    found["in_f4"] = rng.normal(size=n).astype(np.float32)
    found["in_f8"] = rng.normal(size=n) * 10.0 ** rng.integers(-12, 12, n)
    found["in_bool"] = rng.random(n) < 0.5
    return found


def rich_cloud(rng, n=N, at=FAR, **fields):
    """A cloud with normals, colours, attributes of all dtypes and an intensity, far from zero."""
    normals = rng.normal(size=(n, 3))
    given = {
        "normals": (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32),
        "colors": rng.integers(0, 256, (n, 3), np.uint8),
        "attributes": {"intensity": rng.integers(0, 65536, n).astype(np.uint16)} | all_dtypes(rng, n),
    }
    return pr.Points(rng.random((n, 3)) * 100 + at, **{**given, **fields})


def with_nan(points, rows):
    """The cloud with some rows that are not finite."""
    positions = points.positions.copy()
    positions[rows] = np.nan
    return points.changed(positions=positions)


def with_scans(points, rng, stations=STATIONS):
    """The cloud scanned from several positions, with its rows in the order of the scans."""
    scan = np.sort(np.arange(len(points)) % len(stations)).astype(np.int32)
    known = pr.Georeference(crs="EPSG:25832", unit="metre", stations=stations)
    return points.changed(attributes=points.attributes | {"scan": scan}, georeference=known)


def written(path, points):
    """Write points; return what the format cannot store, and the points that are read from the file."""
    losses = write_points(path, points)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return losses, pr.read(path)


def check_same(points, again, skip=(), rows=slice(None), dtypes=None):
    """Compare all arrays to the last bit.

    skip : attributes that are not compared; rows : of `points`, in the file
    dtypes : types of attributes that differ from those of `points`, by name
    """
    np.testing.assert_array_equal(again.positions, points.positions[rows])
    np.testing.assert_array_equal(again.origin, points.origin)
    for name in ("normals", "colors"):
        one, other = getattr(points, name), getattr(again, name)
        assert (one is None) == (other is None), name
        if one is not None:
            np.testing.assert_array_equal(other, one[rows])
    for name, values in points.attributes.items():
        if name not in skip:
            np.testing.assert_array_equal(again.attributes[name], values[rows], err_msg=name)
            wanted = np.dtype(np.uint8) if values.dtype == np.bool_ else values.dtype
            assert again.attributes[name].dtype == (dtypes or {}).get(name, wanted), name
