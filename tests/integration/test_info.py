"""`pointray info`: files, coordinate system, ranges of attributes, scanners."""

import json

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from pointray.cli import execute
from pointray.cli.facts import crs_name, describe_attributes, describe_georeference
from pointray.cli.tables import show_table

WKT = 'PROJCS["ETRS89 / UTM zone 32N",GEOGCS["ETRS89",DATUM["European Terrestrial"]],UNIT["metre",1]]'
TIME = 311_417_063.123456
ROWS = sphere_points(100)


@pytest.fixture
def scan(tmp_path):
    """A map with a coordinate system and attributes of several types."""
    attributes = {
        "gps_time": np.linspace(TIME, TIME + 5, 100),
        "classification": np.where(np.arange(100) < 60, 2, np.where(np.arange(100) < 99, 6, 77)).astype(np.uint8),
        "reflectance": np.linspace(-1.1, 0.3, 100, dtype=np.float32),
    }
    path = tmp_path / "a.ply"
    pr.write(
        path, pr.Points(ROWS + [5e5, 5.4e6, 100], ROWS, attributes=attributes, georeference=pr.Georeference(crs=WKT))
    )
    return path


def test_json_has_all_facts(scan, capsys):
    assert execute(["info", str(scan), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["format"] == "PLY" and facts["crs"] == WKT and facts["crs_name"] == "ETRS89 / UTM zone 32N"
    assert facts["files"][0]["bytes"] == scan.stat().st_size and facts["files"][0]["rows"] == 100
    assert facts["stations"] == [] and facts["attributes"] == sorted(facts["ranges"])
    ranges = facts["ranges"]
    assert ranges["gps_time"] == {"dtype": "float64", "low": TIME, "high": TIME + 5}
    assert ranges["classification"]["counts"] == {"2": 60, "6": 39, "77": 1}
    assert (ranges["classification"]["low"], ranges["classification"]["high"]) == (2, 77)
    assert ranges["reflectance"]["low"] == float(np.float32(-1.1))


def test_facts_are_printed_as_a_table(scan, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    assert execute(["info", str(scan)]) == 0
    out = capsys.readouterr().out
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert "coordinate system ETRS89 / UTM zone 32N" in lines
    assert f"gps_time float64 {TIME!r} {TIME + 5!r}" in lines  # all digits
    assert "reflectance float32 -1.1 0.3" in lines
    assert "2 ground 60" in lines and "6 building 39" in lines and "77 unnamed 1" in lines
    assert WKT not in out and "crs" not in out


def test_it_ends_with_what_a_picture_shows(scan, capsys, tmp_path, rng):
    assert execute(["info", str(scan), "--json"]) == 0
    picture = json.loads(capsys.readouterr().out)["first_picture"]
    assert picture["up"] == "+z (large coordinates, as on a map)" and picture["colors"] == "none: shown in grey"
    assert picture["ignored"] == "" and picture["normals"].startswith("from the file")
    ball = rng.normal(size=(1000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    pr.write(tmp_path / "b.ply", pr.Points([*ball, [1e5, 0, 0]], colors=np.full((1001, 3), 9, np.uint8)))
    assert execute(["info", str(tmp_path / "b.ply")]) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()][-6:]
    assert lines[0].startswith("picture automatic: --up") and lines[1].startswith("up +z (")
    assert lines[2] == "view front (azimuth 25, elevation 18)" and lines[3] == "colours from the file"
    assert lines[4] == "normals estimated" and lines[5] == "ignored 0.1% of the points lie far from all others"


def test_control_characters_of_files_are_escaped(tmp_path, capsys):
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(version="1.2", point_format=0)
    header.generating_software = "a\x1b[2Jb"
    with laspy.open(tmp_path / "a.las", "w", header=header) as writer:
        record = laspy.ScaleAwarePointRecord.zeros(9, header=header)
        record.x = record.y = np.arange(9.0) ** 2
        writer.write_points(record)
    assert execute(["info", str(tmp_path / "a.las")]) == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out and "a\ufffd[2Jb" in out
    (tmp_path / "b.xyz").write_bytes(b"1 2 3 \x9b31mx\n" * 3)
    assert execute(["info", str(tmp_path / "b.xyz")]) == 2
    err = capsys.readouterr().err
    assert "\x9b" not in err and err.count("\n") == 1


def test_the_rows_of_the_file_are_printed_if_fewer_are_read(scan, capsys):
    assert execute(["info", str(scan), "--every", "4"]) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "rows of the file 100" in lines and "points 25" in lines


def test_names_of_coordinate_systems():
    assert crs_name(WKT) == "ETRS89 / UTM zone 32N"
    assert crs_name("EPSG:25832") == "EPSG:25832"
    assert crs_name('COMPD_CS["NAD83 + NAVD88",PROJCS["NAD83"]]') == "NAD83 + NAVD88"
    assert crs_name('a "local" one') == 'a "local" one'
    assert crs_name("") == ""


def test_ranges_are_exact():
    n = 5
    values = {
        "big": np.array([2**63 + 1, 0, 1, 2, 2**64 - 1], np.uint64),
        "flag": np.array([True, False, True, True, True]),
        "lost": np.array([np.nan, 1.5, np.inf, -2, 0]),
        "none": np.full(n, np.nan, np.float32),
        "pair": np.array([[1, -1], [2, -2], [3, -3], [4, -4], [5, -5]], np.int16),
        "scalar_Classification": np.array([2, 2, 6, 6, 6], np.float32),
        "Classification": np.array([2, 2, 6.5, 6, 6], np.float32),
    }
    found = describe_attributes(pr.Points(ROWS[:n], attributes=values))
    assert found["big"] == {"dtype": "uint64", "low": 0, "high": 2**64 - 1}
    assert found["flag"] == {"dtype": "bool", "low": False, "high": True}
    assert found["lost"] == {"dtype": "float64", "low": -2.0, "high": 1.5, "not_finite": 2}
    assert found["none"] == {"dtype": "float32", "low": None, "high": None, "not_finite": 5}
    assert found["pair"] == {"dtype": "int16", "low": [1, -5], "high": [5, -1]}
    assert found["scalar_Classification"]["counts"] == {"2": 2, "6": 3}
    assert "counts" not in found["Classification"]
    assert json.loads(json.dumps(found)) == found


def test_scanners_are_listed(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    stations = [(float(k), 2.0, 3.25) for k in range(20)]
    facts = describe_georeference(pr.Georeference(unit="metre", stations=tuple(stations)))
    assert facts["stations"] == [list(s) for s in stations] and facts["unit"] == "metre"
    show_table({"file": "a", "points": 3, **facts}, False)
    out = " ".join(capsys.readouterr().out.split())
    assert "20 scanners at 0, 2, 3.25; 1, 2, 3.25;" in out and "and 8 more" in out and "unit metre" in out


def test_facts_of_headers_of_several_kinds(capsys):
    scans = [{"name": "one", "points": 1200}, {"name": "two", "points": 7}]
    file = {"file": "a.e57", "format": "E57", "bytes": 1, "rows": 3, "scans": scans, "version": "1.0"}
    show_table({"file": "a.e57", "points": 3, "files": [file]}, False)
    out = " ".join(capsys.readouterr().out.split())
    assert "scans name one, points 1,200; name two, points 7" in out and "version 1.0" in out


def test_blank_names_are_quoted(capsys):
    file = {"file": "a.xyz", "format": "Text", "bytes": 1, "rows": 3, "separator": " "}
    show_table({"file": "a.xyz", "points": 3, "files": [file]}, False)
    assert "separator blank" in " ".join(capsys.readouterr().out.split())


def test_coordinates_are_shown_with_the_decimals_of_the_file(tmp_path, capsys):
    numbers = np.linspace((0, 0, 0), (336_270, 463_573, 17_979), 500).round()
    georeference = pr.Georeference(scale=(0.01, 0.01, 0.01), offset=(0.0, 0.0, 0.0))
    path = tmp_path / "a.las"
    pr.write(path, pr.Points(numbers * 0.01 + [635_619.85, 848_899.7, 406.59], georeference=georeference))
    assert execute(["info", str(path)]) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "min 635619.85, 848899.7, 406.59" in lines and "max 638982.55, 853535.43, 586.38" in lines
    assert "size 3362.7, 4635.73, 179.79" in lines


@pytest.mark.parametrize("command", [(), ("render",)])
def test_h_prints_help(command, capsys):
    assert execute([*command, "-h"]) == 0
    assert "Usage: pointray" in capsys.readouterr().out
