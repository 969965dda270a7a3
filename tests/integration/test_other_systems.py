"""Libraries for other systems link, and give the same results where qemu or Wine can run them.

After `make wheels` all kernels of models and pictures are compared, otherwise a few small ones.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pointray
from helpers.kernel_recordings import read
from native import link
from native.__main__ import best_level, this_system
from native.library import builder_key
from native.targets import SYSTEMS
from pointray.base.dependencies import ROOT as PACKAGE, digest_of
from pointray.engine.jit import library

pytestmark = pytest.mark.long
pytest.importorskip("ziglang", reason="it links for other systems (make wheel installs it)")
ROOT = Path(pointray.__file__).parents[2]
WHEELS = ROOT / "build" / "wheel"
LEVEL = "x86-64-v3"  # gives the same results on Windows as here
FEW = (
    "pointray.cloud.neighbors.search.find_nearest",
    "pointray.surface.splats.borders._find_gaps",
    "pointray.surface.tree.wide.collapse",
)

RECORD = """
import sys
from pathlib import Path
import pointray as pr
from pointray.engine.jit import library
from helpers.kernel_recordings import Recorder

library.FOLDER = Path(sys.argv[1])
library._runs = lambda name, code: name == sys.argv[2]
recorder = Recorder(library.choice()[0], Path(sys.argv[3]), sys.argv[4:])
points = pr.procedural("statue", 4000)
model, bare = pr.Model(points), pr.Model(points.positions)
scene = pr.Scene()
scene.add(model, material=pr.Phong(specular=0.3))
scene.add(bare, transform=pr.transform(translate=(1.0, 0.0, 0.0)))
scene.add_light(pr.SunLight((1, 1, -2)))
camera = pr.Camera.look_at((1, -4, 1.5), (0.5, 0, 1), fov=40, size=(64, 48))
scene.intersect(*camera.rays())
for integrator in ("phong", "path"):
    pr.render(scene, camera, pr.Settings(integrator))
recorder.finish()
"""
BUILD = """
import sys
from pathlib import Path
from native import library, link, objects, signatures

if __name__ == "__main__":
    system, level, folder, *kernels = sys.argv[1:]
    signatures.import_all()
    order = objects.Order(system, (level,), Path(folder, "objects"), 2, tuple(kernels))
    library.make(order, Path(folder, "out"), link.zig(system), print)
"""


def fits(folder: Path) -> bool:
    """Return whether a folder contains libraries built from the current sources with the current builder."""
    try:
        manifest = json.loads((folder / library.MANIFEST).read_text())
        same = all(digest_of(PACKAGE / name) == digest for name, digest in manifest["sources"].items())
        return same and bool(manifest["builder"] == builder_key())
    except (OSError, KeyError):
        return False


def runnable() -> list[str]:
    """Return the levels of x86-64 that this processor supports."""
    levels = list(SYSTEMS["linux-x86_64"].levels)
    best = best_level("linux-x86_64") if this_system() == "linux-x86_64" else None
    return levels[: levels.index(best) + 1] if best else []


def run(code: str, *arguments: object, **variables: str) -> None:
    """Run a program with the modules of the tests and of the project."""
    paths = os.pathsep.join(map(str, (ROOT, ROOT / "tests")))
    environment = {**os.environ, "PYTHONPATH": paths, "POINTRAY_KERNELS": "auto", "POINTRAY_CHECK": "", **variables}
    subprocess.run([sys.executable, "-c", code, *map(str, arguments)], env=environment, check=True, stdout=sys.stderr)


def library_for(system: str, level: str, folder: Path) -> tuple[Path, tuple[str, ...]]:
    """Return a library for a system, and its kernels if it does not contain all."""
    if fits(WHEELS / system):
        return next((WHEELS / system).glob(f"{level}-*")), ()
    script = folder / "build.py"
    script.write_text(BUILD)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run(
        [sys.executable, script, system, level, folder, *FEW], env=environment, check=True, stdout=sys.stderr
    )
    return next((folder / "out").glob(f"{level}-*")), FEW


def replayed(system: str, command: list[str], made: Path, folder: Path, recording: Path) -> str:
    """Repeat the calls on another system and return the name of the file of results."""
    driver, name = folder / "replay.exe", f"on-{system}"
    target = [*link.zig(system), str(ROOT / "tests" / "helpers" / "replay.c"), "-O1", "-o", str(driver)]
    subprocess.run([*target, *([] if system.startswith("windows") else ["-ldl"])], check=True)
    drive = "Z:" if system.startswith("windows") else ""
    subprocess.run(
        [*command, str(driver), f"{drive}{made}", "calls", name],
        cwd=recording,
        env={**os.environ, "WINEPREFIX": str(folder / "wine"), "WINEDEBUG": "-all"},
        check=True,
    )
    return name


EMULATORS = {"linux-aarch64": ["qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"], "windows-x86_64": ["wine"]}


@pytest.mark.parametrize("system", EMULATORS)
def test_kernels_on_other_systems_give_the_same_results(system, tmp_path):
    command = EMULATORS[system]
    if shutil.which(command[0]) is None or not Path(*command[2:]).exists():
        pytest.skip(f"no {command[0]}, or no libraries of that system for it")
    if not fits(WHEELS / "linux-x86_64") or LEVEL not in runnable():
        pytest.skip("no libraries of these sources for this system (make wheel)")
    made, some = library_for(system, "aarch64" if system.endswith("aarch64") else LEVEL, tmp_path)
    recording = tmp_path / "recording"
    recording.mkdir()
    run(RECORD, WHEELS / "linux-x86_64", LEVEL, recording, *some, POINTRAY_THREADS="1")
    name = replayed(system, command, made, tmp_path, recording)
    wanted, found = read(recording, "wanted"), read(recording, name)
    assert len(found) >= (len(some) or 41)
    for kernel, result in found.items():
        assert (result.code, result.out) == (wanted[kernel].code, wanted[kernel].out), kernel
        for got, want in zip(result.arrays, wanted[kernel].arrays, strict=True):
            if got.dtype.kind != "f":
                np.testing.assert_array_equal(got, want, kernel)
            else:  # the statue is 2 high, its splats are 0.05 apart
                np.testing.assert_allclose(got, want, rtol=5e-6, atol=5e-6, err_msg=kernel)


@pytest.mark.parametrize("system", sorted(SYSTEMS))
def test_a_library_of_each_system_is_linked(system, tmp_path):
    made, _ = library_for(system, SYSTEMS[system].levels[0], tmp_path)
    content = made.read_bytes()
    magic = {"linux": b"\x7fELF", "windows": b"MZ", "macos": b"\xcf\xfa\xed\xfe"}[system.partition("-")[0]]
    assert content.startswith(magic)
    for name in (*map(library.symbol, FEW), "pr_release"):
        assert name.encode() in content
