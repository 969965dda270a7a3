"""Compare pictures with Mitsuba 3: Mitsuba renders meshes, pointray points on their triangles.

    python -m bench.light.beside_mitsuba [--meshes bunny dragon ...] [--lights sun ...] [--materials diffuse ...]
                                   [--bounces] [--size 128] [--spp 144] [--halvings 2] [--folder DIR] [--json FILE]
                                   [--pictures DIR]
    python -m bench.light.beside_mitsuba --speed [--points 1000000] [--size 512] [--spp 4] [--runs 5]

Both have the same lights, materials, planes and camera. Every light is rendered with every material by direct light,
then with 4 bounces on a floor and in a corner; --bounces runs only the latter. Mirrors and glass get more bounces
under light from all around, and glass gets no other light.

The program prints a row for each scene, where a is Mitsuba's picture and b is pointray's. The pixels are those of
surfaces, farther than 2 pixels from a silhouette or the edge of a hard shadow. The figures are sum |a - b| / sum b,
which must be at most 5%, and (sum a - sum b) / sum b, which must be at most 1% either way. Both follow for the
model's own pixels, with the same limits. The noise is the value of these figures for two seeds.
Pictures show pointray, Mitsuba and the difference.

Between its vertices a mesh is flat and its normals are interpolated, whereas pointray reconstructs a curved surface. So
edges are halved once or twice, which gives points with interpolated normals between the vertices, too. (The bunny in
mirrors is 8 to 16% apart with its vertices alone, and 1 to 3% with these points.)

It needs mitsuba and trimesh (pip install 'pointray[dev]') and LLVM 16 or later (libLLVM.so; DRJIT_LIBLLVM_PATH names
it; 14 and 15 fail on processors with AVX-512). Without LLVM, or with one that does not know the processor, materials
that Mitsuba lacks are left out. A run takes some half an hour.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

import pointray as pr
from bench.helpers.truth import FOLDER
from bench.light.mitsuba_child import llvm_works
from bench.light.mitsuba_pairs import COLOR, FORMULAS, LIGHTS, MATERIALS, Floats
from bench.light.mitsuba_pictures import write_difference
from bench.light.mitsuba_scenes import Body, Case, body, camera, halved, our_scene, their_camera, their_scene

ENOUGH = 500_000  # points of a mesh
MOST_APART, MOST_OFF = 0.05, 0.01
FINER = 3  # rays a side of a pixel, with which edges are found
STEEP = 10.0  # pixels' widths: a larger step in depth is a silhouette (a surface seen at under 6 degrees)
AWAY = 2  # pixels from an edge that are left out
COLUMNS = "  pixels   apart   noise     off   noise"
HEAD = f"mesh    light      material     around bounces{COLUMNS} | model{COLUMNS[7:]}"
NO_VARIANT = "mitsuba is not here: pip install 'pointray[dev]'"


@dataclass
class Figures:
    """Differences relative to the light in pointray's pixels; `pixels` is their number.

    apart : sum |a - b| / sum b; off : (sum a - sum b) / sum b; noise : the same figures if there were nothing but noise
    """

    pixels: int
    apart: float
    apart_noise: float
    off: float
    off_noise: float

    def __str__(self) -> str:
        shares = self.apart, self.apart_noise, self.off, self.off_noise
        return f"{self.pixels:8,}" + "".join(f"{100 * share:7.2f}%" for share in shares)

    @property
    def met(self) -> bool:
        """Whether both limits hold."""
        return self.apart <= MOST_APART and abs(self.off) <= MOST_OFF


@dataclass
class Row:
    """The figures of a scene. model : those of the pixels that show nothing but the model"""

    mesh: str
    light: str
    material: str
    around: str
    bounces: int
    all: Figures
    model: Figures

    @property
    def met(self) -> bool:
        """Whether the limits hold, everywhere and on the model."""
        return self.all.met and self.model.met

    def __str__(self) -> str:
        scene = f"{self.mesh:8s}{self.light:11s}{self.material:13s}{self.around:7s}{self.bounces:7d}"
        return f"{scene}{self.all} {self.model}  {'good' if self.met else 'NOT MET'}"


def choose_variant(arrays: bool = True) -> str:
    """Mitsuba's variant: on arrays if there is LLVM, else the scalar one, without the materials that need arrays.

    Raises
    ------
    ImportError
        If there is no mitsuba.
    """
    import mitsuba as mi

    name = "llvm_ad_rgb" if arrays and llvm_works() else "scalar_rgb"
    mi.set_variant(name)
    if name != "scalar_rgb":
        from bench.light import mitsuba_formulas  # noqa: F401  # Mitsuba knows its materials from now on
    return name


def halvings_of(shape: Body) -> int:
    """How often a mesh's edges are halved until it has ENOUGH points; each time multiplies them by four."""
    return max(math.ceil(math.log(ENOUGH / len(shape.vertices), 4)), 0)


