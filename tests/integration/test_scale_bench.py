"""`bench/scale/stages.py`: its city, rows and measurements, and each stage at a small size."""

import io
import json
import mmap
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

import pointray as pr
from bench.scale import city as scale_city, stages as scale
from bench.scale.city import EDGE, ORIGIN, City, Sculptor, ground, make
from bench.scale.paper import lines, markdown
from bench.scale.prepare import Options, asked
from bench.scale.rows import LEAST, MOST, Row, Rows, shown, table_of
from bench.scale.same import compared, part_size
from bench.scale.watch import Watch, disk_of, watched

CITY = City(50_000)
MIB = 1 << 20


@pytest.fixture(autouse=True)
def one_template(monkeypatch):
    """Use the same cloud everywhere, as each takes seconds to make."""
    monkeypatch.setattr(scale_city, "TEMPLATES", 1)


def options_of(folder):
    return Options(folder, CITY, part_points=1 << 14, size=(80, 60), frames=3, runs=1)


# ------------------------------------------------------------------------------------------------------------- city


def test_a_city_has_the_requested_number_of_distinct_points(tmp_path):
    paths = make(CITY, tmp_path / "tiles")
    points = [pr.read(path) for path in paths]
    world = np.concatenate([each.world for each in points])
    assert len(paths) > 1 and len(world) == 50_000 == len(np.unique(world, axis=0))
    low, high = world.min(axis=0) - ORIGIN, world.max(axis=0) - ORIGIN
    assert (low[:2] > -1).all() and (high[:2] < CITY.width + 1).all() and high[2] - low[2] > 2
    normals = np.concatenate([each.normals for each in points])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    is_ground = np.concatenate([each.attributes["classification"] for each in points]) == 2
    assert is_ground.mean() == pytest.approx(0.5, abs=1e-4)
    some = world[is_ground] - ORIGIN
    height, slope = ground(some[:, :2])
    np.testing.assert_allclose(some[:, 2], height, atol=1e-4)
    np.testing.assert_allclose(-normals[is_ground][:, :2] / normals[is_ground][:, 2:], slope, atol=1e-3)


def test_cells_are_reproducible():
    """Each has a statue with its own position, rotation and scale."""
    one, other = Sculptor(CITY), Sculptor(CITY)
    other.cell(0)
    for name, rows in one.cell(2).items():
        np.testing.assert_array_equal(rows, other.cell(2)[name])
    sizes = [np.ptp(one.cell(cell)["positions"][: CITY.statue], axis=0) for cell in range(CITY.cells)]
    assert len({tuple(np.round(size, 3)) for size in sizes}) == CITY.cells
    big = City(100_000_000)
    assert sum(map(big.points_of, range(big.cells))) == big.points
    assert [cell for tile in big.tiles() for cell in tile] == list(range(big.cells))
    assert 20 <= len(big.tiles()) <= 30 and big.width == big.side * EDGE


def test_tiles_of_the_same_city_are_reused(tmp_path):
    first = make(CITY, tmp_path)
    first[1].unlink()
    before = first[0].stat().st_mtime_ns, first[1].parent.stat().st_ino
    assert make(CITY, tmp_path) == first and first[1].exists()
    assert (first[0].stat().st_mtime_ns, first[1].parent.stat().st_ino) == before
    las = make(replace(CITY, format="las", normals=False), tmp_path)
    assert not first[0].exists() and pr.read(las[0]).normals is None


def test_cameras_look_at_the_city():
    scene = pr.Scene()
    cells = [Sculptor(CITY).cell(cell) for cell in range(CITY.cells)]
    positions, normals = (np.concatenate([cell[name] for cell in cells]) for name in ("positions", "normals"))
    scene.add(pr.Model(pr.Points(positions + ORIGIN, normals)))
    for camera, least in ((CITY.far((80, 60)), 0.1), (CITY.near((80, 60)), 0.2)):
        assert np.isfinite(scene.intersect(*camera.rays()).t).mean() > least
    flight = CITY.flight(20, (80, 60))
    above = [camera.eye[2] - ORIGIN[2] - ground(np.array([camera.eye[:2]]) - ORIGIN[:2])[0][0] for camera in flight]
    assert len(flight) == 20 and min(above) > 1 and max(above) < 2


# ------------------------------------------------------------------------------------------------------------- rows


