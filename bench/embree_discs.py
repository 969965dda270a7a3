"""The peer of the speed benchmark: the same splats as Embree's oriented discs, traced by the same kind of loop as ours.

Needs Embree 3 (`libembree3.so.3`; Debian and Ubuntu: `libembree3-3`); `available()` says whether it is there.

The loop over the rays is compiled by Numba and runs in `pointray.jit.run`; it calls Embree by address. `embree_shim.py`
measures what that costs against the same loop in C++.

    discs = Discs(positions, normals, radii)
    order = tile_order(512, 512)
    t = discs.closest(origins[order], directions[order], packets=True)
    discs.close()
"""

from __future__ import annotations

import ctypes
from ctypes import c_char_p, c_int, c_size_t, c_ssize_t, c_uint, c_void_p
from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from pointray import jit

LIBRARY = "libembree3.so.3"
ABSENT = f"Embree 3 ({LIBRARY}) is not installed"

# From rtcore_*.h of Embree 3.13.
ORIENTED_DISC_POINT, BUFFER_VERTEX, BUFFER_NORMAL = 52, 1, 3
FLOAT3, FLOAT4 = 0x9003, 0x9004
QUALITY_HIGH, SCENE_NONE = 2, 0
INCOHERENT, COHERENT = 0, 1
PROPERTY_VERSION, PROPERTY_NATIVE_RAY16 = 0, 34

_PROTOTYPES: dict[str, tuple[Any, list[Any]]] = {
    "rtcNewDevice": (c_void_p, [c_char_p]),
    "rtcGetDeviceProperty": (c_ssize_t, [c_void_p, c_int]),
    "rtcGetDeviceError": (c_int, [c_void_p]),
    "rtcReleaseDevice": (None, [c_void_p]),
    "rtcNewScene": (c_void_p, [c_void_p]),
    "rtcSetSceneFlags": (None, [c_void_p, c_int]),
    "rtcSetSceneBuildQuality": (None, [c_void_p, c_int]),
    "rtcAttachGeometry": (c_uint, [c_void_p, c_void_p]),
    "rtcCommitScene": (None, [c_void_p]),
    "rtcReleaseScene": (None, [c_void_p]),
    "rtcNewGeometry": (c_void_p, [c_void_p, c_int]),
    "rtcSetGeometryBuildQuality": (None, [c_void_p, c_int]),
    "rtcSetNewGeometryBuffer": (c_void_p, [c_void_p, c_int, c_uint, c_int, c_size_t, c_size_t]),
    "rtcCommitGeometry": (None, [c_void_p]),
    "rtcReleaseGeometry": (None, [c_void_p]),
}


@cache
def _library() -> ctypes.CDLL | None:
    """Embree with its prototypes, or None where it is not installed."""
    try:
        library = ctypes.CDLL(LIBRARY)
    except OSError:
        return None
    for name, (result, arguments) in _PROTOTYPES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


def available() -> bool:
    """Whether Embree is installed."""
    return _library() is not None


def tile_order(width: int, height: int, tile: int = 4) -> NDArray[np.int64]:
    """Order of the pixels of an image in which `tile * tile` consecutive ones are a square tile.

    The tiles follow each other along a Morton curve, so that longer stretches are compact too.

    Returns
    -------
    (width * height,) int64
        Numbers of the pixels, counted row by row.

    Raises
    ------
    ValueError
        If the tiles do not fill the image: every later packet would straddle two of them.
    """
    if width % tile or height % tile:
        raise ValueError(f"an image of {width} x {height} pixels is not made of tiles of {tile} x {tile}")
    y, x = np.divmod(np.arange(width * height, dtype=np.int64), width)
    column, row = x // tile, y // tile
    curve = np.zeros_like(x)
    for bit in range(16):
        curve |= ((column >> bit & 1) << 2 * bit) | ((row >> bit & 1) << 2 * bit + 1)
    return np.lexsort((x, y, curve))


# --------------------------------------------------------------------------------------------------- the loop

TILE = 1024  # rays that a thread takes at a time

