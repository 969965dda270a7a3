"""Clouds that are hardly a surface, drawn with `scatter`, give a picture or a message that says what to change."""

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long
from pointray.cli import execute

UP = np.array([0.0, 0.0, 1.0])
ONE_PLACE, NOTHING = "no radius can be chosen", "all points are scattered"
ADVICE = {ONE_PLACE: "give radii or an attribute radius", NOTHING: "use spheres"}
CLOUDS = {
    "one": np.array([[1.0, 2, 3]]),
    "two": np.array([[0.0, 0, 0], [1, 0, 0]]),
    "same": np.ones((50, 3)),
    "two places": np.repeat([[0.0, 0, 0], [1, 0, 0]], 20, axis=0),
}
MESSAGES = [  # cloud, whether it has normals, scatter, and the message; empty: there is a picture
    ("one", False, "spheres", ONE_PLACE),
    ("one", False, "discs", ONE_PLACE),
    ("one", True, "spheres", ONE_PLACE),
    ("one", True, "discs", ONE_PLACE),
    ("one", True, "none", NOTHING),
    ("two", False, "spheres", ""),
    ("two", False, "discs", ""),
    ("two", True, "spheres", ""),
    ("two", True, "discs", ""),
    ("two", True, "none", NOTHING),
    ("same", False, "spheres", ONE_PLACE),
    ("same", True, "discs", ONE_PLACE),
    ("two places", False, "spheres", ""),
    ("two places", False, "discs", ""),
    ("two places", True, "discs", ""),
]


def points_of(cloud, has_normals=False, **attributes):
    positions = CLOUDS[cloud]
    normals = np.tile(UP, (len(positions), 1)) if has_normals else None
    return pr.Points(positions, normals, attributes=attributes)


@pytest.fixture(params=MESSAGES, ids=lambda case: "-".join([case[0], "normals" * case[1] or "plain", case[2]]))
def case(request):
    return request.param


def test_a_few_points_in_python_are_drawn_or_refused(case):
    cloud, has_normals, scatter, message = case
    points = points_of(cloud, has_normals)
    if not message:
        model = pr.Model(points, scatter=scatter)
        assert model.scattered.all()
        np.testing.assert_allclose(model.radii, 0.35, rtol=1e-6)
        return
    with pytest.raises(ValueError, match=f"^scatter: {message}.*{ADVICE[message]}"):
        pr.Model(points, scatter=scatter)


def lines_of(capsys, *arguments):
    """Exit status of a command, and the lines that it prints as errors."""
    capsys.readouterr()
    status = execute([str(a) for a in arguments])
    lines = capsys.readouterr().err.splitlines()
    return status, [line for line in lines if not line.startswith("Compiling")]


def test_a_few_points_on_the_command_line_are_drawn_or_refused(case, tmp_path, capsys):
    cloud, has_normals, scatter, message = case
    pr.write(tmp_path / "scan.ply", points_of(cloud, has_normals))
    picture = ["-o", tmp_path / "a.png", "--size", "16x12", "--light", "headlight", "--scatter", scatter]
    status, lines = lines_of(capsys, "render", tmp_path / "scan.ply", *picture)
    assert status == (2 if message else 0)
    if message:
        (line,) = lines
        assert f"scan.ply: --scatter: {message}" in line and ADVICE[message] in line
        assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize("scatter", ["spheres", "discs"])
@pytest.mark.parametrize("cloud", ["one", "same"])
def test_points_at_one_place_with_radii(cloud, scatter, tmp_path, capsys):
    """The advice of the message works."""
    points = points_of(cloud, True, radius=np.full(len(CLOUDS[cloud]), 0.5, np.float32))
    pr.write(tmp_path / "scan.ply", points)
    picture = ["-o", tmp_path / "a.png", "--size", "16x12", "--light", "headlight", "--scatter", scatter]
    assert lines_of(capsys, "render", tmp_path / "scan.ply", *picture)[0] == 0
    scene = pr.Scene()
    scene.add(pr.Model(points, points.attributes["radius"], scatter=scatter))
    at = CLOUDS[cloud][0]
    assert scene.intersect(at + 3 * UP, -UP).t == pytest.approx(2.5 if scatter == "spheres" else 3.0)


