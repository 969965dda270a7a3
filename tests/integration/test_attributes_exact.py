"""Attributes keep dtypes and exact values in files, models, pickles, subsets, hits and clicks."""

import copy
import pickle
import re

import numpy as np
import pytest

import pointray as pr
from pointray.cli import execute
from pointray.cloud.georeference import SCAN, Georeference
from pointray.surface.splats.radii import radii_in
from pointray.viewer.pick import _format_value, pick

N = 2000
GEOREFERENCE = Georeference(
    "EPSG:25832", "metre", (0.001,) * 3, (500_000.0, 5_400_000.0, 0.0), ((512_340.0, 5_400_000.5, 3.25),)
)
OTHERS = {"i1": np.int8, "u2": np.uint16, "i2": np.int16, "u4": np.uint32, "i4": np.int32, "u8": np.uint64}


def all_kinds():
    """Return one attribute of each dtype, with values that the next smaller dtype cannot represent."""
    rng, made = np.random.default_rng(8), {}
    for name, dtype in OTHERS.items():
        limits = np.iinfo(dtype)
        made[name] = rng.integers(limits.min, limits.max, N, dtype, endpoint=True)
        made[name][:2] = limits.min, limits.max
    made["gps_time"] = 3e8 + 1e-7 * np.arange(N)
    made["classification"] = np.resize(np.uint8([2, 6, 9, 64, 255]), N)
    made["id"] = 2**53 + 1 + 2 * np.arange(N, dtype=np.int64)
    made["withheld"] = np.arange(N) % 3 == 0
    made["echo"] = rng.integers(0, 256, (N, 3), np.uint8)
    made["reflectance"] = rng.normal(size=N).astype(np.float32)
    made["reflectance"][3] = np.nan
    made[SCAN] = np.arange(N, dtype=np.int32) % 3 - 1
    return made


@pytest.fixture(scope="module")
def points():
    torus = pr.procedural("torus", N)
    world = torus.positions.astype(np.float64) + (512_345.678, 5_400_000.123, 321.5)
    return pr.Points(world, torus.normals, None, all_kinds(), georeference=GEOREFERENCE)


@pytest.fixture(scope="module")
def model(points):
    return pr.Model(points)


def same(found, want, georeference=True):
    """Return whether attributes have the same names, order, dtypes and bits."""
    assert list(found.attributes) == list(want.attributes)
    for name, values in want.attributes.items():
        assert found.attributes[name].dtype == values.dtype, name
        assert found.attributes[name].tobytes() == values.tobytes(), name
    assert not georeference or found.georeference == want.georeference


def test_points_keep_attributes_unchanged(points):
    for name, values in points.attributes.items():
        assert values.dtype.isnative and values.flags["C_CONTIGUOUS"], name
    assert len(np.unique(points.attributes["gps_time"])) == len(np.unique(points.attributes["id"])) == N


def test_pickles_copies_and_selections(rng, points):
    same(pickle.loads(pickle.dumps(points)), points)
    same(copy.deepcopy(points), points)
    same(points.with_normals(None), points)
    same(points.select(np.arange(N)), points)
    rows = rng.permutation(N)[:700]
    some = points.select(rows)
    for name, values in points.attributes.items():
        assert some.attributes[name].dtype == values.dtype
        np.testing.assert_array_equal(some.attributes[name], values[rows])


def test_other_byte_orders_and_floats_are_converted(points):
    swapped = {name: values.astype(values.dtype.newbyteorder(">")) for name, values in points.attributes.items()}
    same(points.changed(attributes=swapped), points)
    narrow = pr.Points(points.positions, attributes={"a": np.float16(points.positions[:, 0])})
    assert narrow.attributes["a"].dtype == np.float32


@pytest.mark.filterwarnings("ignore:.* points belong to scans such as")
def test_normals_radii_and_cleaning_do_not_change_attributes(points, model):
    same(pr.estimate_normals(points), points)
    same(model.points, points)


def test_saved_models_keep_attributes(tmp_path, points, model):
    model.save(tmp_path / "a.pointray")
    same(pr.Model.load(tmp_path / "a.pointray").points, points)
    same(pickle.loads(pickle.dumps(model)).points, points)


