"""`pointray bake`, and baked light in `render`, `animate`, `view` and scene files."""

import inspect
import re
import shutil
import warnings
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from plyfile import PlyData

import pointray as pr
from helpers.marks import long
from pointray.cli import bake as command, execute, serve
from pointray.cli.commands.files import bake as bake_command
from pointray.cli.read_options import Reading
from pointray.cli.scan_surface import PLAIN
from pointray.cloud.normals.validation import select_normals
from pointray.image.tone import linear_to_srgb, srgb_to_linear, tone
from pointray.scenefile import plan
from pointray.viewer.shared_scene import SharedScene
from pointray.viewer.view_settings import ViewSettings

FEW = ["--patches", "200", "--links", "8"]
BAKED = pr.BakeSettings(patches=200, links=8)
SMALL = ["--size", "24x18", "--spp", "1"]
LIGHTS = ["--light", "sun:1,1,-1.5:2", "--light", "sky:0.3,0.5,0.9"]
NAMES = ("ao", "irradiance_r", "irradiance_g", "irradiance_b")


@pytest.fixture(autouse=True)
def _threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POINTRAY_THREADS", "2")


@cache
def ring() -> pr.Points:
    """Return a torus, red to the right and blue to the left, with shuffled rows."""
    points = pr.procedural("torus", 1000)
    points = points.select(np.random.default_rng(0).permutation(len(points)))
    x, y, _ = points.positions.T
    colors = np.where(x[:, None] > 0, np.uint8([[230, 60, 50]]), np.uint8([[60, 70, 230]]))
    return pr.Points(points.positions, points.normals, colors, {"quality": x, "pair": np.stack([x, y], axis=1)})


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ring") / "scan.ply"
    pr.write(path, ring())
    return path


@pytest.fixture
def scan(tmp_path: Path, written: Path) -> Path:
    return Path(shutil.copy(written, tmp_path))