def test_rows_are_stored_by_name_and_size(tmp_path):
    rows = Rows(tmp_path / "scale.json")
    rows.put([Row("a.x", 10, 1.0, "s", "x"), Row("a.y", 10, 2.0, "s", "y"), Row("b.x", 10, 3.0, "s", "x")])
    rows.put([Row("a.x", 100, 4.0, "s", "x")], "a")
    rows.put([Row("a.x", 10, 5.0, "s", "x")], "a")
    again = Rows(tmp_path / "scale.json")
    assert {row.key: row.value for row in again} == {"a.x @ 10": 5.0, "a.x @ 100": 4.0, "b.x @ 10": 3.0}
    assert again.find("a.x").points == 100 and again.find("c") is None
    assert [row.key for row in again.under("a.")] == ["a.x @ 100"] and not again.under("c.")


@pytest.mark.parametrize(("kind", "limit", "met"), [(MOST, 2.0, True), (MOST, 1.9, False), (LEAST, 2.1, False)])
def test_a_row_is_compared_with_its_limit(kind, limit, met):
    row = asked(Row("a.x", 10, 2.0, "s", "x"), kind, limit)
    assert row.is_met is met and Row("a.x", 10, 2.0, "s", "x").is_met is None
    console = Console(width=120, file=io.StringIO())
    console.print(table_of("a", [row]))
    assert ("NOT met" in console.file.getvalue()) is not met and f"at {kind}" in console.file.getvalue()


def test_figures_have_units():
    assert shown(2.5 * 2**30, "bytes") == "2,560 MiB" and shown(0.8512, "s") == "0.851 s"
    assert shown(3, "") == "3" and shown(12345.6, "points") == "12,346"


# ------------------------------------------------------------------------------------------------------------ watch

HOLDER = """
import mmap, sys, numpy as np
held = np.ones(60 << 20, np.uint8)
file = open(sys.argv[1], "rb")
pages = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
np.frombuffer(pages, np.uint8).max()
child = None
if len(sys.argv) > 2:
    import subprocess
    child = subprocess.run([sys.executable, "-c", sys.argv[2], sys.argv[1]], check=True)
print("ready", flush=True)
sys.stdin.read()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the system does not tell what is of files")
def test_memory_of_all_processes_is_measured(tmp_path):
    file = tmp_path / "file"
    file.write_bytes(bytes(40 * MIB))
    command = [sys.executable, "-c", HOLDER, file]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"
        watch = Watch(process.pid)
        while not watch._samples:
            time.sleep(0.01)
        seen = watch.end()
        process.stdin.close()
    assert 100 * MIB < seen.resident < 250 * MIB and 60 * MIB < seen.anonymous < seen.resident - 40 * MIB
    assert seen.processes == 1 and seen.stages == [] and seen.left == 0
    assert mmap.PAGESIZE <= disk_of(file) <= 41 * MIB


MARKER = """
import pathlib, sys, time
there = pathlib.Path(sys.argv[1]) / "unfinished"
there.mkdir(parents=True)
for name in ("task", "spooled", "place-0000", "margin-0000", "place-0001", "usual-support", ".beside-1a", "tree-0000"):
    (there / f"{name}.json").write_text("{}")
    (there / f"column.{name}").write_bytes(bytes(1 << 20))
    time.sleep(0.2)