def test_levels_in_files_keep_dtypes(tmp_path):
    torus = pr.procedural("torus", 6000)
    kinds = {"classification": np.resize(np.uint8([2, 6]), 6000), "gps_time": 3e8 + 1e-7 * np.arange(6000)}
    model = pr.Model(torus.changed(attributes=kinds, georeference=GEOREFERENCE))
    model.make_levels()
    model.save(tmp_path / "a.pointray")
    loaded = pr.Model.load(tmp_path / "a.pointray")
    assert len(loaded.levels) == len(model.levels) > 0
    for found, want in zip(loaded.levels, model.levels, strict=True):
        same(found.points, want.points)


@pytest.mark.parametrize(
    "georeference",
    [
        b'{"crs": 3}',
        b'{"scale": [1, 1, 0], "offset": [0, 0, 0]}',
        b'{"stations": [[1, 2]]}',
        b'{"stations": 5}',
        b'{"stations": [[1, 2, NaN]]}',
        b'{"planet": "Mars"}',
        b"[1, 2]",
        b"null",
    ],
)
def test_a_damaged_georeference_is_an_error(tmp_path, model, georeference):
    model.save(tmp_path / "a.pointray")
    data = (tmp_path / "a.pointray").read_bytes()
    known = re.search(rb'"survey": (\{.*?\})', data)[1]
    assert len(georeference) <= len(known)
    (tmp_path / "a.pointray").write_bytes(data.replace(known, georeference.ljust(len(known)), 1))
    with pytest.raises(ValueError, match=r"a\.pointray: the model is damaged: invalid georeference"):
        pr.Model.load(tmp_path / "a.pointray")


def test_a_level_with_another_dtype_is_an_error(tmp_path):
    torus = pr.procedural("torus", 6000)
    model = pr.Model(torus.changed(attributes={"kind": np.resize(np.uint8([2, 6]), 6000)}))
    model.make_levels()
    coarse = model.levels[0].points
    coarse.attributes["kind"] = coarse.attributes["kind"].astype(np.int64)
    model.save(tmp_path / "a.pointray")
    with pytest.raises(ValueError, match="different attributes"):
        pr.Model.load(tmp_path / "a.pointray")


def test_ply_keeps_coordinates_and_wide_integers_as_floats(tmp_path, points):
    with pytest.warns(UserWarning) as told:
        pr.write(tmp_path / "a.ply", points)
    output = " ".join(str(warning.message) for warning in told)
    assert all(f"stores {name} as 64-bit floats" in output for name in ("u8", "id")) and "scanner positions" in output
    found = pr.read(tmp_path / "a.ply")
    np.testing.assert_allclose(found.world, points.world, atol=1e-9)
    assert found.crs == points.crs
    columns = dict(points.attributes)
    echo = columns.pop("echo")
    columns |= {f"echo_{k}": echo[:, k] for k in range(3)}
    kept = {"withheld": np.uint8, "u8": np.float64, "id": np.float64}
    assert set(found.attributes) == set(columns)
    for name, values in columns.items():
        assert found.attributes[name].dtype == kept.get(name, values.dtype), name
        np.testing.assert_array_equal(found.attributes[name], values.astype(found.attributes[name].dtype))


@pytest.mark.parametrize("number", [2**53 + 1, -(2**53) - 1, -(2**63)])
def test_ply_reports_rounded_numbers(tmp_path, number):
    few = pr.Points(np.eye(3), attributes={"id": np.array([0, 1, number])})
    with pytest.warns(UserWarning, match="stores id as 64-bit floats"):
        pr.write(tmp_path / "a.ply", few)
    small = pr.Points(np.eye(3), attributes={"id": np.array([0, -(2**31), 2**53])})
    pr.write(tmp_path / "b.ply", small)  # a warning would be an error
    assert pr.read(tmp_path / "b.ply").attributes["id"].astype(np.int64).tolist() == [0, -(2**31), 2**53]


def test_prepared_models_and_subsamples_keep_attributes(tmp_path, points):
    plain = points.changed(attributes={n: v for n, v in points.attributes.items() if n not in ("u8", "id", "echo")})
    pr.write(tmp_path / "a.ply", plain.changed(georeference=Georeference(GEOREFERENCE.crs)))
    assert execute(["prepare", str(tmp_path / "a.ply"), "-o", str(tmp_path / "a.pointray"), "--normals", "file"]) == 0
    prepared = pr.Model.load(tmp_path / "a.pointray").points
    same(prepared, pr.read(tmp_path / "a.ply"))
    few, _ = pr.subsample(points, count=300)
    assert few.georeference == GEOREFERENCE
    for name, values in few.attributes.items():
        assert values.dtype == points.attributes[name].dtype and values.shape[1:] == points.attributes[name].shape[1:]
    assert np.isin(few.attributes["classification"], points.attributes["classification"]).all()


