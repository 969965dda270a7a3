"""`write_splats`: what other viewers show of a model, compared with its own picture."""

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from bench.helpers.gaussians import rasterize, read_gaussians
from bench.looks.splats import compare
from helpers.clouds import sphere_points
from helpers.marks import long
from helpers.prepared_parts import prepared
from pointray.auto_view.splats import write_model
from pointray.io.formats.splats._flat import BALL, WIDTH
from pointray.io.formats.splats._own_shapes import THICKNESS
from pointray.model.splat_points import splat_points
from pointray.surface.splats.scattered.spheres import Drawing

STUDIO_SIDES = 3  # brightest to darkest side of a white sphere in the studio, at least


def ball(n=2000, **fields):
    return pr.Points(rows := sphere_points(n), rows, **fields)


def with_leaves(rng, drawing):
    """A model of a sphere, and of scattered points beside it."""
    surface, loose = sphere_points(1500), rng.uniform(-1, 1, (500, 3)) + [4, 0, 0]
    mask = np.arange(2000) >= 1500
    normals = np.concatenate([surface, np.broadcast_to([0.0, 0, 1], loose.shape)])
    return pr.Model(pr.Points(np.concatenate([surface, loose]), normals), scatter=drawing, _scattered=mask), mask


# ------------------------------------------------------------------------------------------------------ pictures


def picture(model, size):
    scene = pr.Scene()
    scene.add(model, material=pr.Diffuse())
    camera = pr.frame(model, size=size)
    image = pr.render(scene, camera, pr.Settings("color", spp=16)).astype(np.float64)
    return (np.ones((*image.shape[:2], 3)) * image[..., 3:], image[..., 3]), camera


@pytest.mark.parametrize(("n", "size", "beside"), [(800, (64, 48), 0.13), long(20_000, (400, 300), 0.012)])
def test_splats_cover_what_the_model_covers(tmp_path, n, size, beside):
    """Splats of other widths either leave gaps or cover more."""
    model = pr.Model(pr.procedural("torus", n).changed(colors=np.full((n, 3), 255, np.uint8)))
    own, camera = picture(model, size)
    pr.write_splats(tmp_path / "a.ply", model)
    splats = read_gaussians(tmp_path / "a.ply")
    found = compare(rasterize(splats, camera, 0.01), own)
    assert found.excess + found.lack < beside and found.open < 0.002 and found.color < 1
    narrow, wide = (compare(rasterize(splats.widened(f), camera, 0.01), own) for f in (0.7, 1.5))
    assert narrow.open > 10 * found.open and wide.excess > 1.5 * found.excess


@pytest.mark.parametrize(("n", "size"), [(500, (40, 30)), long(2000, (160, 120))])
def test_lit_splats_have_the_colors_of_the_picture(tmp_path, n, size):
    """Each splat in front has the colour that a picture with automatic exposure shows there."""
    model = pr.Model(ball(n, colors=np.full((n, 3), 200, np.uint8)))
    pr.write_splats(tmp_path / "a.ply", model, light="studio")
    splats = pr.read(tmp_path / "a.ply")
    brightness = splats.colors.mean(axis=1)
    assert brightness.max() > STUDIO_SIDES * brightness.min() > 0
    camera = pr.frame(model, size=size)
    x, y, _ = np.subtract(camera.eye, camera.target)
    scene = pr.Scene()
    scene.add(model, material=pr.Diffuse())
    scene.lights = pr.studio(azimuth=float(np.round(np.degrees(np.arctan2(x, -y)))))
    scene.baked = pr.bake(scene)
    image = pr.render(scene, camera, pr.Settings("baked", spp=16))
    pr.write_image(tmp_path / "a.png", image, "auto", "auto")
    shown = np.asarray(Image.open(tmp_path / "a.png"))[..., :3].astype(float)
    origins, directions = camera.rays()
    hits = scene.intersect(origins, directions)
    facing = np.isfinite(hits.t) & ((hits.normal * directions).sum(axis=-1) < -0.5)
    rows = np.array([np.argmin(((splats.world - at) ** 2).sum(axis=1)) for at in hits.position[facing]])
    apart = np.abs(splats.colors[rows] - shown[facing])
    assert np.median(apart) < 6 and apart.mean() < 12
    assert np.corrcoef(splats.colors[rows, 0], shown[facing][:, 0])[0, 1] > 0.93


