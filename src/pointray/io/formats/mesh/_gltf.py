"""Preparation of glTF files for trimesh: checks, and conversion of quantized and sparse attributes to float32.

trimesh reads normalized integers as plain ones (KHR_mesh_quantization), and ignores sparse values and texture
transforms (KHR_texture_transform). Attributes that use these get a new float32 accessor, in an additional buffer.
"""

from __future__ import annotations

import base64
import json
import math
import re
from collections.abc import Callable
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Floats
from .._source import Faults

GLB_HEADER = 20  # bytes before the JSON of a .glb file
PACKERS = re.compile(r"draco|meshopt", re.IGNORECASE)
KNOWN = re.compile(r"KHR_(mesh_quantization|texture_transform|lights_punctual|materials_\w+)$")
DTYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
ATTRIBUTES = ("POSITION", "NORMAL", "TEXCOORD_0", "COLOR_0")


class UnsupportedError(ValueError):
    """Raised if a valid glTF file uses a feature that is unsupported."""


def readable(data: bytes, kind: str, get: Callable[[str], bytes], faults: Faults) -> bytes:
    """Return the contents of a glTF file as trimesh can read them: quantized and sparse attributes become float32.

    Parameters
    ----------
    data : bytes
        The file.
    kind : {"glb", "gltf"}
    get : callable
        Name of a file in the same folder -> its bytes.
    faults : Faults
        Records unsupported extensions.

    Raises
    ------
    UnsupportedError
        If it is compressed.
    ValueError
        If it is cut off, or shorter than announced.
    """
    text, rest = _split(data) if kind == "glb" else (data, b"")
    tree = json.loads(text)
    _check(tree, len(data), faults)
    floats = _Floats(tree, rest, get)
    for mesh in tree.get("meshes", ()):
        for primitive in mesh["primitives"]:
            floats.replace(primitive)
    if not floats.added:
        return data
    floats.attach()
    text = json.dumps(tree).encode()
    if kind == "gltf":
        return text
    text += b" " * (-len(text) % 4)
    length = GLB_HEADER + len(text) + len(rest)
    return b"glTF" + b"".join(n.to_bytes(4, "little") for n in (2, length, len(text))) + b"JSON" + text + rest


def _split(data: bytes) -> tuple[bytes, bytes]:
    """Split a .glb file into its JSON and the chunks after it."""
    announced, length = (int.from_bytes(data[at : at + 4], "little") for at in (8, 12))
    if announced > len(data) or length > len(data) - GLB_HEADER:
        raise ValueError(f"is cut off: expected {max(announced, length):,} bytes, found {len(data):,}")
    return data[GLB_HEADER : GLB_HEADER + length], data[GLB_HEADER + length :]


def _check(tree: Any, size: int, faults: Faults) -> None:
    """Raise ValueError for compressed data, which trimesh would read as zeros, and for announced rows without data.

    The latter could need more memory than the file has bytes.

    tree : the file's JSON; size : of the file in bytes; faults : records unsupported extensions
    """
    required, used = tree.get("extensionsRequired", ()), tree.get("extensionsUsed", ())
    empty = [a for a in tree.get("accessors", ()) if "bufferView" not in a and "sparse" not in a]
    packed = next((name for name in (*required, *(used if empty else ())) if PACKERS.search(name)), None)
    if packed is not None:
        raise UnsupportedError(f"is compressed with {packed}, which is unsupported: save it without compression")
    unknown = [name for name in required if not KNOWN.match(name)]
    if unknown:
        faults.add(f"requires {', '.join(unknown)}, which is unsupported: parts of it may be missing or wrong")
    for number, accessor in enumerate(tree.get("accessors", ())):
        item = np.dtype(DTYPES[accessor["componentType"]]).itemsize * WIDTHS[accessor["type"]]
        need = int(accessor["count"]) * item
        if need < 0 or ("bufferView" not in accessor and need > size):
            raise ValueError(f"accessor {number} announces {accessor['count']:,} rows without data")