time.sleep(1)
import shutil
shutil.rmtree(there)
(there.parent / "index.json").write_text("{}")
"""


@pytest.mark.long
def test_stages_are_identified_by_their_marks(tmp_path):
    seen = watched(["-c", MARKER, tmp_path / "model"], tmp_path / "model")
    assert [(stage.name, stage.parts) for stage in seen.stages] == [
        *(("spooled", 0), ("place", 2), ("usual-support", 0), ("tree", 1), ("files", 0))
    ]
    assert all(stage.seconds > 0 for stage in seen.stages)
    assert sum(stage.seconds for stage in seen.stages) == pytest.approx(seen.seconds, abs=0.2)
    assert seen.disk >= 6 * MIB > seen.left > 0


def test_a_command_that_fails_is_reported():
    with pytest.raises(RuntimeError, match="ValueError: so it is"):
        watched(["-c", "raise ValueError('so it is')"])


# ----------------------------------------------------------------------------------------------------------- stages


def test_there_are_at_least_as_many_parts_as_requested():
    for points, parts in ((10_000_000, 8), (10_000_000, 64), (1 << 20, 8)):
        size = part_size(points, parts)
        assert size & (size - 1) == 0 and points / size >= parts > points / (2 * size)


def test_hits_that_differ_are_counted():
    scenes = [pr.Scene(), pr.Scene()]
    sphere = pr.procedural("sphere", 5000)
    for scene, height in zip(scenes, (0.0, 0.001), strict=True):
        scene.add(pr.Model(sphere), pr.transform(translate=(0, 0, height)))
    cameras = [pr.Camera.frame(scenes[0].bounds, size=(40, 30))] * 2
    rays, hit, apart = compared(scenes[0], scenes[0], cameras)
    assert rays == 2400 > hit > 500 and apart == 0
    assert compared(*scenes, cameras)[2] > hit / 2


def test_paper_names_the_row_of_each_number(tmp_path):
    rows = Rows(tmp_path / "scale.json")
    assert all(line.value is None and "needs the row" in line.how for line in lines(rows))
    hundred = 100_000_000
    rows.put(
        [
            Row("prepare.stage.spooled.time", hundred, 50.0, "s", "all at once"),
            Row("prepare.stage.place.time", hundred, 100.0, "s", "48 parts, one by one"),
            Row("prepare.stage.usual-support.time", hundred, 7.0, "s", "all at once"),
            Row("prepare.stage.level-1-tree.time", hundred, 20.0, "s", "48 parts, one by one"),
            Row("prepare.stage.level-2-tree.time", hundred, 30.0, "s", "48 parts, one by one"),
            Row("cluster.prepare.throughput", 10**7, 0.8, "", ""),
            Row("prepare.disk", hundred, 1e10, "bytes", ""),
        ]
    )
    found = {line.what: line for line in lines(rows)}
    assert found["prepare, spooled, at once"].value == pytest.approx(500)
    assert found["prepare, usual-support, by a sample"].value == pytest.approx(7)  # as large for all scans
    assert found["prepare, place, part by part"].value == pytest.approx(100 / 0.8)
    assert found["prepare, levels, part by part"].value == pytest.approx(50 / 0.8)
    assert "and 1 more like it: 50 s" in found["prepare, levels, part by part"].how
    assert found["prepare, in all"].value == pytest.approx(507 + 150 / 0.8)
    assert found["disk of the model"].value == pytest.approx(1e11)
    how = found["prepare, place, part by part"].how
    assert "prepare.stage.place.time @ 100,000,000" in how and "cluster.prepare.throughput @ 10,000,000" in how
    rows.put([asked(Row("prepare.peak", hundred, 2.0 * 2**30, "bytes", "memory"), MOST, 2.5 * 2**30)])
    text = markdown(rows).splitlines()
    assert "| memory | `prepare.peak` | 100,000,000 | 2,048 MiB | at most 2,560 MiB |" in text
    assert {line.count("|") for line in text[:3]} == {6} and {line.count("|") for line in text[4:]} == {4}


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_stages_run_at_a_small_size(tmp_path):
    options, console = options_of(tmp_path), Console(quiet=True)
    for stage in ("make", "prepare", "view", "same", "paper", "docs"):
        scale.run(stage, options, console)
    rows = {row["name"]: row for row in json.loads((tmp_path / "scale.json").read_text())}
    assert all(np.isfinite(row["value"]) and row["points"] == 50_000 for row in rows.values())
    assert rows["prepare.parts"]["value"] == 4 and rows["make.tiles"]["value"] == len(options.tiles())
    assert rows["prepare.peak"]["value"] > 100 * MIB and rows["prepare.disk"]["value"] > 4 * MIB
    assert rows["view.far"]["value"] > rows["view.far.opened"]["value"] > 0 and rows["view.flight"]["value"] > 0
    assert (options.there / "near.png").stat().st_size > 1000
    for count in (8, 64):
        assert rows[f"same.{count}.rays"]["value"] == 6 * 80 * 60 and rows[f"same.{count}.apart"]["value"] < 20
        assert 0.9 < rows[f"same.{count}.bytes"]["value"] < 2


@pytest.mark.parametrize("words", [["make", "--points", "12"], ["nothing"], ["make", "--runs", "0"]])
def test_invalid_options_are_reported(words, tmp_path, capsys):
    with pytest.raises(SystemExit):
        scale.main([*words, "--folder", str(tmp_path)])
    assert "error" in capsys.readouterr().err and not list(tmp_path.iterdir())


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_workers_give_the_same_results_at_a_small_size(tmp_path):
    pytest.importorskip("distributed")
    options, console = options_of(tmp_path), Console(quiet=True)
    for stage in ("cluster", "faults"):
        scale.run(stage, options, console)
    rows = {row["name"]: row["value"] for row in json.loads((tmp_path / "scale.json").read_text())}
    apart = {name: value for name, value in rows.items() if name.endswith(".apart")}
    rounded = {name for name in apart if "spread" in name and "rays" not in name}  # a pixel may, see docs/scale.md
    assert len(apart) >= 11 and not any(value for name, value in apart.items() if name not in rounded)
    assert rounded and all(apart[name] <= 10 for name in rounded)
    assert rows["cluster.film.sent"] > 80 * 60 * 16 and rows["cluster.spread.rays.sent.ray"] > 10
    assert rows["faults.prepare.killed"] == 1
