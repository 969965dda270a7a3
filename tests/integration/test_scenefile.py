"""Scene files give the same scene as Python; errors are reported with file, line and key."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from helpers.clouds import sphere_points
from helpers.places import ROOT
from pointray.cli import execute
from pointray.scenefile import shading

GOOD = """
exposure = 0.5
background = [0.1, 0.2, 0.3]

[models.ball]
procedural = "sphere"
points = 2000
surface = "imls"
samples = 5
refine = 0
trim = "none"
radius_scale = 1.2

[models.scan]
file = "scan.ply"

[materials.gold]
kind = "principled"
base_color = [1.0, 0.77, 0.34]
roughness = 0.3
metallic = 1

[materials.glass]
kind = "dielectric"
ior = 1.4

[[instances]]
model = "ball"
material = "gold"
scale = [1, 2, -1]
rotate = 30
axis = [0, 1, 0]
translate = [1, 0, 0]

[[instances]]
model = "scan"
transform = [
    [1, 0, 0, -1],
    [0, 1, 0, 0],
    [0, 0, 1, 0.5],
    [0, 0, 0, 1],
]

[[instances]]
model = "scan"
material = "glass"
transforms = "many.npy"

[[planes]]
point = [0, 0, -1]
normal = [0, 0, 1]
color = 0.4
checker = 0.5

[[lights]]
kind = "sun"
direction = [1, 1, -2]
irradiance = [3, 3, 2]
angle = 1

[[lights]]
kind = "point"
position = [0, -4, 4]
intensity = 20

[[lights]]
kind = "rect"
center = [0, 0, 5]
u = [0, 1, 0]
v = [1, 0, 0]
radiance = 2

[[lights]]
kind = "disk"
center = [-3, 0, 5]
normal = [0, 0, -1]
radius = 0.5
radiance = 3

[[lights]]
kind = "sphere"
center = [3, 0, 5]
radius = 0.5
radiance = 3

[[lights]]
kind = "environment"
image = "sky.exr"
radiance = 0.5

[[clips]]
point = [0, 0, 0.7]
normal = [0.1, 0, 2]

[[clips]]
point = [-9, 0, 0]
normal = [-1, 0, 0]

[camera]
eye = [0, -6, 2]
target = [0, 0, 0]
fov = 50
size = [32, 24]
aperture = 0.1
focus = 5

[settings]
integrator = "path"
spp = 3
max_depth = "none"
seed = 7
filter = "tent"
"""


@pytest.fixture(autouse=True)
def _threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POINTRAY_THREADS", "2")


def many() -> np.ndarray:
    out = np.tile(np.eye(4), (3, 1, 1))
    out[:, 0, 3] = -2, 0, 2
    out[:, 1, 3] = 2
    return out


def sky() -> np.ndarray:
    return np.random.default_rng(1).uniform(0, 2, (8, 16, 3)).astype(np.float32)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a scene file and the files that it names."""
    rows = sphere_points(2000)
    points = pr.Points(0.5 * rows, rows, attributes={"radius": np.full(2000, 0.1, np.float32)})
    pr.write(tmp_path / "scan.ply", points)
    np.save(tmp_path / "many.npy", many())
    pytest.importorskip("OpenEXR")
    pr.write_image(tmp_path / "sky.exr", sky())
    (tmp_path / "scene.toml").write_text(GOOD)
    return tmp_path