class _Floats:
    """New float32 accessors of a glTF file, in place of those that trimesh would read wrongly.

    Attributes
    ----------
    added : list of (n, k) float32
        Values of the new accessors.
    """

    def __init__(self, tree: Any, rest: bytes, get: Callable[[str], bytes]) -> None:
        self._tree, self._rest, self._get = tree, rest, get
        self._buffers: dict[int, bytes] = {}
        self._known: dict[Any, int] = {}
        self.added: list[Floats] = []

    def replace(self, primitive: Any) -> None:
        """Let the attributes of a primitive refer to new accessors where trimesh would read them wrongly.

        Raise UnsupportedError if its triangle indices are sparse.

        primitive : part of the file's JSON, which is changed
        """
        if "indices" in primitive and "sparse" in self._tree["accessors"][primitive["indices"]]:
            raise UnsupportedError("has sparse triangle indices, which are unsupported")
        attributes = primitive["attributes"]
        texture = self._texture(primitive)
        number = texture.get("texCoord", 0)
        if number and f"TEXCOORD_{number}" in attributes:
            attributes["TEXCOORD_0"] = attributes[f"TEXCOORD_{number}"]
        transform = texture.get("extensions", {}).get("KHR_texture_transform", {})
        for name in ATTRIBUTES:
            index = attributes.get(name)
            moved = transform if name == "TEXCOORD_0" else {}
            if index is None or not (moved or self._is_stored_otherwise(index, name)):
                continue
            key = index, json.dumps(moved, sort_keys=True)
            if key not in self._known:
                self._known[key] = len(self._tree["accessors"]) + len(self.added)
                self.added.append(_moved(self._values(index), moved))
            attributes[name] = self._known[key]

    def attach(self) -> None:
        """Add the new accessors and their values to the file's JSON, in an additional buffer."""
        data, tree = b"".join(values.tobytes() for values in self.added), self._tree
        start = 0
        for values in self.added:
            view = {"buffer": len(tree["buffers"]), "byteOffset": start, "byteLength": values.nbytes}
            kind = next(name for name, width in WIDTHS.items() if width == values.shape[1])
            accessor = {"bufferView": len(tree["bufferViews"]), "componentType": 5126, "count": len(values)}
            tree["bufferViews"].append(view)
            tree["accessors"].append({**accessor, "type": kind})
            start += values.nbytes
        uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        tree["buffers"].append({"byteLength": len(data), "uri": uri})

    def _texture(self, primitive: Any) -> Any:
        materials = self._tree.get("materials", [])
        material = materials[primitive["material"]] if "material" in primitive else {}
        return material.get("pbrMetallicRoughness", {}).get("baseColorTexture", {})

    def _is_stored_otherwise(self, index: int, name: str) -> bool:
        """Whether an attribute is sparse, or has integers that trimesh would misread.

        index : of its accessor; name : such as "POSITION"
        """
        accessor = self._tree["accessors"][index]
        if "sparse" in accessor:
            return True
        if accessor["componentType"] in (5125, 5126) or "bufferView" not in accessor:
            return False
        if name == "COLOR_0" and accessor["componentType"] == 5121:  # trimesh reads 8-bit colours correctly
            return False
        return bool(accessor.get("normalized")) or name == "TEXCOORD_0"

    def _values(self, index: int) -> Floats:
        """Return the values of an accessor, (n, k), with its sparse values and with normalized integers scaled."""
        accessor = self._tree["accessors"][index]
        count, sparse = accessor["count"], accessor.get("sparse")
        dtype, width = np.dtype(DTYPES[accessor["componentType"]]), WIDTHS[accessor["type"]]
        is_stored = "bufferView" in accessor
        rows = self._rows(accessor, count, dtype, width).copy() if is_stored else np.zeros((count, width), dtype)
        if sparse is not None:
            indices = np.dtype(DTYPES[sparse["indices"]["componentType"]])
            places = self._rows(sparse["indices"], sparse["count"], indices, 1)[:, 0]
            rows[places] = self._rows(sparse["values"], sparse["count"], dtype, width)
        values = rows.astype(np.float32)
        if accessor.get("normalized") and dtype.kind != "f":
            values = np.maximum(values / np.iinfo(dtype).max, -1)
        return values

    def _rows(self, place: Any, count: int, dtype: np.dtype[Any], width: int) -> NDArray[Any]:
        """Return the stored values of an accessor, or of the indices or values of a sparse one, (count, width).

        place : part of the file's JSON that refers to a buffer view
        """
        view = self._tree["bufferViews"][place["bufferView"]]
        start = view.get("byteOffset", 0)
        data = self._buffer(view["buffer"])[start : start + view["byteLength"]]
        strides = view.get("byteStride", width * dtype.itemsize), dtype.itemsize
        return np.ndarray((count, width), dtype, data, place.get("byteOffset", 0), strides)

    def _buffer(self, number: int) -> bytes:
        if number not in self._buffers:
            uri = self._tree["buffers"][number].get("uri")
            if uri is None:
                self._buffers[number] = self._rest[8:]
            elif uri.startswith("data:"):
                head, _, text = uri.partition(",")
                plain = base64.b64decode(text) if head.endswith("base64") else unquote_to_bytes(text)
                self._buffers[number] = plain
            else:
                self._buffers[number] = self._get(uri)
        return self._buffers[number]


def _moved(uv: Floats, transform: Any) -> Floats:
    """Apply a KHR_texture_transform to texture coordinates, (n, 2). transform : its JSON; empty: none"""
    if not transform:
        return uv
    angle = float(transform.get("rotation", 0))
    x, y = (uv * np.float32(transform.get("scale", (1, 1)))).T
    turned = x * math.cos(angle) + y * math.sin(angle), y * math.cos(angle) - x * math.sin(angle)
    return (np.stack(turned, axis=1) + np.float32(transform.get("offset", (0, 0)))).astype(np.float32)
