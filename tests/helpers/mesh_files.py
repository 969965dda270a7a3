"""Mesh files of trimesh."""

import pytest

trimesh = pytest.importorskip("trimesh")


def save(folder, shape, kind):
    """Write a mesh or a scene with trimesh."""
    if kind == "gltf":
        for name, data in shape.export(file_type="gltf").items():
            (folder / name).write_bytes(data)
        return folder / "model.gltf"
    path = folder / f"a.{kind}"
    data = shape.export(file_type="stl_ascii" if kind == "ascii.stl" else kind)
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path