def test_lights_can_be_given(tmp_path):
    model = pr.Model(ball(500))
    for name, z in (("a", -1), ("b", 1)):
        pr.write_splats(tmp_path / f"{name}.splat", model, light=[pr.SunLight((0, 0, z))])
    above, below = (pr.read(tmp_path / f"{name}.splat") for name in "ab")
    top = above.normals[:, 2] > 0.7
    assert above.colors[top].mean() > 100 > 20 > below.colors[top].mean()
    assert above.colors[top][:, 0].mean() > 1.05 * above.colors[top][:, 2].mean()  # clay


# -------------------------------------------------------------------------------------------------------- splats


def test_splats_have_the_places_and_radii_of_the_model(tmp_path, rng):
    rows = sphere_points(800)
    noisy = pr.Points(rows + rng.normal(size=rows.shape) * 0.01, attributes={"quality": np.arange(800)})
    model = pr.Model(noisy)
    with pytest.warns(UserWarning, match=r"a\.ply: cannot store the attribute quality$"):
        pr.write_splats(tmp_path / "a.ply", model)
    splats, (own, kept) = pr.read(tmp_path / "a.ply"), model.splats
    np.testing.assert_array_equal(splats.world, own.world)
    assert np.abs(own.world - noisy.world[kept]).max() > 1e-3  # noise was removed
    assert (splats.normals * own.normals).sum(axis=1).min() > 0.9999
    np.testing.assert_allclose(splats.attributes["scale"].max(axis=1), WIDTH * model.radii[kept], rtol=1e-5)


def test_points_become_a_model_with_their_radii(tmp_path):
    radii = np.linspace(0.1, 0.2, 500)
    points = ball(500, attributes={"radius": radii})
    pr.write_splats(tmp_path / "a.ply", points)
    np.testing.assert_allclose(pr.read(tmp_path / "a.ply").attributes["scale"].max(axis=1), WIDTH * radii, rtol=1e-5)


@pytest.mark.parametrize("light", [None, [pr.SunLight((0, 0, -1))]])
def test_opacity_is_kept(tmp_path, rng, light):
    opacity = rng.uniform(0.1, 0.9, 500)
    points = ball(500, attributes={"opacity": opacity})
    for name, subject in (("a.ply", pr.Model(points)), ("b.ply", points)):
        pr.write_splats(tmp_path / name, subject, light=light)
        stored = pr.read(tmp_path / name, opacity=0).attributes["opacity"]
        np.testing.assert_allclose(stored, opacity, atol=1e-5)


def test_invalid_opacities_are_reported(tmp_path):
    opacity = np.linspace(0.1, 1.2, 500)
    opacity[3] = np.nan
    invalid = int((~(opacity <= 1)).sum())
    message = rf"a\.splat: makes {invalid} points opaque, whose opacity is not between 0 and 1$"
    with pytest.warns(UserWarning, match=message):
        pr.write_splats(tmp_path / "a.splat", pr.Model(ball(500, attributes={"opacity": opacity})))
    stored = pr.read(tmp_path / "a.splat").attributes["opacity"]
    np.testing.assert_allclose(stored, np.where(opacity <= 1, opacity, 1), atol=0.005)
    with pytest.warns(UserWarning, match=r"ignores the attribute opacity: expected one number per point$"):
        pr.write_splats(tmp_path / "a.splat", ball(500, attributes={"opacity": np.ones((500, 2))}))


def test_shapes_replaced_by_a_model_are_reported(tmp_path):
    attributes = {"scale": np.tile([0.3, 0.1, 0.01], (500, 1)), "rotation": np.tile([1, 0, 0, 0], (500, 1))}
    replaced = "writes discs of the model instead of the shapes of the splats that were read"
    more = {"radius": np.full(500, 0.1)}
    given = [ball(500, attributes=attributes), ball(500, attributes=attributes | more)]
    for subject in (pr.Model(given[0]), given[1]):
        with pytest.warns(UserWarning, match="a.ply") as caught:
            pr.write_splats(tmp_path / "a.ply", subject)
        assert [str(one.message).partition("a.ply: ")[2] for one in caught] == [replaced]


@pytest.mark.parametrize("name", ["rotation", "scale"])
def test_other_attributes_of_these_names_are_reported(tmp_path, name):
    points = ball(500, attributes={name: np.arange(500)})
    with pytest.warns(UserWarning, match=f"a.ply: cannot store the attribute {name}$"):
        pr.write_splats(tmp_path / "a.ply", points)


