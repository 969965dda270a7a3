"""Render points with CloudCompare, which has no such option, by capturing its window on a virtual screen.

Its camera cannot be set from outside either. So points are projected to pixel coordinates, and CloudCompare shows them
from above, its default view. Needs Debian's cloudcompare, xvfb and xdotool:

    apt-get install --no-install-recommends cloudcompare xvfb xdotool
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageGrab

import pointray as pr

DISPLAY = ":95"
SCREEN = 2400, 2000
VIEW = 330, 80, 2340, 1830  # pixels of the screen in which there are points: left, top, right, bottom
AXES = 2240, 1740  # from here on to the right and down there are the axes
MIDDLE, TICKS = (1344, 960), 14  # where the wheel is turned, and how often, to make points large
OPENS, ANSWERS = 10.0, 4.0  # seconds to wait after opening a file, and after each mouse or key event
GREY = 220  # sRGB, of points without colours


@contextmanager
def screen() -> Iterator[dict[str, str]]:
    """The environment of programs on a screen in memory."""
    for program in ("CloudCompare", "Xvfb", "xdotool"):
        if shutil.which(program) is None:
            raise SystemExit(f"{program} is not installed: see {Path(__file__).name}")
    server = subprocess.Popen(["Xvfb", DISPLAY, "-screen", "0", "{}x{}x24".format(*SCREEN)], stderr=subprocess.DEVNULL)
    time.sleep(1)
    try:
        yield {**os.environ, "DISPLAY": DISPLAY}
    finally:
        server.terminate()
        server.wait()


def drawn(points: pr.Points, camera: pr.Camera, folder: Path) -> Image.Image:
    """Return CloudCompare's picture, or a grey one if its window stayed empty."""
    flat, colors = seen_from(points, camera)
    pr.write(folder / "seen.ply", pr.Points(flat, colors=colors))
    with screen() as environment:
        silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        quiet = {"env": {**environment, "HOME": str(folder)}, **silent}
        convert = ["-C_EXPORT_FMT", "BIN", "-NO_TIMESTAMP", "-SAVE_CLOUDS"]  # others open with a dialog
        subprocess.run(["CloudCompare", "-SILENT", "-O", folder / "seen.ply", *convert], **quiet, timeout=200)
        program = subprocess.Popen(["CloudCompare", folder / "seen.bin"], **quiet)
        try:
            time.sleep(OPENS)
            _press(environment, "search", "--onlyvisible", "--name", "CloudCompare", "windowsize", *SCREEN)
            _press(environment, "search", "--onlyvisible", "--name", "CloudCompare", "windowmove", 0, 0)
            time.sleep(ANSWERS)
            _press(environment, "mousemove", *MIDDLE, "click", "--repeat", TICKS, "--delay", 150, 4)
            time.sleep(ANSWERS)
            shown = ImageGrab.grab(xdisplay=DISPLAY).convert("RGB")
        finally:
            program.terminate()
            program.wait()
    box = _corners(np.asarray(shown).astype(int))
    if box is None:
        return Image.new("RGB", camera.size, "grey")
    return shown.crop(box).resize(camera.size, Image.Resampling.LANCZOS)


def seen_from(points: pr.Points, camera: pr.Camera) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points in the picture, in pixels from its middle: to the right, upwards, and to the camera; and their colours.

    Four red points are the corners of the picture.
    """
    width, height = camera.size
    forward = np.asarray(camera.target) - camera.eye
    distance = np.linalg.norm(forward)
    forward /= distance
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    positions = points.positions[points.finite] + points.origin - camera.eye
    across, upward, depth = np.stack([right, np.cross(right, forward), forward]) @ positions.T
    pixels = height / 2 / np.tan(np.radians(camera.fov) / 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        flat = np.column_stack([across / depth, upward / depth, 1 - depth / distance]) * pixels
    inside = (depth > 0) & (np.abs(flat[:, 0]) < width / 2) & (np.abs(flat[:, 1]) < height / 2)
    flat = flat[inside]
    colors = np.full((len(flat), 3), GREY, np.uint8)
    if points.colors is not None:
        colors = points.colors[points.finite][inside]
    middle = float(flat[:, 2].mean()) if len(flat) else 0.0
    corners = [[x * width / 2, y * height / 2, middle] for x in (-1, 1) for y in (-1, 1)]
    return np.concatenate([flat, corners]), np.concatenate([colors, np.tile(np.uint8([[255, 0, 0]]), (4, 1))])


def _press(environment: dict[str, str], *words: object) -> None:
    subprocess.run(["xdotool", *map(str, words)], env=environment, check=False, stdout=subprocess.DEVNULL)


def _corners(screen: NDArray[np.int64]) -> tuple[int, int, int, int] | None:
    """Left, top, right, bottom of the four red points on the screen, (h, w, 3); None if not found."""
    red = (screen[..., 0] > 200) & (screen[..., 1:] < 60).all(axis=-1)
    left, top, right, bottom = VIEW
    red[AXES[1] :, AXES[0] :] = False
    y, x = np.nonzero(red[top:bottom, left:right])
    if len(y) == 0:
        return None
    return int(x.min() + left), int(y.min() + top), int(x.max() + left + 1), int(y.max() + top + 1)
