"""Preview of a scan while kernels are being compiled: points drawn as shaded dots by NumPy alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..auto_view.studio import CLAY, HORIZON, KEY, KEY_DIRECTION
from ..base.arrays import Doubles, Floats
from ..cloud.points import Points
from ..image.tone import srgb_to_linear
from ..rendering.camera import Camera, view_axes

MAX_POINTS = 60_000  # points drawn; an image takes about 30 ms
NEIGHBORS = 12  # neighbours from which missing normals are fitted
DOT_RADIUS = 0.9  # radius of a dot, in distances to the DOT_NEIGHBOR-th neighbour; leaves few gaps
DOT_NEIGHBOR = 6
MAX_DOT_RADIUS = 2.5  # pixels; for larger dots the resolution of the image is reduced
DEPTH_STEPS = 2.0**31  # quantization steps of the depth buffer


class Sketch:
    """A sample of a scan's points that can be drawn as dots without compiled kernels.

    Parameters
    ----------
    clouds : sequence of Points
        Clouds drawn together.
    counts : sequence of int, optional
        Number of points that each cloud represents; by default its own number.

    Attributes
    ----------
    points : Points
        The points drawn.
    count : int
        The sum of `counts`.
    """

    def __init__(self, clouds: Sequence[Points], counts: Sequence[int] | None = None) -> None:
        counts = [len(cloud) for cloud in clouds] if counts is None else counts
        self.count, rng = sum(counts), np.random.default_rng(0)
        drawn = []
        for cloud, count in zip(clouds, counts, strict=True):
            share = min(MAX_POINTS * count / self.count / max(len(cloud), 1), 1.0)
            drawn.append(cloud.select(np.flatnonzero(cloud.finite & (rng.random(len(cloud)) < share))))
        world = np.concatenate([cloud.origin + cloud.positions for cloud in drawn])
        self.points = Points(world, _joined_normals([cloud.normals for cloud in drawn]))
        from scipy.spatial import cKDTree  # late: the import takes 0.1 s and is rarely needed

        ranks = np.arange(1, min(NEIGHBORS, len(world)) + 1)
        distances, near = cKDTree(self.points.positions).query(self.points.positions, ranks)
        self._spacing = float(np.median(distances[:, min(DOT_NEIGHBOR, len(ranks) - 1)]))
        self._normals: NDArray[Any] | None = self.points.normals
        if self._normals is None:
            self._normals = _plane_normals(self.points.positions, near)
        self._colors = np.concatenate([_linear_colors(cloud) for cloud in drawn])

    def draw(self, camera: Camera) -> Floats:
        """Return an image of the points as shaded dots: (h, w, 4) float32, linear with alpha, like that of `render`.

        If dots would be large, the image is smaller than the camera's size.
        """
        radius = self._radius(camera, np.median(self._camera_coordinates(camera)[2]))
        camera = _smaller(camera, radius / MAX_DOT_RADIUS)
        across, upwards, depth = self._camera_coordinates(camera)
        shown = depth > 0
        (width, height), scale = camera.size, _pixels(camera, np.where(shown, depth, 1.0))
        column, row = (width / 2 + across * scale).astype(int), (height / 2 - upwards * scale).astype(int)
        shown &= (column >= 0) & (column < width) & (row >= 0) & (row < height)
        which = np.flatnonzero(shown)
        nearest = self._nearest(column[which], row[which], depth[which], min(radius, MAX_DOT_RADIUS), (height, width))
        image = np.zeros((height, width, 4), np.float32)
        hit = nearest >= 0
        image[hit, :3] = self._shade(camera, which[nearest[hit]])
        image[hit, 3] = 1.0
        return image

    def _camera_coordinates(self, camera: Camera) -> tuple[Doubles, ...]:
        """Return the points' coordinates relative to the eye: to the right, up and along the view, (n,) each."""
        eye = np.asarray(camera.eye) - self.points.origin
        forward, right, top = view_axes(np.subtract(camera.target, camera.eye), np.asarray(camera.up, np.float64))
        from_eye = self.points.positions.astype(np.float64) - eye
        return from_eye @ right, from_eye @ top, from_eye @ forward

    def _radius(self, camera: Camera, depth: float) -> float:
        """Return the radius of a dot in pixels. depth : its distance along the view"""
        return max(DOT_RADIUS * self._spacing * float(_pixels(camera, np.array(max(depth, 1e-300)))), 0.5)

    def _nearest(
        self, column: NDArray[np.int64], row: NDArray[np.int64], depth: Doubles, radius: float, shape: tuple[int, int]
    ) -> NDArray[np.int64]:
        """Return for each pixel the index of the dot nearest to the eye, or -1: an array of the given shape.

        column, row, depth : (n,), pixel of each dot's centre, and distance along the view
        radius : of the dots, in pixels; shape : height and width of the image
        """
        height, width = shape
        none = np.iinfo(np.int64).max
        buffer = np.full(height * width, none)
        steps = (depth / max(float(depth.max(initial=0.0)), 1e-300) * (DEPTH_STEPS - 1)).astype(np.int64)
        keys = (steps << 32) | np.arange(len(depth))
        half, square = int(np.ceil(radius)), radius * radius + 0.5
        for down in range(-half, half + 1):
            for aside in range(-half, half + 1):
                if down * down + aside * aside > square:
                    continue
                x, y = column + aside, row + down
                inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
                np.minimum.at(buffer, (y * width + x)[inside], keys[inside])
        return np.where(buffer == none, -1, buffer & 0xFFFFFFFF).reshape(shape)

    def _shade(self, camera: Camera, rows: NDArray[np.int64]) -> Floats:
        """Return linear colours, (n, 3), of points in the studio's key light and sky; both sides are shaded alike.

        rows : (n,), indices of the points
        """
        assert self._normals is not None
        forward, right, top = view_axes(np.subtract(camera.target, camera.eye), np.asarray(camera.up, np.float64))
        sideways, upwards, backwards = KEY_DIRECTION
        light = sideways * right + upwards * top - backwards * forward
        normals = self._normals[rows].astype(np.float64)
        toward = np.where(normals @ forward > 0, 1.0, -1.0)  # the eye looks along `forward`
        facing = toward * (normals @ light) / np.linalg.norm(light)
        bright = HORIZON + KEY / np.pi * np.maximum(facing, 0.0)
        return np.asarray(self._colors[rows] * bright[:, None], np.float32)