# A ray and its hit are 20 words (RTCRay, then RTCHit), each of them 1 or 16 lanes wide.
ORIGIN, TNEAR, DIRECTION, TIME, TFAR, MASK, ID, FLAGS, GEOMETRY, WORDS = 0, 3, 4, 7, 8, 9, 10, 11, 18, 20
CONTEXT = WORDS * 16  # then RTCIntersectContext: flags, gap, filter (2 words), instID
VALID = CONTEXT + 16  # then the 16 lanes of a packet that are in use
SCRATCH = VALID + 16
INVALID = np.uint32(0xFFFFFFFF)


@intrinsic
def _call(typingctx, address, arguments):  # type: ignore[no-untyped-def]
    """Call the C function at an address with pointers; a pointer is an int64."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        pointer = ir.IntType(8).as_pointer()
        prototype = ir.FunctionType(ir.VoidType(), [pointer] * len(arguments))
        function = builder.inttoptr(args[0], prototype.as_pointer())
        numbers = [builder.extract_value(args[1], i) for i in range(len(arguments))]
        builder.call(function, [builder.inttoptr(number, pointer) for number in numbers])
        return context.get_dummy_value()

    return types.void(types.int64, arguments), codegen


@jit.inline
def _scratch(width, flags):  # type: ignore[no-untyped-def]
    """A thread's ray, context and valid lanes, aligned to 64 bytes, with everything that all rays share filled in."""
    block = np.zeros(SCRATCH + 16, np.uint32)
    skip = (-block.ctypes.data % 64) // 4
    scratch = block[skip : skip + SCRATCH]
    scratch[MASK * width : (MASK + 1) * width] = INVALID
    scratch[CONTEXT] = flags
    scratch[CONTEXT + 4] = INVALID
    return scratch


@jit.inline
def _fill(floats, words, width, lane, origin, direction):  # type: ignore[no-untyped-def]
    """Write one ray into its lane."""
    for axis in range(3):
        floats[(ORIGIN + axis) * width + lane] = origin[axis]
        floats[(DIRECTION + axis) * width + lane] = direction[axis]
    floats[TFAR * width + lane] = np.inf
    words[GEOMETRY * width + lane] = INVALID


@jit.kernel
def _singles(work, function, scene, flags, origins, directions, t):  # type: ignore[no-untyped-def]
    """Trace ray by ray and keep `tfar`."""
    words = _scratch(1, flags)
    floats = words.view(np.float32)
    ray = words.ctypes.data
    while True:
        tile = jit.take(work)
        if tile < 0:
            return
        for i in range(tile * TILE, min(tile * TILE + TILE, len(t))):
            _fill(floats, words, 1, 0, origins[i], directions[i])
            _call(function, (scene, ray + 4 * CONTEXT, ray))
            t[i] = floats[TFAR]


@jit.kernel
def _packets(work, function, scene, flags, origins, directions, t):  # type: ignore[no-untyped-def]
    """Trace 16 rays at a time and keep `tfar`."""
    words = _scratch(16, flags)
    floats = words.view(np.float32)
    ray = words.ctypes.data
    words[VALID : VALID + 16] = INVALID
    while True:
        tile = jit.take(work)
        if tile < 0:
            return
        for first in range(tile * TILE, min(tile * TILE + TILE, len(t)), 16):
            count = min(16, len(t) - first)
            for lane in range(count):
                _fill(floats, words, 16, lane, origins[first + lane], directions[first + lane])
            if count < 16:
                words[VALID + count : VALID + 16] = 0
            _call(function, (ray + 4 * VALID, scene, ray + 4 * CONTEXT, ray))
            t[first : first + count] = floats[TFAR * 16 : TFAR * 16 + count]


# --------------------------------------------------------------------------------------------------- the scene


