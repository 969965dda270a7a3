"""Record hashes of some 400 arrays from all stages, or compare two records, to verify a refactoring.

    python -m bench.maintenance.identical record before.json
    python -m bench.maintenance.identical compare before.json after.json

Only public names are used, so that records of different versions can be compared. Hashes depend on the processor.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

import pointray as pr

MODELS = Path(os.environ.get("POINTRAY_MODELS") or Path(__file__).parents[3] / "shared" / "models")
CASES = MODELS.parent / "cases"
SIZE = (96, 72)


def hashed(array: Any) -> str:
    array = np.ascontiguousarray(array)
    return hashlib.sha256(f"{array.dtype} {array.shape} ".encode() + array.tobytes()).hexdigest()[:24]


class Record(dict[str, str]):
    """Hashes by name."""

    def put(self, name: str, value: Any) -> None:
        """Add an array, or every array that a dataclass, a mapping, a sequence or a cloud holds."""
        if isinstance(value, pr.Points):
            facts = {"positions": value.positions, "normals": value.normals, "colors": value.colors}
            self.put(name, facts | {"origin": value.origin} | dict(value.attributes))
        elif is_dataclass(value) and not isinstance(value, type):
            self.put(name, {field.name: getattr(value, field.name) for field in fields(value)})
        elif isinstance(value, Mapping):
            for key, item in value.items():
                self.put(f"{name}/{key}", item)
        elif isinstance(value, tuple | list) and value and not np.isscalar(value[0]):
            for key, item in enumerate(value):
                self.put(f"{name}/{key}", item)
        elif isinstance(value, np.ndarray | float | int | bool | np.generic):
            assert name not in self, name
            self[name] = hashed(value)
        elif value is not None:
            assert name not in self, name
            self[name] = hashlib.sha256(repr(value).encode()).hexdigest()[:24]

    def file(self, name: str, path: Path) -> None:
        self[name] = hashlib.sha256(path.read_bytes()).hexdigest()[:24]


def file_arrays(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays of a saved model or of baked light, by name: a sequence of .npy arrays, the first containing JSON."""
    names: list[str] = []
    with path.open("rb") as file:
        size = path.stat().st_size
        while file.tell() + 8 < size:
            start = file.tell()
            if file.read(6) != b"\x93NUMPY":
                file.seek(start + 1)
                continue
            file.seek(start)
            array = np.load(file)
            if names:
                yield names.pop(0), array
            else:
                names = json.loads(array.tobytes())["arrays"]


def clouds() -> Iterator[tuple[str, pr.Points]]:
    """Clean, noisy, scattered, coloured, far from the origin; and real scans, if available."""
    yield "statue", pr.procedural("statue", 20_000, seed=1)
    torus = pr.procedural("torus", 8_000, seed=2)
    noise = np.random.default_rng(3).normal(0, 0.008, torus.positions.shape)
    yield "noisy", pr.Points(torus.positions + noise)
    lattice = pr.procedural("lattice", 8_000, seed=4)
    rng = np.random.default_rng(5)
    colors = rng.integers(0, 256, (len(lattice), 3), dtype=np.uint8)
    far = lattice.positions + np.array([4.5e6, 5.4e5, 200.0])
    yield "lattice", pr.Points(far, lattice.normals, colors, {"height": far[:, 2]})
    crown = rng.normal(0, 1, (4_000, 3)) + (0, 0, 4)
    ground = np.column_stack([rng.uniform(-6, 6, (9_000, 2)), rng.normal(0, 0.01, 9_000)])
    yield "tree", pr.Points(np.vstack([ground, crown]))
    for file in ("stanford_bunny_rangescans.ply", "rgbd_kinect_chair_rgb.ply", "stanford_lucy_50k.ply"):
        for path in sorted(MODELS.rglob(file))[:1]:
            scan = pr.read(path)
            rows = np.sort(np.random.default_rng(6).permutation(len(scan))[:40_000])
            normals = None if scan.normals is None else scan.normals[rows]
            yield path.stem, pr.Points(scan.positions[rows] + scan.origin, normals)


