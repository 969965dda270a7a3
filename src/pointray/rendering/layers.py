"""A picture in layers for other programs: its light, and what each pixel shows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.executor import Client, snapshot_and_executor
from ..engine.kernels.records import BASE_COLOR, FORWARD, INSTANCE, MATERIAL, MATERIAL_SIZE, OWN_COLOR
from ..scene.casting import intersect_snapshot
from ..scene.rays import Hits, check_rays
from ..scene.scene import Scene
from ..scene.world import Snapshot
from .camera import Camera
from .picture import check_picture, check_view, picture_bytes, render_snapshot
from .ray_forwarding.spread import check_spread
from .settings import Settings

LAYER_BYTES = 80  # a pixel, of all layers
BAND, SQUARE = 1 << 13, 32  # pixels whose rays are traced together, in squares of this edge


def render_layers(
    scene: Scene,
    camera: Camera,
    settings: Settings | None = None,
    progress: Callable[[float], None] | None = None,
    client: Client = None,
) -> dict[str, NDArray[Any]]:
    """Render a scene, and tell for each pixel what it shows.

    Parameters
    ----------
    settings : Settings, optional
        For the radiance. The other layers take one ray, through the pixel's middle: edges are not blended in them.
    progress : callable, optional
        Called with the share done, some ten times a second.
    client : dask.distributed.Client, optional
        As for `render`, for the radiance.

    Returns
    -------
    dict
        radiance : (h, w, 4) float32
            What `render` returns.
        depth : (h, w) float32
            Distance along the view, in a panorama from the eye; inf where nothing is.
        normal : (h, w, 3) float32
            World, unit, where the points' normals point; 0 where nothing is.
        position : (h, w, 3) float64
            World; NaN where nothing is.
        albedo : (h, w, 3) float32
            Linear colour of the surface: the material's, else the points' own; 0 where nothing is.
        instance : (h, w) int32
            What `Scene.add` returned; -1 where nothing is.
        point : (h, w) int64
            Row, in the caller's points, of the splat of most weight; -1 for planes and where nothing is.

    See Also
    --------
    write_layers : writes them as .npz, or as .exr for other programs.
    """
    scene, settings = check_view(scene, camera, settings, progress)
    check_picture(camera.size, max(picture_bytes(settings), LAYER_BYTES))
    share = settings.spp / (settings.spp + 1)  # the layers take one ray for each pixel

    def show(done: float) -> None:
        if progress is not None:
            progress(done)

    now, executor = snapshot_and_executor(scene, client, check_spread(None, client, settings))
    radiance = render_snapshot(now, camera, settings, lambda done: show(share * done), executor)
    shape = radiance.shape[:2]
    layers: dict[str, NDArray[Any]] = {
        "radiance": radiance,
        "depth": np.full(shape, np.inf, np.float32),
        "normal": np.empty((*shape, 3), np.float32),
        "position": np.empty((*shape, 3)),
        "albedo": np.empty((*shape, 3), np.float32),
        "instance": np.empty(shape, np.int32),
        "point": np.empty(shape, np.int64),
    }
    rows = max(BAND // shape[1], 1) * SQUARE
    tops = list(range(0, max(shape[0] - 1, 1), rows))  # no single row at the end: it would not be traced in squares
    for top, end in zip(tops, [*tops[1:], shape[0]], strict=True):
        _trace_band(now, camera, slice(top, end), layers)
        show(share + (1 - share) * end / shape[0])
    return layers


def _trace_band(scene: Snapshot, camera: Camera, band: slice, layers: dict[str, NDArray[Any]]) -> None:
    """Fill some rows of all layers but the radiance: rays and hits of all rows would take more memory than these."""
    origins, directions = camera.rays(band)
    hits = intersect_snapshot(scene, *check_rays(origins, directions, 0, np.inf))
    view = directions @ camera.record()[FORWARD : FORWARD + 3] if camera.projection != "panorama" else 1.0
    np.multiply(hits.t, view, out=layers["depth"][band], where=hits.instance >= 0)
    for name in ("normal", "position", "instance", "point"):
        layers[name][band] = getattr(hits, name)
    layers["albedo"][band] = _albedo(scene, hits)


def _albedo(scene: Snapshot, hits: Hits) -> NDArray[np.float32]:
    """The colours of hits, or the material's colour where it has one of its own."""
    records = scene.world.instances.reshape(-1, INSTANCE)
    materials = scene.world.materials.reshape(-1, MATERIAL_SIZE)[records[:, MATERIAL].astype(int)]
    row = np.searchsorted(scene.numbers[:-1], hits.instance)
    own = (hits.instance >= 0) & (materials[np.minimum(row, len(materials) - 1), OWN_COLOR] == 0)
    albedo = hits.color.copy()
    albedo[own] = materials[row[own], BASE_COLOR : BASE_COLOR + 3]
    return albedo