def in_python(folder: Path) -> tuple[pr.Scene, pr.Camera, pr.Settings]:
    """Return the scene of GOOD, made in Python."""
    ball = pr.Model(pr.procedural("sphere", 2000), surface="imls", samples=5, refine=0, trim=None, radius_scale=1.2)
    points = pr.read(folder / "scan.ply")
    scan = pr.Model(points, points.attributes["radius"])
    glass = pr.Dielectric(ior=1.4)
    scene = pr.Scene()
    scene.background = (0.1, 0.2, 0.3)
    transform = pr.transform(scale=(1, 2, -1), rotate=30, axis=(0, 1, 0), translate=(1, 0, 0))
    scene.add(ball, transform, pr.Principled(base_color=(1.0, 0.77, 0.34), roughness=0.3, metallic=1))
    scene.add(scan, [[1, 0, 0, -1], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]])
    for matrix in many():
        scene.add(scan, matrix, glass)
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1), color=0.4, checker=0.5))
    scene.add_light(pr.SunLight((1, 1, -2), (3, 3, 2), angle=1))
    scene.add_light(pr.PointLight((0, -4, 4), 20))
    scene.add_light(pr.RectLight((0, 0, 5), u=(0, 1, 0), v=(1, 0, 0), radiance=2))
    scene.add_light(pr.DiskLight((-3, 0, 5), (0, 0, -1), radius=0.5, radiance=3))
    scene.add_light(pr.SphereLight((3, 0, 5), radius=0.5, radiance=3))
    scene.add_light(pr.EnvironmentLight(image=sky(), radiance=0.5))
    scene.clips = [((0, 0, 0.7), (0.1, 0, 2)), ((-9, 0, 0), (-1, 0, 0))]
    camera = pr.Camera.look_at((0, -6, 2), (0, 0, 0), fov=50, size=(32, 24), aperture=0.1, focus=5)
    return scene, camera, pr.Settings("path", spp=3, max_depth=None, seed=7, filter="tent")


# ---------------------------------------------------------------------------------------------- what it describes


