"""Extending pointray: these tests add and use a format, an integrator and a material."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import pointray as pr
from conftest import sphere_points
from pointray.choices import FORMATS, INTEGRATORS
from pointray.cli import execute
from pointray.jit import Array, inline, kernel
from pointray.kernels.records import World
from pointray.kernels.scratch import TILE, Scratch
from pointray.kernels.vec import scale
from pointray.points import formats
from pointray.rendering.film import add_color
from pointray.rendering.integrate import Pass, render_tiles
from pointray.rendering.picture import KERNELS
from pointray.shade.materials import Material, Principled
from pointray.trace.hits import tile_hit
from pointray.trace.world import trace_tile

BRASS = (0.9, 0.7, 0.3)
CAMERA = pr.Camera.look_at((0, -4, 1), (0, 0, 0), size=(24, 16))

XYZ = """
import numpy as np
from pointray.data import Points


def read(path, progress=None):
    rows = np.loadtxt(path, ndmin=2)
    if rows.shape[1:] != (3,):
        raise ValueError("has rows of other than three numbers")
    return Points(rows)


def write(file, points):
    np.savetxt(file, points.world)
"""


def test_a_format_is_its_own_file_and_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file lies in a folder that this test adds to the package `formats`."""
    scan, rows = tmp_path / "scan.xyz", sphere_points(500)
    np.savetxt(scan, rows)
    with pytest.raises(ValueError, match=r"cannot read \.xyz; can read \.ply$"):
        pr.read(scan)
    (tmp_path / "own_xyz.py").write_text(XYZ)
    monkeypatch.setattr(formats, "__path__", [*formats.__path__, str(tmp_path)])
    monkeypatch.setitem(FORMATS, ".xyz", "own_xyz")
    np.testing.assert_allclose(pr.read(scan).world, rows, atol=1e-6)
    assert execute(["info", str(scan)]) == 0
    assert "500" in capsys.readouterr().out
    pr.write(tmp_path / "again.xyz", pr.read(scan))
    np.testing.assert_allclose(pr.read(tmp_path / "again.xyz").world, rows, atol=1e-6)
    scan.write_text("1 2\n")
    with pytest.raises(ValueError, match=r"scan\.xyz: has rows of other than three numbers$"):
        pr.read(scan)


@inline
def _integrate_facing(world: World, camera: Array, job: Pass, sample: int, scratch: Scratch) -> None:
    """Grey by how far the surface faces upwards."""
    trace_tile(world, scratch)
    for i in range(TILE):
        hit = tile_hit(scratch, i)
        if hit.instance >= 0:
            add_color(scratch, i, scale((1.0, 1.0, 1.0), 0.5 + 0.5 * hit.normal[2]))


@kernel
def facing_frame(work: Array, world: World, camera: Array, job: Pass, film: Array, image: Array) -> int:
    render_tiles(_integrate_facing, work, world, camera, job, film, image)
    return 0


@pytest.mark.long
def test_an_integrator_is_its_own_file_and_two_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """This compiles kernels for a minute."""
    with pytest.raises(ValueError, match="unknown integrator 'facing'"):
        pr.Settings("facing")
    rows = sphere_points(2000)
    sphere = pr.Scene()
    sphere.add(pr.Model(pr.Points(rows, rows)))
    monkeypatch.setitem(INTEGRATORS, "facing", "Facing up")
    monkeypatch.setitem(KERNELS, "facing", facing_frame)
    shown = pr.render(sphere, CAMERA, pr.Settings("facing"))
    normals = pr.render(sphere, CAMERA, pr.Settings("normal"))
    assert (shown[..., 3] > 0).sum() > 20
    np.testing.assert_array_equal(shown[..., 3], normals[..., 3])
    for k in range(3):
        np.testing.assert_allclose(shown[..., k], normals[..., 2], atol=1e-6)


@dataclass(frozen=True)
class Brass(Material):
    """A material whose kind the kernels know."""

    polish: float = 0.5

    def record(self) -> NDArray[np.float64]:
        return Principled(BRASS, 1.0 - self.polish, 1.0).record()


SCENE = """
[models.ball]
procedural = "sphere"
points = 2000

[materials.brass]
kind = "brass"
polish = 0.75

[[instances]]
model = "ball"
material = "brass"

[[lights]]
kind = "sun"
direction = [1, 1, -1]
"""


def test_a_material_of_a_kind_that_kernels_know_is_a_class(tmp_path: Path) -> None:
    """Scene files can name it, with its parameters."""
    file = tmp_path / "scene.toml"
    file.write_text(SCENE)
    scene = pr.load_scene(file).scene
    shown = pr.render(scene, CAMERA)
    (ball,) = scene.models
    same = pr.Scene()
    same.add(ball, material=Principled(BRASS, 0.25, 1.0))
    same.add_light(pr.SunLight((1, 1, -1)))
    assert shown[..., 3].max() == 1
    np.testing.assert_array_equal(shown, pr.render(same, CAMERA))
    file.write_text(SCENE.replace("0.75", "1.75"))
    with pytest.raises(ValueError, match=r"scene\.toml:6: materials\.brass: roughness"):
        pr.load_scene(file)
