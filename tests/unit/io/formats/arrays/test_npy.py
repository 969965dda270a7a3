import io
import warnings
import zipfile
from contextlib import nullcontext

import numpy as np
import pytest

from pointray.cloud.georeference import RESIDUAL, SCAN, Georeference, numbers_of
from pointray.cloud.points import Points
from pointray.io.files import read, write, write_points
from pointray.io.formats.arrays import _array as _arrays, npy

N = 70
XYZ, NORMALS = np.random.default_rng(7).normal(size=(2, N, 3)).astype(np.float32)
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)
RGB = np.random.default_rng(8).integers(0, 256, (N, 3)).astype(np.uint8)
RGB[0] = 255


def saved(path, array, **more):
    np.save(path, array, **more)
    return path


def beside(*parts):
    return np.concatenate([part.astype(np.float32) for part in parts], axis=1)


@pytest.fixture(params=[1 << 25, 100], ids=["at once", "in chunks"])
def chunked(request, monkeypatch):
    monkeypatch.setattr(_arrays, "BLOCK", request.param)


# --------------------------------------------------------------------------------------------------------- NPY


@pytest.mark.usefixtures("chunked")
@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8", ">f8", "<f2", "<i2", ">i4"])
@pytest.mark.parametrize("order", "CF")
def test_arrays_of_every_order_and_type_are_read(tmp_path, dtype, order):
    array = (XYZ * 100).astype(dtype, order=order)
    points = read(saved(tmp_path / "a.npy", array))
    np.testing.assert_array_equal(points.positions, array.astype(np.float32))


def test_float64_positions_keep_their_digits(tmp_path):
    world = XYZ.astype(np.float64) / 1000 + [4e6, 5e6, 100]
    points = read(saved(tmp_path / "a.npy", world))
    np.testing.assert_allclose(points.world, world, atol=1e-9)


@pytest.mark.usefixtures("chunked")
@pytest.mark.parametrize("order", "CF")
def test_an_organised_cloud_is_read_row_by_row(tmp_path, order):
    array = np.asarray(XYZ.reshape(10, 7, 3), order=order)
    np.testing.assert_array_equal(read(saved(tmp_path / "a.npy", array)).positions, XYZ)


GREY = np.random.default_rng(9).random((N, 3)) * 0.99
WITH_GAPS = NORMALS.copy()
WITH_GAPS[3], WITH_GAPS[5] = 0, np.nan


@pytest.mark.usefixtures("chunked")
@pytest.mark.parametrize(
    ("more", "normals", "colors", "names"),
    [
        ([NORMALS], NORMALS, None, []),
        ([WITH_GAPS], WITH_GAPS, None, []),
        ([RGB], None, RGB, []),
        ([GREY], None, np.rint(GREY.astype(np.float32) * 255).astype(np.uint8), []),
        ([RGB, NORMALS], NORMALS, RGB, []),
        ([NORMALS, RGB], NORMALS, RGB, []),
        ([RGB, GREY], None, RGB, ["column_7", "column_8", "column_9"]),
        ([XYZ], None, None, ["column_4", "column_5", "column_6"]),
        ([RGB + 0.5], None, None, ["column_4", "column_5", "column_6"]),
        ([RGB * 0], None, None, ["column_4", "column_5", "column_6"]),
        ([XYZ[:, :1]], None, None, ["intensity"]),
    ],
)
def test_columns_are_recognised_from_all_their_values(tmp_path, more, normals, colors, names):
    array = beside(XYZ, *more)
    with pytest.warns(UserWarning, match="not recognised") if len(names) > 1 else nullcontext():
        points = read(saved(tmp_path / "a.npy", array))
    np.testing.assert_array_equal(points.positions, XYZ)
    for found, expected in ((points.normals, normals), (points.colors, colors)):
        assert (found is None) == (expected is None)
        if expected is not None:
            np.testing.assert_array_equal(found, expected)
    assert list(points.attributes) == names
    for name in names:
        np.testing.assert_array_equal(points.attributes[name], array[:, int(name[-1]) - 1 if name[-1].isdigit() else 3])


def test_a_single_late_value_decides_what_a_column_is(tmp_path, monkeypatch):
    monkeypatch.setattr(_arrays, "BLOCK", 100)
    array = beside(XYZ, RGB)
    array[-1, 3] = 256
    with pytest.warns(UserWarning, match="columns 4, 5, 6 are not recognised"):
        assert list(read(saved(tmp_path / "a.npy", array)).attributes) == ["column_4", "column_5", "column_6"]


