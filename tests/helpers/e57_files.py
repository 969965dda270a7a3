"""E57 files written by pye57, and copies with changed XML."""

import struct
from functools import cache

import numpy as np
import pytest

libe57 = pytest.importorskip("pye57.libe57")

N = 500

XYZ = np.random.default_rng(7).normal(size=(N, 3))

NORMALS = XYZ / np.linalg.norm(XYZ, axis=1, keepdims=True)

RGB = np.random.default_rng(8).integers(0, 256, (N, 3))

HALF = np.sqrt(0.5)

TURN = (HALF, 0.0, 0.0, HALF)  # 90 degrees about z: (x, y, z) -> (-y, x, z)

AT = (5400000.125, 300.0, 20.0)


class Column:
    """A column to be written: its values, and how the file keeps them."""

    def __init__(self, values, kind="double", low=None, high=None, grid=(1.0, 0.0)):
        self.values, self.kind, self.grid = np.asarray(values), kind, grid
        self.low = int(self.values.min()) if low is None and kind not in ("single", "double") else low
        self.high = int(self.values.max()) if high is None and kind not in ("single", "double") else high

    def node(self, file):
        if self.kind in ("single", "double"):
            precision = libe57.E57_SINGLE if self.kind == "single" else libe57.E57_DOUBLE
            limit = 3.4e38 if self.kind == "single" else 1.7e308
            return libe57.FloatNode(file, 0.0, precision, -limit, limit)
        if self.kind == "scaled":
            return libe57.ScaledIntegerNode(file, self.low, self.low, self.high, *self.grid)
        return libe57.IntegerNode(file, self.low, self.low, self.high)

    def array(self):
        kinds = {"single": np.float32, "double": np.float64}
        out = np.empty(N, kinds.get(self.kind, "q"))  # pye57 treats "l", which is as wide, as 32 bits
        out[:] = self.values
        return out


def xyz_columns(xyz=XYZ, kind="double"):
    return {f"cartesian{axis}": Column(column, kind) for axis, column in zip("XYZ", xyz.T, strict=True)}


def structure(file, values):
    """A node of XML with values in it: dicts, texts, floats."""
    node = libe57.StructureNode(file)
    for name, value in values.items():
        if isinstance(value, dict):
            node.set(name, structure(file, value))
        elif isinstance(value, str):
            node.set(name, libe57.StringNode(file, value))
        else:
            node.set(name, libe57.FloatNode(file, float(value)))
    return node


def pose(rotation=TURN, at=AT):
    return {
        "pose": {"rotation": dict(zip("wxyz", rotation, strict=True)), "translation": dict(zip("xyz", at, strict=True))}
    }


def save(path, *scans, crs=""):
    """Write scans, each a dict of columns and a dict of header fields."""
    file = libe57.ImageFile(str(path), "w")
    file.extensionsAdd("", libe57.E57_V1_0_URI)
    file.extensionsAdd("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt")
    root, data3d = file.root(), libe57.VectorNode(file, True)
    texts = {"formatName": "ASTM E57 3D Imaging Data File", "guid": "{0}", "e57LibraryVersion": "a test"}
    for name, text in (texts | {"coordinateMetadata": crs}).items():
        root.set(name, libe57.StringNode(file, text))
    root.set("versionMajor", libe57.IntegerNode(file, libe57.E57_FORMAT_MAJOR))
    root.set("versionMinor", libe57.IntegerNode(file, libe57.E57_FORMAT_MINOR))
    root.set("data3D", data3d)
    for columns, facts in scans:
        save_scan(file, data3d, columns, facts)
    file.close()
    return path


def save_scan(file, data3d, columns, facts):
    scan = structure(file, {"guid": "{1}", **facts})
    prototype = libe57.StructureNode(file)
    buffers = libe57.VectorSourceDestBuffer()
    arrays = [column.array() for column in columns.values()]
    for (name, column), array in zip(columns.items(), arrays, strict=True):
        prototype.set(name, column.node(file))
        buffers.append(libe57.SourceDestBuffer(file, name, array, N, True, False))
    points = libe57.CompressedVectorNode(file, prototype, libe57.VectorNode(file, True))
    scan.set("points", points)
    data3d.append(scan)
    writer = points.writer(buffers)
    writer.write(N)
    writer.close()


def with_xml(path, old, new):
    """The file with other words in its XML, of the same length, and valid checksums."""
    data = bytearray(path.read_bytes())
    pages = [bytearray(data[at : at + 1020]) for at in range(0, len(data), 1024)]
    whole = b"".join(pages)
    assert whole.count(old.encode()) >= 1
    whole = whole.replace(old.encode(), new.ljust(len(old)).encode(), 1)
    rows = [whole[at : at + 1020] for at in range(0, len(whole), 1020)]
    path.write_bytes(b"".join(row + struct.pack(">I", crc32c(row)) for row in rows))


@cache
def crc32c(row):
    """The checksum of a page; most pages of changed files are alike."""
    crc = 0xFFFFFFFF
    for byte in row:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF
