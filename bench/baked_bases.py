"""Compare ways to keep, in 8 bytes a splat, from where light comes, by the error of glossy reflections made of them.

    python bench/baked_bases.py [--points 60] [--spp 64] [--maps FILE]

Truth is the radiance that arrives at random points of three scenes, without that of lamps (`baked_maps`). Errors are of
the radiance that it gives to 32 eyes by Phong lobes, (e + 2) / (2 pi) cos^e, and by GGX without Fresnel: root mean
square over points, eyes and RGB in percent of a scene's mean, root mean square over the scenes. Negative results count
as 0. "noise" is that of the truth. The error of blending splats at a hit is not measured. --maps takes the panoramas,
which need minutes, from a file, or writes them there.

F is radiance times cosine, SH2 the spherical harmonics of bands 0 to 2, SH1 those of bands 0 and 1, H6 the H-basis;
"hemi" is SH2 made orthonormal on the hemisphere under the cosine. How a reflection is made of moments:

- convolved: harmonics of F are convolved with the lobe.
- over even: they only add to the reflection of even light, which is exact.
- averaged: harmonics of the radiance are averaged over the lobe, times the lobe's reflection of even light.
- fitted: the combination of the functions that has these moments; the lobe's products with the functions are tables.
- expected: the likeliest radiance with these moments, if they have 1% noise, and radiances of directions an angle apart
  are correlated as 1 + exp(-angle). Tables too; they depend on the angle of eye and normal only.
- pointray: what pointray ships, by its own kernels: expected, with other steps, exact for even light.

"world": kept in world axes, so that all splats of a hit are summed first; else each is evaluated. Operations of one
evaluation are estimated by hand: additions and multiplications, t: table look-ups, r: roots and exponentials. "10%"
and "ggx" are the highest exponents with errors below 10%, as packed, of Phong's lobes and of GGX. Code h takes 15
bytes, for comparison.
"""

from __future__ import annotations

import argparse
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from baked_codes import Y00, Code, Dominant, Gaussians, Kernel, Linear, Records, harmonics
from baked_maps import COSINE, MIRRORED, NAMES, SOLID, Floats, Lobe, W, even_sky, ggx, light_maps, phong

EXPONENTS = (1, 2, 4, 8, 20, 100)
DENSE = np.geomspace(1, 128, 57)
SHOWN = [*map(phong, EXPONENTS), ggx(0.5), ggx(0.8)]
LOBES = [*SHOWN, *map(phong, DENSE), *map(ggx, (2 * DENSE + 1) ** -0.25)]


def habel(w: Floats) -> Floats:
    """The H-basis of Habel and Wimmer (2010), orthonormal on the hemisphere, (6, n)."""
    x, y, z = w.T
    rows = [np.ones(len(w)), *(np.sqrt(3) * a for a in (x, y, 2 * z - 1))]
    rows += [np.sqrt(15) * x * y, np.sqrt(15) / 2 * (x * x - y * y)]
    return np.array(rows) / np.sqrt(2 * np.pi)


def orthonormal(functions: Floats) -> Floats:
    """The functions made orthonormal on the hemisphere under the cosine, in their order, the first one positive."""
    root = np.sqrt(COSINE)
    rows = np.linalg.qr((functions * root).T)[0].T / root
    return rows * np.sign(rows[0, 0])


def convolved(lobe: Lobe, moments: Floats) -> Floats:
    """Radiance of harmonics of F. GGX is the nearest Phong lobe, scaled to reflect as much of even light."""
    e = lobe.exponent
    zonal = (e + 2) * np.array([1 / (e + 1), 1 / (e + 2), e / ((e + 1) * (e + 3))])
    share = lobe.table.sum(axis=0) / phong(e).table.sum(axis=0)
    return (np.repeat(zonal, (1, 3, 5))[:, None] * harmonics(MIRRORED) * share)[: len(moments)]


def over_even(lobe: Lobe, moments: Floats) -> Floats:
    """As `convolved`, but even light is reflected exactly."""
    kernel = convolved(lobe, moments)
    kernel[0] += (lobe.table.sum(axis=0) - moments.sum(axis=1) @ kernel) / (np.pi * Y00)
    return kernel


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


def expected(lobe: Lobe, moments: Floats) -> Floats:
    """Kernel of the likeliest radiance: kriging with noise in all moments but the first."""
    both = moments @ correlation()
    noise = np.full(len(moments), (0.01**2) * (both[0] @ moments[0]))
    noise[0] = 0
    return solved(both @ moments.T + np.diag(noise), both @ lobe.table)


@cache
def correlation() -> Floats:
    """How radiances of two directions are correlated, (n, n)."""
    return 1 + np.exp(-np.arccos(np.clip(W @ W.T, -1, 1)))


def flat(lobe: Lobe, moments: Floats) -> Floats:
    """The irradiance over pi, whatever lobe and eye."""
    return np.full((1, len(MIRRORED)), 1 / (np.pi * Y00))