def scene_file(folder, cloud, more):
    pr.write(folder / "scan.ply", points_of(cloud))
    path = folder / "scene.toml"
    path.write_text(f'[models.a]\nfile = "scan.ply"\n{more}\n[[instances]]\nmodel = "a"\n')
    return path


@pytest.mark.parametrize(
    ("cloud", "more", "message"),
    [
        ("one", 'scatter = "spheres"', f"scene.toml:1: models.a: scatter: {ONE_PLACE}"),
        ("same", 'scatter = "discs"', f"scene.toml:1: models.a: scatter: {ONE_PLACE}"),
        ("two", 'scatter = "none"', f"scene.toml:1: models.a: scatter: {NOTHING}"),
        ("two", 'scatter = "balls"', "scene.toml:3: models.a.scatter: unknown scatter 'balls'"),
        *(
            ("two", f"scatter_size = {value}", "scene.toml:3: models.a.scatter_size: must ")
            for value in ("-1.0", "0", "nan", "inf", '"large"', "true", "[1.0]")
        ),
        ("two", 'scatter = "spheres"\nscatter_size = 1e17', "scene.toml:1: models.a: radii range from 3.5e+16"),
    ],
)
def test_extremes_in_scene_files_are_refused(tmp_path, capsys, cloud, more, message):
    path = scene_file(tmp_path, cloud, more)
    status, (line,) = lines_of(capsys, "render", path, "-o", tmp_path / "a.png", "--size", "16x12")
    assert status == 2 and message in line


@pytest.mark.parametrize("command", ["render", "animate", "view", "bake"])
@pytest.mark.parametrize("value", ["-1", "0", "nan", "inf", "-inf", "large", ""])
def test_sizes_on_the_command_line(tmp_path, capsys, monkeypatch, command, value):
    """They are refused before the scan is read."""
    monkeypatch.setattr("pointray.cli.serve.serve", lambda *shown: None)
    pr.write(tmp_path / "scan.ply", points_of("two"))
    result = {"render": "a.png", "animate": "a", "bake": "a.bake"}.get(command)
    output = [] if result is None else ["-o", tmp_path / result]
    size = f"--scatter-size={value}"
    status, (line,) = lines_of(capsys, command, tmp_path / "scan.ply", *output, "--scatter", "spheres", size)
    assert status == 2 and "--scatter-size" in line


@pytest.mark.parametrize(("value", "size"), [("1e30", "3.5e[+]29"), ("1e-30", "3.5e-31")])
def test_sizes_that_make_useless_radii(tmp_path, capsys, value, size):
    pr.write(tmp_path / "scan.ply", points_of("two"))
    options = ["--scatter", "spheres", "--scatter-size", value]
    status, (line,) = lines_of(capsys, "render", tmp_path / "scan.ply", "-o", tmp_path / "a.png", *options)
    assert status == 2 and "with scatter_size" in line
    with pytest.raises(ValueError, match=f"from {size} .* with scatter_size"):
        pr.Model(points_of("two"), scatter="spheres", scatter_size=float(value))


# ------------------------------------------------------------------------------------------------ what is no surface


def scene_of(model):
    scene = pr.Scene()
    scene.add(model)
    return scene


def test_noise_becomes_spheres_of_about_one_size(rng):
    """No sphere is a balloon, and rays at the points meet one of them or its neighbours."""
    x = rng.random((5000, 3))
    model = pr.Model(x, scatter="spheres")
    assert model.scattered.mean() > 0.97
    radii = model.radii[model.scattered]
    spacing = (1 / 5000) ** (1 / 3)
    assert 0.25 * spacing < np.median(radii) < 0.6 * spacing and radii.max() < 2 * np.median(radii)
    some = np.flatnonzero(model.scattered)
    hits = scene_of(model).intersect(x[some] + 5 * UP, -UP)
    assert np.isfinite(hits.t).all() and (hits.t <= 5 - 0.99 * radii).all()


def test_two_points_are_two_spheres():
    model = pr.Model(CLOUDS["two"], scatter="spheres")
    scene = scene_of(model)
    hits = scene.intersect(CLOUDS["two"] + 3 * UP, -UP)
    np.testing.assert_allclose(hits.t, 3 - 0.35, rtol=1e-6)
    assert hits.point.tolist() == [0, 1]
    assert not scene.occluded([[0.5, 0, 3], [0.36, 0, 3]], -UP).any() and scene.occluded([0.34, 0, 3], -UP)