def run(capsys, *arguments):
    """Return exit status, output and messages of a command, without the line about kernels."""
    capsys.readouterr()
    status = execute([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return status, out, re.sub(r"^Compiling .* kernels.*\n", "", err, flags=re.MULTILINE)


def fail(capsys, *arguments) -> str:
    """Run the command on invalid input and return the one line that it prints."""
    status, out, err = run(capsys, *arguments)
    assert (status, out) == (2, "") and err.startswith("pointray: ") and err.count("\n") == 1, (status, out, err)
    return err


def scene_of(path: Path, lights: list, material=None) -> tuple[pr.Scene, int]:
    """Return the scene that commands make of a scan."""
    scene = pr.Scene()
    number = scene.add(pr.Model(pr.read(path)), material=material)
    scene.lights = lights
    return scene, number


def lights() -> list:
    """Return the lights of LIGHTS."""
    return [pr.SunLight((1, 1, -1.5), 2.0), pr.EnvironmentLight((0.3, 0.5, 0.9))]


@pytest.fixture
def bakes(monkeypatch: pytest.MonkeyPatch) -> list:
    """The scenes and settings of all bakes, which run with little work."""
    calls, real = [], pr.bake

    def bake(scene, settings=None, progress=None, client=None):
        calls.append((scene, settings))
        return real(scene, BAKED, progress, client=client)

    monkeypatch.setattr(pr, "bake", bake)
    monkeypatch.setattr(plan, "bake", bake)
    return calls


# ------------------------------------------------------------------------------------------------- points with light


def test_light_is_stored_as_attributes_in_the_order_of_the_file(scan, capsys):
    out = scan.with_name("lit.ply")
    status, text, err = run(capsys, "bake", scan, "-o", out, *FEW, *LIGHTS)
    count = len(ring())
    assert status == 0 and err == ""
    assert text.splitlines()[0] == f"{out}: {count:,} points with ao and irradiance"
    assert text.splitlines()[1].endswith(". Change with --up.")
    scene, number = scene_of(scan, lights())
    baked = pr.bake(scene, BAKED)
    found, before = pr.read(out), pr.read(scan)
    irradiance = np.stack([found.attributes[name] for name in NAMES[1:]], axis=1)
    assert np.array_equal(irradiance, baked.irradiance(number)) and irradiance.std() > 0.1
    assert np.array_equal(found.attributes["ao"], baked.ambient_occlusion(number))
    assert found.attributes["ao"].min() < 0.7 < 0.99 < found.attributes["ao"].max() < 1.001
    for name in ("positions", "normals", "colors"):
        assert np.array_equal(getattr(found, name), getattr(before, name)), name
    assert {*found.attributes} == {*before.attributes, *NAMES}
    assert all(np.array_equal(found.attributes[name], values) for name, values in before.attributes.items())


def test_other_programs_find_plain_floats(scan, capsys):
    out = scan.with_name("lit.ply")
    assert run(capsys, "bake", scan, "-o", out, *FEW)[0] == 0
    vertex = PlyData.read(out)["vertex"]
    types = {p.name: p.val_dtype for p in vertex.properties}
    assert all(types[name] == "f4" for name in NAMES) and list(types)[-4:] == list(NAMES)


def test_a_scan_without_normals_far_from_the_origin_is_baked(tmp_path, capsys):
    """No normals are added to the file; points without a splat have no light."""
    rows = ring().positions + np.array([4e6, 5e6, 100.0])
    rows[5] = np.nan
    points = pr.Points(rows)
    pr.write(tmp_path / "scan.ply", points)
    status, _, err = run(capsys, "bake", tmp_path / "scan.ply", "-o", tmp_path / "lit.ply", *FEW, "--colors")
    found = pr.read(tmp_path / "lit.ply")
    assert status == 0 and "1 of" in err
    assert found.normals is None and np.array_equal(found.world, points.world, equal_nan=True)
    assert [np.flatnonzero(np.isnan(found.attributes[name])).tolist() for name in NAMES] == [[5]] * 4
    assert (found.colors[5] == 255).all() and (found.colors[6] < 255).any()


def test_invalid_normals_are_not_used_but_kept_in_the_file(scan, capsys):
    """The light is that of fitted normals; the file keeps its own."""
    wrong = np.roll(ring().normals, 1, axis=1)
    pr.write(scan, ring().with_normals(wrong))
    out = scan.with_name("lit.ply")
    status, _, err = run(capsys, "bake", scan, "-o", out, *FEW, *LIGHTS)
    assert status == 0 and "replaced by fitted normals" in err
    scene = pr.Scene()
    with pytest.warns(UserWarning, match="fitted"):
        number = scene.add(pr.Model(select_normals(pr.read(scan))))
    scene.lights = lights()
    found = pr.read(out)
    assert np.array_equal(found.normals, wrong)
    assert np.array_equal(found.attributes["ao"], pr.bake(scene, BAKED).ambient_occlusion(number))


def test_baking_into_the_same_file_again_needs_force(scan, capsys):
    before = scan.read_bytes()
    assert "--force" in fail(capsys, "bake", scan, "-o", scan, *FEW)
    assert scan.read_bytes() == before
    for lamp in ("sky:1,1,1", "sky:2,2,2"):
        assert run(capsys, "bake", scan, "-o", scan, *FEW, "--force", "--light", lamp)[0] == 0
    twice = pr.read(scan).attributes
    assert {*twice} == {*pr.read(scan).attributes} and len(twice) == 3 + len(NAMES)  # the pair has two columns
    assert run(capsys, "bake", scan, "-o", scan.with_name("once.ply"), *FEW, "--light", "sky:1,1,1")[0] == 0
    once = pr.read(scan.with_name("once.ply")).attributes
    assert twice["irradiance_r"] == pytest.approx(2 * once["irradiance_r"], rel=1e-3)


def test_a_saved_model_is_baked_like_its_scan(scan, capsys):
    """The light equals that of the scan."""
    saved = scan.with_name("scan.pointray")
    assert run(capsys, "prepare", scan, "-o", saved, "--no-levels")[0] == 0
    for source, name in ((scan, "a.ply"), (saved, "b.ply")):
        assert run(capsys, "bake", source, "-o", scan.with_name(name), *FEW, *LIGHTS)[0] == 0
    one, other = (pr.read(scan.with_name(name)) for name in ("a.ply", "b.ply"))
    assert all(np.array_equal(one.attributes[name], other.attributes[name]) for name in one.attributes)


@pytest.mark.parametrize(("paint", "curve"), [([150, 140, 120], "neutral"), ([60, 70, 250], "soft")])
def test_colors_contain_the_light(scan, capsys, paint, curve):
    """Their mean is medium grey and none are clipped: highlights are softened as in pictures."""
    points = ring()
    shade = np.where(points.positions[:, :1] > 1.2, np.uint8([paint]), np.uint8([[120, 110, 100]]))
    pr.write(scan, pr.Points(points.positions, points.normals, shade))
    out = scan.with_name("lit.ply")
    status, text, _ = run(capsys, "bake", scan, "-o", out, *FEW, *LIGHTS, "--colors")
    told = re.fullmatch(
        rf"{out}: {len(points):,} points with ao and irradiance, lit colours, exposure (\S+?)(, .*)?",
        text.splitlines()[0],
    )
    assert status == 0 and (told[2] == ", highlights softened") == (curve == "soft")
    found = pr.read(out)
    irradiance = np.stack([found.attributes[name] for name in NAMES[1:]], axis=1)
    light = tone(srgb_to_linear(shade) * irradiance / np.float32(np.pi), float(told[1]), curve)
    assert np.abs(255 * linear_to_srgb(light) - found.colors).max() < 0.51
    assert 90 < found.colors.mean() < 170 and (found.colors == 255).mean() < 0.01


def test_colors_of_points_that_have_none_are_white_or_the_given_one(scan, capsys):
    """Indirect light has no hue unless a material or colour has one."""
    points = ring()
    pr.write(scan, pr.Points(points.positions, points.normals))
    out, shown = scan.with_name("lit.ply"), {}
    for name, more in {"white": [], "red": ["--color", "0.5,0,0"], "clay": ["--material", "clay"]}.items():
        assert run(capsys, "bake", scan, "-o", out, *FEW, "--light", "sky:1,1,1", "--colors", *more)[0] == 0
        shown[name] = pr.read(out).colors.astype(int)
    assert np.ptp(shown["white"], axis=1).max() <= 1  # rounding
    assert shown["white"].mean() > 60 and np.median(np.ptp(shown["clay"], axis=1)) > 20
    assert (shown["red"][:, 1:] == 0).all() and shown["red"][:, 0].mean() > 60
    assert (shown["clay"][:, 0] > shown["clay"][:, 2]).all()


def test_light_of_a_scan_without_colors_fits_its_pictures(scan, capsys):
    """Pictures show clay, so light is baked with clay."""
    points = ring()
    pr.write(scan, pr.Points(points.positions, points.normals))
    light = scan.with_name("lit.bake")
    assert run(capsys, "bake", scan, "-o", light, *FEW, "--light", "sky:1,1,1")[0] == 0
    picture = ["-o", scan.with_name("a.png"), "--size", "24x18", "--light", "sky:1,1,1", "--bake", light]
    assert run(capsys, "render", scan, *picture)[0] == 0


def test_baking_without_lights_gives_black_and_a_message(scan, capsys):
    status, _, err = run(capsys, "bake", scan, "-o", scan.with_name("a.ply"), *FEW, "--light", "sky:0,0,0", "--colors")
    assert status == 0 and err == "pointray: note: the scene has no light: the baked light is black\n"
    vertex = PlyData.read(scan.with_name("a.ply"))["vertex"]
    assert not any(vertex[name].any() for name in ("red", "green", "blue"))


# ------------------------------------------------------------------------------------------------------- the options


def test_default_lights_are_fixed_suns_and_a_sky(scan, bakes, capsys):
    assert run(capsys, "bake", scan, "-o", scan.with_name("a.ply"), "--up", "z")[0] == 0
    sun, rim, sky = bakes[0][0].lights
    assert not sun.camera and sun.direction[2] < 0 and isinstance(sky, pr.EnvironmentLight)
    camera = pr.frame(bakes[0][0], up="z")
    right = np.cross(np.subtract(camera.target, camera.eye), (0, 0, 1))
    assert right @ sun.direction > 0  # it comes from the left of the automatic view
    assert np.subtract(camera.target, camera.eye) @ sun.direction > 0  # and from in front
    assert right @ rim.direction < 0 > np.subtract(camera.target, camera.eye) @ rim.direction  # from behind, right


def test_each_option_is_passed_to_the_bake(scan, bakes, capsys):
    out = scan.with_name("a.ply")
    more = ["--noise", 0.1, "--links", 5, "--patches", 99, "--albedo-scale", 0.5, "--seed", 3, "--threads", 1]
    scene = ["--up", "y", "--material", "clay", "--ground", "--light", "point:0,0,2:7", "--fill", "0.5"]
    surface = ["--surface", "imls", "--samples", 5, "--normals", "fit"]
    assert run(capsys, "bake", scan, "-o", out, *more, *scene, *surface)[0] == 0
    made, settings = bakes[0]
    assert settings == pr.BakeSettings(noise=0.1, links=5, patches=99, albedo_scale=0.5, seed=3, threads=1)
    model, ground = made.shapes.values()
    assert (model.surface, model.settings.samples) == ("imls", 5) and model.points.normals is None
    assert isinstance(ground, pr.Plane)
    lamp, sky = made.lights
    assert np.max(lamp.intensity) == 7 and np.max(sky.radiance) == 0.5 and tuple(sky.up) == (0, 1, 0)
    assert run(capsys, "bake", scan, "-o", out, "--radius-scale", 2)[0] == 0
    assert bakes[1][0].models[0].radii.mean() > 1.5 * model.radii.mean()
    assert bakes[1][1] == pr.BakeSettings()


def test_the_defaults_are_those_of_python():
    told = {name: p.default for name, p in inspect.signature(bake_command).parameters.items()}
    assert pr.BakeSettings(**{name: told[name] for name in command.BAKING}) == pr.BakeSettings()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["-o", "lit.foo"], "cannot write .foo; supported: .asc, .copc.laz, .csv, .e57, .glb, "),
        (["-o", "lit"], "a file without extension"),
        (["-o", "no/folder/lit.ply"], "folder not found"),
        (["-o", "lit.bake", "--colors"], "--colors requires .asc, .copc.laz, .csv, .e57, "),
        (["-o", "lit.ply", "--colors", "--color-by", "quality"], "--color-by"),
        (["-o", "lit.ply", "--links", "0"], "links"),
        (["-o", "lit.ply", "--links", "5000"], "links"),
        (["-o", "lit.ply", "--patches", "3"], "patches"),
        (["-o", "lit.ply", "--noise", "0"], "noise"),
        (["-o", "lit.ply", "--noise", "nan"], "noise"),
        (["-o", "lit.ply", "--albedo-scale", "1.5"], "albedo_scale"),
        (["-o", "lit.ply", "--seed", "-1"], "seed"),
        (["-o", "lit.ply", "--threads", "0"], "threads"),
        (["-o", "lit.ply", "--light", "sun:0,0,-1,camera"], "cannot be baked"),
        (["-o", "lit.ply", "--fill", "0.5"], "--fill"),
        (["-o", "lit.ply", "--color", "2,0,0"], "--color"),
        (["-o", "lit.ply", "--up", "0,0,0"], "--up"),
        (["-o", "lit.ply", "--size", "3x4"], "--size"),
        (["-o", "lit.ply", "--eye", "1,2,3"], "--eye"),
        ([], "--output"),
    ],
)
def test_bad_options_are_reported_before_the_work(tmp_path, monkeypatch, capsys, options, words):
    (tmp_path / "broken.ply").write_text("nothing")
    monkeypatch.chdir(tmp_path)
    output = fail(capsys, "bake", "broken.ply", *options)
    assert words in output and "broken.ply" not in output
    assert [path.name for path in tmp_path.iterdir()] == ["broken.ply"]


