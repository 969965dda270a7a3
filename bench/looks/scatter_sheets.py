"""Contact sheets of scans with scattered points: pointray next to plain points, at the same camera.

    python -m bench.looks.scatter_sheets SCAN... -o FOLDER [--synthetic vehicle] [--pyvista PYTHON] [--cloudcompare]

A row for each scan; a column for each word of --columns, drawn by `pointray render --scatter WORD` with defaults
otherwise, and one of PyVista's points with eye-dome lighting, if --pyvista names a Python that has PyVista:

    python -m venv /tmp/pv && /tmp/pv/bin/pip install pyvista

--cloudcompare adds CloudCompare's points, see `cloudcompare.py`.
--synthetic adds labelled scenes of `scatter_scenes.py`, sampled as named ("airborne 4", "vehicle", ...).
--measure prints the fraction of scattered points, and the largest fraction of the picture that one point covers, of
models with spheres.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import pointray as pr
from bench.looks import cloudcompare
from bench.surface.scatter_scanners import SAMPLINGS, scan
from bench.surface.scatter_scenes import make_scene
from pointray.base.choices import SCATTER
from pointray.cli import execute
from pointray.cloud.normals.validation import select_normals
from pointray.surface.splats.radii import radii_in

CHILD = Path(__file__).with_name("pyvista_child.py")
WINDOW = 3  # size of PyVista's window, in pictures of the sheet
BLOCK = 8  # pixels: a part of a picture that counts as covered if a point is in it
LINE = 18  # pixels of a row's title
SEED, NOISE = 100, 0.1  # of the labelled scenes; noise in spacings


def synthetic(sampling: str, folder: Path) -> Path:
    """A file of a labelled scene, as scanned."""
    labelled = scan(make_scene(SEED), sampling, np.random.default_rng([SEED, 1]))
    path = folder / f"synthetic_{sampling.replace(' ', '_')}.ply"
    pr.write(path, pr.Points(labelled.noisy(NOISE, np.random.default_rng([SEED, 2]))))
    return path


def options_of(camera: pr.Camera) -> list[str]:
    """The camera as options of `pointray render`."""
    vectors = [f"--{name}={','.join(f'{x:.17g}' for x in getattr(camera, name))}" for name in ("eye", "target", "up")]
    return [*vectors, "--fov", str(camera.fov), "--size", "{}x{}".format(*camera.size)]


def drawn(path: Path, scatter: str, camera: pr.Camera, folder: Path) -> Image.Image:
    """The picture of `pointray render --scatter`; a grey one if there is none."""
    out = folder / "drawn.png"
    out.unlink(missing_ok=True)
    begun = time.process_time()
    status = execute(["render", str(path), "-o", str(out), "--no-cache", "--scatter", scatter, *options_of(camera)])
    print(f"    {scatter}: {time.process_time() - begun:.1f} processor seconds", flush=True)
    return Image.open(out).convert("RGB") if status == 0 else Image.new("RGB", camera.size, "grey")


def closed(points: pr.Points, camera: pr.Camera) -> float:
    """The size in pixels at which points just cover the part of the picture in which they are, 4 to 12."""
    at = cloudcompare.seen_from(points, camera).positions[:-4, :2] // BLOCK
    blocks = len(np.unique(at, axis=0))
    return float(np.clip(1.5 * BLOCK * np.sqrt(blocks / max(len(at), 1)), 4, 12))


def plain(points: pr.Points, camera: pr.Camera, python: str, folder: Path) -> Image.Image:
    """Return PyVista's picture, rendered at window size and scaled down, or a grey one if missing."""
    size, camera = camera.size, replace(camera, size=tuple(WINDOW * side for side in camera.size))
    job, out = folder / "job.npz", folder / "plain.png"
    out.unlink(missing_ok=True)
    finite = points.finite
    colors = np.zeros((0, 3), np.uint8) if points.colors is None else points.colors[finite]
    np.savez(
        job,
        positions=points.positions[finite],
        eye=np.asarray(camera.eye) - points.origin,
        target=np.asarray(camera.target) - points.origin,
        up=np.asarray(camera.up, np.float64),
        fov=camera.fov,
        size=camera.size,
        point_size=closed(points, camera),
        colors=colors,
    )
    status = subprocess.run([python, str(CHILD), str(job), str(out)], timeout=300).returncode
    if status != 0:
        return Image.new("RGB", size, "grey")
    return Image.open(out).convert("RGB").resize(size, Image.Resampling.LANCZOS)


def measure(points: pr.Points, camera: pr.Camera) -> str:
    """The share of scattered points, and of the picture that one point covers."""
    model = pr.Model(select_normals(points, "auto"), radii_in(points), scatter="spheres")
    scene = pr.Scene()
    scene.add(model)
    hits = scene.intersect(*camera.rays()).point
    covered = np.bincount(hits[hits >= 0]).max(initial=0) / hits.size
    return f"{model.scattered.mean():.1%} scattered, one point covers up to {covered:.2%} of the picture"


def row(path: Path, options: argparse.Namespace, folder: Path) -> Image.Image:
    """Return the pictures of a scan side by side, under its name."""
    print(path.name, flush=True)
    points = pr.read(path)
    camera = pr.frame(points, up=options.up, size=options.size)
    tiles = {name: drawn(path, name, camera, folder) for name in options.columns}
    if options.pyvista:
        tiles["PyVista, eye-dome lighting"] = plain(points, camera, options.pyvista, folder)
    if options.cloudcompare:
        tiles["CloudCompare"] = cloudcompare.drawn(points, camera, folder)
    if options.measure:
        print(f"    {measure(points, camera)}", flush=True)
    width, height = options.size
    out = Image.new("RGB", (width * len(tiles), height + LINE), "white")
    for k, (name, tile) in enumerate(tiles.items()):
        title = f"{path.stem}, {len(points):,} points: {name}" if k == 0 else name
        ImageDraw.Draw(out).text((k * width + 4, 3), title, fill="black")
        out.paste(tile, (k * width, LINE))
    return out


def size_of(text: str) -> tuple[int, int]:
    width, height = map(int, text.split("x"))
    return width, height


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scans", nargs="*", type=Path)
    parser.add_argument("--output", "-o", type=Path, required=True, help="folder for the sheets")
    parser.add_argument("--synthetic", nargs="*", default=[], choices=SAMPLINGS)
    parser.add_argument("--columns", nargs="+", default=["spheres", "surface"], choices=list(SCATTER))
    parser.add_argument("--size", type=size_of, default=(480, 360), help="size of a picture (default: 480x360)")
    parser.add_argument("--up", default="auto", help="up direction of all scans: z, y, -y, ...")
    parser.add_argument("--rows", type=int, default=3, help="rows per sheet")
    parser.add_argument("--pyvista", help="a Python interpreter with PyVista")
    parser.add_argument("--cloudcompare", action="store_true", help="add a column of CloudCompare's points")
    parser.add_argument("--measure", action="store_true")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = [*options.scans, *(synthetic(sampling, folder) for sampling in options.synthetic)]
        for first in range(0, len(paths), options.rows):
            rows = [row(path, options, folder) for path in paths[first : first + options.rows]]
            sheet = Image.new("RGB", (rows[0].width, sum(image.height for image in rows)), "white")
            for k, image in enumerate(rows):
                sheet.paste(image, (0, k * image.height))
            sheet.save(options.output / f"sheet_{paths[first].stem}.jpg", quality=90)
    return 0


if __name__ == "__main__":
    sys.exit(main())
