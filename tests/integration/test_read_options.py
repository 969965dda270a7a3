"""Options of reading, several files as one cloud, folders, and messages about invalid options."""

import json
from pathlib import Path

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from pointray.cli import execute
from pointray.cli.declare import parsed
from pointray.cli.read_options import Reading
from pointray.cli.scan_files import scan_of
from pointray.viewer.loading import FileLoader
from pointray.viewer.shared_scene import SharedScene

NONE = {"columns": None, "every": 1, "max_points": None, "bounds": None, "keep": None, "drop": None}
NONE |= {"resolution": None, "sample": None, "opacity": 0.1, "intrinsics": None, "strict": False}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two halves of a sphere with classes 0 to 4, of 600 and 400 points."""
    rows, classes = sphere_points(1000), (np.arange(1000) % 5).astype(np.uint8)
    for name, part in (("a.ply", slice(0, 600)), ("b.ply", slice(600, None))):
        pr.write(tmp_path / name, pr.Points(rows[part], rows[part], attributes={"classification": classes[part]}))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def info(capsys, *arguments):
    capsys.readouterr()
    assert execute(["info", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_option_texts_are_parsed():
    assert parsed(Reading, NONE) == Reading() and Reading().is_plain and Reading().arguments == {}
    given = {"columns": "x, y,z,-,r,g,b", "every": 2, "bounds": "-1,0,0,1,1,inf", "opacity": 0.5}
    given |= {"keep": ["classification=2,6", "classification=6,9", "a=b=1"], "intrinsics": "500,500,320,240,1000"}
    reading = parsed(Reading, {**NONE, **given})
    assert reading.arguments == {
        "columns": ("x", "y", "z", "-", "r", "g", "b"),
        "every": 2,
        "bounds": (-1, 0, 0, 1, 1, np.inf),
        "keep": {"classification": (2, 6, 9), "a=b": (1,)},
        "opacity": 0.5,
        "intrinsics": (500, 500, 320, 240, 1000),
    }
    assert not reading.is_plain and reading.request.columns == reading.columns
    assert json.loads(json.dumps(reading.inputs))["keep"]["classification"] == [2, 6, 9]


@pytest.mark.parametrize(
    ("options", "count"),
    [
        ("--every 3", 200),
        ("--max-points 77", 77),
        ("--keep classification=2,3", 240),
        ("--keep classification=2 --keep classification=3 --drop classification=3", 120),
        ("--drop classification=0,1,2,3", 120),
        ("--keep classification=ground,3,medium-Vegetation", 360),
        ("--bounds=-2,-2,-2,2,2,2", 600),
    ],
)
def test_points_are_chosen(options, count, folder, capsys):
    assert info(capsys, "a.ply", *options.split())["points"] == count


def test_bounds_select_the_points_in_a_box(folder, capsys):
    facts = info(capsys, "a.ply", "b.ply", "--bounds", "0,-1,-1,1,1,1")
    rows = np.vstack([pr.read(name).positions for name in ("a.ply", "b.ply")])
    assert facts["points"] == (rows[:, 0] >= 0).sum() and facts["low"][0] >= 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--every 0", "--every must be a whole number from 1"),
        ("--every two", "Invalid value for '--every'"),
        ("--max-points 0", "--max-points must be"),
        ("--bounds 0,0,0", "--bounds must be x0,y0,z0,x1,y1,z1"),
        ("--bounds 0,0,0,1,1,x", "--bounds must be x0,y0,z0,x1,y1,z1, not '0,0,0,1,1,x'"),
        ("--bounds 1,0,0,0,1,1", "--bounds must be x0,y0,z0,x1,y1,z1, minimum first"),
        ("--keep classification", "--keep must be like classification=2,6, not 'classification'"),
        ("--keep =2", "--keep must be like classification=2,6"),
        ("--drop classification=hill", "--drop must be like classification=2,6, or the name of a class: never-cl"),
        ("--drop return=ground", "--drop must be like return=2,6, not 'ground'"),
        ("--columns x,y", "--columns must name z once"),
        ("--columns x,,z", "--columns must be names"),
        ("--resolution 0", "--resolution must be a positive number"),
        ("--sample -1", "--sample must be a whole number from 0"),
        ("--opacity 2", "--opacity must be a number from 0 to 1"),
        ("--intrinsics 1,2", "--intrinsics must be fx,fy,cx,cy"),
        ("--intrinsics 1,2,a,b", "--intrinsics must be fx,fy,cx,cy"),
    ],
)
@pytest.mark.parametrize("command", ["info", "render -o a.png", "view --no-open"])
def test_invalid_values_are_reported_before_any_work(command, options, message, folder, capsys):
    (folder / "broken.ply").write_text("nothing")
    name, *rest = command.split()
    assert execute([name, "broken.ply", *rest, *options.split()]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("pointray: ") and message in err


@pytest.mark.parametrize("command", ["info", "render -o out.png", "prepare -o out.ply", "bake -o out.ply", "view"])
def test_saved_models_and_scenes_refuse_reading_options(command, folder, capsys):
    pr.Model(pr.read("a.ply")).save("a.pointray")
    Path("scene.toml").write_text('[models.a]\nfile = "a.ply"\n[[instances]]\nmodel = "a"\n')
    name, *rest = command.split()
    for file in ["a.pointray", "scene.toml"][: 1 if name in ("info", "prepare") else 2]:
        capsys.readouterr()
        assert execute([name, file, *rest, "--every", "2"]) == 2
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and "--every is" in err and file in err


# ------------------------------------------------------------------------------------------------- several files


def test_several_files_are_one_cloud(folder, capsys):
    facts = info(capsys, "a.ply", "b.ply")
    assert facts["points"] == 1000 and facts["file"] == "2 files"
    assert [(file["file"], file["format"], file["rows"]) for file in facts["files"]] == [
        ("a.ply", "PLY", 600),
        ("b.ply", "PLY", 400),
    ]
    assert execute(["info", "a.ply", "b.ply"]) == 0
    out = capsys.readouterr().out
    assert "b.ply" in out and "600" in out and "400" in out and "1,000" in out


def test_a_folder_stands_for_its_scans(folder, capsys):
    tiles = folder / "tiles"
    tiles.mkdir()
    for name in ("b.ply", "a.ply"):
        (folder / name).rename(tiles / name)
    (tiles / "cut.ply").write_text("hello")
    (tiles / "notes.doc").write_text("hello")
    (tiles / ".hidden.ply").write_text("hello")
    (tiles / "inner").mkdir()
    assert execute(["info", "tiles", "--json"]) == 0
    out, err = capsys.readouterr()
    assert [Path(file["file"]).name for file in json.loads(out)["files"]] == ["a.ply", "b.ply"]
    assert err == "pointray: note: tiles: skipped files that are not scans: cut.ply, notes.doc\n"
    assert execute(["render", "tiles", "-o", "a.png", "--size", "32x24", "--spp", "1", "--light", "headlight"]) == 0
    assert "1,000 points" in capsys.readouterr().out
    assert execute(["info", "tiles/inner"]) == 2
    assert "tiles/inner: contains no readable file; supported: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ("a.ply a.ply", "a.ply: is given twice"),
        ("a.ply .", "is given twice"),
        ("a.ply a.pointray", "a.pointray: a saved model cannot be combined with other files"),
        ("a.ply scene.toml", "scene.toml: a scene file cannot be combined with other files"),
        ("a.ply absent.ply", "absent.ply: No such file"),
        ("a.ply broken.ply", "broken.ply: invalid PLY file"),
    ],
)
def test_incompatible_files_are_refused(files, message, folder, capsys):
    for name in ("a.pointray", "scene.toml", "broken.ply"):
        (folder / name).write_text("nothing")
    assert execute(["render", *files.split(), "-o", "out.png"]) == 2
    err = capsys.readouterr().err.splitlines()
    assert message in err[-1] and all("note:" in line for line in err[:-1])


def test_the_viewer_shows_one_cloud_and_saved_models_beside_it(folder, monkeypatch):
    pr.Model(pr.read("a.ply")).save("c.pointray")
    shared, shown = SharedScene("three"), []
    monkeypatch.setattr(shared, "show", lambda scene, home=None, coarse=False: shown.append(scene))
    files = [Path(name) for name in ("c.pointray", "a.ply", "b.ply")]
    FileLoader(files, {}, lambda scene: (0.0, 0.0, 1.0), reading={"every": 2})(shared)
    assert [len(model.points) for model in shown[-1].models] == [500, 600]


def test_a_film_depends_on_files_and_options(folder):
    one, two = scan_of([Path("a.ply")], Reading()), scan_of([Path("a.ply"), Path("b.ply")], Reading(every=2))
    assert len(two.inputs["scan"]) == 2 and two.inputs["every"] == 2 and two.name == "2 files"
    assert one.inputs["every"] == 1 and one.name == "a.ply"
    assert len(two.read()) == 500


def test_prepare_and_bake_accept_several_files(folder, capsys):
    assert execute(["prepare", "a.ply", "b.ply", "-o", "c.ply", "--keep", "classification=1"]) == 0
    assert len(pr.read("c.ply")) == 200
    assert execute(["prepare", "a.ply", "b.ply", "-o", "b.ply"]) == 2
    assert capsys.readouterr().err == "pointray: b.ply: is an input; use --force to overwrite it\n"


# -------------------------------------------------------------------------------------------------- scene files


def test_scene_files_have_reading_options(folder):
    scene = folder / "scene.toml"
    scene.write_text(
        '[models.a]\nfile = "a.ply"\nevery = 2\nkeep = { classification = [2, 4] }\n[[instances]]\nmodel = "a"\n'
    )
    (model,) = pr.load_scene(scene).scene.models
    wanted = np.isin(pr.read("a.ply").attributes["classification"][::2], (2, 4)).sum()
    assert len(model.points) == wanted


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("every = 0", "scene.toml:3: models.a.every: must be a whole number from 1"),
        ("bounds = [1, 2, 3]", "scene.toml:3: models.a.bounds: must be x0,y0,z0,x1,y1,z1"),
        ("intrinsics = 5", "scene.toml:3: models.a.intrinsics: must be fx,fy,cx,cy"),
        ("keep = 2", "scene.toml:3: models.a.keep: must be a table"),
        ('keep = { classification = "ground" }', "scene.toml:3: models.a.keep"),
        ('columns = "x,y"', "scene.toml:3: models.a.columns: must name z once"),
    ],
)
def test_scene_files_check_reading_options(line, message, folder):
    (folder / "scene.toml").write_text(f'[models.a]\nfile = "a.ply"\n{line}\n[[instances]]\nmodel = "a"\n')
    with pytest.raises(ValueError) as error:
        pr.load_scene("scene.toml")
    assert message in str(error.value)