def test_an_invalid_scan_is_reported(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("broken.ply").write_text("nothing")
    assert "broken.ply" in fail(capsys, "bake", "broken.ply", "-o", "lit.ply")
    assert "absent.ply" in fail(capsys, "bake", "absent.ply", "-o", "lit.ply")
    assert "broken.ply" in fail(capsys, "bake", "broken.ply", "-o", "broken.ply")
    assert [path.name for path in tmp_path.iterdir()] == ["broken.ply"]


def test_a_full_disk_keeps_the_old_file(scan, capsys, monkeypatch):
    out = scan.with_name("lit.ply")
    out.write_text("old")

    def full(*arguments, **more):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pointray.base.atomic_write.Replacement.write", full)
    status, _, err = run(capsys, "bake", scan, "-o", out, *FEW)
    assert status == 1 and err == f"pointray: {out}: No space left on device\n"
    assert out.read_text() == "old" and sorted(path.name for path in scan.parent.iterdir()) == ["lit.ply", "scan.ply"]


# ---------------------------------------------------------------------------------------------------------- pictures


def test_render_bakes_first_and_reports_it(scan, bakes, capsys):
    out = scan.with_name("a.npz")
    status, _, err = run(capsys, "render", scan, "-o", out, *SMALL, "--integrator", "baked", *LIGHTS, "--seed", "4")
    assert status == 0 and err.startswith("pointray: note: baking light first (") and err.count("\n") == 1
    assert [settings.seed for _, settings in bakes] == [4]
    scene, _ = scene_of(scan, lights(), pr.Diffuse())
    scene.baked = pr.bake(scene)
    camera = pr.frame(bakes[0][0], size=(24, 18))
    wanted = pr.render(scene, camera, pr.Settings("baked", spp=1, seed=4))
    assert np.array_equal(np.load(out)["radiance"], wanted)


def test_light_from_a_file_equals_baked_light(scan, bakes, capsys):
    light, picture = scan.with_name("lit.bake"), scan.with_name("a.png")
    status, text, err = run(capsys, "bake", scan, "-o", light)
    assert status == 0 and err == "" and text.startswith(f"{light}: light of {len(ring()):,} points, ")
    assert run(capsys, "render", scan, "-o", picture, *SMALL, "--integrator", "baked")[0] == 0
    before = picture.read_bytes()
    del bakes[:]
    for more in ([], ["--integrator", "baked"], ["--view", "auto"]):
        assert run(capsys, "render", scan, "-o", picture, *SMALL, "--bake", light, *more)[2] == ""
        assert picture.read_bytes() == before
    assert bakes == []
    assert run(capsys, "render", scan, "-o", picture, *SMALL, "--bake", light, "--view", "top")[2] == ""


@pytest.mark.parametrize("program", ["render", long("animate")])
def test_light_that_does_not_fit_is_refused(program, scan, bakes, capsys):
    light = scan.with_name("lit.bake")
    assert run(capsys, "bake", scan, "-o", light)[0] == 0
    out = scan.with_name("a.png" if program == "render" else "frames")
    for more, words in (
        (["--light", "sun:1,1,-1"], "lights, materials or colours have changed"),
        (["--material", "clay"], "lights, materials or colours have changed"),
        (["--ground"], "lit.bake"),
        (["--radius-scale", "2"], "lit.bake"),
        (["--integrator", "path"], "--bake requires --integrator baked, not path"),
    ):
        output = fail(capsys, program, scan, "-o", out, *SMALL, "--bake", light, *more)
        assert words in output and not out.is_file(), more


@pytest.mark.parametrize("program", ["render", "animate", "view"])
@pytest.mark.parametrize("subject", ["scan.ply", "scene.toml"])
def test_a_missing_file_of_light_is_reported(program, subject, scan, scene, capsys, monkeypatch):
    monkeypatch.chdir(scan.parent)
    more = {"render": ["-o", "a.png"], "animate": ["-o", "frames"], "view": ["--no-open"]}[program]
    assert (
        fail(capsys, program, subject, *more, "--bake", "nix.bake") == "pointray: nix.bake: No such file or directory\n"
    )


@pytest.mark.parametrize("program", ["render", "animate"])
def test_an_invalid_file_of_light_is_reported(program, scan, capsys):
    out = scan.with_name("a.png" if program == "render" else "frames")
    output = fail(capsys, program, scan, "-o", out, *SMALL, "--bake", scan)
    assert output.startswith(f"pointray: {scan}: ")


def test_a_film_bakes_once(scan, bakes, capsys):
    film = [*SMALL, "--seconds", "1", "--fps", "3", "--integrator", "baked"]
    status, out, err = run(capsys, "animate", scan, "-o", scan.with_name("frames"), *film)
    assert status == 0 and "3 frames" in out and len(bakes) == 1
    assert err.startswith("pointray: note: baking light first, once for all frames")
    frames = [path.read_bytes() for path in sorted(scan.with_name("frames").iterdir())]
    assert len(set(frames)) == 3


def test_a_film_bakes_after_levels_of_detail_are_made(scan, bakes, capsys, monkeypatch):
    """Light is stored for each level: a level made later would be black."""
    made = []
    monkeypatch.setattr(pr.Model, "make_levels", lambda self, show: made.append(len(bakes)))
    monkeypatch.setattr("pointray.rendering.lod.is_far", lambda *_: True)
    film = [*SMALL, "--seconds", "1", "--fps", "1", "--integrator", "baked"]
    assert run(capsys, "animate", scan, "-o", scan.with_name("frames"), *film)[0] == 0
    assert made == [0] and len(bakes) == 1


def test_a_film_uses_a_file_of_light(scan, bakes, capsys, monkeypatch):
    """It bakes nothing and makes no levels of detail, for which the file has no light."""
    light, frames = scan.with_name("lit.bake"), scan.with_name("frames")
    assert run(capsys, "bake", scan, "-o", light)[0] == 0
    del bakes[:]
    made = []
    monkeypatch.setattr(pr.Model, "make_levels", lambda self, show: made.append(self))
    monkeypatch.setattr("pointray.rendering.lod.is_far", lambda *_: True)
    film = [*SMALL, "--seconds", "1", "--fps", "2", "--bake", light]
    assert run(capsys, "animate", scan, "-o", frames, *film)[2] == "" and bakes == made == []
    assert len(list(frames.iterdir())) == 2


@pytest.mark.long
def test_an_interrupted_film_is_resumed_only_with_the_same_light(scan, bakes, capsys, monkeypatch):
    from pointray.rendering import sequence

    real, left = sequence.render_snapshot, [1]

    def render(*arguments):
        if not left:
            raise KeyboardInterrupt
        left.pop()
        return real(*arguments)

    monkeypatch.setattr(sequence, "render_snapshot", render)
    film = ["--size", "24x18", "--spp", "1", "--seconds", "1", "--fps", "2", "--integrator", "baked"]
    assert run(capsys, "animate", scan, "-o", scan.with_name("frames"), *film)[0] == 130
    monkeypatch.setattr(sequence, "render_snapshot", real)
    status, out, err = run(capsys, "animate", scan, "-o", scan.with_name("frames"), *film, "--seed", "2")
    assert status == 0 and "these changed: seed, bake" in err and "from before" not in out


# ------------------------------------------------------------------------------------------------------- scene files

SCENE = """
background = [0.1, 0.2, 0.3]

[models.scan]
file = "scan.ply"

[[instances]]
model = "scan"
translate = [1, 0, 0]

[[planes]]
point = [0, 0, -1.1]
normal = [0, 0, 1]

[[lights]]
kind = "sun"
direction = [1, 1, -1.5]

[camera]
size = [24, 18]

[settings]
integrator = "baked"
seed = 6

[bake]
links = 7
patches = 99
memory = "none"
file = "scene.bake"
"""


@pytest.fixture
def scene(scan: Path) -> Path:
    scan.with_name("scene.toml").write_text(SCENE)
    return scan.with_name("scene.toml")


def test_a_scene_file_sets_how_light_is_baked(scene, bakes, capsys):
    out = scene.with_name("a.npz")
    status, _, err = run(capsys, "render", scene, "-o", out)
    assert status == 0 and err.startswith("pointray: note: baking light first (") and err.count("\n") == 1
    assert [settings for _, settings in bakes] == [pr.BakeSettings(links=7, patches=99, seed=6)]
    made = pr.load_scene(scene)
    assert made.scene.baked is not None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.array_equal(np.load(out)["radiance"], pr.render(*made[:3]))


def test_a_scene_file_with_another_integrator_bakes_nothing(scene, bakes, capsys):
    scene.write_text(SCENE.replace('"baked"', '"phong"'))
    assert run(capsys, "render", scene, "-o", scene.with_name("a.png"))[2] == ""
    assert bakes == [] and pr.load_scene(scene).scene.baked is None
    assert run(capsys, "render", scene, "-o", scene.with_name("a.png"), "--integrator", "baked")[0] == 0
    assert len(bakes) == 1


def test_a_scene_file_without_the_table_bakes_with_its_seed(scene, bakes):
    scene.write_text(SCENE.partition("[bake]")[0])
    assert pr.load_scene(scene).scene.baked is not None
    assert [settings for _, settings in bakes] == [pr.BakeSettings(seed=6)]


def test_a_scene_file_reads_its_light_if_it_exists(scene, bakes, capsys):
    """Options of `bake` override the table, and the output is not read while it is baked."""
    picture, light = scene.with_name("a.png"), scene.with_name("scene.bake")
    assert run(capsys, "render", scene, "-o", picture)[0] == 0
    before = picture.read_bytes()
    for _ in range(2):
        del bakes[:]
        status, text, err = run(capsys, "bake", scene, "-o", light, "--links", "5", "--seed", "1", "--noise", "0.2")
        assert (status, err) == (0, "") and text.startswith(f"{light}: light of {len(ring()):,} points, ")
        wanted = pr.BakeSettings(links=5, patches=99, seed=1, noise=0.2)
        assert [settings for _, settings in bakes] == [wanted]
    del bakes[:]
    assert run(capsys, "render", scene, "-o", picture)[2] == "" and picture.read_bytes() == before
    assert run(capsys, "animate", scene, "-o", scene.with_name("frames"), "--seconds", "1", "--fps", "2")[2] == ""
    light.rename(light.with_name("other.bake"))
    more = ["--bake", light.with_name("other.bake")]
    assert run(capsys, "render", scene, "-o", picture, *more)[2] == "" and picture.read_bytes() == before
    picture.unlink()
    scene.write_text(SCENE.replace('"baked"', '"phong"'))  # which --bake overrides
    assert run(capsys, "render", scene, "-o", picture, *more)[2] == "" and picture.read_bytes() == before
    assert bakes == []


def test_a_film_of_a_scene_file_bakes_once(scene, bakes, capsys):
    film = ["animate", scene, "-o", scene.with_name("frames"), "--seconds", "1", "--fps", "3"]
    status, out, err = run(capsys, *film)
    assert status == 0 and "3 frames" in out and len(bakes) == 1 and "once for all frames" in err
    assert run(capsys, *film)[0] == 0


@pytest.mark.long
def test_light_of_another_scene_is_reported_with_its_line(scene, bakes, capsys):
    assert run(capsys, "bake", scene, "-o", scene.with_name("scene.bake"))[0] == 0
    picture = scene.with_name("a.png")
    for before, after in (("translate = [1, 0, 0]", "translate = [2, 0, 0]"), ("[1, 1, -1.5]", "[1, 2, -1.5]")):
        scene.write_text(SCENE.replace(before, after))
        output = fail(capsys, "render", scene, "-o", picture)
        assert output.startswith(f"pointray: {scene}:30: bake.file: {scene.with_name('scene.bake')}: ")
        with pytest.raises(ValueError, match=r"scene.toml:30: bake.file: "):
            pr.load_scene(scene)


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ("links = 7", "linx = 7", "27: bake.linx: unknown key 'linx' (did you mean 'links'?)"),
        ("links = 7", "links = 0", "27: bake.links: must be a whole number from 1 to 4096"),
        ("links = 7", "links = 1.5", "27: bake.links: must be a whole number"),
        ("patches = 99", "patches = 3", "28: bake.patches: must be a whole number from 64"),
        ("patches = 99", 'noise = "low"', "28: bake.noise: must be a number"),
        ("patches = 99", "albedo_scale = 2", "28: bake.albedo_scale: must be at most 1"),
        ("patches = 99", "max_depth = -1", "28: bake.max_depth: must be a whole number from 0"),
        ('memory = "none"', "memory = 0", "29: bake.memory: must be a whole number"),
        ('"scene.bake"', "7", "30: bake.file: must be a text"),
        ('"scene.bake"', '"."', "30: bake.file: "),
        ('"scene.bake"', '"scan.ply"', "30: bake.file: "),
        ("[bake]", "[bake.more]", "26: bake.more: unknown key"),
        ("[bake]", "[bakes]", "26: bakes: unknown key 'bakes' (did you mean 'bake'?)"),
    ],
)
def test_errors_in_the_table_are_reported(scene, capsys, before, after, told):
    assert before in SCENE
    scene.write_text(SCENE.replace(before, after))
    assert f"pointray: {scene}:{told}" in fail(capsys, "render", scene, "-o", scene.with_name("a.png"))


