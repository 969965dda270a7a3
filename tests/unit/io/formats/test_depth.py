"""Depth images: 16-bit PNG and arrays."""

import zlib

import numpy as np
import pytest

from helpers.depth_files import FLOATS, STEPS, save
from pointray.io.files import read
from pointray.io.formats import depth

CAMERA = (50.0, 55.0, 40.25, 30.5)


def expected(picture, steps):
    """Return the points of a picture, computed one by one."""
    fx, fy, cx, cy = CAMERA
    points = []
    for v, row in enumerate(picture.astype(np.float64) / steps):
        points += [((u - cx) * z / fx, (v - cy) * z / fy, z) for u, z in enumerate(row) if 0 < z < np.inf]
    return np.array(points)


@pytest.mark.parametrize(
    ("name", "picture", "steps"),
    [
        ("a.png", STEPS, 1000),
        ("a.npy", STEPS, 1000),
        ("a.npy", STEPS.astype(">u2"), 1000),
        ("a.npy", np.asfortranarray(STEPS), 1000),
        ("a.npy", FLOATS, 1),
        ("a.npy", FLOATS.astype(np.float64) + 1e-9, 1),
        ("a.wrong", STEPS, 1000),
    ],
)
def test_pixels_become_points(tmp_path, name, picture, steps, monkeypatch):
    monkeypatch.setattr(depth, "CHUNK", 1000)
    path = save(tmp_path / ("b.npy" if name == "a.wrong" else name), picture).rename(tmp_path / name)
    points = read(path, intrinsics=CAMERA)
    np.testing.assert_allclose(points.world, expected(picture, steps), rtol=1e-6)
    assert points.georeference.stations == ((0, 0, 0),)


def test_the_unit_of_depths_can_be_given(tmp_path):
    path = save(tmp_path / "a.png", STEPS)
    np.testing.assert_allclose(read(path, intrinsics=(*CAMERA, 5000)).world, expected(STEPS, 5000), rtol=1e-6)


def test_a_missing_camera_is_reported(tmp_path):
    path = save(tmp_path / "a.png", STEPS)
    with pytest.raises(ValueError, match=r"a.png: is a depth image: pass the camera as --intrinsics fx,fy,cx,cy"):
        read(path)


def test_narrow_arrays_are_not_recognised_as_depth_images():
    for shape, sure in [((17, 17), True), ((16, 40), False), ((900, 16), False), ((20, 20, 3), False)]:
        assert (depth.recognise(header(np.zeros(shape)), None) > 0) == sure
    assert depth.recognise(header(np.zeros((40, 40), complex)), None) == 0


def header(array):
    import io

    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()[:4096]


def test_colors_are_no_depths(rng, tmp_path):
    path = save(tmp_path / "a.png", rng.integers(0, 256, (20, 20, 3)).astype(np.uint8))
    with pytest.raises(ValueError, match="is a colour image, expected a 16-bit"):
        read(path, intrinsics=CAMERA)
    path = save(tmp_path / "b.png", rng.integers(0, 256, (20, 20)).astype(np.uint8))
    with pytest.raises(ValueError, match="is a grey image of 8 bits, expected a 16-bit"):
        read(path, intrinsics=CAMERA)


def test_an_empty_depth_image_is_reported(tmp_path):
    path = save(tmp_path / "a.png", np.zeros((20, 20), np.uint16))
    with pytest.raises(ValueError, match="contains no points"):
        read(path, intrinsics=CAMERA)


@pytest.mark.parametrize("name", ["a.png", "a.npy"])
def test_cut_files_are_refused(tmp_path, name):
    path = save(tmp_path / name, STEPS)
    data = path.read_bytes()
    for size in range(140, len(data) - 12, 397):  # the last 12 bytes of a PNG say only that it ends
        path.write_bytes(data[:size])
        with pytest.raises(ValueError, match="cut off"):
            read(path, intrinsics=CAMERA)


def test_a_picture_larger_than_its_file_is_refused(tmp_path):
    path = save(tmp_path / "a.png", STEPS)
    data = bytearray(path.read_bytes())
    data[16:24] = (60_000).to_bytes(4, "big") * 2
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    path.write_bytes(data)
    with pytest.raises(ValueError, match="60,000 x 60,000 pixels expected"):
        read(path, intrinsics=CAMERA)
