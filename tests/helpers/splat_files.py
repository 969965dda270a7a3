"""Splats for tests: their values, and what a file of them should become."""

from dataclasses import dataclass

import numpy as np

HARMONIC = 0.5 / np.sqrt(np.pi)


@dataclass
class Cloud:
    """Splats with values as training has them: logarithms of scales, logits of opacities."""

    xyz: np.ndarray
    harmonic: np.ndarray
    opacity: np.ndarray
    scale: np.ndarray
    turn: np.ndarray

    @property
    def rgb(self):
        return np.clip(0.5 + HARMONIC * self.harmonic, 0, 1) * 255

    @property
    def alpha(self):
        return 1 / (1 + np.exp(-self.opacity))

    @property
    def axes(self):
        """The shortest axes, from rotation matrices."""
        return np.array([matrix(q)[:, s.argmin()] for q, s in zip(self.turn, self.scale, strict=True)])


def matrix(q):
    """The rotation by a quaternion w, x, y, z of any length: columns are turned axes."""
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def covariances(scales, turns):
    """The covariance matrices of Gaussians, in units of their largest variance: (n, 3, 3)."""
    axes = [matrix(q) * (s / s.max()) for q, s in zip(turns.astype(float), scales.astype(float), strict=True)]
    return np.array([a @ a.T for a in axes])


def cloud(n, seed=0):
    rng = np.random.default_rng(seed)
    scale = rng.uniform(-6, -1, (n, 3))
    scale[np.arange(n), rng.integers(0, 3, n)] = -8  # the shortest axis is clear
    return Cloud(
        rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), rng.normal(size=n) * 3, scale, rng.normal(size=(n, 4)) * 2
    )


def check(points, made, rows=slice(None), turned=0.9999, shades=0.51, **near):
    """Check points against splats: positions and scales within what `near` says, colours, opacities, axes."""
    np.testing.assert_allclose(points.positions, made.xyz[rows], rtol=0, atol=near.get("position", 1e-6))
    np.testing.assert_allclose(
        np.log(points.attributes["scale"]), made.scale[rows], rtol=0, atol=near.get("scale", 1e-5)
    )
    np.testing.assert_allclose(points.attributes["opacity"], made.alpha[rows], atol=near.get("opacity", 1e-6))
    np.testing.assert_allclose(points.colors, made.rgb[rows], atol=shades)
    assert np.abs((points.normals * made.axes[rows]).sum(axis=1)).min() > turned
    np.testing.assert_allclose(np.linalg.norm(points.normals, axis=1), 1, rtol=1e-5)
    turns = made.turn[rows] / np.linalg.norm(made.turn[rows], axis=1, keepdims=True)
    assert np.abs((points.attributes["rotation"] * turns).sum(axis=1)).min() > turned
    np.testing.assert_allclose(np.linalg.norm(points.attributes["rotation"], axis=1), 1, rtol=1e-5)


def damaged(rng, data):
    """The bytes of a file with one to three changes, most of them near the start."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.random() ** 2 * len(out))
        kind = int(rng.integers(4))
        if kind == 0 and out:
            out[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            out[at : at + 4] = bytes(rng.integers(0, 256, 4, np.uint8))
        elif kind == 2:
            out[at : at + 4] = [b"\xff" * 4, b"\0" * 4, b"\x7f" * 4][int(rng.integers(3))]
        else:
            del out[at : at + int(rng.integers(1, 200))]
    return bytes(out)
