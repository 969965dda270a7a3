"""Small files of every format that is read, for attacks: by the encoders of the formats' own tests, or other libraries.

A library that is absent leaves out its formats.
"""

from __future__ import annotations

import gzip
import io
import struct
import warnings
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import pointray as pr
from helpers.splat_files import cloud
from pointray.io.known_formats import written

ROWS = 200


def small_scans(folder: Path) -> dict[str, list[Path]]:
    """Files of each kind, by the kind's name, in the folder."""
    makers: dict[str, tuple[str, Callable[[Path], Iterator[Path]]]] = {
        "las": ("laspy", _las),
        "laz": ("lazrs", _laz),
        "copc": ("lazrs", _copc),
        "e57": ("pye57", _e57),
        "obj": ("trimesh", lambda folder: _mesh(folder, "obj")),
        "stl": ("trimesh", lambda folder: _mesh(folder, "stl", "ascii.stl")),
        "glb": ("trimesh", lambda folder: _mesh(folder, "glb")),
        "off": ("trimesh", lambda folder: _mesh(folder, "off")),
        "ply": ("numpy", lambda folder: _written(folder, ".ply")),
        "npy": ("numpy", lambda folder: _written(folder, ".npy")),
        "npz": ("numpy", lambda folder: _written(folder, ".npz")),
        "gaussians": ("plyfile", _gaussians),
        "spz": ("backports.zstd", _spz),
        "splat": ("numpy", _splat),
        "pcd": ("numpy", _pcd),
        "glb-points": ("numpy", _glb),
        "text": ("numpy", _text),
        "ptx": ("numpy", _ptx),
        "kitti": ("numpy", _kitti),
        "depth": ("numpy", _depth),
        "colmap": ("numpy", _colmap),
    }
    found: dict[str, list[Path]] = {}
    for kind, (module, make) in makers.items():
        if _there(module):
            (folder / kind).mkdir(parents=True, exist_ok=True)
            found[kind] = list(make(folder / kind))
    (folder / "packed").mkdir(exist_ok=True)
    found["packed"] = list(_packed(folder / "packed", [files[0] for kind, files in found.items() if kind != "e57"]))
    return found


def _there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def full_points(attributes: bool = True) -> pr.Points:
    """Points with all that formats keep."""
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(ROWS, 3))
    named = {
        "classification": rng.integers(0, 9, ROWS).astype(np.uint8),
        "intensity": rng.integers(0, 65536, ROWS).astype(np.uint16),
        "gps_time": rng.random(ROWS) + 3e8,
        "height_above_ground": rng.random(ROWS).astype(np.float32),
    }
    return pr.Points(
        rng.random((ROWS, 3)) + [500_000, 5_400_000, 100],
        (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32),
        rng.integers(0, 256, (ROWS, 3)).astype(np.uint8),
        named if attributes else {},
        georeference=pr.Georeference("EPSG:25832"),
    )


def _written(folder: Path, extension: str) -> Iterator[Path]:
    for attributes in (True, False) if extension in written() else ():
        path = folder / f"own-{int(attributes)}{extension}"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # not all formats keep all
            pr.write(path, full_points(attributes))
        yield path


def _las(folder: Path) -> Iterator[Path]:
    from helpers.las_files import write_random

    yield from _written(folder, ".las")
    for version, format in (("1.2", 3), ("1.4", 7), ("1.3", 5)):
        path = folder / f"{version}-{format}.las"
        write_random(path, version, format, ROWS)
        yield path


def _laz(folder: Path) -> Iterator[Path]:
    from helpers.las_files import write_random

    yield from _written(folder, ".laz")
    for version, format in (("1.2", 3), ("1.4", 7), ("1.4", 10)):
        path = folder / f"{version}-{format}.laz"
        write_random(path, version, format, ROWS)
        yield path