def record_points(record: Record, name: str, points: pr.Points, folder: Path) -> None:
    """Stages before a model."""
    record.put(f"{name}/points", points)
    record.put(f"{name}/normals", pr.estimate_normals(points))
    record.put(f"{name}/normals from above", pr.estimate_normals(points, viewpoint=(3.0, 2.0, 10.0)))
    record.put(f"{name}/smooth", pr.smooth(points))
    record.put(f"{name}/strays", pr.find_strays(points))
    record.put(f"{name}/flaws", pr.find_flaws(points))
    record.put(f"{name}/clean", pr.clean(points))
    record.put(f"{name}/layers", pr.merge_layers(points))
    oriented = points if points.normals is not None else pr.estimate_normals(points)
    record.put(f"{name}/subsample", pr.subsample(oriented, count=len(points) // 5))
    for suffix in (".ply", ".las", ".npz", ".npy"):
        pr.write(folder / f"cloud{suffix}", points)
        record.put(f"{name}/read {suffix}", pr.read(folder / f"cloud{suffix}"))


def record_models(record: Record, name: str, points: pr.Points, folder: Path) -> pr.Model:
    """Models with every surface, as files."""
    for surface in (None, "paper", "imls", "apss", "disc"):
        model = pr.Model(points, surface=surface)
        model.save(folder / "model")
        for array_name, array in file_arrays(folder / "model"):
            record.put(f"{name}/{surface}/{array_name}", array)
        record.put(f"{name}/{surface}/Model.bounds", model.bounds)
        record.put(f"{name}/{surface}/Model.scattered", model.scattered)
    return pr.Model(points)


def lit(model: pr.Model) -> tuple[pr.Scene, pr.Camera]:
    """A scene with a plane, a second instance and several lights."""
    scene = pr.Scene()
    scene.add(model)
    low, high = model.bounds
    size = float(np.linalg.norm(high - low))
    scene.add(model, transform=pr.transform((size * 0.7, 0, 0)), material=pr.Principled((0.8, 0.4, 0.2), 0.4, 0.5))
    scene.add(pr.Plane((*((low + high) / 2)[:2], low[2]), (0, 0, 1), checker=size / 8))
    scene.add_light(pr.SunLight((-0.4, 0.3, -1.0), 2.0))
    scene.add_light(pr.SphereLight(high + size * 0.3, size * 0.1, 20.0))
    scene.add_light(pr.EnvironmentLight(0.4))
    return scene, pr.frame(scene, size=SIZE)


def record_pictures(record: Record, name: str, model: pr.Model, folder: Path) -> None:
    """Rays, every integrator, layers, baked light, films."""
    scene, camera = lit(model)
    record.put(f"{name}/camera", camera.rays())
    record.put(f"{name}/hits", scene.intersect(*camera.rays()))
    record.put(f"{name}/occluded", scene.occluded(*camera.rays()))
    for integrator in ("phong", "ao", "path", "normal", "depth", "color"):
        settings = pr.Settings(integrator=integrator, spp=2, seed=7)
        record.put(f"{name}/{integrator}", pr.render(scene, camera, settings))
    record.put(f"{name}/filtered", pr.render(scene, camera, pr.Settings(spp=3, seed=8, threads=1)))
    record.put(f"{name}/layers", pr.render_layers(scene, camera, pr.Settings(spp=1)))
    light = pr.bake(scene, pr.BakeSettings(links=64))
    light.save(folder / "light")
    for array_name, array in file_arrays(folder / "light"):
        record.put(f"{name}/baked file/{array_name}", array)
    scene.baked = light
    record.put(f"{name}/baked", pr.render(scene, camera, pr.Settings(integrator="baked")))
    film = pr.animate(scene, pr.turntable(camera, 3), pr.Settings(spp=1))
    record.put(f"{name}/film", list(film))
    studio = pr.Scene()
    studio.add(model)
    for light in pr.studio():
        studio.add_light(light)
    record.put(f"{name}/studio", pr.render(studio, pr.frame(studio, size=SIZE), pr.Settings(integrator="path", spp=2)))


def record_commands(record: Record, points: pr.Points, folder: Path) -> None:
    """What the command line makes: a picture without options, a cleaned file, a model in parts."""
    pr.write(folder / "scan.ply", points)
    run = [sys.executable, "-m", "pointray"]

    def call(*words: str) -> None:
        subprocess.run([*run, *words], check=True, cwd=folder, capture_output=True)

    call("render", "scan.ply", "-o", "picture.png", "--size", "160x120", "--no-cache")
    record.file("command/picture", folder / "picture.png")
    call("render", "scan.ply", "-o", "path.png", "--size", "96x72", "--no-cache", "--integrator", "path", "--spp", "4")
    record.file("command/path", folder / "path.png")
    call("prepare", "scan.ply", "-o", "clean.ply", "--drop-strays", "--smooth", "auto", "--count", "5000")
    record.file("command/prepared", folder / "clean.ply")
    call("prepare", "scan.ply", "-o", "parts.pointray/", "--part-points", "6000")
    call("prepare", "scan.ply", "-o", "split.pointray/", "--part-points", "4096", "--memory", "8MiB")
    for path in sorted([*(folder / "parts.pointray").rglob("*"), *(folder / "split.pointray").rglob("*")]):
        if path.is_file() and path.suffix != ".json":
            for array_name, array in file_arrays(path):
                record.put(f"{path.relative_to(folder)}/{array_name}", array)
    call("render", "split.pointray/", "-o", "parts.png", "--size", "160x120")
    record.file("command/picture of parts", folder / "parts.png")


def record_cases(record: Record) -> None:
    """Small files of all kinds."""
    for path in sorted(CASES.glob("*")):
        try:
            record.put(f"case/{path.name}", pr.read(path))
        except (ValueError, OSError, ImportError) as error:
            record[f"case/{path.name}"] = f"{type(error).__name__}"


def record_all() -> Record:
    record = Record()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for name, points in clouds():
            print(name, flush=True)
            record_points(record, name, points, folder)
            record_pictures(record, name, record_models(record, name, points, folder), folder)
        print("commands", flush=True)
        record_commands(record, pr.procedural("statue", 20_000, seed=1), folder)
        record_cases(record)
    return record


def compare(before: dict[str, str], after: dict[str, str]) -> int:
    """Print what differs; return the number of differences."""
    differing = [name for name in sorted({*before, *after}) if before.get(name) != after.get(name)]
    for name in differing:
        print(f"{name}: {'missing' if name not in after else 'new' if name not in before else 'differs'}")
    print(f"{len(before)} arrays before, {len(after)} after, {len(differing)} differ")
    return len(differing)


def main() -> int:
    if sys.argv[1] == "record":
        record = record_all()
        Path(sys.argv[2]).write_text(json.dumps(record, indent=1))
        print(f"{len(record)} arrays")
        return 0
    return min(compare(*(json.loads(Path(path).read_text()) for path in sys.argv[2:4])), 1)


if __name__ == "__main__":
    sys.exit(main())