@dataclass(frozen=True)
class Pixels:
    """The pixels that are compared, (h, w) bool. model : only those of the model"""

    all: NDArray[np.bool_]
    model: NDArray[np.bool_]


class Pair:
    """A mesh for Mitsuba, its vertices as a model for pointray, and the camera that sees both.

    halvings : how often edges get a point in the middle, too
    """

    def __init__(self, shape: Body, size: int, spp: int, halvings: int = 0) -> None:
        self.shape, self.spp = shape, spp
        for _ in range(halvings):
            shape = halved(shape)
        self.model = pr.Model(pr.Points(shape.vertices, normals=shape.normals))
        self.camera = camera(size)
        self._pixels: dict[tuple[str, str], Pixels] = {}

    def ours(self, case: Case, seed: int) -> Floats:
        """The picture by pointray, (h, w, 3)."""
        settings = pr.Settings("path", self.spp, case.bounces, seed=seed, filter="box")
        return pr.render(our_scene(case, self.model, self.shape.floor), self.camera, settings)[..., :3].astype(
            np.float64
        )

    def theirs(self, case: Case, seed: int) -> Floats:
        """The picture by Mitsuba, (h, w, 3)."""
        import mitsuba as mi

        # Mitsuba's depth counts the edges of a path, from the eye to the light.
        integrator = {"type": "path", "max_depth": case.bounces + 1, "rr_depth": 10_000}
        sensor = their_camera(self.camera, self.spp)
        picture = mi.render(
            their_scene(case, self.shape), sensor=sensor, integrator=mi.load_dict(integrator), seed=seed
        )
        return np.array(picture, np.float64)

    def pixels(self, case: Case) -> Pixels:
        """The pixels that are compared."""
        hard = case.light if LIGHTS[case.light]().hard else ""
        key = hard, case.around
        if key not in self._pixels:
            self._pixels[key] = self._find_pixels(case._replace(material="diffuse"), bool(hard))
        return self._pixels[key]

    def _find_pixels(self, case: Case, hard: bool) -> Pixels:
        """Find them from Mitsuba's depths, shapes and hard shadows at a higher resolution."""
        import mitsuba as mi

        scene, sensor = their_scene(case, self.shape), their_camera(self.camera, 1, FINER)
        layers = mi.load_dict({"type": "aov", "aovs": "depth:depth,color:albedo"})
        picture = np.array(mi.render(scene, sensor=sensor, integrator=layers))
        depth, color = picture[..., 0], picture[..., 1:] @ (1.0, 10.0, 100.0)  # one number identifies a surface
        width = depth * 2 * np.tan(np.radians(self.camera.fov) / 2) / len(depth)
        edges = _steps(color, 0.1) | _steps(depth, STEEP * width)
        if hard:
            lit = np.array(mi.render(scene, sensor=sensor, integrator=mi.load_dict({"type": "direct"}))).sum(axis=2) > 0
            edges |= _steps(lit.astype(float), 0.0)
        near = binary_dilation(_blocks(edges).any(axis=(1, 3)), np.ones((3, 3)), AWAY)
        model = np.abs(color - np.dot(COLOR, (1.0, 10.0, 100.0))) < 0.1
        return Pixels(*(_blocks(shown).all(axis=(1, 3)) & ~near for shown in (depth > 0, model)))


