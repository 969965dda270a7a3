"""Hits as points and as tables: which rays they contain, and their columns."""

import sys

import numpy as np
import pytest

import pointray as pr


@pytest.fixture(scope="module")
def scene():
    points = pr.procedural("sphere", 5000)
    points = points.changed(
        colors=np.full((5000, 3), [255, 128, 0], np.uint8),
        attributes={"height": points.positions[:, 2], "t": np.full(5000, 7.0), "axis": points.positions},
    )
    scene = pr.Scene()
    scene.add(pr.Model(points), pr.transform(translate=(1_000_000, 0, 0)))
    return scene


def rays():
    """A picture of two rows and three columns; the outer ones miss."""
    z, x = np.meshgrid([0.5, -0.5], [-3, 0, 3], indexing="ij")
    return np.stack([1_000_000 + x, np.full_like(x, -5), z], axis=-1), [0, 1, 0]


def test_points_are_the_hits(scene):
    hits = scene.intersect(*rays(), attributes=("height", "t", "axis"))
    points = hits.to_points()
    hit = np.isfinite(hits.t)
    assert hit.tolist() == [[False, True, False]] * 2
    np.testing.assert_allclose(points.world, hits.position[hit], atol=1e-6)
    np.testing.assert_array_equal(points.normals, hits.normal[hit])
    assert points.colors.tolist() == [[255, 128, 0]] * 2
    assert set(points.attributes) == {"t", "ray", "point", "instance", "height", "t_", "axis"}
    assert points.attributes["ray"].tolist() == [1, 4]
    np.testing.assert_array_equal(points.attributes["t"], hits.t[hit])
    np.testing.assert_allclose(points.attributes["t_"], 7)
    np.testing.assert_allclose(points.attributes["height"], [0.5, -0.5], atol=0.01)
    np.testing.assert_array_equal(points.attributes["axis"], hits.attributes["axis"][hit])
    np.testing.assert_array_equal(points.attributes["point"], hits.point[hit])
    pr.Model(pr.Points(points.world, points.normals), np.full(2, 0.1))  # they can be used as any others


def test_points_without_colours_and_without_hits(scene):
    plain = pr.Scene()
    plain.add(pr.Model(pr.Points(pr.procedural("sphere", 1000).positions)))
    assert plain.intersect([0, -5, 0], [0, 1, 0]).to_points().colors is None
    with pytest.raises(ValueError, match="no ray of 6 hits anything"):
        scene.intersect(rays()[0], [0, -1, 0]).to_points()


def test_the_table_has_a_row_for_each_ray(scene):
    pandas = pytest.importorskip("pandas")
    hits = scene.intersect(*rays(), attributes=("height", "axis"))
    table = hits.to_pandas()
    assert isinstance(table, pandas.DataFrame) and table.index.name == "ray" and len(table) == 6
    names = "t x y z nx ny nz red green blue point instance height axis_0 axis_1 axis_2"
    assert table.columns.tolist() == names.split()
    missed = ~np.isfinite(hits.t.reshape(-1))
    assert np.isinf(table.t[missed]).all() and table.x[missed].isna().all() and (table.instance[missed] == -1).all()
    np.testing.assert_array_equal(table[["x", "y", "z"]][~missed], hits.position.reshape(-1, 3)[~missed])
    assert table[["red", "green", "blue"]][~missed].to_numpy().tolist() == [[255, 128, 0]] * 2
    np.testing.assert_array_equal(table.axis_1, hits.attributes["axis"].reshape(-1, 3)[:, 1])
    assert table.dtypes["red"] == np.uint8 and table.dtypes["point"] == np.int64


def test_one_ray_is_a_table_of_one_row(scene):
    pytest.importorskip("pandas")
    assert len(scene.intersect([1_000_000, -5, 0], [0, 1, 0]).to_pandas()) == 1
    assert len(scene.intersect(np.zeros((0, 3)), [0, 1, 0]).to_pandas()) == 0


def test_rays_of_dask_arrays_are_traced_once(scene):
    dask_array = pytest.importorskip("dask.array")
    pytest.importorskip("pandas")
    origins, direction = rays()
    calls = []

    def counted(block):
        calls.append(block.shape)
        return block

    chunks = dask_array.from_array(origins, chunks=(1, 3, 3)).map_blocks(counted, meta=np.zeros((0, 0, 0)))
    hits = scene.intersect(chunks, direction, attributes=("height", "axis"))
    assert not calls
    points = hits.to_points()
    assert calls == [(1, 3, 3)] * 2
    table = hits.to_pandas()
    assert len(calls) == 4
    whole = scene.intersect(origins, direction, attributes=("height", "axis"))
    np.testing.assert_array_equal(points.world, whole.to_points().world)
    for name, values in whole.to_points().attributes.items():
        np.testing.assert_array_equal(points.attributes[name], values)
    assert table.equals(whole.to_pandas())


def test_a_missing_package_is_named(scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="Hits.to_pandas needs pandas: pip install pandas"):
        scene.intersect(*rays()).to_pandas()