def test_columns_are_named_by_the_caller(tmp_path):
    path = saved(tmp_path / "a.npy", beside(XYZ[:, ::-1], RGB, XYZ[:, :1], XYZ[:, :1]))
    points = read(path, columns="z,y,x,r,g,b,intensity,-")
    np.testing.assert_array_equal(points.positions, XYZ)
    np.testing.assert_array_equal(points.colors, RGB)
    assert list(points.attributes) == ["intensity"]
    with pytest.raises(ValueError, match="has 8 columns, but 3 are named"):
        read(path, columns="x,y,z")


@pytest.mark.usefixtures("chunked")
def test_structured_arrays_are_read_by_field_names(tmp_path):
    dtype = [("time", ">f8"), ("Z", "f8"), ("X", "f8"), ("Y", ">f8"), ("color", "u1", (3,)), ("nx", "f4")]
    dtype += [("ny", "f4"), ("nz", "f4"), ("hit", "?"), ("class", "i1"), ("code", "u2", (4,))]
    rows = np.zeros(N, dtype)
    rows["X"], rows["Y"], rows["Z"] = XYZ.T
    rows["nx"], rows["ny"], rows["nz"] = NORMALS.T
    rows["color"], rows["time"], rows["class"] = RGB, np.arange(N) / 3, np.arange(N) - 9
    points = read(saved(tmp_path / "a.npy", rows))
    np.testing.assert_array_equal(points.positions, XYZ)
    np.testing.assert_array_equal(points.normals, NORMALS)
    np.testing.assert_array_equal(points.colors, RGB)
    assert {n: v.dtype.str for n, v in points.attributes.items()} == {
        "time": "<f8",
        "hit": "|b1",
        "class": "|i1",
        "code": "<u2",
    }
    np.testing.assert_array_equal(points.attributes["time"], np.arange(N) / 3)


def header(text, version=1):
    size = len(text).to_bytes(2 if version == 1 else 4, "little")
    return b"\x93NUMPY" + bytes([version, 0]) + size + text.encode("utf-8")


@pytest.mark.parametrize("version", [1, 2, 3])
def test_every_version_of_the_header_is_read(tmp_path, version):
    text = "{'descr': '<f4', 'fortran_order': False, 'shape': (70L, 3L)}\n"  # as Python 2 wrote it
    (tmp_path / "a.npy").write_bytes(header(text, version) + XYZ.tobytes())
    np.testing.assert_array_equal(read(tmp_path / "a.npy").positions, XYZ)


SHAPE = "{'descr': '<f4', 'fortran_order': False, 'shape': %s}"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (header(SHAPE % "(71, 3)") + XYZ.tobytes(), r"cut off: 852 bytes of \(71, 3\) expected, 840 found"),
        (header(SHAPE % "(69, 3)") + XYZ.tobytes(), "has more bytes after its array"),
        (header(SHAPE % "(99999999999999, 3)") + XYZ.tobytes(), "cut off"),
        (header(SHAPE % "(-70, 3)") + XYZ.tobytes(), "header is damaged: invalid shape"),
        (header(SHAPE % "(70.0, 3)") + XYZ.tobytes(), "header is damaged: invalid shape"),
        (header(SHAPE % "(True, 3)"), "header is damaged: invalid shape"),
        (header(SHAPE % "(0, 3)"), "contains no points"),
        (header(SHAPE % "(210,)") + XYZ.tobytes(), r"has the shape \(210,\) of float32"),
        (header(SHAPE % "(105, 2)") + XYZ.tobytes(), r"has the shape \(105, 2\)"),
        (header(SHAPE % "(3, 70)") + XYZ.tobytes(), "save it transposed"),
        (header("{'descr': '<f4', 'shape': (70, 3)}") + XYZ.tobytes(), "header is damaged"),
        (header("{'descr': 'O', 'fortran_order': False, 'shape': (3, 3)}"), "Python objects"),
        (header("{'descr': [('x', 'O')], 'fortran_order': False, 'shape': (3,)}"), "'x' contains values of type"),
        (header("{'descr': '<c8', 'fortran_order': False, 'shape': (1, 3)}") + bytes(24), "complex64, expected number"),
        (header("{'descr': '|b1', 'fortran_order': False, 'shape': (1, 3)}") + bytes(3), "of bool: expected rows of x"),
        (header("{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (1,)}") + bytes(4), "x, y, z not found"),
        (header("(" * 60_000), "header is damaged"),
        (header("-" * 60_000 + "1"), "header is damaged"),
        (header("[" * 150 + "]" * 150), "header is damaged"),
        (header("x" * 70_000, 2), "invalid length of 70,000 bytes"),
        (header(SHAPE % "(70, 3)", 3).replace(b"descr", b"d\xffscr"), "header is damaged: byte 15 is not UTF-8"),
        (header(SHAPE % "(70, 3)", 4), "unsupported header version 4.0"),
        (header(SHAPE % "(70, 3)")[:40], "the header is cut off"),
        (b"\x93NUMPY", "is not a NumPy array"),
    ],
)
def test_damaged_arrays_are_refused(tmp_path, data, message):
    (tmp_path / "a.npy").write_bytes(data)
    with pytest.raises(ValueError, match=message) as caught:
        read(tmp_path / "a.npy", strict=True)
    assert "\n" not in str(caught.value)


