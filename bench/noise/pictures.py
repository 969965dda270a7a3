"""Close views of real scans without and with smoothing.

    python -m bench.noise.pictures [SCAN...] -o docs/noise.jpg [--models FOLDER]

Each row is a scan. The first half of its pictures is without smoothing (`smooth=0`), the second with it (default):
under a headlight, under a grazing sun, and by ambient occlusion. Colours are omitted because they hide the shape.
"""

from __future__ import annotations

import argparse
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

import pointray as pr
from bench.helpers.truth import FOLDER
from pointray.auto_view.first_view import frame
from pointray.image.tone import linear_to_srgb

TILE, LINE = (270, 200), 16  # pixels of a picture, and of a line of text
ELEVATION = 12.0  # of the sun, degrees over the surface in the middle
SUN, EYE = 1.1 * np.pi, 0.2 * np.pi  # irradiance of the sun, and of a weak headlight for shadowed parts
LIGHTS = ("headlight", "grazing sun", "ao")
REACH = 0.05  # how far ambient occlusion looks, as a share of what the picture shows
SPP = 16


class Shot(NamedTuple):
    """A close view of a scan: position in the first picture, 0 to 1 to the right and downwards, and zoom."""

    file: str
    right: float
    down: float
    zoom: float


SHOTS = {
    "tower": Shot("tls_tower_wall_ghost_nonormals", 0.5, 0.5, 3.0),
    "bunny": Shot("stanford_bunny_rangescans", 0.5, 0.4, 2.5),
    "dragon": Shot("stanford_dragon_stand_rangescans", 0.45, 0.5, 2.5),
    "lion": Shot("potree_lion_takanawa_rgb", 0.5, 0.35, 2.5),
    "kinect": Shot("rgbd_kinect_chair_rgb", 0.5, 0.55, 2.5),
    "pump": Shot("tls_pumpA_rgb", 0.5, 0.5, 2.5),
    "garden": Shot("sfm_garden_rgb_nonormals", 0.5, 0.5, 2.5),
    "outcrop": Shot("outcrop_qcompass_rgb", 0.5, 0.5, 3.0),
    "autzen": Shot("autzen_stadium_crop_rgb", 0.5, 0.5, 3.0),
}


class View(NamedTuple):
    """A camera, and the sun's direction."""

    camera: pr.Camera
    sun: NDArray[np.float64]


def nearer(model: pr.Model, shot: Shot) -> View:
    """Return the camera of a shot, aimed at the point that the first picture shows there."""
    whole = frame(model, size=TILE)
    origins, directions = whole.rays()
    column, row = int(shot.right * (TILE[0] - 1)), int(shot.down * (TILE[1] - 1))
    scene = pr.Scene()
    scene.add(model)
    around = np.s_[max(row - 30, 0) : row + 30, max(column - 30, 0) : column + 30]
    hits = scene.intersect(origins[around], directions[around])
    seen = np.isfinite(hits.t)
    middle = np.median(hits.position[seen], axis=0)
    normal = hits.normal[seen].mean(axis=0)
    back = np.asarray(whole.eye) - middle
    normal *= np.sign(normal @ back) / np.linalg.norm(normal)
    camera = pr.Camera.look_at(tuple(whole.eye), tuple(middle), whole.up, fov=whole.fov / shot.zoom, size=TILE)
    left = np.cross(back, whole.up) / np.linalg.norm(back)
    side = np.asarray(whole.up, float) - left  # the sun stands above and to the left
    side -= (side @ normal) * normal
    angle = np.radians(ELEVATION)
    return View(camera, -np.cos(angle) * side / np.linalg.norm(side) - np.sin(angle) * normal)


def pictures(model: pr.Model, view: View) -> list[NDArray[np.uint8]]:
    """The model under each of the LIGHTS."""
    out = []
    width = (
        2 * np.linalg.norm(np.subtract(view.camera.eye, view.camera.target)) * np.tan(np.radians(view.camera.fov / 2))
    )
    grey = pr.Diffuse((0.8, 0.8, 0.8))
    for light in LIGHTS:
        scene = pr.Scene()
        scene.add(model, material=grey)
        if light == "grazing sun":
            scene.add_light(pr.SunLight(view.sun, SUN))
            scene.add_light(pr.SunLight((0, 0, -1), EYE, camera=True))
        integrator = "ao" if light == "ao" else "phong"
        settings = pr.Settings(integrator=integrator, spp=SPP, ao_distance=REACH * width)
        image = pr.render(scene, view.camera, settings)
        shown = linear_to_srgb(np.clip(image[..., :3], 0.0, 1.0)) + 0.18 * (1 - image[..., 3:])
        out.append((255 * np.clip(shown, 0, 1)).astype(np.uint8))
    return out


def row_of(name: str, folder: Path) -> NDArray[np.uint8]:
    """All pictures of a scan, side by side."""
    points = pr.read(folder / f"{SHOTS[name].file}.ply")
    plain, smooth = (pr.Model(points, smooth=amount, scatter="surface") for amount in (0, "auto"))
    view = nearer(smooth, SHOTS[name])
    return np.concatenate([*pictures(plain, view), *pictures(smooth, view)], axis=1)


def main() -> None:
    """Render, put on one sheet, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scans", nargs="*", metavar="SCAN", help=", ".join(SHOTS))
    parser.add_argument("-o", dest="sheet", type=Path, default=Path("noise.jpg"))
    parser.add_argument("--models", type=Path, default=FOLDER.parent)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    rows = []
    for name in options.scans or SHOTS:
        rows.append(row_of(name, options.models / "points"))
        print(name, flush=True)
    body = np.concatenate(rows)
    sheet = Image.new("RGB", (body.shape[1], body.shape[0] + LINE), "white")
    sheet.paste(Image.fromarray(body), (0, LINE))
    draw = ImageDraw.Draw(sheet)
    for k, title in enumerate([f"{light}, {how}" for how in ("smooth=0", "smoothed") for light in LIGHTS]):
        draw.text((k * TILE[0] + 4, 2), title, "black")
    sheet.save(options.sheet, quality=82)
    print(options.sheet)


if __name__ == "__main__":
    main()
