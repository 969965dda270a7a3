"""Building the library of kernels, whose results equal those of Numba."""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pointray
from helpers.native_library import needs_library
from native import link, signatures
from native.targets import LEVELS
from pointray.engine.jit import library

ROOT = Path(pointray.__file__).parents[2]
WHEEL = ROOT / "build" / "wheel" / "linux-x86_64"
needs_compiler = pytest.mark.skipif(link.compiler() is None, reason="no C compiler")


def test_the_arguments_of_all_kernels_are_recorded():
    """`python -m native signatures` writes them."""
    signatures.import_all()
    assert set(signatures.recorded()["kernels"]) == set(signatures.shipped())


def test_types_are_written_and_parsed():
    signatures.import_all()
    recorded = signatures.recorded()
    for name, texts in recorded["kernels"].items():
        records: dict[str, object] = {}
        kinds = [signatures.type_of(text, recorded["records"]) for text in texts]
        assert [signatures.described(kind, records) for kind in kinds] == texts, name
        assert records.items() <= recorded["records"].items()


BUILD = """
import sys
from pathlib import Path
from native import library, link, objects, signatures

def main():
    folder, jobs, *kernels = sys.argv[1:]
    signatures.import_all()
    order = objects.Order("linux-x86_64", ("x86-64-v2",), Path(folder, "objects"), int(jobs), tuple(kernels))
    library.make(order, Path(folder, "out"), link.compiler(), lambda done, total, name: print(name, flush=True))

if __name__ == "__main__":
    main()
"""
SMALL = (
    "pointray.surface.tree.wide.enclose",
    "pointray.surface.tree.wide.collapse",
    "pointray.surface.splats.grow._grade",
)


def start(root: Path, folder: Path, jobs: int, *kernels: str) -> subprocess.Popen[str]:
    """Start building a library of some kernels; the process prints the names of those it compiles."""
    folder.mkdir(exist_ok=True)
    script = folder / "build.py"
    script.write_text(BUILD)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (root, root / "src")))}
    command = [sys.executable, str(script), str(folder), str(jobs), *kernels]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


def built(root: Path, folder: Path, jobs: int, *kernels: str) -> list[str]:
    """Return the names of the kernels that a build compiles."""
    with start(root, folder, jobs, *kernels) as process:
        output, _ = process.communicate()
    assert process.returncode == 0
    return sorted(output.split())


def content(folder: Path) -> list[tuple[str, bytes]]:
    """All files of a library."""
    return [(path.name, path.read_bytes()) for path in sorted((folder / "out").iterdir())]


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources."""
    root = tmp_path_factory.mktemp("copy")
    for name in ("src/pointray", "native"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    return root


@pytest.mark.long
@needs_compiler
def test_builds_are_reproducible_to_the_last_byte(copy, tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    assert built(ROOT, first, 1, *SMALL) == sorted(SMALL)
    assert built(copy, second, 2, *reversed(SMALL)) == sorted(SMALL)
    sorted_content = [dict(content(folder)) for folder in (first, second)]
    libraries = [next(data for name, data in one.items() if name.endswith(".so")) for one in sorted_content]
    assert len(libraries[0]) > 10_000 and libraries[0] == libraries[1]


@pytest.mark.long
@needs_compiler
def test_only_an_edited_kernel_is_compiled_again(copy, tmp_path):
    assert built(copy, tmp_path, 2, *SMALL) == sorted(SMALL)
    assert built(copy, tmp_path, 2, *SMALL) == []
    before = content(tmp_path)
    path = copy / "src" / "pointray" / "surface" / "splats" / "grow.py"
    text = path.read_text()
    path.write_text(text + "# edited\n")
    assert built(copy, tmp_path, 2, *SMALL) == ["pointray.surface.splats.grow._grade"]
    path.write_text(text)
    assert content(tmp_path) != before
    assert built(copy, tmp_path, 2, *SMALL) == ["pointray.surface.splats.grow._grade"]
    assert content(tmp_path) == before


@pytest.mark.long
@needs_compiler
def test_two_concurrent_builds_make_one_library(tmp_path):
    processes = [start(ROOT, tmp_path, 1, *SMALL[:2]) for _ in range(2)]
    printed = [process.communicate()[0].split() for process in processes]
    assert [process.returncode for process in processes] == [0, 0]
    assert sorted(map(len, printed)) == [0, 2]
    assert len(content(tmp_path)) == 2


@needs_compiler
def test_libraries_loaded_one_after_the_other_are_distinct(tmp_path):
    """The loader identifies libraries by path, and copies in memory once had the same path."""
    found = []
    for k in (1, 2, 3):
        source, made = tmp_path / "level.c", tmp_path / f"{k}.so"
        source.write_text(f"int pr_level(void) {{ return {k}; }}\n")
        subprocess.run([*link.compiler(), "-shared", "-fPIC", str(source), "-o", str(made)], check=True)
        found.append(library._load(made, hashlib.sha256(made.read_bytes()).hexdigest()).pr_level())
    assert found == [1, 2, 3]


# Points, normals and points without outliers, as hashes.
RESULTS = """
import hashlib, json
import numpy as np
import pointray as pr
from pointray.engine import jit
from pointray.engine.jit import library

found = {}