def test_an_empty_scene_is_reported(scene, capsys):
    text = SCENE.partition("[models.scan]")[0] + "[camera]\neye = [0, 0, 1]\ntarget = [0, 0, 0]\n"
    scene.write_text(text)
    status, _, err = run(capsys, "render", scene, "-o", scene.with_name("a.png"), "--integrator", "baked")
    assert status == 2 and err.endswith(f"\npointray: {scene}: the scene is empty: nothing to bake\n")


def test_points_of_a_scene_with_one_instance_are_baked(scene, bakes, capsys):
    out = scene.with_name("lit.ply")
    status, text, _ = run(capsys, "bake", scene, "-o", out, "--colors")
    assert status == 0 and text.startswith(f"{out}: {len(ring()):,} points with ao and irradiance, lit colours")
    made = pr.load_scene(scene).scene
    (number, _), _ = made.shapes.items()
    found = pr.read(out)
    assert np.array_equal(found.attributes["irradiance_g"], made.baked.irradiance(number)[:, 1])
    assert np.array_equal(found.positions, pr.read(scene.with_name("scan.ply")).positions)


@pytest.mark.parametrize("more", ['[[instances]]\nmodel = "scan"\n', "many", "none"])
def test_points_of_other_scenes_cannot_be_baked(scene, capsys, more):
    text = SCENE + more
    if more == "many":
        np.save(scene.with_name("many.npy"), np.tile(np.eye(4), (3, 1, 1)))
        text = SCENE.replace("translate = [1, 0, 0]", 'transforms = "many.npy"')
    if more == "none":
        text = SCENE.replace('[[instances]]\nmodel = "scan"\ntranslate = [1, 0, 0]\n', "")
        text = text.replace("size =", "eye = [0, 0, 1]\ntarget = [0, 0, 0]\nsize =")
    scene.write_text(text)
    scene.with_name("scan.ply").write_text("nothing")
    output = fail(capsys, "bake", scene, "-o", scene.with_name("lit.ply"))
    assert "can store one instance of a model, the scene has " in output