def codes() -> dict[str, tuple[str, Code]]:
    """The name of each code to its operations and itself."""
    y, h = harmonics(W), habel(W)
    f, cosine, hemi = y * COSINE, np.eye(9)[0] / Y00, orthonormal(y)
    zonal = np.repeat((np.pi, 2 * np.pi / 3, np.pi / 4), (1, 3, 5)) * harmonics(np.array([[0.0, 0.0, 1.0]]))[:, 0]

    def of(functions: Floats, weight: Floats, kernel: Kernel | None = None, **options: Any) -> Linear:
        moments = functions * weight
        own = solved(functions @ moments.T, functions @ COSINE)
        return Linear(moments, kernel or fitted(functions), own, **options)

    return {
        "0 irradiance only": ("3", Linear(f[:1], flat, cosine[:1])),
        "0 even light": ("5 1t", of(y[:1], COSINE)),
        "a SH2 of F convolved, world": ("45", Linear(f, convolved, cosine, world=True)),
        "a SH2 of F over even, world": ("55 1t", Linear(f, over_even, cosine, world=True)),
        "a SH2 of F fitted, world": ("85 6t 1r", of(y, COSINE, world=True)),
        "a SH2 of F expected, world": ("85 6t 1r", of(y, COSINE, expected, world=True)),
        "b SH2 of L averaged, world": ("80 1t", Linear(y * SOLID, averaged, zonal, world=True)),
        "b SH2 of L fitted, world": ("110 6t 1r", of(y, SOLID, world=True)),
        "c SH1 RGB convolved, world": ("30", Linear(f[:4], convolved, cosine[:4], bits=7, rgb=True, world=True)),
        "c SH1 RGB over even, world": ("36 1t", Linear(f[:4], over_even, cosine[:4], bits=7, rgb=True, world=True)),
        "c SH1 RGB fitted, world": ("65 3t 1r", of(y[:4], COSINE, bits=7, rgb=True, world=True)),
        "c SH1 RGB expected, world": ("65 3t 1r", of(y[:4], COSINE, expected, bits=7, rgb=True, world=True)),
        "d one Gaussian RGB": ("70 1t 4r", Gaussians(1, True)),
        "d two Gaussians": ("130 1t 8r", Gaussians(2, False)),
        "d two Gaussians RGB": ("140 1t 8r", Gaussians(2, True, (6, 4, 5))),
        "e H6 fitted": ("45 4t", of(h, COSINE, bits=12)),
        "e H6 RGB fitted": ("65 4t", of(h, COSINE, bits=4, rgb=True)),
        "e hemi fitted": ("75 6t", of(hemi, COSINE)),
        "f dominant direction": ("50 4r", Dominant()),
        "g H6, chroma, fitted": ("70 4t", of(h, COSINE, bits=8, chroma=4)),
        "g hemi, chroma, fitted": ("95 6t", of(hemi, COSINE, bits=5, chroma=4)),
        "g SH2 F, chroma, over even, world": ("95 1t", Linear(f, over_even, cosine, bits=5, chroma=4, world=True)),
        "g SH2 F, chroma, fitted, world": ("130 9t 1r", of(y, COSINE, bits=5, chroma=4, world=True)),
        "g SH2 F, chroma, expected, world": ("130 9t 1r", of(y, COSINE, expected, bits=5, chroma=4, world=True)),
        "g SH2 F, chroma, pointray, world": ("110 8t", Records()),
        "h SH2 F RGB expected, world": ("210 6t 1r", of(y, COSINE, expected, bits=5, rgb=True, world=True)),
    }


def errors(found: list[Floats], true: list[Floats]) -> Floats:
    """Root mean square errors in percent of the mean, (scenes, lobes)."""
    shape = len(true), len(NAMES), -1
    goal = np.reshape(true, shape)
    squares = (np.maximum(np.reshape(found, shape), 0) - goal) ** 2
    return np.asarray(100 * np.sqrt(squares.mean(axis=2)) / goal.mean(axis=2)).T


def limit(curve: Floats, most: float) -> str:
    """The exponent at which a rising curve over DENSE reaches an error."""
    if curve[0] > most:
        return "-"
    return f"{np.exp(np.interp(most, curve, np.log(DENSE))):.1f}"


def overall(scenes: Floats) -> Floats:
    """Root mean square of (scenes, lobes) over the scenes."""
    return np.asarray(np.sqrt((scenes**2).mean(axis=0)))


def print_tables(pictures: Floats, frames: Floats) -> None:
    """Print errors as packed, as not packed, and of each scene."""
    maps = pictures.mean(axis=0)
    true = [np.einsum("pnc,nr->pcr", maps, lobe.table, optimize=True) for lobe in LOBES]
    halves = [np.einsum("pnc,nr->pcr", pictures[0] - pictures[1], lobe.table, optimize=True) / 2 for lobe in LOBES]
    exact: dict[str, Floats] = {}
    each: dict[str, Floats] = {}
    head = "".join(f"{lobe.name:>9}" for lobe in SHOWN)
    print(f"{'percent, as packed':36}{'bits':>5} {'operations':10}{head}{'10%':>7}{'ggx':>7}")
    noise = overall(errors([a + b for a, b in zip(true, halves, strict=True)], true))
    print(f"{'noise':52}" + "".join(f"{x:9.1f}" for x in noise[: len(SHOWN)]))
    for name, (operations, code) in codes().items():
        each[name] = errors(code(maps, frames, LOBES, True), true)
        exact[name] = overall(errors(code(maps, frames, SHOWN, False), true[: len(SHOWN)]))
        packed, dense, facets = np.split(overall(each[name]), [len(SHOWN), len(SHOWN) + len(DENSE)])
        row = "".join(f"{x:9.1f}" for x in packed) + "".join(f"{limit(curve, 10):>7}" for curve in (dense, facets))
        print(f"{name:36}{code.size:5} {operations:10}{row}", flush=True)
    print(f"\n{'percent, not packed':52}{head}")
    for name, values in exact.items():
        print(f"{name:52}" + "".join(f"{x:9.1f}" for x in values))
    print(f"\n{'percent, as packed':36}", *(f"{scene:>9} e 2      8     20" for scene in NAMES))
    for name, scenes in each.items():
        print(f"{name:36}", *(f"{row[1]:13.1f}{row[3]:7.1f}{row[4]:7.1f}" for row in scenes))


def main() -> None:
    """Make or read the maps, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=60, help="of each scene")
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
    print_tables(made["pictures"].astype(np.float64), made["frames"])


if __name__ == "__main__":
    main()
