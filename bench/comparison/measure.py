"""Run the programs and compare their silhouettes with the surface of pointray."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

import pointray as pr
from bench.comparison.peers import Peer, environment
from pointray.cloud.normals.validation import select_normals
from pointray.surface.splats.radii import radii_in

ROOT = Path(__file__).parents[2]
LAUNCH = Path(__file__).with_name("launch.py")
DIFFERS = 6  # levels of 255 from the background: a pixel is covered
GAPS = 7  # pixels: gaps between points up to this size count as covered
LONGEST = 150  # seconds of one run: stopped after it
TRIES = 4  # stopped runs before a program counts as failed


@dataclass
class Result:
    """Measurements of one program with one scan.

    seconds, processor : of each run, elapsed and of all cores together
    peak : bytes; overlap : intersection over union of silhouettes; stopped : number of runs longer than LONGEST
    """

    peer: Peer
    picture: Path
    seconds: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)
    peak: int = 0
    overlap: float = np.nan
    stopped: int = 0
    failure: str = ""


def run(result: Result, command: list[str]) -> None:
    """Run a command once and add its time and memory, or how it failed; again if it had to be stopped."""
    result.picture.unlink(missing_ok=True)
    words = [sys.executable, "-IS", str(LAUNCH), str(LONGEST), *command]
    done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, env=environment())
    if done.returncode != 0:
        result.failure = f"failed: the measurement ended with status {done.returncode}"
        return
    measured = json.loads(done.stdout)
    if measured["status"] is None:
        result.stopped += 1
        if result.stopped < TRIES:
            run(result, command)
        else:
            result.failure = f"failed: stopped {TRIES} times after {LONGEST} s"
        return
    if measured["status"] != 0 or not result.picture.exists():
        last = (done.stderr.strip().splitlines() or ["no picture was written"])[-1]
        result.failure = f"failed with status {measured['status']}: {last}"
        return
    result.seconds.append(measured["seconds"])
    result.processor.append(measured["processor"])
    result.peak = max(result.peak, measured["peak"])


def coverage(points: pr.Points, camera: pr.Camera) -> NDArray[np.bool_]:
    """The pixels of the camera's image, (h, w), at which the surface of pointray is hit."""
    scene = pr.Scene()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of isolated points
        scene.add(pr.Model(select_normals(points, "auto"), radii_in(points)))
    return np.isfinite(scene.intersect(*camera.rays()).t)


def covered(picture: Path) -> NDArray[np.bool_]:
    """The pixels of a picture, (h, w), that differ from its background, the colour at its top left."""
    levels = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    background = np.median(levels[5:25, 5:25], axis=(0, 1))  # CloudCompare's has a mark in its corner
    return (np.abs(levels - background) > DIFFERS).any(axis=-1)


def overlap(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> float:
    """Intersection over union of two silhouettes whose gaps are closed."""
    square = np.ones((GAPS, GAPS), bool)
    closed = [ndimage.binary_closing(np.pad(each, GAPS), square) for each in (one, other)]
    return float((closed[0] & closed[1]).sum() / max((closed[0] | closed[1]).sum(), 1))