@pytest.mark.parametrize("option", ["--up z", "--light sun:1,1,1", "--material clay", "--surface imls", "--ground"])
def test_options_that_scene_files_contain_are_refused(scene, capsys, option):
    output = fail(capsys, "bake", scene, "-o", scene.with_name("lit.bake"), *option.split())
    assert "is not for a scene file" in output and option.split()[0] in output


# -------------------------------------------------------------------------------------------------------- the viewer


def viewed(files: list[Path], **options) -> tuple[object, list]:
    """Return the loaded shared scene of `pointray view`, and its messages."""
    typed = {name: value for name, value in options.items() if name in ("bake", "integrator")}
    told = {"up": None, "light": None, "fill": None, "background": "auto", "ground": False, "normals": "auto"}
    told |= {"settings": pr.Settings("baked"), "bake": None, "quick": False}
    told |= {"backfaces": None, "contact_shadow": True, **options}
    surface = dict(PLAIN)
    shared, loader = serve.shared_scene_of(files, Reading(), typed, told, surface)
    stages = []
    shared.subscribe(lambda: stages.append(shared.progress.stage))
    shared.load(loader).join(120)
    return shared, stages


def test_the_viewer_shows_a_scan_before_it_bakes(scan, bakes, capsys):
    """The painter's baker bakes in the background; pictures have direct light until then."""
    shared, _ = viewed([scan])
    assert shared.problem == "" and bakes == [] and shared.scene.baked is None
    assert "baked first" not in capsys.readouterr().err


