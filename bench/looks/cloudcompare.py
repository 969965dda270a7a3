"""Render points with CloudCompare, which has no such option, by capturing its window on a virtual screen.

    python -m bench.looks.cloudcompare SEEN.ply WIDTHxHEIGHT PICTURE.png

Its command line mode draws nothing (https://github.com/CloudCompare/CloudCompare/issues/1431), and its camera cannot be
set from outside. So points are projected to pixel coordinates, `seen_from`, and CloudCompare shows them from above, its
default view. Needs Debian's cloudcompare, xvfb and xdotool:

    apt-get install --no-install-recommends cloudcompare xvfb xdotool
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageGrab

import pointray as pr

SCREEN = 2400, 2000
VIEW = 330, 80, 2340, 1830  # pixels of the screen in which there are points: left, top, right, bottom
AXES = 2240, 1740  # from here on to the right and down there are the axes
SMALLEST = 100  # pixels between corners: less is something else
MIDDLE = 1344, 960  # where the wheel is turned with Alt, which changes the size of points
POINT_SIZE = 3  # pixels; CloudCompare starts with 1
LONGEST, ANSWER, PAUSE = 120.0, 10.0, 0.25  # seconds to wait for a picture, for a change, and between two looks
TRIES = 10  # turns of the wheel, as some are lost
CONFIG = ".config/CCCorp/CloudCompare.conf"
WHITE = r"""[OpenGL]
backgroundColor=@ByteArray(\xff\xff\xff)
backgroundGradient=false
crossDisplayed=false
"""
GREY = 220  # sRGB, of points without colours


@contextmanager
def screen() -> Iterator[dict[str, str]]:
    """The environment of programs on a screen in memory."""
    for program in ("CloudCompare", "Xvfb", "xdotool"):
        if shutil.which(program) is None:
            raise SystemExit(f"{program} is not installed: see {Path(__file__).name}")
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", "{}x{}x24".format(*SCREEN)]  # prints a number that is free
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        yield {**os.environ, "DISPLAY": f":{server.stdout.readline().strip()}"}
    finally:
        server.terminate()
        server.wait()


def drawn(points: pr.Points, camera: pr.Camera, folder: Path) -> Image.Image:
    """Return CloudCompare's picture, or a grey one if its window stayed empty."""
    pr.write(folder / "seen.ply", seen_from(points, camera))
    try:
        return capture(folder / "seen.ply", camera.size)
    except TimeoutError:
        return Image.new("RGB", camera.size, "grey")


def capture(file: Path, size: tuple[int, int]) -> Image.Image:
    """Return the picture of a file of `seen_from`. A TimeoutError is raised if its corners do not appear."""
    config = file.parent / CONFIG
    config.parent.mkdir(parents=True, exist_ok=True)
    config.write_text(WHITE)
    with screen() as environment:
        quiet = {"env": {**environment, "HOME": str(file.parent)}}
        quiet |= {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        convert = ["-C_EXPORT_FMT", "BIN", "-NO_TIMESTAMP", "-SAVE_CLOUDS"]  # others open with a dialog
        subprocess.run(["CloudCompare", "-SILENT", "-O", file, *convert], **quiet, timeout=200)
        program = subprocess.Popen(["CloudCompare", file.with_suffix(".bin")], **quiet)
        try:
            shown = _settled(environment)
            _press(environment, "mousemove", *MIDDLE)
            for _ in range(TRIES):
                if _red(shown).sum() >= 4 * POINT_SIZE**2:
                    break
                _press(environment, "keydown", "alt", "click", 4, "keyup", "alt")
                with suppress(TimeoutError):  # the event was lost
                    shown = _settled(environment, shown, ANSWER)
        finally:
            program.terminate()
            program.wait()
    return shown.crop(_corners(shown)).resize(size, Image.Resampling.LANCZOS)


def _wait(ready: Callable[[], bool], longest: float = LONGEST) -> None:
    end = time.monotonic() + longest
    while not ready():
        if time.monotonic() > end:
            raise TimeoutError(f"CloudCompare shows no points after {longest:g} s")
        time.sleep(PAUSE)


def _settled(environment: dict[str, str], before: Image.Image | None = None, longest: float = LONGEST) -> Image.Image:
    """Return the screen once it has corners of a picture, differs from `before`, and has stopped changing."""
    last = before

    def settled() -> bool:
        nonlocal last
        window = ["search", "--onlyvisible", "--name", "CloudCompare"]  # at first the splash screen, too
        _press(environment, *window, "windowmove", "%@", 0, 0, "windowsize", "%@", *SCREEN)
        shown, last = last, ImageGrab.grab(xdisplay=environment["DISPLAY"]).convert("RGB")
        return shown == last and last != before and _corners(last) is not None

    _wait(settled, longest)
    return last


def seen_from(points: pr.Points, camera: pr.Camera) -> pr.Points:
    """Points in the picture, in pixels from its middle: to the right, upwards, and to the camera.

    Colours are kept, normals turned. Four red points are the corners of the picture.
    """
    width, height = camera.size
    forward = np.asarray(camera.target) - camera.eye
    distance = np.linalg.norm(forward)
    forward /= distance
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, forward), forward])
    across, upward, depth = axes @ (points.positions[points.finite] + points.origin - camera.eye).T
    pixels = height / 2 / np.tan(np.radians(camera.fov) / 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        flat = np.column_stack([across / depth, upward / depth, 1 - depth / distance]) * pixels
    inside = (depth > 0) & (np.abs(flat[:, 0]) < width / 2) & (np.abs(flat[:, 1]) < height / 2)
    flat = flat[inside]
    colors = np.full((len(flat), 3), GREY, np.uint8)
    if points.colors is not None:
        colors = points.colors[points.finite][inside]
    normals = None
    if points.normals is not None:
        turned = points.normals[points.finite][inside] @ axes.T * (1, 1, -1)
        normals = np.concatenate([turned, np.tile([0.0, 0, 1], (4, 1))])
    middle = float(flat[:, 2].mean()) if len(flat) else 0.0
    corners = [[x * width / 2, y * height / 2, middle] for x in (-1, 1) for y in (-1, 1)]
    red = np.tile(np.uint8([[255, 0, 0]]), (4, 1))
    return pr.Points(np.concatenate([flat, corners]), normals=normals, colors=np.concatenate([colors, red]))


def _press(environment: dict[str, str], *words: object) -> None:
    subprocess.run(["xdotool", *map(str, words)], env=environment, check=False, stdout=subprocess.DEVNULL)


def _red(screen: Image.Image) -> NDArray[np.bool_]:
    """The pixels of the view in which there are points that are red."""
    levels = np.asarray(screen).astype(int)
    red = (levels[..., 0] > 200) & (levels[..., 1:] < 60).all(axis=-1)
    left, top, right, bottom = VIEW
    red[AXES[1] :, AXES[0] :] = False
    return red[top:bottom, left:right]


def _corners(screen: Image.Image) -> tuple[int, int, int, int] | None:
    """Left, top, right, bottom of the four red points on the screen; None if not found."""
    red = _red(screen)
    y, x = np.nonzero(red)
    if len(y) == 0 or np.ptp(y) < SMALLEST or not red[np.ix_([y.min(), y.max()], [x.min(), x.max()])].all():
        return None
    left, top = VIEW[:2]
    return int(x.min() + left), int(y.min() + top), int(x.max() + left + 1), int(y.max() + top + 1)


def main() -> int:
    width, height = map(int, sys.argv[2].split("x"))
    capture(Path(sys.argv[1]), (width, height)).save(sys.argv[3])
    return 0


if __name__ == "__main__":
    sys.exit(main())
