"""Conversion of Gaussian splats to points: centre, colour, and the shortest axis as normal.

Nearly transparent splats are left out: trained scenes contain many, for haze and soft edges, and as points they would
be opaque.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Flags
from ....base.warning_log import warn
from .._source import Chunk, Listing

ROWS = 1 << 17  # splats unpacked at a time, a multiple of 256; more take more memory but no less time
ROW = 12 + 12 + 3 + 4 + 12 + 16  # bytes per point with normal, colour, opacity, scale and rotation
HARMONIC = 0.28209479177387814  # spherical harmonic of degree 0, 1 / sqrt(4 pi)
UNKNOWN = 128  # sRGB of a colour that is NaN
KEEPS = {
    "positions": "the centres of the splats",
    "normals": "the shortest axis; its sign is unknown and chosen by `Model`",
    "colors": "the spherical harmonic of degree 0; higher degrees are ignored",
    "attributes": "opacity (0 to 1), scale (standard deviations along the axes of the splat), rotation "
    "(unit quaternion w, x, y, z)",
    "note": "splats with an opacity below --opacity are left out",
}


Floats = NDArray[np.floating[Any]]


class Splats(NamedTuple):
    """Some Gaussian splats of a file.

    Attributes
    ----------
    positions : (m, 3) array of floats
        Centres of the Gaussians.
    colors : (m, 3) float32
        sRGB; may be outside 0 to 1, or NaN.
    opacity : (m,) float32
        0 to 1.
    scale : (m, 3) or (m, 2) float32
        Standard deviations along the axes; two for flat splats.
    rotation : (m, 4) float32
        Quaternions w, x, y, z of any length.
    others : dict of str to array
        Further attributes.
    """

    positions: NDArray[Any]
    colors: Floats
    opacity: Floats
    scale: Floats
    rotation: Floats
    others: Mapping[str, NDArray[Any]] = {}


def listing_of(count: int, opacity: float, facts: Mapping[str, Any], row: int = ROW) -> Listing:
    """Return what the header of a file of `count` Gaussian splats announces.

    If `opacity` is not 0, `count` is only an estimate of the rows: transparent splats are left out.

    opacity : minimum opacity; facts : information for `pointray info`; row : bytes per point while reading
    """
    return Listing(count if opacity <= 0 else None, row, count, facts=facts)


def opaque_chunks(
    parts: Iterable[tuple[Splats, float]], opacity: float, facts: dict[str, Any] | None = None
) -> Iterator[Chunk]:
    """Yield points for the Gaussian splats that are opaque enough; raise ValueError if no splat is.

    Parameters
    ----------
    parts : iterable of (Splats, float)
        Splats with the fraction of the file that has been read.
    opacity : float
        Minimum opacity; 0 keeps all splats.
    facts : dict, optional
        Receives the number of splats left out, as "transparent".
    """
    seen, kept, greatest = 0, 0, 0.0
    for splats, share in parts:
        rows = splats.opacity >= opacity if opacity > 0 else np.ones(len(splats.opacity), np.bool_)
        seen, kept = seen + len(rows), kept + int(rows.sum())
        greatest = max(greatest, float(np.nan_to_num(splats.opacity).max(initial=0.0)))
        yield _to_chunk(splats, rows, share)
    if facts is not None:
        facts["transparent"] = seen - kept
    if seen and not kept:
        raise ValueError(
            f"none of its {seen:,} splats has an opacity of {opacity:g} or more: the maximum is {greatest:g}; "
            "use a lower threshold"
        )
    if kept < seen:
        warn(f"{seen - kept:,} of {seen:,} splats are left out: their opacity is below {opacity:g}", stacklevel=2)


@np.errstate(over="ignore", invalid="ignore")
def _to_chunk(splats: Splats, rows: Flags, share: float) -> Chunk:
    scale = splats.scale[rows]
    turns = unit_quaternions(splats.rotation[rows])
    attributes = {"opacity": splats.opacity[rows], "scale": scale, "rotation": turns}
    attributes |= {name: column[rows] for name, column in splats.others.items()}
    normals = shortest_axes(scale, splats.rotation[rows])
    return Chunk(splats.positions[rows], normals, _to_bytes(splats.colors[rows]), attributes, share)


def unit_quaternions(rotation: NDArray[Any]) -> NDArray[np.float32]:
    """Return quaternions (m, 4) of any length as unit quaternions, float32; 0 for invalid ones."""
    wide = rotation.astype(np.float64)  # squares of float32 neither overflow nor underflow
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(wide, axis=1, keepdims=True)
        known = np.isfinite(length) & (length > 0)
        return np.where(known, wide / np.where(known, length, 1), 0).astype(np.float32)


def shortest_axes(scale: Floats, rotation: Floats) -> NDArray[np.float32]:
    """Return the unit vector along each Gaussian's shortest axis, (m, 3) float32; 0 for an invalid quaternion.

    Parameters
    ----------
    scale : (m, 3) or (m, 2) float32
        Standard deviations. With two columns the third axis is the shortest.
    rotation : (m, 4) float32
        Quaternions w, x, y, z of any length.
    """
    every = np.arange(len(scale))
    axis = np.argmin(scale, axis=1) if scale.shape[1] == 3 else np.full(len(scale), 2)
    after, before = (axis + 1) % 3, (axis + 2) % 3
    wide = rotation.astype(np.float64)  # squares of float32 neither overflow nor underflow
    w, v = wide[:, 0], wide[:, 1:]
    turned = 2 * v[every, axis][:, None] * v  # rotation of a unit vector e: (w w - v v) e + 2 (v e) v + 2 w v x e
    turned[every, after] += 2 * w * v[every, before]
    turned[every, before] -= 2 * w * v[every, after]
    turned[every, axis] += w * w - np.einsum("ij,ij->i", v, v)
    square = np.einsum("ij,ij->i", wide, wide)
    good = np.isfinite(square) & (square > 0)
    turned[good] /= square[good, None]
    turned[~good] = 0
    return turned.astype(np.float32)


def _to_bytes(colors: Floats) -> NDArray[np.uint8]:
    """Convert colours from 0 to 1 to 8 bits, with clipping; NaN becomes grey."""
    shades = np.clip(np.rint(colors * np.float32(255)), 0, 255)
    shades[np.isnan(shades)] = UNKNOWN
    return shades.astype(np.uint8)


def smallest_three(largest: NDArray[Any], rest: Floats) -> NDArray[np.float32]:
    """Return unit quaternions whose largest component is not stored but follows from the others, (m, 4) float32.

    Parameters
    ----------
    largest : (m,) int
        Index of that component, 0 to 3.
    rest : (m, 3) float32
        The other components in order.
    """
    missing = np.sqrt(np.maximum(1 - np.einsum("ij,ij->i", rest, rest), 0))
    out = np.empty((len(rest), 4), np.float32)
    for place in range(4):
        rows = largest == place
        out[rows] = np.insert(rest[rows], place, missing[rows], axis=1)
    return out