def test_a_wide_array_may_be_a_picture():
    assert npy.recognise(header(SHAPE % "(480, 640)"), None) == npy.MAYBE
    assert npy.recognise(header(SHAPE % "(480, 3)"), None) == npy.SURE


def test_objects_are_not_unpickled(tmp_path):
    np.save(tmp_path / "a.npy", np.array([[1, 2, {}]], object), allow_pickle=True)
    np.savez(tmp_path / "a.npz", points=np.array([[1, 2, {}]], object))
    for name in ("a.npy", "a.npz"):
        with pytest.raises(ValueError, match="contains Python objects"):
            read(tmp_path / name)


# --------------------------------------------------------------------------------------------------------- NPZ


@pytest.mark.usefixtures("chunked")
@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize(
    "arrays",
    [
        {"positions": XYZ, "normals": NORMALS, "colors": RGB},
        {"Points": XYZ.astype(">f8"), "normal": np.asfortranarray(NORMALS), "colours": RGB / 255},
        {"xyz": XYZ, "rgb": np.column_stack([RGB, RGB[:, :1]]), "nx": NORMALS[:, 0], "ny": NORMALS[:, 1]}
        | {"nz": NORMALS[:, 2]},
        dict(zip(("x", "y", "z", "r", "g", "b"), [*XYZ.T, *RGB.T], strict=True)) | {"normals": NORMALS},
        {"pts": beside(XYZ, RGB), "normals": NORMALS},
        {"arr_0": beside(XYZ, NORMALS, RGB)},
    ],
)
def test_names_of_arrays_decide_their_meaning(tmp_path, save, arrays):
    save(tmp_path / "a.npz", **arrays, label=np.arange(N), crs="EPSG:25832")
    if "arr_0" in arrays:
        save(tmp_path / "a.npz", **arrays, crs="EPSG:25832")
    points = read(tmp_path / "a.npz")
    np.testing.assert_array_equal(points.positions, XYZ)
    np.testing.assert_array_equal(points.normals, NORMALS)
    np.testing.assert_array_equal(points.colors, RGB)
    assert points.crs == "EPSG:25832"
    assert list(points.attributes) == ([] if "arr_0" in arrays else ["label"])


@pytest.mark.parametrize("name", ["pts3d", "world_points", "points3d", "Points"])
@pytest.mark.parametrize("pixels", [(2, 7, 5), (10, 7), (70,)])
def test_pictures_of_points(tmp_path, name, pixels):
    """Files of depth networks contain positions, colours and confidence per pixel."""
    rng = np.random.default_rng(4)
    conf, mask = rng.random(N), rng.random(N) > 0.5
    arrays = {name: XYZ.reshape(*pixels, 3), "rgb": RGB.reshape(*pixels, 3)}
    np.savez(tmp_path / "a.npz", **arrays, conf=conf.reshape(pixels), mask=mask.reshape(pixels))
    points = read(tmp_path / "a.npz")
    np.testing.assert_array_equal(points.positions, XYZ)
    np.testing.assert_array_equal(points.colors, RGB)
    np.testing.assert_array_equal(points.attributes["conf"], conf)
    np.testing.assert_array_equal(points.attributes["mask"], mask)


