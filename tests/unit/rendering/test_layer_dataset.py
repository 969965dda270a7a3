"""`Layers`: a dict as before, and a dataset of xarray with labelled axes."""

import copy
import pickle
import sys

import numpy as np
import pytest

import pointray as pr


@pytest.fixture(scope="module")
def layers():
    scene = pr.Scene()
    scene.add(pr.Model(pr.procedural("sphere", 2000)))
    return pr.render_layers(scene, pr.frame(scene, size=(20, 12)), pr.Settings(spp=1))


def test_layers_are_a_dict_with_a_camera(layers, tmp_path):
    assert isinstance(layers, dict) and layers.camera.size == (20, 12)
    for twin in (pickle.loads(pickle.dumps(layers)), copy.deepcopy(layers)):
        assert twin.camera == layers.camera and (twin["depth"] == layers["depth"]).all()
    pr.write_layers(tmp_path / "a.npz", layers)
    assert set(np.load(tmp_path / "a.npz")) == set(layers)


def test_the_dataset_has_labels_units_and_the_camera(layers, tmp_path):
    xarray = pytest.importorskip("xarray")
    data = layers.to_xarray()
    assert isinstance(data, xarray.Dataset) and set(data.data_vars) == set(layers)
    for name, values in layers.items():
        np.testing.assert_array_equal(data[name].values, values)
        assert data[name].dims[:2] == ("y", "x") and data[name].attrs["units"] and data[name].attrs["long_name"]
    assert data.x.values.tolist() == (np.arange(20) + 0.5).tolist() and data.y.attrs["units"] == "pixels"
    np.testing.assert_array_equal(data.position.sel(axis="z"), layers["position"][..., 2])
    np.testing.assert_array_equal(data.radiance.sel(channel="alpha"), layers["radiance"][..., 3])
    assert data.attrs["camera_eye"] == layers.camera.eye and data.attrs["camera_fov"] == layers.camera.fov
    for value in data.attrs.values():  # what files can hold
        assert isinstance(value, int | float | str) or all(isinstance(part, int | float) for part in value)


def test_other_layers_are_converted_too(layers):
    pytest.importorskip("xarray")
    more = type(layers)({**layers, "mask": layers["depth"] < 3, "pair": np.zeros((12, 20, 2))}, layers.camera)
    data = more.to_xarray()
    assert data.mask.dims == ("y", "x") and data.pair.dims == ("y", "x", "pair_0")


def test_without_xarray_a_command_is_named(layers, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ImportError, match="Layers.to_xarray needs xarray: pip install xarray"):
        layers.to_xarray()