def _blocks(values: NDArray[Any]) -> NDArray[Any]:
    """The fine pixels in each pixel: (h, FINER, w, FINER)."""
    height, width = values.shape
    return values.reshape(height // FINER, FINER, width // FINER, FINER)


def _steps(values: NDArray[Any], least: Any) -> NDArray[np.bool_]:
    """Where a value differs by more than `least` from that of a neighbour, to the right or below, on either side."""
    out = np.zeros(values.shape, bool)
    for axis in (0, 1):
        a, b = [slice(None)] * 2, [slice(None)] * 2
        a[axis], b[axis] = slice(None, -1), slice(1, None)
        limit = np.broadcast_to(least, values.shape)
        step = np.abs(values[tuple(a)] - values[tuple(b)]) > limit[tuple(a)]
        out[tuple(a)] |= step
        out[tuple(b)] |= step
    return out


def compare(pair: Pair, case: Case, pictures: Path | None = None) -> Row:
    """Render a case with seeds 0 and 1 by both, and compare the means. The seeds' differences are the noise."""
    theirs, ours = ([render(case, seed) for seed in (0, 1)] for render in (pair.theirs, pair.ours))
    a, b = sum(theirs) / 2, sum(ours) / 2
    # This has the variance of a - b, without what the two disagree on.
    noise = ((theirs[0] - theirs[1]) - (ours[0] - ours[1])) / 2
    pixels = pair.pixels(case)
    if pictures is not None:
        write_difference(pictures / f"{pair.shape.name}, {case.name}.png".replace(", ", "_"), a, b, pixels.all)

    figures = [_figures(a, b, noise, mask) for mask in (pixels.all, pixels.model)]
    return Row(pair.shape.name, *case, *figures)


def _figures(a: Floats, b: Floats, noise: Floats, mask: NDArray[np.bool_]) -> Figures:
    light = b[mask].sum()
    shares = (
        value / light for values in ((a - b)[mask], noise[mask]) for value in (np.abs(values).sum(), values.sum())
    )
    apart, off, apart_noise, off_noise = map(float, shares)
    return Figures(int(mask.sum()), apart, apart_noise, off, off_noise)


def cases(options: argparse.Namespace) -> Iterator[Case]:
    """What a run compares, in the order of the table."""
    materials = [name for name in options.materials if name not in FORMULAS or options.variant != "scalar_rgb"]
    for material in materials:
        least = MATERIALS[material]().bounces
        for light in () if options.bounces else options.lights:
            if least == 1 or light in ("constant", "gradient"):
                yield Case(light, material, "floor", least)
            elif material == "mirror" and not LIGHTS[light]().hard:
                yield Case(light, material)  # with more bounces, what it casts on the floor is all noise
        if least == 1 and "gradient" in options.lights:
            yield Case("gradient", material, "floor", 4)
        corner = "rectangle" if least == 1 else "gradient"
        if corner in options.lights:
            yield Case(corner, material, "corner", max(least, 4))


def parsed(arguments: list[str] | None) -> argparse.Namespace:
    """The options."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", nargs="+", default=["bunny", "dragon"], metavar="NAME")
    parser.add_argument("--lights", nargs="+", choices=LIGHTS, default=list(LIGHTS), metavar="NAME")
    parser.add_argument("--materials", nargs="+", choices=MATERIALS, default=list(MATERIALS), metavar="NAME")
    parser.add_argument("--bounces", action="store_true")
    parser.add_argument(
        "--size", type=int, help="width and height of pictures in pixels (default: 128, with --speed 512)"
    )
    parser.add_argument("--spp", type=int, help="samples per pixel (default: 144, with --speed 4)")
    parser.add_argument(
        "--halvings", type=int, help=f"how often edges are halved (default: until there are {ENOUGH:,} points)"
    )
    parser.add_argument("--folder", type=Path, default=FOLDER)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--speed", action="store_true", help="compare speed instead of pictures, see mitsuba_speed.py")
    parser.add_argument("--points", type=int, default=1_000_000, help="of --speed")
    parser.add_argument("--runs", type=int, default=5, help="of --speed")
    options = parser.parse_args(arguments)
    options.size = options.size or (512 if options.speed else 128)
    options.spp = options.spp or (4 if options.speed else 144)
    if options.size < 16 or options.spp < 1:
        parser.error("--size must be at least 16, --spp at least 1")
    return options


def main(arguments: list[str] | None = None) -> None:
    """Render, compare, print, write."""
    options = parsed(arguments)
    if options.speed:
        try:
            from bench.light.mitsuba_speed import speed
        except ImportError:
            sys.exit(NO_VARIANT)
        speed(options.points, options.size, options.runs, options.spp)
        return
    try:
        options.variant = choose_variant()
    except ImportError:
        sys.exit(NO_VARIANT)
    warnings.simplefilter("ignore")
    rows = []
    print(HEAD)
    for mesh in options.meshes:
        shape = body(mesh, options.folder)
        halvings = halvings_of(shape) if options.halvings is None else options.halvings
        pair = Pair(shape, options.size, options.spp, halvings)
        for case in cases(options):
            rows.append(compare(pair, case, options.pictures))
            print(rows[-1], flush=True)
    print(f"{sum(row.met for row in rows)} of {len(rows)} rows are within 5% and 1%")
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1))


if __name__ == "__main__":
    main()