# ------------------------------------------------------------------------------------------------------- at hits


@pytest.fixture(scope="module")
def seen(model):
    scene = pr.Scene()
    scene.add(model)
    camera = pr.Camera.frame(model.bounds, size=(24, 24))
    hits = scene.intersect(*camera.rays(), attributes=list(model.points.attributes))
    return scene, camera, hits, hits.instance >= 0


def test_hits_have_exact_categories_and_blend_other_attributes(seen, points):
    _, _, hits, hit = seen
    narrow = {"i1", "u2", "i2", "echo", "reflectance"}
    for name, values in points.attributes.items():
        found = hits.attributes[name]
        if name in ("classification", "withheld", SCAN):
            assert found.dtype == values.dtype, name
            np.testing.assert_array_equal(found[hit], values[hits.point[hit]])
            assert not found[~hit].any()
        else:
            assert found.dtype == (np.float32 if name in narrow else np.float64), name
            assert np.isnan(found[~hit]).all()


def test_gps_times_are_blended_in_float64(seen, points):
    _, _, hits, hit = seen
    found, own = hits.attributes["gps_time"][hit], points.attributes["gps_time"]
    assert ((found >= own[0]) & (found <= own[-1])).all() and len(np.unique(found)) > 10
    assert (np.abs(found - own[hits.point[hit]]) > 1e-8).mean() > 0.5


def test_a_click_shows_all_attributes(seen, points):
    scene, camera, hits, hit = seen
    y, x = np.argwhere(hit)[hit.sum() // 2]
    lines = pick(scene, camera, (x + 0.5) / 24, (y + 0.5) / 24).lines
    row = int(hits.point[y, x])
    output = dict(line.split(" ", 1) for line in lines)
    assert output["point"] == f"{row:,}"
    for name, values in points.attributes.items():
        value = values[row]
        if name == "classification":
            known = {2: "2 ground", 6: "6 building", 9: "9 water"}
            assert output[name] == known.get(int(value), str(value))
        elif name == "withheld":
            assert output[name] == ("yes" if value else "no")
        else:
            told = np.array([values.dtype.type(text) for text in output[name].split()], values.dtype)
            np.testing.assert_array_equal(told, np.atleast_1d(value))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.float32(0.1), "0.1"),
        (np.float64(300_000_000.1234567), "300000000.1234567"),
        (np.float64(3e8), "300000000"),
        (np.float64(1e300), "1e+300"),
        (np.float32(np.nan), "nan"),
        (np.float64(-np.inf), "-inf"),
        (np.uint64(2**64 - 1), "18446744073709551615"),
        (np.int64(-(2**53) - 1), "-9007199254740993"),
        (np.array([1, 2, 255], np.uint8), "1 2 255"),
        (np.array([True, False]), "yes no"),
    ],
)
def test_values_are_printed_exactly(value, text):
    assert _format_value("a", value) == text


def test_classes_are_printed_by_name():
    assert (
        _format_value("classification", np.uint8(2))
        == _format_value("scalar_Classification", np.float32(2))
        == "2 ground"
    )
    assert _format_value("classification", np.uint8(77)) == "77"


# ---------------------------------------------------------------------------------------------------------- radii


@pytest.mark.parametrize("dtype", [np.uint8, np.int64, np.float32, np.float64])
def test_radii_may_have_any_dtype(dtype):
    few = pr.Points(np.eye(3), attributes={"radius": np.array([1, 2, 3], dtype)})
    assert radii_in(few).dtype == np.float32 and radii_in(few).tolist() == [1, 2, 3]


@pytest.mark.parametrize("radius", [[1, 0, 2], [1, 1e-50, 1], [1, 1e50, 1], [True, True, True], [1, np.nan, 1]])
def test_invalid_radii_are_refused(radius):
    assert radii_in(pr.Points(np.eye(3), attributes={"radius": np.array(radius)})) is None