@pytest.mark.parametrize("drawing", ["spheres", "discs"])
def test_scattered_points_become_spheres_or_single_discs(tmp_path, rng, drawing):
    model, mask = with_leaves(rng, drawing)
    pr.write_splats(tmp_path / "a.ply", model)
    scale = np.sort(pr.read(tmp_path / "a.ply").attributes["scale"], axis=1)
    thin = scale[:, 0] / scale[:, 2]
    np.testing.assert_allclose(thin[~mask], THICKNESS, rtol=1e-4)
    np.testing.assert_allclose(thin[mask], 1 if drawing == "spheres" else THICKNESS, rtol=1e-4)
    np.testing.assert_allclose(scale[mask, 2], BALL * model.radii[mask], rtol=1e-4)


def test_points_that_are_not_drawn_are_left_out(tmp_path, rng):
    model, mask = with_leaves(rng, "none")
    assert model.drawing == Drawing("none", 1.0)
    np.testing.assert_allclose(splat_points(model).positions, model.points.positions[~mask], atol=0.02)
    with pytest.warns(UserWarning, match=r"a\.spz: leaves out 500 points without a splat$"):
        pr.write_splats(tmp_path / "a.spz", model)
    assert len(pr.read(tmp_path / "a.spz")) == 1500


@pytest.mark.parametrize(("normals", "n"), [(True, 2000), long(True, 20_000), long(False, 20_000)])
def test_models_in_parts_are_written(tmp_path, monkeypatch, normals, n):
    """All their splats, each once, though parts also hold splats of their neighbours."""
    rows = sphere_points(n)
    pr.write(tmp_path / "a.ply", pr.Points(rows, rows if normals else None))
    model = prepared(tmp_path / "a.ply", tmp_path / "parts", 1 << 12)
    assert len(model.parts) > 1 or n < 1 << 12
    pr.write_splats(tmp_path / "a.splat", model)
    splats = pr.read(tmp_path / "a.splat")
    assert np.linalg.norm(splats.world - model.points.world, axis=1).max() < 0.02
    assert (splats.normals * splats.world).sum(axis=1).min() > 0.97
    np.testing.assert_allclose(splats.attributes["scale"].max(axis=1), WIDTH * model.radii, rtol=1e-5)
    monkeypatch.setattr("pointray.auto_view.splats.bake", None)  # not called
    with pytest.raises(ValueError, match="this needs a model in memory, not one in parts"):
        pr.write_splats(tmp_path / "b.splat", model, light="studio")
    assert not (tmp_path / "b.splat").exists()


# --------------------------------------------------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("path", "light", "error", "message"),
    [
        ("a.las", None, ValueError, r"cannot write \.las; supported: \.ply, \.spz, \.splat"),
        ("a", None, ValueError, "cannot write a file without extension"),
        ("no/a.spz", None, FileNotFoundError, "folder not found"),
        ("a.spz", "moon", ValueError, 'light must be "studio", a sequence of lights, or None'),
        ("a.spz", 3, TypeError, "light must be"),
        ("a.spz", ["studio"], TypeError, "light must be"),
        ("a.spz", [], ValueError, "light must contain at least one light"),
        ("a.spz", pr.studio(), ValueError, "light that moves with the camera cannot be baked"),
    ],
)
def test_errors_come_before_the_work(tmp_path, monkeypatch, path, light, error, message):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pointray.auto_view.splats.Model", None)  # not built
    with pytest.raises(error, match=message):
        pr.write_splats(path, ball(10), light=light)
    assert not list(tmp_path.iterdir())


def test_progress_names_the_stages(tmp_path):
    stages, model = [], pr.Model(ball(500))
    pr.write_splats(tmp_path / "a.spz", model, light=[pr.SunLight((0, 0, -1))], progress=lambda *x: stages.append(x))
    assert list(dict.fromkeys(stage for stage, _ in stages)) == ["baking light", "splats", "writing"]
    assert all(0 <= share <= 1.0001 for _, share in stages) and stages[-1] == ("writing", pytest.approx(1))
    assert write_model(tmp_path / "b.spz", model, None, None) == (500, [])


def test_files_arrays_and_saved_models_are_written(tmp_path):
    points = ball(300)
    pr.write(tmp_path / "a.ply", points)
    pr.Model(points).save(tmp_path / "a.pointray")
    subjects = [points, tmp_path / "a.ply", str(tmp_path / "a.pointray"), points.to_structured()]
    for k, subject in enumerate(subjects):
        pr.write_splats(tmp_path / f"{k}.splat", subject)
    assert len({(tmp_path / f"{k}.splat").read_bytes() for k in range(len(subjects))}) == 1