def test_the_origin_is_added_in_float64(tmp_path):
    np.savez(tmp_path / "a.npz", positions=XYZ, origin=np.array([4e6, 5e6, 1.25]))
    points = read(tmp_path / "a.npz")
    np.testing.assert_allclose(points.world, XYZ + [4e6, 5e6, 1.25], rtol=0, atol=3e-7)


def test_arrays_of_other_lengths_are_left_out_with_a_warning(tmp_path):
    np.savez(tmp_path / "a.npz", positions=XYZ, K=np.eye(3), objects=np.array([{}, 3]), t=np.arange(N))
    with pytest.warns(UserWarning, match="arrays without one number per point are ignored: 'K', 'objects'"):
        points = read(tmp_path / "a.npz")
    assert list(points.attributes) == ["t"]


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"positions": XYZ, "colors": RGB[1:]}, "the array 'colors' has 69 rows, expected 70"),
        ({"x": XYZ[:, 0], "y": XYZ[1:, 1], "z": XYZ[:, 2]}, "the array 'y' has 69 rows"),
        ({"a": XYZ, "b": XYZ}, "positions not found: .* available: a, b"),
        ({}, "contains no arrays"),
        ({"positions": XYZ[:0]}, "contains no points"),
        ({"positions": XYZ, "origin": np.array([np.nan, 0, 0])}, "origin must be finite"),
    ],
)
def test_archives_without_a_cloud_are_refused(tmp_path, arrays, message):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(ValueError, match=message):
        read(tmp_path / "a.npz")


def archive(path, info=None, data=None, **changes):
    """Write an archive with one array and changes to its directory."""
    stream = io.BytesIO()
    np.save(stream, XYZ)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(info or "positions.npy", data or stream.getvalue())
        for name, value in changes.items():
            setattr(file.filelist[0], name, value)
    return path


def test_archives_with_false_sizes_are_refused(tmp_path):
    path = tmp_path / "a.npz"
    with pytest.raises(ValueError, match="at most .* can be stored"):
        read(archive(path, file_size=2**31))
    with pytest.raises(ValueError, match="840 bytes expected, 800 found"):
        read(archive(path, data=header(SHAPE % "(70, 3)") + XYZ.tobytes()[:800]))
    with pytest.raises(ValueError, match="larger than the file"):
        read(archive(path, compress_size=2**31))
    with pytest.raises(ValueError, match="CRC"):
        read(archive(path, CRC=5))
    with pytest.raises(ValueError, match="array 'positions': is not a NumPy array"):
        read(archive(path, data=b"not at all an array"))
    data = archive(path).read_bytes()
    path.write_bytes(data[:-30])
    with pytest.raises(ValueError, match="damaged or cut off"):
        read(path)


# ----------------------------------------------------------------------------------------------------- writing


def cloud(**more):
    attributes = {
        "gps_time": 1e9 + np.arange(N) / 3,
        "class": np.arange(N, dtype=np.uint8) % 4,
        "big": 2**63 + np.arange(N, dtype=np.uint64),
        "hit": np.arange(N) % 2 == 0,
        "feature": np.random.default_rng(10).random((N, 5)).astype(np.float32),
        "Größe": np.arange(N, dtype=np.int16),
    }
    return Points(**{"positions": XYZ, "normals": NORMALS, "colors": RGB, "attributes": attributes, **more})


def check_same(found, points):
    np.testing.assert_array_equal(found.world, points.world)
    np.testing.assert_array_equal(found.origin, points.origin)
    np.testing.assert_array_equal(found.positions, points.positions)
    for name in ("normals", "colors"):
        assert (getattr(found, name) is None) == (getattr(points, name) is None)
        np.testing.assert_array_equal(getattr(found, name), getattr(points, name))
    assert set(found.attributes) == set(points.attributes)
    for name, values in points.attributes.items():
        assert found.attributes[name].dtype == values.dtype, name
        np.testing.assert_array_equal(found.attributes[name], values)


SPECIAL = {"scale": XYZ, "rgb": RGB, "x": XYZ[:, 0], "crs": XYZ[:, 0], "origin": XYZ[:3].repeat(N, 0)[:N]}
GEOREFERENCE = Georeference("EPSG:25832", "metre", None, None, ((1.0, 2.0, 3.0), (4.5, 5.0, 6e6)))


