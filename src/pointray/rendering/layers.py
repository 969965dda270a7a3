"""`render_layers`: radiance with AOVs (depth, normal, position, albedo, ids) for other programs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.executor import Client, snapshot_and_executor
from ..base.progress import StageProgress, in_stage
from ..engine.kernels.records import BASE_COLOR, FORWARD, INSTANCE, MATERIAL, MATERIAL_SIZE, OWN_COLOR
from ..scene.casting import intersect_snapshot
from ..scene.rays import Hits, check_rays
from ..scene.scene import Scene
from ..scene.world import Snapshot
from .camera import Camera
from .layer_dataset import Layers
from .picture import check_picture, check_view, picture_bytes, render_snapshot
from .ray_forwarding.spread import check_spread
from .settings import Settings

LAYER_BYTES = 80  # bytes of a pixel, in all layers
BAND, SQUARE = 1 << 13, 32  # pixels a band of rays, and the edge of the squares in which rays are traced


def render_layers(
    scene: Scene,
    camera: Camera,
    settings: Settings | None = None,
    progress: StageProgress | None = None,
    client: Client = None,
) -> Layers:
    """Render a scene as layers: radiance, and geometry at the first hit of each pixel. The scene is not modified.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    settings : Settings, optional
        For the radiance. The other layers take one ray through the centre of the pixel, without antialiasing.
    progress : callable, optional
        Called about ten times a second as `progress(stage, share)` with the name of the stage and its completed share,
        0 to 1.
    client : dask.distributed.Client, optional
        Render the radiance on the workers of a cluster; the other layers are computed in this process.

    Returns
    -------
    Layers
        A dict, which `to_xarray` converts to a `xarray.Dataset`:

        radiance : (h, w, 4) float32
            Result of `render`: linear RGB, premultiplied, and alpha.
        depth : (h, w) float32
            Distance along the view, in a panorama from the eye; inf for a miss.
        normal : (h, w, 3) float32
            Unit normal in world space, on the side of the points' normals; 0 for a miss.
        position : (h, w, 3) float64
            World; NaN for a miss.
        albedo : (h, w, 3) float32
            Linear colour of the material, else of the points; 0 for a miss.
        instance : (h, w) int32
            Id that `Scene.add` returned; -1 for a miss.
        point : (h, w) int64
            Row of the splat with the greatest weight in the model's points; -1 for planes and for a miss.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ImportError
        If `Settings.denoise` is set and pyoidn is not installed.
    ValueError
        If an argument is invalid, or the layers do not fit into the available memory.

    See Also
    --------
    write_layers : writes the layers as .npz, or as .exr for other programs.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
    >>> layers = pr.render_layers(scene, pr.frame(scene, size=(32, 24)))
    >>> layers["depth"].shape, int(layers["instance"][12, 16])
    ((24, 32), 0)
    """
    scene, settings = check_view(scene, camera, settings, progress)
    check_picture(camera.size, max(picture_bytes(settings), LAYER_BYTES))
    share = settings.spp / (settings.spp + 1)  # the layers count as one sample

    report = in_stage(progress, "rendering") or (lambda done: None)
    now, executor = snapshot_and_executor(scene, client, check_spread(None, client, settings))
    radiance = render_snapshot(now, camera, settings, lambda done: report(share * done), executor)
    shape = radiance.shape[:2]
    layers = Layers(
        {
            "radiance": radiance,
            "depth": np.full(shape, np.inf, np.float32),
            "normal": np.empty((*shape, 3), np.float32),
            "position": np.empty((*shape, 3)),
            "albedo": np.empty((*shape, 3), np.float32),
            "instance": np.empty(shape, np.int32),
            "point": np.empty(shape, np.int64),
        },
        camera,
    )
    rows = max(BAND // shape[1], 1) * SQUARE
    tops = list(range(0, max(shape[0] - 1, 1), rows))  # no single row at the end, as it could not be traced in squares
    for top, end in zip(tops, [*tops[1:], shape[0]], strict=True):
        _trace_band(now, camera, slice(top, end), layers)
        report(share + (1 - share) * end / shape[0])
    return layers


def _trace_band(scene: Snapshot, camera: Camera, band: slice, layers: dict[str, NDArray[Any]]) -> None:
    """Fill some rows of all layers except radiance with the first hits through the pixel centres.

    An image is traced band by band to limit the memory for rays and hits.

    band : range of rows; layers : arrays of the whole image, by name, as `render_layers` returns them
    """
    origins, directions = camera.rays(band)
    hits = intersect_snapshot(scene, *check_rays(origins, directions, 0, np.inf))
    view = directions @ camera.record()[FORWARD : FORWARD + 3] if camera.projection != "panorama" else 1.0
    np.multiply(hits.t, view, out=layers["depth"][band], where=hits.instance >= 0)
    for name in ("normal", "position", "instance", "point"):
        layers[name][band] = getattr(hits, name)
    layers["albedo"][band] = _albedo(scene, hits)


def _albedo(scene: Snapshot, hits: Hits) -> NDArray[np.float32]:
    """Return the linear colour at hits, (h, w, 3): the material's, else the points' own; 0 for a miss."""
    records = scene.world.instances.reshape(-1, INSTANCE)
    materials = scene.world.materials.reshape(-1, MATERIAL_SIZE)[records[:, MATERIAL].astype(int)]
    row = np.searchsorted(scene.numbers[:-1], hits.instance)
    own = (hits.instance >= 0) & (materials[np.minimum(row, len(materials) - 1), OWN_COLOR] == 0)
    albedo = hits.color.copy()
    albedo[own] = materials[row[own], BASE_COLOR : BASE_COLOR + 3]
    return albedo
