"""Models merge second layers and misaligned passes, and do not change other surfaces."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

import pointray as pr
from helpers.marks import long
from pointray.cloud.outliers import merge_for_model
from pointray.cloud.outliers.local_fits import CORE, GROUP, KEPT, LocalSurfaceFits
from pointray.cloud.outliers.passes import merge_passes

N = 12_000
H = np.sqrt(4 / N)  # the spacing on the wall
STATIONS = ((-1, 0, 10), (2, 1, 10))


def sheet(n, seed, height=0.0, tilt=0.0, noise=0.1):
    """Return a gently curved wall over x, y from -1 to 1, seen from +z."""
    draw = np.random.default_rng(seed)
    x, y = draw.uniform(-1, 1, (2, n))
    z = 0.1 * np.sin(2 * x) * np.cos(1.5 * y) + height * H + np.radians(tilt) * x
    return np.stack([x, y, z], axis=1) + draw.normal(size=(n, 3)) * noise * H


def off(positions):
    """Return the distance from the wall, in spacings."""
    x, y, z = np.asarray(positions, np.float64).T
    return (z - 0.1 * np.sin(2 * x) * np.cos(1.5 * y)) / H


def layered(height):
    return np.vstack([sheet(N, 0), sheet(N // 10, 1, height)])


def scans(gap, tilt=0.0, seed=0):
    """Return two scans of the wall of about equal density, and the scan of each point."""
    rows = np.vstack([sheet(N // 2, seed, -gap / 2, -tilt / 2), sheet(N // 2, seed + 1, gap / 2, tilt / 2)])
    return rows, np.arange(N) // (N // 2)


def rms(values):
    return float(np.sqrt((values**2).mean()))


@pytest.mark.parametrize("height", [long(1), 3])
def test_a_model_has_no_second_layer(height):
    rows = layered(height)
    points = pr.Points(rows, attributes={"row": np.arange(len(rows))})
    model = pr.Model(points)
    splats, of = model.splats
    layer = (of >= N) & (np.abs(splats.world[:, :2]).max(axis=1) < 0.9)
    assert rms(off(splats.world[layer])) < 0.3
    assert model.points is points and (splats.attributes["row"] == of).all()


@pytest.mark.long
def test_layers_are_kept_without_smoothing_and_with_given_radii():
    rows = layered(2)
    for model in (pr.Model(rows, smooth=0), pr.Model(rows, np.full(len(rows), 2 * H, np.float32))):
        splats, of = model.splats
        assert (splats.positions == model.points.positions[of]).all()


def test_layers_are_merged_where_normals_are_given():
    rows = layered(2)
    normals = np.zeros_like(rows)
    normals[:, 2] = 1
    merged = merge_for_model(pr.Points(rows, normals))
    assert np.abs(off(merged.world[N:])).mean() < 0.3
    normals[N:] *= -1  # the back of a thin body
    points = pr.Points(rows, normals)
    assert merge_for_model(points) is points


@pytest.mark.parametrize("name", [long("statue"), long("lattice"), "torus"])
@pytest.mark.parametrize("noise", [0, 0.3])
def test_surfaces_without_layers_are_not_changed(name, noise):
    points = pr.procedural(name, 20_000)
    spacing = np.median(cKDTree(points.positions).query(points.positions[:500], 2)[0][:, 1]) * 2
    moved = points.positions + np.random.default_rng(0).normal(size=(20_000, 3)) * noise * spacing
    points = points.changed(positions=moved.astype(np.float32))
    assert merge_for_model(points) is points
    bare = points.with_normals(None)
    assert merge_for_model(bare) is bare


@pytest.mark.parametrize("thickness", [1, long(2), long(4)])
def test_thin_plates_keep_their_sheets(thickness):
    draw = np.random.default_rng(1)
    rows = draw.uniform(-1, 1, (N, 3))
    rows[:, 2] = draw.integers(0, 2, N) * thickness * np.sqrt(8 / N)
    points = pr.Points(rows + draw.normal(size=rows.shape) * 0.1 * H)
    assert merge_for_model(points) is points


@pytest.mark.parametrize(
    "rows",
    [
        np.ones((100, 3)),
        np.random.default_rng(0).uniform(-1, 1, (19, 3)),
        np.random.default_rng(0).normal(size=(999, 3)),
    ],
    ids=["equal", "few", "strays"],
)
def test_degenerate_clouds_are_not_changed(rows):
    points = pr.Points(
        rows, attributes={"scan": np.arange(len(rows)) % 2}, georeference=pr.Georeference(stations=STATIONS)
    )
    assert merge_for_model(points) is points


@pytest.mark.parametrize(("gap", "tilt"), [long(0.5, 0), long(2, 0), (2.5, 0), long(0, 1)])
def test_two_scans_of_one_wall_become_one_surface(gap, tilt):
    rows, scan = scans(gap, tilt)
    points = pr.Points(rows, attributes={"scan": scan}, georeference=pr.Georeference(stations=STATIONS))
    inner = np.abs(rows[:, :2]).max(axis=1) < 0.9
    moved = off(merge_passes(points).world)[inner]
    assert rms(moved) < 0.3 and abs(moved.mean()) < 0.1
    flights = pr.Points(
        rows, np.broadcast_to((0, 0, 1), (N, 3)), attributes={"point_source_id": scan.astype(np.uint16)}
    )
    assert rms(off(merge_for_model(flights).world)[inner]) < 0.3
    assert rms(off(pr.merge_layers(points.changed(georeference=pr.Georeference()), (0, 0, 10)).world)[inner]) < 0.3


def stays(rows, scan, stations=STATIONS):
    points = pr.Points(rows, attributes={"scan": scan}, georeference=pr.Georeference(stations=stations))
    return merge_passes(points) is points


def test_two_sheets_are_not_merged():
    rows, scan = scans(2)
    assert stays(rows, scan, ((0, 0, 10), (0, 0, -10)))  # seen from opposite sides
    assert stays(rows, np.arange(N) % 2)  # each scan sees both
    assert stays(rows, scan, ())  # the stations are unknown
    assert stays(*scans(0)) and stays(scans(0)[0], np.arange(N) % 5)


@pytest.mark.parametrize("wrong", [-1, long(7), np.nan, *map(long, (0.5, np.inf, 1e30))])
def test_scans_that_do_not_exist_are_ignored(wrong):
    rows, scan = scans(2)
    assert stays(rows, np.where(scan == 1, wrong, 0.0))
    some = np.where(np.arange(N) % 50 == 0, wrong, scan)
    points = pr.Points(rows, attributes={"scan": some}, georeference=pr.Georeference(stations=STATIONS))
    moved = merge_passes(points).positions != points.positions
    assert not moved[::50].any() and moved.any(axis=1).mean() > 0.9


def test_groups_list_the_neighbours_of_each_point():
    rows = layered(3).astype(np.float32)
    fits = LocalSurfaceFits(rows)
    fits.examine(np.arange(0, len(fits.known), 2))
    away, near = cKDTree(rows).query(rows, KEPT)
    seen = np.flatnonzero(np.isfinite(fits.noise))
    assert (seen == np.flatnonzero(np.arange(len(rows)) // GROUP % 2 == 0)).all()
    assert (np.sort(fits.near[seen]) == np.sort(near[seen])).mean() > 0.9999
    assert np.allclose(fits.core[seen], away[seen, CORE], rtol=1e-4)
    ratio = fits.noise / fits.spacing
    around = np.sort(ratio[fits.near[seen]], axis=1)  # NaN last
    middle = np.isfinite(around).sum(axis=1) // 2
    expected = around[np.arange(len(seen)), middle] * fits.spacing[seen]
    assert np.allclose(fits.shared(seen), expected, rtol=1e-5)