def note(name, *arrays):
    found[name] = hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()[:16]

points = pr.procedural("statue", 4000)
noisy = points.positions + np.random.default_rng(0).normal(scale=0.01, size=points.positions.shape)
note("points", points.positions, points.normals, points.colors)
note("normals", pr.estimate_normals(noisy).normals)
note("cleaned", pr.clean(pr.Points(noisy)).positions)
print(json.dumps([found, jit.compilations(), library.choice()[1]]))
"""


def results(**variables: str) -> tuple[dict[str, str], int, str]:
    """Hashes of all kinds of results, how many kernels Numba compiled, and which library was used."""
    command = [sys.executable, "-c", RESULTS]
    environment = {**os.environ, "POINTRAY_THREADS": "2", "POINTRAY_CHECK": "", **variables}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    found, compilations, why = json.loads(done.stdout)
    return found, compilations, why


@pytest.mark.long
@needs_library
def test_results_equal_those_of_numba_to_the_last_bit(tmp_path):
    """Numba compiles for the same processor; all kernels would take minutes."""
    found, compilations, why = results(POINTRAY_KERNELS="compiled")
    assert compilations == 0 and len(found) == 3
    level = LEVELS[why.removeprefix("compiled for ")]
    same = {"NUMBA_CPU_NAME": level.name, "NUMBA_CPU_FEATURES": level.features}
    wanted, compilations, why = results(POINTRAY_KERNELS="jit", POINTRAY_CACHE=str(tmp_path), **same)
    assert compilations > 10 and why == "POINTRAY_KERNELS=jit"
    assert found == wanted


USE = """
library.FOLDER, level = Path({folder!r}), {level!r}
library._runs = lambda name, code: name == level
library.choice.cache_clear()
"""
# Compared values: with other vector widths the last bits of sums differ.
LEVEL = """
import json, sys
from pathlib import Path
import numpy as np
import pointray as pr
from pointray.engine import jit
from pointray.engine.jit import library
{before}
u, v = np.random.default_rng(0).random((2, 4000)) * 2 * np.pi
normals = np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], axis=1)
ring = np.stack([np.cos(u), np.sin(u), np.zeros_like(u)], axis=1)
model = pr.Model(pr.Points(ring + 0.4 * normals, normals))
scene = pr.Scene()
scene.add(model, material=pr.Phong(specular=0.3))
scene.add_light(pr.SunLight((1, 1, -2)))
camera = pr.Camera.look_at((1, -4, 1.5), (0, 0, 0), fov=40, size=(128, 96))
hits = scene.intersect(*camera.rays())
image = pr.render(scene, camera, pr.Settings("phong"))
np.savez(sys.argv[1], radii=model.radii, t=hits.t, normal=hits.normal, image=image)
print(jit.compilations(), library.choice()[1])
"""


# Registers used by kernels of a level.
WIDEST = {"x86-64-v2": {"xmm"}, "x86-64-v3": {"xmm", "ymm"}}


def best_level():
    """The best level of the wheel's libraries that this CPU supports: code of another one would be an illegal one."""
    libraries = json.loads((WHEEL / library.MANIFEST).read_text())["libraries"]  # best first
    return next(n for n, about in libraries.items() if library._runs(n, ctypes.CDLL(str(WHEEL / about["file"]))))


@pytest.mark.long
@pytest.mark.skipif(not (WHEEL / library.MANIFEST).exists(), reason="no libraries of other levels here (make wheel)")
@pytest.mark.parametrize("level", ["x86-64-v2", "x86-64-v3"])
def test_lower_levels_give_the_same_pictures(tmp_path, level):
    found, best = [], best_level()
    if level >= best or not any(WHEEL.glob(f"{level}-*")):
        pytest.skip(f"{level} was not built, or this CPU supports no level above it")
    for name in (level, best):
        before, file = USE.format(folder=str(WHEEL), level=name), tmp_path / f"{name}.npz"
        command = [sys.executable, "-c", LEVEL.format(before=before), str(file)]
        environment = {**os.environ, "POINTRAY_KERNELS": "compiled", "POINTRAY_CHECK": ""}
        done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
        assert done.stdout == f"0 compiled for {name}\n"
        found.append(dict(np.load(file)))
    low, high = found
    spacing = np.sqrt(4 * np.pi**2 * 0.4 / 4000)
    np.testing.assert_allclose(low["radii"], high["radii"], rtol=1e-5)
    both = np.isfinite(low["t"]) & np.isfinite(high["t"])
    assert both.sum() > 1000 and (np.isfinite(low["t"]) != np.isfinite(high["t"])).sum() <= 3
    assert np.quantile(np.abs(low["t"][both] - high["t"][both]), 0.999) < 1e-4 * spacing
    assert (np.abs(low["image"] - high["image"]) > 1e-3).mean() < 1e-3
    if level == "x86-64-v2":  # without fused multiplications: these are other kernels
        assert (low["t"] != high["t"]).any()
    if (objdump := shutil.which("objdump")) is not None:
        code = subprocess.run([objdump, "-d", *WHEEL.glob(f"{level}-*")], capture_output=True, text=True).stdout
        assert {"xmm", "ymm", "zmm"}.intersection(re.findall("[xyz]mm", code)) == WIDEST[level]
