"""Compare files of Gaussian splats (`pr.write_splats`) with pointray's own pictures of the same models.

python -m bench.looks.splats [SCAN...] [--light] [--zoom 4] [--widths 0.5,0.55,0.6] [--viewers FOLDER] [-o sheet.png]

Without scans the model is the statue of `pointray demo`. Splats are rendered by a reference in NumPy, with each width
(standard deviation in support radii), and, with --viewers, by two viewers of npm in chromium: FOLDER is one in which
`npm install three @sparkjsdev/spark @mkkellogg/gaussian-splats-3d` was run. Shares are of the area that pointray
covers: "excess" and "lack" are the positive and negative differences of alpha; "open" is the alpha that lacks inside of
the silhouette. "colour" is the mean difference there, of 255. The sheet shows pointray's picture first.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import binary_erosion

import pointray as pr
from bench.helpers.gaussians import rasterize, read_gaussians
from bench.looks.splat_viewers import VIEWERS, open_in
from pointray.auto_view.first_view import Scan, ViewChoice
from pointray.auto_view.splats import lit_colors, write_model
from pointray.auto_view.studio import CLAY, studio
from pointray.image.tone import linear_to_srgb, tone
from pointray.io.formats.splats._flat import WIDTH
from pointray.surface.splats.radii import radii_in

SIZE, SPP = (640, 480), 16
INSIDE = 3  # pixels from the silhouette

Picture = tuple[NDArray[np.float64], NDArray[np.float64]]  # sRGB on black, (h, w, 3), and alpha, (h, w)


class Difference(NamedTuple):
    """Differences of a picture of splats from pointray's, as the module describes them."""

    excess: float
    lack: float
    open: float
    color: float


def compare(splats: Picture, own: Picture) -> Difference:
    """Return the differences of a picture of splats from pointray's own."""
    alpha, covered = splats[1], own[1]
    inside = binary_erosion(covered > 0.999, iterations=INSIDE)
    area, more = covered.sum(), alpha - covered
    unmixed = [picture[inside] / np.maximum(a[inside], 1e-3)[:, None] for picture, a in (splats, own)]
    return Difference(
        float(np.maximum(more, 0).sum() / area),
        float(np.maximum(-more, 0).sum() / area),
        float((1 - alpha[inside]).mean()) if inside.any() else np.nan,
        float(255 * np.abs(unmixed[0] - unmixed[1]).mean()) if inside.any() else np.nan,
    )


def write_and_render(points: pr.Points, file: Path, light: bool, zoom: float) -> tuple[Picture, pr.Camera]:
    """Write points as Gaussian splats; return pointray's own picture of them, and its camera.

    light : whether the studio's light is baked into the splats and shown in the picture
    """
    model = pr.Model(points, radii_in(points))
    scan, scene, colors = Scan(model, ViewChoice()), pr.Scene(), None
    camera = replace(pr.frame(model, size=SIZE), fov=40 / zoom)
    number = scene.add(model, material=pr.Diffuse(CLAY if points.colors is None else None))
    curve = 0.0, "srgb"
    if light:
        scene.lights = studio(scan.up, float(round(scan.natural_outlook.azimuth)))
        lit = lit_colors(scene, pr.bake(scene), number, scan.up)
        colors, curve = lit.colors, lit[1:]
    write_model(file, model, colors, None)
    image = pr.render(scene, camera, pr.Settings("baked" if light else "color", spp=SPP))
    alpha = image[..., 3:].astype(np.float64)
    plain = (image[..., :3] / np.maximum(alpha, 1e-6)).astype(np.float32)
    return (linear_to_srgb(tone(plain, *curve)) * alpha, alpha[..., 0]), camera


def measure(name: str, points: pr.Points, given: argparse.Namespace) -> NDArray[np.float64]:
    """Print the differences for one model; return a row of the sheet, (h, w, 3)."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "splats.ply"
        own, camera = write_and_render(points, file, given.light, given.zoom)
        splats, pictures = read_gaussians(file), [own[0]]
        makers: dict[str, Callable[[], Picture]] = {
            f"reference, width {width:g}": partial(rasterize, splats.widened(width / WIDTH), camera)
            for width in given.widths
        }
        for viewer in VIEWERS if given.viewers else ():
            makers[viewer] = partial(open_in, viewer, given.viewers, file, camera)
        print(f"{name}: {len(splats.positions):,} splats, {file.stat().st_size:,} bytes")
        for label, make in makers.items():
            picture = make()
            found = compare(picture, own)
            shares = ", ".join(f"{x} {getattr(found, x):.2%}" for x in ("excess", "lack", "open"))
            print(f"  {label}: {shares}, colour {found.color:.1f}", flush=True)
            if label in VIEWERS or f"{WIDTH:g}" in label:
                pictures.append(picture[0])
    return np.concatenate(pictures, axis=1)


def main() -> None:
    """Measure each model and write the sheet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scans", nargs="*", type=Path)
    parser.add_argument("--light", action="store_true")
    parser.add_argument("--zoom", type=float, default=1.0)
    parser.add_argument("--widths", type=lambda text: [float(x) for x in text.split(",")], default=[0.5, WIDTH, 0.6])
    parser.add_argument("--viewers", type=Path)
    parser.add_argument("-o", "--output", type=Path)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    clouds = {str(file): pr.read(file) for file in given.scans} or {"statue": pr.procedural("statue", 60_000)}
    rows = [measure(name, points, given) for name, points in clouds.items()]
    if given.output:
        sheet = np.concatenate(rows)
        Image.fromarray(np.rint(255 * np.clip(sheet, 0, 1)).astype(np.uint8)).save(given.output)


if __name__ == "__main__":
    main()