def _copc(folder: Path) -> Iterator[Path]:
    """An octree of three nodes, byte by byte."""
    import laspy
    import lazrs

    yield from _written(folder, ".copc.laz")
    rng, rows, nodes = np.random.default_rng(4), 90, [(0, 0, 0, 0), (1, 0, 0, 0), (1, 1, 1, 1)]
    las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=7))
    las.x, las.y, las.z = rng.random((3, rows)) * 100
    stream = io.BytesIO()
    las.write(stream)
    plain = stream.getvalue()
    (start,), points = struct.unpack_from("<I", plain, 96), las.points.array.tobytes()
    vlr = lazrs.LazVlr.new_for_compression(7, 0, True)
    record = bytes(vlr.record_data())
    data = io.BytesIO()
    first = 375 + 54 + 160 + 54 + len(record)
    data.write(bytes(first))
    compressor = lazrs.LasZipCompressor(data, vlr)
    places = [first + 8]
    for k in range(3):
        compressor.compress_many(points[k * len(points) // 3 : (k + 1) * len(points) // 3])
        if k < 2:
            compressor.finish_current_chunk()
            places.append(data.tell())
    compressor.done()
    (table,) = struct.unpack_from("<q", data.getvalue(), first)
    places.append(table)
    end = len(data.getvalue())
    entries = b"".join(
        struct.pack("<4iQii", *node, places[k], places[k + 1] - places[k], rows // 3) for k, node in enumerate(nodes)
    )
    info = struct.pack("<5d2Q2d", 50, 50, 50, 50, 10, end + 60, len(entries), 0, 0).ljust(160, b"\0")
    out = bytearray(data.getvalue())
    out[:375] = plain[:375]
    struct.pack_into("<II", out, 96, first, 2)
    out[104] = plain[104] | 0x80
    struct.pack_into("<QI", out, 235, end, 1)
    out[375:first] = b"".join(
        struct.pack("<H16sHH32s", 0, user, number, len(content), b"") + content
        for user, number, content in ((b"copc", 1, info), (b"laszip encoded", 22204, record))
    )
    out += struct.pack("<H16sHQ32s", 0, b"copc", 1000, len(entries), b"") + entries
    assert start >= 375
    (folder / "a.copc.laz").write_bytes(out)
    yield folder / "a.copc.laz"


def _e57(folder: Path) -> Iterator[Path]:
    from helpers import e57_files as own

    yield from _written(folder, ".e57")
    columns = own.xyz_columns()
    yield own.save(folder / "bare.e57", (columns, {}))
    normals = {f"nor:normal{a}": own.Column(c, "single") for a, c in zip("XYZ", own.NORMALS.T, strict=True)}
    colors = {f"color{n}": own.Column(c, "int") for n, c in zip(["Red", "Green", "Blue"], own.RGB.T, strict=True)}
    scaled = {
        f"cartesian{a}": own.Column(c, "scaled", -5000, 5000, (0.001, 0.0))
        for a, c in zip("XYZ", own.XYZ.T, strict=True)
    }
    yield own.save(folder / "full.e57", (columns | normals, own.pose()), (scaled | colors, own.pose(at=(1, 2, 3))))


def _mesh(folder: Path, *kinds: str) -> Iterator[Path]:
    from helpers import mesh_files as own

    for kind in kinds:
        yield own.save(folder, own.trimesh.creation.icosphere(2, radius=3.0), kind)


def _gaussians(folder: Path) -> Iterator[Path]:
    from helpers import gaussian_files as own

    yield own.save(folder / "trained.ply", own.trained(cloud(ROWS)))
    yield own.save(folder / "text.ply", own.trained(cloud(ROWS)), text=True)
    path = folder / "compressed.ply"
    path.write_bytes(own.packed(cloud(300)))
    yield path


def _spz(folder: Path) -> Iterator[Path]:
    from helpers import spz_files as own

    for version in (1, 2, 3, 4):
        made, path = cloud(ROWS), folder / f"{version}.spz"
        path.write_bytes(own.packed(made, 1) if version == 4 else gzip.compress(own.plain(made, version, 1)))
        yield path


def _splat(folder: Path) -> Iterator[Path]:
    from helpers import spz_files as own

    (folder / "a.splat").write_bytes(own.rows(cloud(ROWS)))
    yield folder / "a.splat"


def _glb(folder: Path) -> Iterator[Path]:
    yield from _written(folder, ".glb")


def _pcd(folder: Path) -> Iterator[Path]:
    from helpers import pcd_files as own

    yield from _written(folder, ".pcd")
    for encoding in own.ENCODINGS:
        yield own.save(folder / f"{encoding}.pcd", encoding=encoding)


def _text(folder: Path) -> Iterator[Path]:
    from helpers import text_files as own

    yield from _written(folder, ".csv")
    yield own.save(folder / "a.xyz", own.XYZ, own.RGB)
    yield own.save(folder / "b.csv", own.XYZ, own.NORMALS, header="x,y,z,nx,ny,nz\n", separator=",")
    yield own.save(folder / "c.txt", own.XYZ, own.INTENSITY, separator=";", decimal=",")
    yield own.save(folder / "d.pts", own.XYZ, own.INTENSITY, own.RGB, header=f"{len(own.XYZ)}\n")


def _ptx(folder: Path) -> Iterator[Path]:
    from helpers import ptx_files as own

    yield from _written(folder, ".ptx")
    yield own.save(folder, own.FIRST + own.SECOND)


def _kitti(folder: Path) -> Iterator[Path]:
    from helpers import kitti_files as own

    yield own.save(folder / "000001.bin", own.XYZ, own.REFLECTANCE)
    yield own.save(folder / "a.pcd.bin", own.XYZ, own.REFLECTANCE, own.RINGS)


def _depth(folder: Path) -> Iterator[Path]:
    from helpers import depth_files as own

    yield own.save(folder / "a.png", own.STEPS)
    yield own.save(folder / "a.npy", own.FLOATS)


def _colmap(folder: Path) -> Iterator[Path]:
    from helpers import colmap_files as own

    for name, content in own.WRITTEN.items():
        (folder / name).write_bytes(content())
        yield folder / name


def _packed(folder: Path, files: list[Path]) -> Iterator[Path]:
    """The same files packed."""
    for file in files:
        path = folder / f"{file.name}.gz"
        path.write_bytes(gzip.compress(file.read_bytes(), mtime=0))
        yield path
        if _there("backports.zstd"):
            from backports import zstd

            path = folder / f"{file.name}.zst"
            path.write_bytes(zstd.compress(file.read_bytes()))
            yield path
