"""Measure the first pictures, those of `pointray render SCAN -o x.png` without options, and put them on one sheet.

python -m bench.looks.first_pictures SCAN... -o sheet.jpg [--page]

The figures are the scan's distance from the centre of its picture, its margin, the mean of its pixels (sRGB, 0 to 1),
the fractions of clipped pixels (250 and above) and of black ones (5 and below), its contrast to the background, and its
tonal range. With --page the sheet shows `pointray view SCAN` in Debian's chromium before any input.
"""

from __future__ import annotations

import argparse
import io
import shutil
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from pointray.cli import execute
from pointray.engine.kernels.vec import LUMINANCE
from pointray.image.tone import GRADIENT, backdrop_rows, linear_to_srgb

BURNT, BLACK = 250, 5
CENTRAL = 0.001  # share of the scan's pixels that are ignored as strays
ACROSS = 4  # pictures in a row of the sheet
TILE, LINE = (400, 300), 16  # pixels of each, and of its name
PAGE, REFINED = (1200, 900), 16  # pixels of the browser's window, and the samples a pixel to wait for


class Measured(NamedTuple):
    """Measurements of a picture.

    Attributes
    ----------
    off : float
        How far the middle of the scan is from the picture's, as a share of the width or height (the larger share).
    margin : float
        Free share of the picture beside the scan in the tighter direction, mean of both sides.
    mean : float
        Mean of the scan's pixels, sRGB, 0 to 1.
    burnt, black : float
        Shares of its pixels.
    contrast : float
        Mean difference from the backdrop, sRGB.
    range : float
        From the 5th to the 95th percentile of the luminance of its pixels, of sRGB values.
    """

    off: float
    margin: float
    mean: float
    burnt: float
    black: float
    contrast: float
    range: float


def measure(levels: NDArray[np.uint8], alpha: NDArray[np.uint8]) -> Measured:
    """Measure a picture. levels : (h, w, 3), sRGB; alpha : (h, w), coverage of each pixel by the scan"""
    covered = alpha > 127
    rows, columns = np.nonzero(covered)
    height, width = alpha.shape
    ends = [
        np.quantile((at + 0.5) / side, [CENTRAL / 2, 1 - CENTRAL / 2])
        for at, side in ((columns, width), (rows, height))
    ]
    off = max(abs(float(end.mean()) - 0.5) for end in ends)
    margin = min((1.0 - float(np.ptp(end))) / 2 for end in ends)
    pixels = levels[covered].astype(float)
    behind = 255 * linear_to_srgb(np.broadcast_to(backdrop_rows(GRADIENT, height), levels.shape))[covered]
    brightest = pixels.max(axis=1)
    return Measured(
        off,
        margin,
        float(pixels.mean()) / 255,
        float((brightest >= BURNT).mean()),
        float((brightest <= BLACK).mean()),
        float(np.abs(pixels - behind).mean()) / 255,
        float(np.subtract(*np.quantile(pixels @ LUMINANCE, [0.95, 0.05]))) / 255,
    )


def picture(scan: Path, folder: Path, size: str = "800x600") -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The first picture, (h, w, 3), and the share of each pixel that the scan covers, (h, w)."""
    shown, alone = folder / "shown.png", folder / "alone.png"
    for path, more in ((shown, []), (alone, ["--background", "none", "--integrator", "color"])):
        if execute(["render", str(scan), "-o", str(path), "--size", size, *more]) != 0:
            raise RuntimeError(f"{scan}: no picture was written")
    return np.asarray(Image.open(shown)), np.asarray(Image.open(alone))[..., 3]


def pages(scans: list[Path]) -> dict[str, NDArray[np.uint8]]:
    """The first pictures of the viewer's page, one for each scan."""
    from playwright.sync_api import sync_playwright

    from bench.viewer.viewer import FLAGS, serving

    shown = {}
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        for scan in scans:
            with serving(scan, light=None) as (_, url):
                page = browser.new_page(bypass_csp=True, viewport={"width": PAGE[0], "height": PAGE[1]})
                page.goto(url)
                page.wait_for_function(f"pointray.last?.samples >= {REFINED}", timeout=600e3)
                shown[scan.stem] = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))
                page.close()
        browser.close()
    return shown


def sheet(pictures: dict[str, NDArray[np.uint8]]) -> Image.Image:
    """One sheet of all pictures, with their names."""
    rows = -(-len(pictures) // ACROSS)
    out = Image.new("RGB", (ACROSS * TILE[0], rows * (TILE[1] + LINE)), "white")
    draw = ImageDraw.Draw(out)
    for k, (name, levels) in enumerate(pictures.items()):
        x, y = k % ACROSS * TILE[0], k // ACROSS * (TILE[1] + LINE)
        draw.text((x + 4, y + 2), name, fill="black")
        out.paste(Image.fromarray(levels).resize(TILE, Image.Resampling.LANCZOS), (x, y + LINE))
    return out


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scans", nargs="+", type=Path)
    parser.add_argument("--output", "-o", type=Path, help="the sheet")
    parser.add_argument("--page", action="store_true", help="show the viewer page instead; measures nothing")
    options = parser.parse_args()
    if options.page:
        sheet(pages(options.scans)).save(options.output, quality=90)
        return 0
    pictures = {}
    print(f"{'':36}" + "".join(f"{name:>10}" for name in Measured._fields))
    with tempfile.TemporaryDirectory() as folder:
        for scan in options.scans:
            levels, alpha = picture(scan, Path(folder))
            pictures[scan.stem] = levels
            print(f"{scan.stem:36}" + "".join(f"{value:10.3f}" for value in measure(levels, alpha)))
    if options.output is not None:
        sheet(pictures).save(options.output, quality=90)
    return 0


if __name__ == "__main__":
    sys.exit(main())