def test_a_line_is_a_thin_string_without_gaps(rng):
    along = np.array([1.0, 2, -1])
    scene = scene_of(model := pr.Model(np.linspace(0, 1, 500)[:, None] * along, scatter="spheres"))
    step = np.linalg.norm(along) / 499
    assert model.scattered.all() and 0.5 * step < model.radii.min() and model.radii.max() < step
    across = np.cross(along, UP) / np.linalg.norm(np.cross(along, UP))
    ends = rng.random((500, 1)) * along
    assert scene.occluded(ends - across, across).all()
    aside = np.cross(along, across) / np.linalg.norm(np.cross(along, across))
    assert not scene.occluded(ends - across + 1.1 * step * aside, across).any()


def test_a_helix_stays_open(rng):
    """Its turns are not joined to a tube."""
    turn = np.linspace(0, 60, 2000)
    helix = np.column_stack([np.cos(turn), np.sin(turn), 0.3 * turn])
    scene = scene_of(model := pr.Model(helix, scatter="spheres"))
    assert model.scattered.all()
    outwards = helix * [1, 1, 0]
    assert scene.occluded(helix + 3 * outwards, -outwards, 0, 3.5).all()
    between = helix[200:-200] + [0, 0, 0.15 * 2 * np.pi]  # half a turn's height above
    assert not scene.occluded(between + 3 * outwards[200:-200], -outwards[200:-200], 0, 3.5).any()
    assert not scene.occluded(rng.uniform(-0.6, 0.6, (100, 3)) - 5 * UP, UP).any()


@pytest.mark.parametrize("displaced", ["column", "checker"])
def test_a_plane_of_which_every_second_point_is_displaced_is_closed(rng, displaced):
    x, y = (a.ravel() for a in np.meshgrid(np.arange(60.0), np.arange(60.0)))
    height = x % 2 if displaced == "column" else (x + y) % 2
    model = pr.Model(np.column_stack([x, y, height]), scatter="spheres")
    assert model.scattered.mean() <= 0.01
    origins = np.column_stack([rng.uniform(2, 57, (4000, 2)), np.full(4000, 9.0)])
    hits = scene_of(model).intersect(origins, -UP)
    assert np.isfinite(hits.t).mean() > 0.999 and (np.abs(hits.t - 8.5) < 1.0).mean() > 0.999


def test_points_with_radii_stay_a_surface_unless_asked(rng):
    x, radii = rng.random((2000, 3)), rng.uniform(0.02, 0.1, 2000).astype(np.float32)
    points = pr.Points(x, np.tile(UP, (2000, 1)))
    plain = pr.Model(points, radii)
    assert not plain.scattered.any()
    np.testing.assert_array_equal(plain.radii, radii)
    asked = pr.Model(points, radii, scatter="spheres", scatter_size=0.5)
    assert asked.scattered.mean() > 0.97
    np.testing.assert_allclose(asked.radii[asked.scattered], radii[asked.scattered] / 2, rtol=1e-6)


@pytest.mark.parametrize("count", [20_000, long(1_000_000)])
def test_coincident_points_beside_a_surface(rng, count):
    """The copies are one sphere, and the surface beside them is as without them."""
    ground = np.column_stack([rng.random((4000, 2)) * 64, np.zeros(4000)])
    x = np.concatenate([np.tile([32.0, 32, 20], (count, 1)), ground])
    model = pr.Model(x, scatter="spheres")
    assert model.scattered[:count].all() and model.scattered[count:].mean() <= 0.002
    assert np.ptp(model.radii[:count]) == 0 and model.radii[0] < 4
    scene = scene_of(model)
    hits = scene.intersect([[32.0, 32, 50], [32, 32, -50]], [-UP, UP])
    np.testing.assert_allclose(hits.t, [30 - model.radii[0], 50], atol=0.01)
    plain = scene_of(pr.Model(ground, scatter="spheres"))
    origins = np.column_stack([rng.uniform(2, 62, (500, 2)), np.full(500, 5.0)])
    np.testing.assert_allclose(scene.intersect(origins, -UP).t, plain.intersect(origins, -UP).t, atol=1e-3)
