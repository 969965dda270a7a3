"""3D Gaussian splatting, PLY files written by training: one splat per vertex.

The layout is that of Kerbl et al., 3D Gaussian Splatting (2023), which most programs use: logarithms of the scales,
logit of the opacity. Flat splats (2D Gaussian Splatting) have two scales.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ....base.arrays import Floats
from ....base.progress import Progress, part_of
from ....cloud.points import Points
from .._source import NO, SURE, Chunk, Format, Request
from ..ply._names import COLORS, NORMALS
from ..ply.ply import Columns, PlySource
from ._common import HARMONIC, KEEPS, ROW, Splats, listing_of, opaque_chunks
from ._flat import FlatSplats

CENTERS, HARMONICS = ("x", "y", "z"), ("f_dc_0", "f_dc_1", "f_dc_2")
SCALES, QUATERNIONS = ("scale_0", "scale_1", "scale_2"), ("rot_0", "rot_1", "rot_2", "rot_3")
NEEDED = (*HARMONICS, "opacity", *SCALES[:2], *QUATERNIONS)
FAINTEST = np.float32(1e-6)  # distance of written opacities from 0 and 1, whose logits are infinite
DROPPED = re.compile(r"f_rest_\d+")
WRITTEN = (*CENTERS, *NORMALS[0], *HARMONICS, "opacity", *SCALES, *QUATERNIONS)
REPLACED = {*CENTERS, *NEEDED, *SCALES, *NORMALS[0], *(name for names in COLORS for name in names)}


def recognise(head: bytes, path: Path) -> int:
    """Detect PLY files of Gaussian splats: return `SURE` + 1, which outranks plain PLY, or `NO`.

    head : first bytes of the file
    """
    begins = re.match(rb"ply[ \t]*[\r\n]", head)
    names = set(re.findall(rb"[\r\n]\s*property\s+\w+\s+(\w+)", head))
    return SURE + 1 if begins and b"f_dc_0" in names and names & {b"scale_0", b"rot_0", b"opacity"} else NO


class GaussianSource(PlySource):
    """Reader of Gaussian splats in PLY files written by training."""

    def __init__(self, path: Path, request: Request) -> None:
        super().__init__(path, request)
        names = list(self._types)
        missing = [name for name in NEEDED if name not in names]
        if missing:
            raise ValueError(f"missing properties of splats: {', '.join(missing)}")
        self._opacity = request.opacity
        self._scales = [name for name in SCALES if name in names]
        self._others = [name for name in names if name not in REPLACED and not DROPPED.fullmatch(name)]
        row = ROW + sum(self._types[name].itemsize for name in self._others)
        self._facts = {**self.listing.facts, "splats": self.listing.rows}
        listing = listing_of(self.listing.rows, self._opacity, self._facts, row)
        self.listing = replace(listing, georeference=self.listing.georeference)

    def chunks(self) -> Iterator[Chunk]:
        return opaque_chunks(self._splats(), self._opacity, self._facts)

    def _splats(self) -> Iterator[tuple[Splats, float]]:
        for columns, share in self._columns():
            yield self._to_splats(columns, share), share

    @np.errstate(over="ignore", invalid="ignore")
    def _to_splats(self, columns: Columns, share: float) -> Splats:
        plain = self._to_chunk({name: columns[name] for name in (*CENTERS, *self._others)}, share)
        return Splats(
            plain.positions,
            0.5 + np.float32(HARMONIC) * _floats(columns, HARMONICS),
            1 / (1 + np.exp(-columns["opacity"].astype(np.float32))),
            np.exp(_floats(columns, self._scales)),
            _floats(columns, QUATERNIONS),
            plain.attributes,
        )


def _floats(columns: Columns, names: Sequence[str]) -> Floats:
    out = np.empty((len(columns["x"]), len(names)), np.float32)
    for k, name in enumerate(names):
        out[:, k] = columns[name]
    return out


def write(file: Any, points: Points, progress: Progress | None = None) -> list[str]:
    """Write points to a stream as flat Gaussian splats in the layout of training; return what it cannot store.

    Harmonics above degree 0 are left out, as in other files without them.
    """
    splats = FlatSplats(points, part_of(progress, 0.0, 0.5))
    properties = [f"property float {name}" for name in WRITTEN]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {splats.count}", *properties, "end_header", ""]
    file.write("\n".join(header).encode("ascii"))
    for part in splats.parts(part_of(progress, 0.5, 1.0)):
        scales, turns = splats.shapes(part)
        opacity = np.clip(splats.opacity(part), FAINTEST, 1 - FAINTEST)
        columns = [
            splats.positions[part],
            splats.normals(part),
            (splats.colors(part) / np.float32(255) - np.float32(0.5)) / np.float32(HARMONIC),
            np.log(opacity / (1 - opacity))[:, None],
            np.log(scales),
            turns,
        ]
        file.write(np.concatenate(columns, axis=1, dtype="<f4").data)
    return splats.lost


KEPT = {
    **KEEPS,
    "attributes": f"{KEEPS['attributes']}; all other properties except f_rest",
    "survey": "the coordinate system",
    "note": f"{KEEPS['note']}; written by `pointray convert --splats` and `pr.write_splats`",
}

FORMAT = Format("3D Gaussian splatting", (".ply",), recognise, GaussianSource, KEPT, write=write)