def _pixels(camera: Camera, depth: Doubles) -> Doubles:
    """Return the length in pixels of one world unit. depth : its distances along the view, of any shape"""
    half = np.tan(np.radians(camera.fov) / 2)
    if camera.projection == "orthographic":
        depth = np.full_like(depth, np.linalg.norm(np.subtract(camera.target, camera.eye)))
    return np.asarray(camera.size[1] / 2 / (half * depth))


def _smaller(camera: Camera, times: float) -> Camera:
    """Return the camera for an image `times` smaller in width and height; unchanged if `times` is below 1."""
    width, height = camera.size
    return replace(camera, size=(max(1, round(width / times)), max(1, round(height / times)))) if times > 1 else camera


def _joined_normals(parts: Sequence[Floats | None]) -> Floats | None:
    """Concatenate the normals of several clouds, (n, 3) each; None if any cloud has none."""
    known = [part for part in parts if part is not None]
    return np.nan_to_num(np.concatenate(known)) if len(known) == len(parts) else None


def _linear_colors(cloud: Points) -> Floats:
    if cloud.colors is None:
        return np.full((len(cloud), 3), CLAY, np.float32)
    return np.asarray(srgb_to_linear(cloud.colors / 255.0), np.float32)


def _plane_normals(positions: Floats, near: NDArray[np.int64]) -> Doubles:
    """Return normals of planes fitted to neighbours, (n, 3), with arbitrary sign.

    near : (n, k), indices of each point's nearest points, including itself
    """
    around = positions[near].astype(np.float64)
    around -= around.mean(axis=1, keepdims=True)
    return np.asarray(np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))[1][:, :, 0])
