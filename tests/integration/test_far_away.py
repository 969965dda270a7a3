"""A scan in map coordinates looks like the same scan at the origin: millimetres are kept."""

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from helpers.marks import long
from pointray.cli import execute
from pointray.cloud.points import Points

FAR = np.array([512_345.678, 5_400_000.123, 321.5])
SIZE = 200
SHARE = 1e-4  # of pixels that may differ, and of hits on edges that may become misses


@pytest.fixture(scope="module", params=["torus", long("statue")])
def scan(request):
    """A body of 2 m, in whole millimetres, and its normals."""
    points = pr.procedural(request.param, 60_000 if request.param == "statue" else 10_000)
    rows = points.positions.astype(np.float64)
    rows -= rows.min(axis=0)
    return np.round(2 * rows / rows.max(), 3), points.normals


def at(scan, place, fitted=False):
    """Return the scan at a position, in whole millimetres."""
    return Points(np.round(scan[0] + place, 3), None if fitted else scan[1])


@pytest.fixture(scope="module")
def files(scan, tmp_path_factory):
    """The scan at zero and far away, each as a PLY file with float64 coordinates."""
    folder = tmp_path_factory.mktemp("far")
    fields = [(name, "<f8") for name in "xyz"] + [(f"n{name}", "<f4") for name in "xyz"]
    for name, place in (("near", 0), ("far", FAR)):
        rows = np.zeros(len(scan[0]), fields)
        for k, axis in enumerate("xyz"):
            rows[axis], rows[f"n{axis}"] = np.round(scan[0] + place, 3)[:, k], scan[1][:, k]
        words = {"<f8": "double", "<f4": "float"}
        head = [f"property {words[kind]} {field}" for field, kind in fields]
        lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}", *head, "end_header", ""]
        (folder / f"{name}.ply").write_bytes("\n".join(lines).encode() + rows.tobytes())
    return folder


def differing(files, *options):
    """Return the share of pixels that differ between the pictures of both files."""
    images = []
    for name in ("near", "far"):
        picture = files / f"{name}.png"
        command = ["render", str(files / f"{name}.ply"), "-o", str(picture), "--size", f"{SIZE}x{SIZE}", *options]
        assert execute(command) == 0
        images.append(np.asarray(Image.open(picture)).astype(int))
    return np.abs(images[0] - images[1]).max(axis=-1), images[0]


def test_positions_are_kept_to_a_thousandth_of_a_millimetre(files, scan):
    near, far = (pr.read(files / f"{name}.ply") for name in ("near", "far"))
    assert np.abs(far.world - FAR - scan[0]).max() < 1e-6
    assert not near.origin.any() and far.positions.dtype == np.float32


@pytest.mark.parametrize("fitted", [False, True])
def test_rays_hit_the_same_places(scan, fitted):
    found = []
    for place in (np.zeros(3), FAR):
        scene = pr.Scene()
        scene.add(pr.Model(at(scan, place, fitted)))
        middle = place + scan[0].max(axis=0) / 2
        camera = pr.Camera.look_at(middle + (0.2, -4.5, 0.9), middle, fov=32, size=(SIZE, SIZE))
        hits = scene.intersect(*camera.rays())
        found.append((hits.position - place, hits.normal, hits.instance))
    (a, m, one), (b, n, other) = found
    assert (one != other).mean() < SHARE
    both = (one >= 0) & (other >= 0)
    assert both.mean() > 0.1
    away = np.linalg.norm(a[both] - b[both], axis=-1)
    turned = np.einsum("ij,ij->i", m[both], n[both])
    print(np.quantile(away, [0.5, 0.99, 0.999, 1]), (turned < 0.99).mean())
    assert np.median(away) < 2e-6
    # With whole millimetres, many neighbours are equally far; which of them a fit uses depends on the last bit.
    assert np.quantile(away, 0.99) < (1e-4 if fitted else 4e-6)
    assert (turned < 0.99).mean() < (0.002 if fitted else SHARE)


def test_pictures_with_the_headlight_are_the_same(files):
    levels, image = differing(files, "--light", "headlight")
    assert (image[..., :3].std(axis=(0, 1)) > 10).any()
    assert (levels > 0).mean() < 2 * SHARE and (levels > 1).mean() < SHARE


@pytest.mark.long
def test_pictures_of_fitted_normals_are_nearly_the_same(files):
    levels, _ = differing(files, "--light", "headlight", "--normals", "fit")
    assert (levels > 1).mean() < 10 * SHARE


@pytest.mark.long
def test_pictures_of_baked_light_are_the_same(files):
    levels, _ = differing(files)
    assert (levels > 1).mean() < 0.01  # measured: 0.004; baked light has noise, which the last bits change