def test_a_transform_scales_rotates_and_translates() -> None:
    matrix = pr.transform(translate=(1, 2, 3), rotate=90, scale=(2, 3, -1))
    assert np.allclose(matrix @ (1, 0, 0, 1), (1, 4, 3, 1))  # x is rotated to y
    assert np.allclose(matrix @ (0, 1, 0, 1), (-2, 2, 3, 1))
    assert np.allclose(matrix @ (0, 0, 1, 1), (1, 2, 2, 1))
    assert np.allclose(pr.transform(rotate=120, axis=(1, 1, 1))[:3, :3], [[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    assert (pr.transform() == np.eye(4)).all()


@pytest.mark.parametrize(
    "wrong",
    [{"translate": 1}, {"rotate": np.nan}, {"rotate": "left"}, {"axis": (0, 0, 0)}, {"scale": 0}, {"scale": (1, 0, 1)}],
)
def test_a_transform_checks_its_keys(wrong: dict) -> None:
    with pytest.raises(ValueError, match=f"^{next(iter(wrong))} must"):
        pr.transform(**wrong)


def test_a_scene_file_gives_the_scene_of_python(folder: Path) -> None:
    scene, camera, settings = in_python(folder)
    made = pr.load_scene(folder / "scene.toml")
    assert made.camera == camera and made.settings == settings
    assert (made.exposure, made.curve) == (0.5, "srgb")
    assert np.array_equal(made.scene.bounds, scene.bounds) and np.array_equal(made.scene.clips, scene.clips)
    image = pr.render(made.scene, made.camera, made.settings)
    assert np.array_equal(image, pr.render(scene, camera, settings))
    assert image[..., :3].std() > 0.05
    origins, directions = camera.rays()
    assert np.array_equal(
        made.scene.intersect(origins, directions).instance, scene.intersect(origins, directions).instance
    )


def test_colour_by_an_attribute(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (
        '[models.ball]\nprocedural = "sphere"\npoints = 2000\n[materials.high]\nkind = "diffuse"\n'
        'color = { name = "z", colormap = "magma", range = [-1, 1] }\n[[instances]]\nmodel = "ball"\n'
        'material = "high"\n[camera]\nsize = [24, 24]\n[settings]\nintegrator = "color"\n'
    )
    (folder / "high.toml").write_text(text)
    made = pr.load_scene(folder / "high.toml")
    scene = pr.Scene()
    scene.add(pr.Model(pr.procedural("sphere", 2000)), material=pr.Diffuse(pr.Attribute("z", "magma", (-1, 1))))
    assert np.array_equal(pr.render(*made[:3]), pr.render(scene, made.camera, made.settings))
    (folder / "high.toml").write_text(text.replace("magma", "magmar"))
    assert execute(["render", str(folder / "high.toml"), "-o", str(folder / "out.png")]) == 2
    assert re.search(r"high.toml:6: materials.high.color.colormap: .*magma", capsys.readouterr().err)


def test_every_light_and_material_has_a_kind() -> None:
    assert sorted(shading.LIGHTS) == ["disk", "environment", "point", "rect", "sphere", "sun"]
    assert {"diffuse", "phong", "mirror", "dielectric", "principled", "emissive"} <= set(shading.material_kinds())


def test_a_camera_may_frame_the_scene(folder: Path) -> None:
    text = re.sub(r"eye = .*\ntarget = .*\n", "direction = [0, -1, 0]\n", GOOD)
    (folder / "scene.toml").write_text(text)
    made = pr.load_scene(folder / "scene.toml")
    framed = pr.Camera.frame(made.scene.bounds, (0, -1, 0), fov=50, size=(32, 24))
    assert made.camera.eye == framed.eye and made.camera.aperture == 0.1


def test_a_scene_file_gives_the_picture_of_its_program(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = folder / "a.png"
    assert execute(["render", str(folder / "scene.toml"), "-o", str(picture)]) == 0
    assert capsys.readouterr().out == f"{picture}: 32x24\n"
    pr.write_image(folder / "b.png", pr.render(*in_python(folder)), exposure=0.5)
    assert picture.read_bytes() == (folder / "b.png").read_bytes()


def test_options_override_the_file(folder: Path) -> None:
    picture = folder / "a.png"
    view = ["--eye", "0,-9,0", "--target", "0,0,1", "--fov", "30", "--size", "20x10"]
    options = ["--integrator", "normal", "--spp", "1", "--exposure", "0", "--background", "none", "--threads", "1"]
    assert execute(["render", str(folder / "scene.toml"), "-o", str(picture), *view, *options]) == 0
    scene = in_python(folder)[0]
    scene.background = None
    camera = pr.Camera.look_at((0, -9, 0), (0, 0, 1), fov=30, size=(20, 10), aperture=0.1, focus=5)
    settings = pr.Settings("normal", max_depth=None, seed=7, filter="tent")
    pr.write_image(folder / "b.png", pr.render(scene, camera, settings))
    assert picture.read_bytes() == (folder / "b.png").read_bytes()


def test_a_scene_file_gives_layers(folder: Path) -> None:
    options = ["--size", "8x6", "--spp", "1"]
    assert execute(["render", str(folder / "scene.toml"), "-o", str(folder / "a.npz"), *options]) == 0
    layers = np.load(folder / "a.npz")
    assert layers["radiance"].shape == (6, 8, 4) and layers["instance"].max() >= 4


def test_a_saved_model_is_loaded(folder: Path) -> None:
    pr.Model(pr.procedural("sphere", 500)).save(folder / "ball.pointray")
    (folder / "scene.toml").write_text('[models.a]\nfile = "ball.pointray"\n[[instances]]\nmodel = "a"\n')
    picture = folder / "a.png"
    assert execute(["render", str(folder / "scene.toml"), "-o", str(picture), "--size", "16x12"]) == 0
    assert np.asarray(Image.open(picture))[6, 8, 3] == 255


@pytest.mark.parametrize("saved", [False, True])
def test_levels_of_detail_are_used(folder: Path, saved: bool) -> None:
    table = 'procedural = "sphere"\npoints = 8_000\n'
    if saved:
        pr.Model(pr.procedural("sphere", 8000)).save(folder / "ball.pointray")
        table = 'file = "ball.pointray"\n'
    for levels in (True, False):
        text = f'[models.a]\n{table}levels = {str(levels).lower()}\n[[instances]]\nmodel = "a"\n'
        (folder / "scene.toml").write_text(text)
        (model,) = pr.load_scene(folder / "scene.toml").scene.snapshot().models
        assert (len(model.levels) > 0) == levels


# -------------------------------------------------------------------------------------------------- what is wrong


def refusal(folder: Path, text: str, capsys: pytest.CaptureFixture[str], *options: str) -> str:
    """Return the one-line error about an invalid scene file, without the folder's name."""
    (folder / "scene.toml").write_text(text)
    capsys.readouterr()
    assert execute(["render", str(folder / "scene.toml"), "-o", str(folder / "a.png"), *options]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and not (folder / "a.png").exists()
    return err.removeprefix("pointray: ").replace(f"{folder}/", "").strip()


def line(text: str, start: str) -> int:
    """Return the number of the line that starts with a text."""
    return next(k for k, row in enumerate(text.split("\n"), 1) if row.startswith(start))


# The text, its replacement, the key that the message names, and the message. The line is that of the replacement.
WRONG = {
    "unknown key": ("fov = 50", "fow = 50", "camera.fow", "unknown key 'fow' (did you mean 'fov'?); available: eye, "),
    "unknown table": ("[settings]", "[seting]", "seting", "unknown key 'seting' (did you mean 'settings'?)"),
    "unknown kind": ('kind = "sun"', 'kind = "son"', "lights[0].kind", "unknown kind 'son' (did you mean 'sun'?)"),
    "levels": ("points = 2000", "levels = 3\npoints = 2000", "models.ball.levels", "must be true or false, not 3"),
    "no kind": ('kind = "point"', "", "lights[1]", "kind is missing"),
    "word of another kind": ("ior = 1.4", "color = 1", "materials.glass.color", "unknown key 'color'; available: kind"),
    "missing": ("direction = [1, 1, -2]", "", "lights[0]", "direction is missing"),
    "no model": ('model = "ball"', 'model = "bell"', "instances[0].model", "unknown model 'bell' (did you mean 'ball'"),
    "no material": ('material = "glass"', 'material = "x"', "instances[2].material", "available: gold, glass"),
    "type": ("angle = 1", 'angle = "wide"', "lights[0].angle", "must be a number, not 'wide'"),
    "true as number": ("radius = 0.5", "radius = true", "lights[3].radius", "must be a number, not True"),
    "text in a list": ("u = [0, 1, 0]", 'u = [0, "1", 0]', "lights[2].u", "must be a number or a list of numbers"),
    "whole": ("spp = 3", "spp = 3.5", "settings.spp", "must be a whole number, not 3.5"),
    "range": ("spp = 3", "spp = 0", "settings.spp", "must be a whole number from 1 to 65536"),
    "nan": ("target = [0, 0, 0]", "target = [0, nan, 0]", "camera.target", "must not be NaN"),
    "nan alone": ("exposure = 0.5", "exposure = nan", "exposure", "must not be NaN"),
    "inf": ("intensity = 20", "intensity = inf", "lights[1].intensity", "must be finite and not negative, not inf"),
    "huge": ("radiance = 2", "radiance = 1e300", "lights[2].radiance", "must not be larger than 1e+18"),
    "huge whole": ("checker = 0.5", f"checker = 1{'0' * 400}", "planes[0].checker", "must not be larger than 1e+18"),
    "negative light": ("radiance = 2", "radiance = -2", "lights[2].radiance", "must be finite and not negative"),
    "light of no size": ("radius = 0.5", "radius = 0", "lights[3].radius", "must be a positive length, not 0"),
    "light of no area": ("u = [0, 1, 0]", "u = [2, 0, 0]", "lights[2].u", "and v must not be parallel"),
    "singular": ("    [0, 0, 1, 0.5],", "    [0, 1, 0, 0.5],", "instances[1].transform", "is singular"),
    "scaled to nothing": ("scale = [1, 2, -1]", "scale = [1, 0, 1]", "instances[0].scale", "must not be zero"),
    "two places": (
        'transforms = "many.npy"',
        'transforms = "many.npy"\nrotate = 3',
        "instances[2].rotate",
        "transforms",
    ),
    "no file": ('file = "scan.ply"', 'file = "scam.ply"', "models.scan.file", "scam.ply: No such file or directory"),
    "unreadable": ('file = "scan.ply"', 'file = "sky.exr"', "models.scan.file", "sky.exr: unsupported file type .exr"),
    "no picture": ('image = "sky.exr"', 'image = "x.exr"', "lights[5].image", "x.exr: No such file or directory"),
    "no transforms": ('"many.npy"', '"scan.ply"', "instances[2].transforms", "scan.ply: not a valid .npy file"),
    "procedural": (
        'procedural = "sphere"',
        'procedural = "cube"',
        "models.ball.procedural",
        "unknown procedural model",
    ),
    "points": ("points = 2000", "points = 0", "models.ball.points", "must be between 1 and 100000000, not 0"),
    "surface": ('surface = "imls"', 'surface = "mesh"', "models.ball.surface", "unknown surface 'mesh'"),
    "color": ("base_color = [1.0,", "base_color = [1.5,", "materials.gold.base_color", "must be a reflectance from 0"),
    "camera": ("eye = [0, -6, 2]", "eye = [0, 0, 0]", "camera.eye", "and target are the same point"),
    "no target": ("target = [0, 0, 0]", "", "camera", "target is missing"),
    "background": ("background = [0.1, 0.2, 0.3]", 'background = "blue"', "background", "must be a number or three"),
    "list": ("[[planes]]", "[planes]", "planes", "must be a list of tables"),
    "clip": ("normal = [-1, 0, 0]", "normal = [0, 0, 0]", "clips[1].normal", "must not be zero"),
    "short clip": ("point = [-9, 0, 0]", "point = [-9, 0]", "clips[1].point", "must be three finite numbers, not [-9"),
    "no normal": ("normal = [-1, 0, 0]", "", "clips[1]", "normal is missing"),
    "word of a clip": (
        "normal = [-1, 0, 0]",
        "offset = 1",
        "clips[1].offset",
        "unknown key 'offset'; available: point",
    ),
    "clips": (
        "[camera]",
        "[[clips]]\nnormal = [0, 0, 1]\npoint = [0, 0, 9]\n" * 15 + "[camera]",
        "clips[16]",
        "at most 16",
    ),
    "two skies": ('kind = "sphere"\ncenter = [3, 0, 5]\nradius = 0.5', 'kind = "environment"', "lights[5]", "only one"),
}


@pytest.mark.parametrize("case", WRONG)
def test_errors_are_found_before_a_scan_is_read(case: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The scan is broken, so these errors must be reported before it is read."""
    (folder / "scan.ply").write_text("broken")
    old, new, key, message = WRONG[case]
    assert old in GOOD
    text = GOOD.replace(old, new, 1)
    start = GOOD[: GOOD.index(old)].count("\n") + 1
    found = refusal(folder, text, capsys)
    location, rest = found.split(": ", 1)
    assert rest.startswith(f"{key}: ") and message in rest, found
    where = int(location.removeprefix("scene.toml:"))
    if case == "two skies":
        start = text.split("\n").index('image = "sky.exr"') - 1
    elif case == "singular":
        start = line(text, "transform = [")
    elif case == "two places":
        start += 1
    elif case == "clips":  # the seventeenth
        start += 3 * 14
    elif case in ("no kind", "missing", "no target", "no normal"):  # the line of the table
        start -= {"no kind": 1, "missing": 2, "no target": 2, "no normal": 2}[case]
    assert where == start, found


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = = 1", "scene.toml:1: not valid TOML: Invalid value"),
        ("\n[camera]\nfov = 3\nfov = 4\n", "scene.toml:4: not valid TOML: Cannot overwrite a value"),
        ("a = '''", "scene.toml: not valid TOML"),
        ("a = " + "[" * 20000, "scene.toml: not valid TOML"),
        ("", "scene.toml: camera: eye and target are missing, and there are no instances for an automatic camera"),
        ("[models.a]\n", "scene.toml:1: models.a: file or procedural is missing"),
        ("models = 3\n", "scene.toml:1: models: must be a table, not 3"),
        ("[models]\na = 3\n", "scene.toml:2: models.a: must be a table, not 3"),
        ("lights = [{kind = 1}]\n", "scene.toml:1: lights[0].kind: unknown kind 1; available: point, sun"),
        (
            '[models.a]\nfile = "b.pointray"\nsamples = 3',
            "scene.toml:3: models.a.samples: cannot be set for a saved model",
        ),
    ],
)
def test_other_files_are_refused(text: str, message: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert refusal(folder, text, capsys).startswith(message)


@pytest.mark.parametrize("damage", ["cut", "nan"])
def test_a_broken_sky_picture_is_reported(damage: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = folder / "sky.exr"
    if damage == "cut":
        file.write_bytes(file.read_bytes()[:-200])
    else:
        pixels = sky()
        pixels[3, 2] = np.nan
        pr.write_image(file, pixels)
    (folder / "scan.ply").write_text("broken")
    found = refusal(folder, GOOD, capsys)
    assert found.startswith(f"scene.toml:{line(GOOD, 'image = ')}: lights[5].image: sky.exr: "), found
    assert damage == "cut" or "row 3, column 2 has nan" in found


def test_broken_transforms_are_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    start = f"scene.toml:{line(GOOD, 'transforms = ')}: instances[2].transforms"
    flat = many()
    flat[1, 2, 2] = 0
    np.save(folder / "many.npy", flat)
    assert refusal(folder, GOOD, capsys).startswith(f"{start}.row 1: transform is singular")
    np.save(folder / "many.npy", flat[0])
    assert refusal(folder, GOOD, capsys).startswith(
        f"{start}: many.npy: expected transforms of shape (n, 4, 4), got (4, 4)"
    )
    np.save(folder / "many.npy", np.array([{}, 1], object), allow_pickle=True)
    assert refusal(folder, GOOD, capsys).startswith(f"{start}: many.npy: not a valid .npy file of numbers")


def test_a_broken_scan_is_reported(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "scan.ply").write_text("broken")
    assert refusal(folder, GOOD, capsys).startswith(f"scene.toml:{line(GOOD, 'file = ')}: models.scan.file: scan.ply: ")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--surface", "imls"], "--surface is not for a scene file, which defines it itself"),
        (["--radius-scale", "2"], "--radius-scale is not for a scene file"),
        (["--light", "sun:0,0,-1"], "--light is not for a scene file"),
        (["--ground"], "--ground is not for a scene file"),
        (["--spp", "0"], "spp must be a whole number from 1"),
        (["--eye", "0,0,0"], "eye and target are the same point"),
        (["--size", "640"], "--size must be like 640x480"),
        (["--background", "blue"], "--background must be three numbers"),
        (["--noise", "nan"], "noise must be a positive number"),
    ],
)
def test_options_are_checked_first(
    options: list[str], message: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "scan.ply").write_text("broken")
    assert refusal(folder, GOOD, capsys, *options).startswith(message)


def test_a_missing_scene_file_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["render", str(tmp_path / "x.toml"), "-o", str(tmp_path / "a.png")]) == 2
    assert capsys.readouterr().err == f"pointray: {tmp_path / 'x.toml'}: No such file or directory\n"
    with pytest.raises(FileNotFoundError):
        pr.load_scene(tmp_path / "x.toml")


def test_the_example_of_the_documentation_works(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The example of docs/scenes.md works, and its mistake gives the message shown there."""
    page = (ROOT / "docs" / "scenes.md").read_text()
    (text,) = re.findall(r"^```toml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    small = text.replace("100_000", "2000").replace('"statue"', '"sphere"')  # its mesh takes less time
    (tmp_path / "scene.toml").write_text(small)
    assert execute(["render", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "a.png"), "--size", "16x12"]) == 0
    (tmp_path / "a.png").unlink()
    wrong = small.replace("direction = [1, 1, -1.5]", "direction = [0, 0, 0]")
    message, _, link = refusal(tmp_path, wrong, capsys).partition("; see ")
    assert f"    pointray: {message}\n" in page and "scenes.html" in link


def test_errors_are_reported_in_one_line(tmp_path):
    (tmp_path / "a.toml").write_text('[models.ball]\n"\\n" = 1\nfile = "\\n/a.ply"\n')
    with pytest.raises((ValueError, OSError)) as told:
        pr.load_scene(tmp_path / "a.toml")
    assert "\n" not in str(told.value)