@pytest.mark.usefixtures("chunked")
@pytest.mark.parametrize("suffix", [".npy", ".npz"])
@pytest.mark.parametrize(
    "points",
    [
        cloud(),
        cloud(normals=None, colors=None, attributes=None),
        cloud(positions=XYZ.astype(np.float64) + [4e5, 5.4e6, 300]),
        cloud(positions=np.where(np.arange(N)[:, None] % 5 == 0, np.nan, XYZ)),
    ],
    ids=["all", "positions", "far away", "gaps"],
)
def test_written_points_are_read_back(tmp_path, suffix, points):
    assert write_points(tmp_path / f"a{suffix}", points) == []
    check_same(read(tmp_path / f"a{suffix}"), points)


@pytest.mark.parametrize("n", [1, 2, 3, N])
def test_npz_stores_attributes_of_every_name_and_the_georeference(tmp_path, n):
    attributes = {k: v[:n] for k, v in {**SPECIAL, "attributes/a": RGB, SCAN: np.arange(N) % 2, "a/b": XYZ}.items()}
    points = Points(XYZ[:n], attributes=attributes, georeference=GEOREFERENCE)
    assert write_points(tmp_path / "a.npz", points) == []
    found = read(tmp_path / "a.npz")
    check_same(found, points)
    assert found.georeference == points.georeference
    with np.load(tmp_path / "a.npz") as arrays:  # NumPy reads it too
        np.testing.assert_array_equal(arrays["positions"], XYZ[:n])


@pytest.mark.parametrize("suffix", [".npz", ".npy"])
def test_integer_coordinates_are_written_unchanged(tmp_path, suffix):
    numbers = np.arange(3 * N).reshape(N, 3) * 7_000_003
    georeference = Georeference("EPSG:1", None, (1e-4, 1e-4, 1e-3), (4e5, 5e6, 0.0))
    world = np.array(georeference.offset) + np.array(georeference.scale) * numbers
    np.savez(tmp_path / "a.npz", positions=world, scale=georeference.scale, offset=georeference.offset)
    points = read(tmp_path / "a.npz")
    assert RESIDUAL in points.attributes, "float32 loses digits here"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write(tmp_path / f"b{suffix}", points)
    if suffix == ".npy":
        rows = np.load(tmp_path / "b.npy")
        written = np.stack([rows[axis] for axis in "xyz"], axis=1)
    else:
        again = read(tmp_path / "b.npz")
        assert again.georeference == points.georeference.__class__(None, None, georeference.scale, georeference.offset)
        check_same(again, points)
        written = np.load(tmp_path / "b.npz")["positions"]
    np.testing.assert_array_equal(numbers_of(georeference, written), numbers)


def test_npy_reports_what_it_cannot_store_and_refuses_reserved_names(tmp_path):
    lost = write_points(tmp_path / "a.npy", cloud(georeference=GEOREFERENCE))
    assert [word.removeprefix("cannot store ") for word in lost] == [
        "the coordinate system",
        "the unit",
        "the scanner positions",
    ]
    with pytest.raises(ValueError, match="attribute named 'X'"):
        write(tmp_path / "a.npy", cloud(attributes={"X": XYZ[:, 0]}))
    with pytest.raises(ValueError, match="attribute named"):
        write(tmp_path / "a.npz", cloud(attributes={"a\0b": XYZ[:, 0]}))


def test_mutated_files_are_read_whole_or_refused(rng, tmp_path):
    np.savez_compressed(tmp_path / "a.npz", positions=XYZ, colors=RGB, crs="EPSG:1")
    write(tmp_path / "b.npz", cloud())
    write(tmp_path / "c.npy", cloud())
    saved(tmp_path / "d.npy", beside(XYZ, NORMALS))
    files = [(name, (tmp_path / name).read_bytes()) for name in ("a.npz", "b.npz", "c.npy", "d.npy")]
    refused = 0
    for k in range(120):
        name, data = files[k % 4][0], bytearray(files[k % 4][1])
        at = int(rng.integers(0, 128 if k % 8 < 4 else len(data)))
        change = rng.integers(0, 3)
        if change == 0:
            del data[at:]
        elif change == 1:
            data[at] ^= 1 << int(rng.integers(0, 8))
        else:
            data[at : at + int(rng.integers(0, 9))] = bytes(rng.integers(0, 256, 4).astype(np.uint8))
        (tmp_path / name).write_bytes(data)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                assert len(read(tmp_path / name, strict=True)) == N
        except ValueError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused > 60
