"""Compare encodings of directional light in 8 bytes a splat by the error of glossy reflections.

    python -m bench.light.baked_bases [--points 60] [--spp 64] [--maps FILE]

The reference is the radiance that arrives at random points of three scenes, without that of lamps (`baked_maps`).
Errors are those of the radiance reflected towards 32 eyes by Phong lobes, (e + 2) / (2 pi) cos^e, and by GGX without
Fresnel: root mean square over points, eyes and RGB in percent of a scene's mean, root mean square over the scenes.
Negative results count as 0. "noise" is that of the reference. The error of blending splats at a hit is not measured.
--maps reads the panoramas, which take minutes, from a file, or writes them there.

F is radiance times cosine, SH2 the spherical harmonics of bands 0 to 2, SH1 those of bands 0 and 1, H6 the H-basis of
Habel and Wimmer. Reconstruction of a reflection from moments:

- convolved: harmonics of F are convolved with the lobe.
- averaged: harmonics of the radiance are averaged over the lobe, times the lobe's reflection of even light.
- fitted: the combination of the functions that has these moments; the lobe's products with the functions are tables.
- pointray: the current implementation, by its own kernels (`shade/lobe_tables.py`).
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from bench.light.baked_codes import Y00, Code, Gaussian, Kernel, Linear, Records, harmonics
from bench.light.baked_maps import COSINE, MIRRORED, NAMES, SOLID, Floats, Lobe, W, even_sky, ggx, light_maps, phong

LOBES = [*map(phong, (1, 2, 4, 5, 8, 20)), ggx(0.5), ggx(0.6), ggx(0.8)]


def habel(w: Floats) -> Floats:
    """The H-basis of Habel and Wimmer (2010), orthonormal on the hemisphere, (6, n)."""
    x, y, z = w.T
    rows = [np.ones(len(w)), *(np.sqrt(3) * a for a in (x, y, 2 * z - 1))]
    rows += [np.sqrt(15) * x * y, np.sqrt(15) / 2 * (x * x - y * y)]
    return np.array(rows) / np.sqrt(2 * np.pi)


def convolved(lobe: Lobe, moments: Floats) -> Floats:
    """Radiance of harmonics of F. GGX is the nearest Phong lobe, scaled to reflect as much of even light."""
    e = lobe.exponent
    zonal = (e + 2) * np.array([1 / (e + 1), 1 / (e + 2), e / ((e + 1) * (e + 3))])
    share = lobe.table.sum(axis=0) / phong(e).table.sum(axis=0)
    return (np.repeat(zonal, (1, 3, 5))[:, None] * harmonics(MIRRORED) * share)[: len(moments)]


def averaged(lobe: Lobe, moments: Floats) -> Floats:
    """Harmonics of the radiance itself, averaged over the lobe, times what the lobe reflects of even light."""
    e = lobe.exponent
    return convolved(lobe, moments) * (e + 1) / (e + 2) * phong(e).table.sum(axis=0)


def solved(matrix: Floats, right: Floats) -> Floats:
    """The solution x of matrix @ x = right."""
    return np.asarray(np.linalg.solve(matrix, right), np.float64)


def fitted(functions: Floats) -> Kernel:
    """Kernel of the combination of functions (k, n) that has the moments."""

    def kernel(lobe: Lobe, moments: Floats) -> Floats:
        used = functions[: len(moments)]
        return solved(used @ moments.T, used @ lobe.table)

    return kernel


def codes() -> dict[str, Code]:
    """The codes by their names."""
    y, h = harmonics(W), habel(W)
    cosine = np.eye(9)[0] / Y00
    zonal = np.repeat((np.pi, 2 * np.pi / 3, np.pi / 4), (1, 3, 5)) * harmonics(np.array([[0.0, 0.0, 1.0]]))[:, 0]

    def of(functions: Floats, **options: Any) -> Linear:
        moments = functions * COSINE
        return Linear(moments, fitted(functions), solved(functions @ moments.T, functions @ COSINE), **options)

    return {
        "even light": of(y[:1]),
        "SH2 of F convolved": Linear(y * COSINE, convolved, cosine, world=True),
        "SH2 of L averaged": Linear(y * SOLID, averaged, zonal, world=True),
        "SH1 of F in RGB fitted": of(y[:4], bits=7, rgb=True, world=True),
        "H6 in RGB fitted": of(h, bits=4, rgb=True),
        "a Gaussian in RGB": Gaussian(),
        "SH2 of F, SH1 of colours, pointray": Records(),
    }


def errors(found: list[Floats], true: list[Floats]) -> Floats:
    """Root mean square errors in percent of the mean, (scenes, lobes)."""
    shape = len(true), len(NAMES), -1
    goal = np.reshape(true, shape)
    squares = (np.maximum(np.reshape(found, shape), 0) - goal) ** 2
    return np.asarray(100 * np.sqrt(squares.mean(axis=2)) / goal.mean(axis=2)).T


def overall(scenes: Floats) -> Floats:
    """Root mean square of (scenes, lobes) over the scenes."""
    return np.asarray(np.sqrt((scenes**2).mean(axis=0)))


def print_table(pictures: Floats, frames: Floats) -> None:
    """Print the errors of each code, and the noise of the truth."""
    maps = pictures.mean(axis=0)
    true = [np.einsum("pnc,nr->pcr", maps, lobe.table, optimize=True) for lobe in LOBES]
    halves = [np.einsum("pnc,nr->pcr", pictures[0] - pictures[1], lobe.table, optimize=True) / 2 for lobe in LOBES]
    print(f"{'percent':36}{'bits':>5}" + "".join(f"{lobe.name:>9}" for lobe in LOBES))
    noise = overall(errors([a + b for a, b in zip(true, halves, strict=True)], true))
    print(f"{'noise':41}" + "".join(f"{x:9.1f}" for x in noise))
    for name, code in codes().items():
        row = overall(errors(code(maps, frames, LOBES), true))
        print(f"{name:36}{code.size:5}" + "".join(f"{x:9.1f}" for x in row), flush=True)


def main() -> None:
    """Make or read the maps, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=60, help="number of points of each scene")
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--maps", type=Path, help="an .npz file")
    options = parser.parse_args()
    print(f"irradiance of an even sky over pi: {even_sky() / np.pi:.4f}")
    if options.maps and options.maps.exists():
        made = dict(np.load(options.maps))
    else:
        made = light_maps(options.points, options.spp)
        if options.maps:
            np.savez_compressed(options.maps, frames=made["frames"], pictures=np.float32(made["pictures"]))
    print_table(made["pictures"].astype(np.float64), made["frames"])


if __name__ == "__main__":
    main()
