"""The memory of a bake, measured in a separate process: size of the result, and peak during the bake."""

from __future__ import annotations

import ctypes
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import pointray as pr
from bench.light.bake_rows import Options, Row, at_most
from bench.light.bake_scenes import solid

SMALL = 5000  # points of a scene that only makes kernels ready
STATUS, RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def memory(options: Options) -> list[Row]:
    """Bytes of the light a splat, and of the process while baking a patch, for the statue under a sky."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "statue.pointray"
        solid("statue", options.points).save(path)
        done = subprocess.run(
            [sys.executable, "-m", "bench.light.bake_memory", str(path)], check=True, capture_output=True, text=True
        )
    kept, grown, patches = json.loads(done.stdout.splitlines()[-1])
    what = f"memory, {options.points:,} points, {patches:,} patches: "
    return [
        at_most(what + "kept, bytes a splat", kept / options.points, 16.0, "{:.1f}"),
        at_most(what + "most while baking, bytes a patch", grown / patches, 200.0, "{:.0f}"),
    ]


def _resident(name: str) -> int:
    """Bytes of this process: VmRSS, now, or VmHWM, the most since the last reset."""
    line = next(line for line in STATUS.read_text().splitlines() if line.startswith(name + ":"))
    return 1024 * int(line.split()[1])


def _reset_peak() -> None:
    """Give free memory back, and forget the most so far."""
    ctypes.CDLL(None).malloc_trim(0)
    RESET.write_text("5")


def measure(path: str) -> tuple[int, int, int]:
    """Return (bytes of the result, growth of the process while baking, patches) for a saved model."""
    small = pr.Scene()
    small.add(pr.Model(pr.procedural("sphere", SMALL)), material=pr.Diffuse(0.6))
    small.add_light(pr.EnvironmentLight())
    pr.bake(small)
    scene = pr.Scene()
    model = pr.Model.load(path)
    scene.add(model, material=pr.Diffuse(0.6))
    scene.add_light(pr.EnvironmentLight())
    for array in model.tree:  # the file's pages that are mapped count as they are read: read all of them before
        if isinstance(array, np.ndarray) and array.size:
            array.max()
    scene.snapshot()
    if STATUS.exists():
        _reset_peak()
        before = _resident("VmRSS")
        baked = pr.bake(scene)
        peak = _resident("VmHWM")
    else:  # the peak so far hides a part
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        baked = pr.bake(scene)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return baked.nbytes, peak - before, len(baked._exchange.transport)


if __name__ == "__main__":
    print(json.dumps(measure(sys.argv[1])))
