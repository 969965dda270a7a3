"""Rounded coordinates are recognised, and rasters are not mistaken for them."""

import json
from pathlib import Path

import numpy as np
import pytest
from plyfile import PlyData, PlyElement

import pointray as pr
from helpers.clouds import sphere_points
from helpers.places import MODELS, shared_model
from pointray.cli import execute
from pointray.cloud.rounding import find_rounding

QUICK = "--spp", "1", "--light", "headlight"
PLACE = np.float64([432_100, 5_412_300, 240])


def hills(rng: np.random.Generator, spacing: float, n: int = 20_000) -> np.ndarray:
    """Return random points of a surface with this spacing."""
    x, y = rng.uniform(0, spacing * np.sqrt(n), (2, n))
    return np.column_stack([x, y, 3 * spacing * np.sin(x / (20 * spacing)) + 2 * spacing * np.cos(y / (13 * spacing))])


def raster(step: float, steepness: float = 1.0) -> np.ndarray:
    x, y = (step * axis.ravel() for axis in np.meshgrid(np.arange(120.0), np.arange(120.0)))
    return np.column_stack([x, y, steepness * (5 * np.sin(x / 9 / step) + 20 * np.cos(y / 20 / step))])


@pytest.fixture
def file(tmp_path: Path, rng: np.random.Generator) -> Path:
    """A surface at 5.4e6, in float32, as other programs write it."""
    rows = np.zeros(20_000, [(name, "f4") for name in "xyz"])
    rows["x"], rows["y"], rows["z"] = (hills(rng, 0.38) + PLACE).T
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(tmp_path / "map.ply"))
    return tmp_path / "map.ply"


@pytest.mark.parametrize("spacing", [0.1, 0.38, 1.0, 1.9])
def test_float32_at_millions_of_metres(spacing, rng):
    rows = hills(rng, spacing) + PLACE
    steps, message = find_rounding(pr.Points(rows.astype(np.float32)))
    assert steps[1:] == (0.5, 0)
    assert message.startswith("coordinates are rounded to steps of 0.5 in ") and "(float32 at 5.4e6)" in message
    times = float(message.split(", ")[-1].split(" times the mean point spacing: ")[0])
    assert times == pytest.approx(0.5 / spacing, rel=0.2)
    assert message.endswith("export with double precision or a local origin")
    assert find_rounding(pr.Points(rows)) == ((0, 0, 0), None)


@pytest.mark.parametrize("origin", [(0, 0, 0), PLACE])
@pytest.mark.parametrize("ratio", [0.3, 0.5, 0.6, 0.7, 1.0, 1.5, 3.0])
def test_decimals(ratio, origin, rng):
    """Decimals are recognised relative to a float64 offset, too, as in LAS."""
    steps, message = find_rounding(pr.Points(np.round(hills(rng, 0.01 / ratio), 2) + origin))
    assert steps[:2] == pytest.approx((0.01, 0.01))
    assert "steps of 0.01" in message and "float32" not in message and message.endswith("more decimals")


@pytest.mark.parametrize("ratio", [0.1, 0.2])
def test_fine_steps_are_not_mentioned(ratio, rng):
    assert find_rounding(pr.Points(np.round(hills(rng, 0.01 / ratio), 2))) == ((0, 0, 0), None)
    assert find_rounding(pr.Points((hills(rng, 0.5 / ratio) + PLACE).astype(np.float32))) == ((0, 0, 0), None)


def cube() -> np.ndarray:
    side = np.stack(np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21)), axis=-1).reshape(-1, 2)
    return np.vstack([np.insert(side, axis, end, axis=1) for axis in range(3) for end in (-1, 1)])


def slices(rng: np.random.Generator) -> np.ndarray:
    """Return points at random x and z, on 40 levels of y."""
    rows = rng.uniform(0, 10, (20_000, 3))
    rows[:, 1] = np.floor(rows[:, 1] * 4) / 4
    return rows


def wires(rng: np.random.Generator) -> np.ndarray:
    rows = slices(rng)
    rows[:, 1:] //= 4
    return rows


def depth(rng: np.random.Generator) -> np.ndarray:
    x, y = rng.uniform(0, 10, (2, 20_000))
    return np.column_stack([x, y, np.round(x, 3)])


NOT_ROUNDED = {
    "raster": lambda _: raster(1.0),
    "raster on a map": lambda _: raster(1.0) + PLACE,
    "raster on a map, in float32": lambda _: (raster(0.5) + PLACE).astype(np.float32),
    "raster of 30 m with whole heights": lambda _: np.round(raster(30.0)),
    "steep raster": lambda _: raster(1.0, 10),
    "cube": lambda _: cube(),
    "cube in sixteenths": lambda _: np.round(cube() * 10) / 16,
    "slices": slices,
    "wires on three levels": wires,
    "sphere": lambda _: sphere_points(20_000),
    "depth in whole millimetres": depth,
    "one place": lambda _: np.ones((500, 3)),
    "three points": lambda _: np.eye(3),
    "a line": lambda _: np.arange(300.0)[:, None] * [1, 0, 0],
}


@pytest.mark.parametrize("name", NOT_ROUNDED)
def test_what_only_looks_rounded(name, rng):
    assert find_rounding(pr.Points(NOT_ROUNDED[name](rng))) == ((0, 0, 0), None)


SCANS = [
    pytest.param(path, id=path.stem, marks=pytest.mark.long if path.stat().st_size > 5e6 else ())
    for path in sorted(MODELS.glob("*/*.ply"))
]


@pytest.mark.scans
@pytest.mark.parametrize("path", SCANS)
def test_no_real_scan_is_reported_as_rounded(path):
    if "3dgs" in path.name:
        pytest.skip("no points of the usual kind")
    assert find_rounding(pr.read(path)) == ((0, 0, 0), None)


@pytest.mark.scans
def test_a_real_scan_in_float32_map_coordinates_is_reported():
    points = pr.read(shared_model("points/outcrop_qcompass_rgb.ply"))
    moved = pr.Points((points.world - points.bounds[0] + PLACE).astype(np.float32))
    assert find_rounding(moved)[0][1] == 0.5


@pytest.mark.long
def test_info_and_render_name_them(file, tmp_path, capsys, rng):
    assert execute(["info", str(file), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["steps"] == [0, 0.5, 0]
    note = "coordinates are rounded to steps of 0.5 in y (float32 at 5.4e6), 1.3 times the mean point spacing: "
    assert len(facts["notes"]) == 1 and facts["notes"][0].startswith(note)
    assert execute(["render", str(file), "-o", str(tmp_path / "a.png"), "--size", "32x24", *QUICK]) == 0
    assert capsys.readouterr().err.count(f"pointray: note: {note}") == 1
    pr.write(file, pr.Points(hills(rng, 0.38)))
    assert execute(["info", str(file), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["steps"] == [0, 0, 0] and facts["notes"] == []
    assert execute(["render", str(file), "-o", str(tmp_path / "a.png"), "--size", "32x24", *QUICK]) == 0
    assert "rounded" not in capsys.readouterr().err
