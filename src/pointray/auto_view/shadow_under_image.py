"""Kernel that composites an image over a shadow on a ground plane, fast enough for each frame of the viewer."""

from __future__ import annotations

from ..base.arrays import Doubles, Floats
from ..engine.jit import Array, borrow, f32, i64, inline, kernel, next_tile, run

ROWS = 16  # rows a thread takes at a time
EYE, FORWARD, ACROSS, UPWARD = 0, 1, 2, 3  # rows of the view


@inline
def _look_up(shadow: Array, half: float, x: float, y: float) -> float:
    """Return the shadow at a position on the ground, interpolated between cell centres; 0 outside the grid.

    shadow : (n, n), values at cell centres; half : half the width of the grid; x, y : relative to its centre
    """
    if not (abs(x) < half and abs(y) < half):
        return f32(0.0)
    cells = shadow.shape[0]
    u = min(max((x / half + 1.0) * (0.5 * cells) - 0.5, 0.0), cells - 1.001)
    v = min(max((y / half + 1.0) * (0.5 * cells) - 0.5, 0.0), cells - 1.001)
    i, j = i64(u), i64(v)
    u, v = f32(u - i), f32(v - j)
    near = shadow[i, j] * (f32(1.0) - v) + shadow[i, j + 1] * v
    far = shadow[i + 1, j] * (f32(1.0) - v) + shadow[i + 1, j + 1] * v
    return near * (f32(1.0) - u) + far * u


@inline
def _shadow_behind(view: Array, parallel: bool, shadow: Array, half: float, pixel: tuple[float, float]) -> float:
    """Return the shadow where the ray through a pixel meets the ground, 0 if it does not.

    view : (4, 3), eye, forward, across and upward; parallel : whether rays are; shadow : (n, n); half : see `_look_up`
    pixel : from -1 to 1 to the right and upwards
    """
    right, above = pixel
    x = right * view[ACROSS, 0] + above * view[UPWARD, 0]
    y = right * view[ACROSS, 1] + above * view[UPWARD, 1]
    z = right * view[ACROSS, 2] + above * view[UPWARD, 2]
    if parallel:
        t = -(view[EYE, 2] + z) / view[FORWARD, 2] if view[FORWARD, 2] != 0.0 else -1.0
        x, y = view[EYE, 0] + x + t * view[FORWARD, 0], view[EYE, 1] + y + t * view[FORWARD, 1]
    else:
        z += view[FORWARD, 2]
        t = -view[EYE, 2] / z if z != 0.0 else -1.0
        x, y = view[EYE, 0] + t * (view[FORWARD, 0] + x), view[EYE, 1] + t * (view[FORWARD, 1] + y)
    return _look_up(shadow, half, x, y) if t > 0.0 else f32(0.0)


@kernel
def _put_under(work: Array, image: Array, view: Array, parallel: bool, shadow: Array, half: float, out: Array) -> None:
    """Composite an image over a shadow, in blocks of rows. image, out : (h, w, 4) float32, premultiplied with alpha.

    view : (4, 3) float64, eye, forward, across and upward, along the grid's axes; parallel : whether rays are
    shadow : (n, n) float32, alpha at cell centres; half : half the width of the grid
    """
    image, view, shadow, out = borrow(image), borrow(view), borrow(shadow), borrow(out)
    height, width = image.shape[:2]
    block = next_tile(work)
    while block >= 0:
        for y in range(block * ROWS, min((block + 1) * ROWS, height)):
            above = 1.0 - (2.0 * y + 1.0) / height
            for x in range(width):
                out[y, x, 0], out[y, x, 1], out[y, x, 2] = image[y, x, 0], image[y, x, 1], image[y, x, 2]
                rest = f32(1.0) - image[y, x, 3]
                if rest > 0.0:
                    pixel = (2.0 * x + 1.0) / width - 1.0, above
                    rest *= f32(1.0) - _shadow_behind(view, parallel, shadow, half, pixel)
                out[y, x, 3] = f32(1.0) - rest
        block = next_tile(work)


def put_under(image: Floats, view: Doubles, parallel: bool, shadow: Floats, half: float, out: Floats) -> None:
    """Composite an image over a shadow on a ground plane z = 0; the shadow is black with an alpha.

    Parameters
    ----------
    image, out : (h, w, 4) float32
        Premultiplied RGB and alpha; `out` is written.
    view : (4, 3) float64
        Eye, forward, across and upward (from the centre of the image to its edges) of the camera.
    parallel : bool
        Whether the projection is orthographic.
    shadow : (n, n) float32
        Alpha at the cell centres of a grid around the origin. The first index runs along x.
    half : float
        Half the width of the grid.
    """
    run(_put_under, -(-len(image) // ROWS), image, view, parallel, shadow, half, out)