class Discs:
    """Splats as Embree's oriented discs; call `close` when done.

    Parameters
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32
        Of any length.
    radii : (n,) float32, or one for all
    config : str
        Embree's own settings of the device, for instance "threads=2"; all processors build the tree otherwise.

    Raises
    ------
    RuntimeError
        If Embree is not installed, or reports an error.
    """

    def __init__(self, positions: Any, normals: Any, radii: Any, config: str = "") -> None:
        library = _library()
        if library is None:
            raise RuntimeError(ABSENT)
        self._embree = library
        self._device = library.rtcNewDevice(config.encode())
        self._scene = library.rtcNewScene(self._device)
        self._check()
        library.rtcSetSceneFlags(self._scene, SCENE_NONE)
        library.rtcSetSceneBuildQuality(self._scene, QUALITY_HIGH)
        geometry = library.rtcNewGeometry(self._device, ORIENTED_DISC_POINT)
        library.rtcSetGeometryBuildQuality(geometry, QUALITY_HIGH)
        vertices = self._buffer(geometry, BUFFER_VERTEX, FLOAT4, (len(positions), 4))
        vertices[:, :3] = positions
        vertices[:, 3] = radii
        self._buffer(geometry, BUFFER_NORMAL, FLOAT3, (len(positions), 3))[:] = normals
        library.rtcCommitGeometry(geometry)
        library.rtcAttachGeometry(self._scene, geometry)
        library.rtcReleaseGeometry(geometry)
        library.rtcCommitScene(self._scene)
        self._check()

    def _buffer(self, geometry: int, kind: int, layout: int, shape: tuple[int, int]) -> NDArray[np.float32]:
        """A new buffer of the geometry, owned and padded by Embree, as an array."""
        data = self._embree.rtcSetNewGeometryBuffer(geometry, kind, 0, layout, 4 * shape[1], shape[0])
        self._check()
        return np.ctypeslib.as_array(ctypes.cast(data, ctypes.POINTER(ctypes.c_float)), shape)

    def _check(self) -> None:
        code = self._embree.rtcGetDeviceError(self._device)
        if code:
            raise RuntimeError(f"Embree reports error {code}")

    @property
    def version(self) -> str:
        """Embree's version, for instance "3.13.5"."""
        number = self._embree.rtcGetDeviceProperty(self._device, PROPERTY_VERSION)
        return f"{number // 10000}.{number // 100 % 100}.{number % 100}"

    @property
    def native_packets(self) -> bool:
        """Whether Embree has code for packets of 16 for this processor (AVX-512); it splits them otherwise."""
        return bool(self._embree.rtcGetDeviceProperty(self._device, PROPERTY_NATIVE_RAY16))

    def closest(
        self, origins: Any, directions: Any, threads: int = 2, packets: bool = False, coherent: bool = True
    ) -> NDArray[np.float32]:
        """Distance to the first disc along each ray, in lengths of the direction.

        Parameters
        ----------
        origins, directions : (m, 3) float32
        packets : bool
            Trace 16 consecutive rays together.
        coherent : bool
            Tell Embree that neighbouring rays are alike: camera rays are, ambient occlusion is not.

        Returns
        -------
        (m,) float32
            inf where nothing is hit.
        """
        name = "rtcIntersect16" if packets else "rtcIntersect1"
        return self._trace(name, origins, directions, threads, coherent)

    def occluded(
        self, origins: Any, directions: Any, threads: int = 2, packets: bool = False, coherent: bool = True
    ) -> NDArray[np.bool_]:
        """Whether each ray hits any disc; arguments as for `closest`."""
        name = "rtcOccluded16" if packets else "rtcOccluded1"
        return self._trace(name, origins, directions, threads, coherent) < 0

    def _trace(self, name: str, origins: Any, directions: Any, threads: int, coherent: bool) -> NDArray[np.float32]:
        if self._scene is None:
            raise RuntimeError("these discs are closed")
        origins, directions = (np.ascontiguousarray(a, np.float32) for a in (origins, directions))
        t = np.empty(len(origins), np.float32)
        function = ctypes.cast(getattr(self._embree, name), c_void_p).value
        kernel = _packets if name.endswith("16") else _singles
        flags = COHERENT if coherent else INCOHERENT
        jit.run(kernel, -(-len(t) // TILE), function, self._scene, flags, origins, directions, t, threads=threads)
        return t

    def close(self) -> None:
        """Free the scene; more than once does no harm."""
        if self._scene is not None:
            self._embree.rtcReleaseScene(self._scene)
            self._embree.rtcReleaseDevice(self._device)
        self._scene = self._device = None
