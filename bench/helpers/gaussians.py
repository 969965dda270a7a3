"""Reference renderer of Gaussian splats, independent of the package: PLY files of training, and their pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData

from pointray.rendering.camera import Camera

Doubles = NDArray[np.float64]

HARMONIC = 0.28209479177387814  # spherical harmonic of degree 0
BLUR = 0.3  # variance in square pixels that viewers add, so that no splat falls between pixels
FAINTEST, DENSEST = 1 / 255, 0.99  # limits of alpha, as in training
FULL = 1e-4  # transmittance below which the rest is hidden


class Gaussians(NamedTuple):
    """Gaussian splats of a file.

    positions : (n, 3); covariances : (n, 3, 3); colors : (n, 3), sRGB from 0 to 1; opacity : (n,)
    """

    positions: Doubles
    covariances: Doubles
    colors: Doubles
    opacity: Doubles

    def widened(self, factor: float) -> Gaussians:
        """Return the splats with all standard deviations multiplied by a factor."""
        return self._replace(covariances=self.covariances * factor**2)


def read_gaussians(path: Path) -> Gaussians:
    """Read a PLY file in the layout of training."""
    rows = PlyData.read(str(path))["vertex"]

    def columns(*names: str) -> Doubles:
        return np.stack([np.asarray(rows[name], np.float64) for name in names], axis=1)

    w, x, y, z = columns("rot_0", "rot_1", "rot_2", "rot_3").T
    turned = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    axes = turned * np.exp(columns("scale_0", "scale_1", "scale_2"))[:, None]
    return Gaussians(
        columns("x", "y", "z"),
        axes @ axes.transpose(0, 2, 1),
        0.5 + HARMONIC * columns("f_dc_0", "f_dc_1", "f_dc_2"),
        1 / (1 + np.exp(-columns("opacity")[:, 0])),
    )


def rasterize(splats: Gaussians, camera: Camera, blur: float = BLUR) -> tuple[Doubles, Doubles]:
    """Render Gaussian splats front to back, (h, w, 3) sRGB on black, with the alpha of each pixel, (h, w).

    References
    ----------
    Kerbl, Kopanas, Leimkuehler, Drettakis: 3D Gaussian Splatting for Real-Time Radiance Field Rendering (2023).
    Zwicker, Pfister, van Baar, Gross: EWA volume splatting (2001), the projection of a Gaussian.
    """
    width, height = camera.size
    forward = np.subtract(camera.target, camera.eye)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward])  # x right, y down, z forward
    focal = height / 2 / np.tan(np.radians(camera.fov) / 2)
    seen = (splats.positions - camera.eye) @ axes.T
    rows = np.flatnonzero(seen[:, 2] > 0)
    rows = rows[np.argsort(seen[rows, 2], kind="stable")]
    x, y, z = seen[rows].T
    jacobian = np.zeros((len(rows), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = focal / z
    jacobian[:, 0, 2], jacobian[:, 1, 2] = -focal * x / z**2, -focal * y / z**2
    turned = jacobian @ axes
    flat = turned @ splats.covariances[rows] @ turned.transpose(0, 2, 1) + blur * np.eye(2)
    opacity = splats.opacity[rows]
    reach = np.sqrt(2 * np.log(np.maximum(opacity / FAINTEST, 1)) * flat[:, [0, 1], [0, 1]].T).T
    at = np.stack([focal * x / z + width / 2, focal * y / z + height / 2], axis=1)
    return _blend(at, np.linalg.inv(flat), reach, (splats.colors[rows], opacity), (width, height))


def _blend(
    at: Doubles, inverse: Doubles, reach: Doubles, look: tuple[Doubles, Doubles], size: tuple[int, int]
) -> tuple[Doubles, Doubles]:
    """Blend splats front to back. at : centres; inverse : of the covariances; reach : half width and height of each

    look : colours and opacities; size : width and height of the picture
    """
    picture, left = np.zeros((size[1], size[0], 3)), np.ones((size[1], size[0]))
    low = np.clip(np.floor(at - reach), 0, size).astype(int)
    high = np.clip(np.ceil(at + reach), 0, size).astype(int)
    for i in np.flatnonzero((high > low).all(axis=1)):
        window: Any = (slice(low[i, 1], high[i, 1]), slice(low[i, 0], high[i, 0]))
        before = left[window]
        if before.max() < FULL:
            continue
        dx = np.arange(low[i, 0], high[i, 0]) + 0.5 - at[i, 0]
        dy = np.arange(low[i, 1], high[i, 1])[:, None] + 0.5 - at[i, 1]
        (a, b), (_, c) = inverse[i]
        alpha = np.minimum(look[1][i] * np.exp(-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy), DENSEST)
        alpha[alpha < FAINTEST] = 0
        picture[window] += (before * alpha)[..., None] * look[0][i]
        left[window] = before * (1 - alpha)
    return picture, 1 - left