def test_the_first_view_of_the_viewer_matches_the_light(scan):
    """The panel stores lights as angles and sRGB colours; unchanged lights keep their exact values."""
    lights = ["sun:1,1,-1.5", "point:0.3,-3,4"]
    shared, _ = viewed([scan], light=lights)
    scene, up = shared.scene, shared.up
    view = ViewSettings.of(shared, scene)
    light = pr.bake(scene, BAKED)
    assert light.fits(view.apply(scene, up))
    changed = view.with_value("lamps.0.azimuth", view.lamps[0].azimuth + 5.0)
    assert not light.fits(changed.apply(scene, up))


FAR = (412345.6, 5412345.7, 101.3)


@pytest.mark.parametrize(
    ("origin", "lights"),
    [((0, 0, 0), ["point:0.3,-3,4"]), long(FAR, None), long((0, 0, 0), None), long(FAR, ["point:0.3,-3,4"])],
)
def test_the_viewer_reads_a_file_of_bake(scan, bakes, capsys, lights, origin):
    """Its lights and ground equal those of `render` to the last bit."""
    light = scan.with_name("lit.bake")
    pr.write(scan, pr.Points(ring().world + origin, ring().normals))
    more = [] if lights is None else ["--light", *lights]
    assert run(capsys, "bake", scan, "-o", light, "--ground", *more)[0] == 0
    del bakes[:]
    shared, stages = viewed([scan], bake=light, light=lights, ground=True)
    assert shared.problem == "" and bakes == [] and "reading light" in stages
    assert shared.scene.baked is not None and shared.scene.baked.stale is None
    assert "baked first" not in capsys.readouterr().err
    shared, _ = viewed([scan], bake=light, light=["sun:1,0,-1"], ground=True)
    assert "does not fit" in shared.problem and shared.scene is None


@pytest.mark.long
def test_the_viewer_shows_a_large_scan_with_light_from_a_file_in_full(scan, bakes, capsys, monkeypatch):
    """There is no coarse version and no level of detail, as the file has no light for them."""
    monkeypatch.setattr("pointray.viewer.loading.LARGE_FROM", 100)
    made, shown = [], []
    monkeypatch.setattr(pr.Model, "make_levels", lambda self, show: made.append(self))
    monkeypatch.setattr(SharedScene, "show", lambda self, scene, home=None, coarse=False: shown.append(scene))
    light = scan.with_name("lit.bake")
    assert run(capsys, "bake", scan, "-o", light)[0] == 0
    del bakes[:]
    shared, stages = viewed([scan], bake=light)
    assert shared.problem == "" and "building a coarse version" not in stages
    assert [scene.baked is not None for scene in shown] == [True]
    assert made == [] and bakes == []


def test_the_viewer_bakes_a_scene_file(scene, bakes, capsys):
    shared, stages = viewed([scene])
    assert shared.problem == "" and shared.scene.baked is not None and "baking light" in stages
    assert [settings.links for _, settings in bakes] == [7]
    assert capsys.readouterr().err.startswith("pointray: baking light first (")
