"""The peers of the speed benchmark: Embree's oriented discs, spheres, or a mesh, traced by a loop like ours.

Needs Embree 3 (`libembree3.so.3`; Debian and Ubuntu: `libembree3-3`); `available()` tests for it.

The loop over the rays (`embree_rays.py`) is compiled by Numba and runs in `pointray.engine.jit.run`; it calls Embree by
address. `embree_shim.py` measures what that costs against the same loop in C++.

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
from numpy.typing import NDArray

from bench.tracing.embree_rays import TILE, trace_packets, trace_singles
from pointray.engine import jit

LIBRARY = "libembree3.so.3"
ABSENT = f"Embree 3 ({LIBRARY}) is not installed"

# From rtcore_*.h of Embree 3.13.
TRIANGLE, SPHERE_POINT, ORIENTED_DISC_POINT = 0, 50, 52
BUFFER_INDEX, BUFFER_VERTEX, BUFFER_NORMAL = 0, 1, 3
UINT3, FLOAT3, FLOAT4 = 0x5003, 0x9003, 0x9004
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
    """Return an order of the pixels of an image in which `tile * tile` consecutive ones form a square tile.

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
        raise ValueError(f"image of {width} x {height} pixels is not divisible into tiles of {tile} x {tile}")
    y, x = np.divmod(np.arange(width * height, dtype=np.int64), width)
    curve = np.zeros_like(x)
    for bit in range(16):
        curve |= ((x >> bit & 1) << 2 * bit) | ((y >> bit & 1) << 2 * bit + 1)
    return np.argsort(curve)


class Peer:
    """One geometry in a scene of Embree's; call `close` when done.

    Parameters
    ----------
    kind : int
        Embree's type of geometry.
    buffers : tuple of (kind, layout, (n, k) array)
        The arrays that define it.
    config : str
        Embree's own settings of the device, for instance "threads=2". By default all processors build the tree.

    Raises
    ------
    RuntimeError
        If Embree is not installed, or reports an error.
    """

    def __init__(self, kind: int, buffers: tuple[tuple[int, int, NDArray[Any]], ...], config: str = "") -> None:
        library = _library()
        if library is None:
            raise RuntimeError(ABSENT)
        self._embree = library
        self._device = library.rtcNewDevice(config.encode())
        self._scene = library.rtcNewScene(self._device)
        self._check()
        library.rtcSetSceneFlags(self._scene, SCENE_NONE)
        library.rtcSetSceneBuildQuality(self._scene, QUALITY_HIGH)
        geometry = library.rtcNewGeometry(self._device, kind)
        library.rtcSetGeometryBuildQuality(geometry, QUALITY_HIGH)
        for use, layout, values in buffers:
            self._buffer(geometry, use, layout, values.shape).view(values.dtype)[:] = values
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
        """Whether Embree has code for packets of 16 on this processor (AVX-512); if not, it splits them."""
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
        kernel = trace_packets if name.endswith("16") else trace_singles
        flags = COHERENT if coherent else INCOHERENT
        jit.run(kernel, -(-len(t) // TILE), function, self._scene, flags, origins, directions, t, threads=threads)
        return t

    def close(self) -> None:
        """Free the scene. Closing twice does no harm."""
        if self._scene is not None:
            self._embree.rtcReleaseScene(self._scene)
            self._embree.rtcReleaseDevice(self._device)
        self._scene = self._device = None


class Discs(Peer):
    """Splats as Embree's oriented discs.

    Parameters
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32
        Of any length.
    radii : (n,) float32, or one for all
    config : str
        See `Peer`.
    """

    def __init__(self, positions: Any, normals: Any, radii: Any, config: str = "") -> None:
        discs = np.empty((len(positions), 4), np.float32)
        discs[:, :3], discs[:, 3] = positions, radii
        buffers = (BUFFER_VERTEX, FLOAT4, discs), (BUFFER_NORMAL, FLOAT3, np.asarray(normals, np.float32))
        super().__init__(ORIENTED_DISC_POINT, buffers, config)


class Spheres(Peer):
    """Spheres.

    Parameters
    ----------
    positions : (n, 3) float32
    radii : (n,) float32, or one for all
    config : str
        See `Peer`.
    """

    def __init__(self, positions: Any, radii: Any, config: str = "") -> None:
        spheres = np.empty((len(positions), 4), np.float32)
        spheres[:, :3], spheres[:, 3] = positions, radii
        super().__init__(SPHERE_POINT, ((BUFFER_VERTEX, FLOAT4, spheres),), config)


class Mesh(Peer):
    """Triangles.

    Parameters
    ----------
    vertices : (n, 3) float32
    triangles : (m, 3) int
    config : str
        See `Peer`.
    """

    def __init__(self, vertices: Any, triangles: Any, config: str = "") -> None:
        points, corners = np.asarray(vertices, np.float32), np.asarray(triangles, np.uint32)
        super().__init__(TRIANGLE, ((BUFFER_VERTEX, FLOAT3, points), (BUFFER_INDEX, UINT3, corners)), config)
