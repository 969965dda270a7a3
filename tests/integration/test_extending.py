"""Extending pointray by a format, an integrator and a material."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import pointray as pr
from helpers.clouds import sphere_points
from helpers.kernel_cache import linked_cache
from pointray.base.choices import INTEGRATORS
from pointray.engine.jit import Array, inline, kernel
from pointray.engine.kernels.records import World
from pointray.engine.kernels.scratch import TILE, Scratch
from pointray.engine.kernels.vec import scale
from pointray.rendering.film import add_color
from pointray.rendering.integrate import Pass, render_tiles
from pointray.rendering.picture import KERNELS
from pointray.shade.materials.base import Material
from pointray.shade.materials.principled import Principled
from pointray.surface.trace.hits import tile_hit
from pointray.surface.trace.world import trace_tile

ROOT = Path(pr.__file__).parent
BRASS = (0.9, 0.7, 0.3)
CAMERA = pr.Camera.look_at((0, -4, 1), (0, 0, 0), size=(24, 16))

CUBES = """
import numpy as np
from pointray.io.formats._source import NO, SURE, Chunk, Format, Listing, Source

class CubesFile(Source):
    def __init__(self, path):
        self.listing, self._path = Listing(None, 24), path

    def chunks(self):
        rows = np.loadtxt(self._path, ndmin=2, skiprows=1)
        if rows.shape[1:] != (3,):
            raise ValueError("has rows of other than three numbers")
        yield Chunk(rows)

def write(file, points, progress=None):
    file.write(b"cubes\\n")
    np.savetxt(file, points.world)
    return ["cannot store normals"]

FORMAT = Format("Cubes", (".cubes",), lambda head, path: SURE if head.startswith(b"cubes") else NO,
                lambda path, request: CubesFile(path), {"positions": "all"}, write=write)
"""

CONVERT = """
import sys
import warnings
import numpy as np
import pointray as pr
from pointray.cli import execute

scan, again, broken = sys.argv[1:]
assert execute(["info", scan]) == 0
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    pr.write(again, pr.read(scan))
print(said[0].message)
assert [x.name for x in pr.formats() if x.writes and ".cubes" in x.extensions] == ["Cubes"]
try:
    pr.read(broken)
except ValueError as error:
    print(error)
"""

VELVET = """
from __future__ import annotations

from dataclasses import dataclass

from ...base.arguments import check_range
from ...engine.jit import inline
from ...engine.kernels.records import VELVET, VELVET_SHARE, ShadingPoint, World
from ...engine.kernels.vec import Vec3, scale
from .base import Color, Material, record_of
from .diffuse import eval_diffuse


@dataclass(frozen=True)
class Velvet(Material):
    color: Color = None
    share: float = 0.5

    def record(self):
        out = record_of(VELVET, self.color)
        out[VELVET_SHARE] = check_range(self.share, "share", 0, 1)
        return out


@inline
def eval_velvet(world: World, material: int, point: ShadingPoint, cosine: float) -> tuple[Vec3, float]:
    rgb, pdf = eval_diffuse(point, cosine)
    return scale(rgb, world.materials[material + VELVET_SHARE]), pdf
"""

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

LINES = [  # lines that a kind of material adds to three other files: after which line, and the text
    ("engine/kernels/records.py", "MATERIAL_KIND = 0\n", "VELVET, VELVET_SHARE = 6, 5\n"),
    (
        "shade/bsdf.py",
        "from .materials.specular import sample_specular\n",
        "from .materials.velvet import VELVET, eval_velvet\n",
    ),
    (
        "shade/bsdf.py",
        "        return eval_principled(world, material, point, wi, cosine)\n",
        "    if kind == VELVET:\n        return eval_velvet(world, material, point, cosine)\n",
    ),
    (
        "__init__.pyi",
        "from .shade.materials.specular import Dielectric as Dielectric, Mirror as Mirror\n",
        "from .shade.materials.velvet import Velvet as Velvet\n",
    ),
]

SHOW = """
import sys
import numpy as np
import pointray as pr

CAMERA = pr.Camera.look_at((0, -4, 1), (0, 0, 0), size=(24, 16))

def scene(material):
    made = pr.Scene()
    made.add(pr.Model(pr.procedural("sphere", 2000)), material=material)
    made.add_light(pr.SunLight((1, 1, -1)))
    return made

def shown(scene):
    return pr.render(scene, CAMERA, pr.Settings("phong"))[..., :3]

told = pr.load_scene(sys.argv[1]).scene  # first: nothing else has imported the new file yet
velvet, matt = shown(scene(pr.Velvet(0.8, share=0.25))), shown(scene(pr.Diffuse(0.8)))
assert matt.max() > 0.1
np.testing.assert_allclose(velvet, 0.25 * matt, rtol=1e-5)
np.testing.assert_array_equal(shown(told), velvet)
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the package, to which files are added."""
    return Path(shutil.copytree(ROOT, tmp_path / "copy" / "pointray", ignore=shutil.ignore_patterns("__pycache__")))


def run(package: Path, code: str, *arguments: str, **variables: str) -> str:
    """Run a program with a copy of the package and environment variables, and return its output."""
    environment = {**os.environ, "PYTHONPATH": str(package.parent), **variables}
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=package.parent)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.long
def test_a_format_needs_one_file(tmp_path: Path, package: Path) -> None:
    """No kernel depends on it, so the copy uses the kernels compiled so far."""
    scan, again, broken = (tmp_path / f"{name}.cubes" for name in ("scan", "again", "broken"))
    rows = sphere_points(500)
    np.savetxt(scan, rows, header="cubes", comments="")
    broken.write_text("cubes\n1 2\n")
    (package / "io" / "formats" / "cubes.py").write_text(CUBES)
    caught = run(package, CONVERT, str(scan), str(again), str(broken))
    assert "500" in caught
    assert f"{again}: cannot store normals" in caught
    assert caught.endswith(f"{broken}: has rows of other than three numbers\n")
    np.testing.assert_allclose(np.loadtxt(again, skiprows=1), rows, atol=1e-6)


@inline
def _integrate_facing(world: World, camera: Array, job: Pass, sample: int, scratch: Scratch) -> None:
    """Shade by how far the surface faces upwards."""
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
def test_an_integrator_needs_one_file_and_two_lines(monkeypatch: pytest.MonkeyPatch) -> None:
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


@pytest.mark.long
def test_a_new_kind_of_material_needs_one_file_and_lines_in_three(tmp_path: Path, package: Path) -> None:
    """The kernel of pictures is compiled with the new kind, which takes a minute."""
    (package / "shade" / "materials" / "velvet.py").write_text(VELVET)
    for name, line, more in LINES:
        text = (package / name).read_text()
        assert text.count(line) == 1, line
        (package / name).write_text(text.replace(line, line + more))
    assert len({name for name, _, _ in LINES}) == 3
    (tmp_path / "scene.toml").write_text(
        SCENE.replace("brass", "velvet").replace("polish = 0.75", "color = 0.8\nshare = 0.25")
    )
    run(package, SHOW, str(tmp_path / "scene.toml"), POINTRAY_CACHE=str(linked_cache(tmp_path / "cache")))


@dataclass(frozen=True)
class Brass(Material):
    """A material whose kind the kernels know."""

    polish: float = 0.5

    def record(self) -> NDArray[np.float64]:
        return Principled(BRASS, 1.0 - self.polish, 1.0).record()


def test_a_material_of_an_existing_kind_needs_one_class(tmp_path: Path) -> None:
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
