"""Memory: the amount available, what is refused, and pictures within the estimate."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from pointray.base import memory
from pointray.base.memory import available_memory, check_memory
from pointray.cli import execute
from pointray.image import draw_legend, write_image
from pointray.image.write import BAND

GIB = 2**30


@pytest.fixture
def system(tmp_path, monkeypatch):
    """Return a function that sets the contents of files like those of Linux."""
    for name in ("MEMINFO", "OWN_CGROUPS", "CGROUPS"):
        monkeypatch.setattr(memory, name, tmp_path / name)

    def set_memory(free=None, own="", **groups):
        if free is not None:
            (tmp_path / "MEMINFO").write_text(f"MemTotal: 99999999 kB\nMemAvailable:   {free // 1024} kB\n")
        (tmp_path / "OWN_CGROUPS").write_text(own)
        for name, (limit, used, inactive) in groups.items():
            folder = tmp_path / "CGROUPS" / name.replace("__", "/").strip("/")
            folder.mkdir(parents=True, exist_ok=True)
            old = name.startswith("memory")
            (folder / ("memory.limit_in_bytes" if old else "memory.max")).write_text(f"{limit}\n")
            (folder / ("memory.usage_in_bytes" if old else "memory.current")).write_text(f"{used}\n")
            key = "total_inactive_file" if old else "inactive_file"
            (folder / "memory.stat").write_text(f"anon 7\n{key} {inactive}\nfile 9\n")

    return set_memory


def test_available_memory_is_the_least_of_machine_and_cgroups(system):
    system(free=8 * GIB)
    assert available_memory() == 8 * GIB
    system(own="0::/a/b\n", a__b=("max", GIB, 0), a=(4 * GIB, 3 * GIB, GIB // 2))
    assert available_memory() == 1.5 * GIB
    system(own="0::/a/b\n", a__b=(GIB, 2 * GIB, 0))
    assert available_memory() == 0
    system(own="0::/../outside\n", **{"__": (2 * GIB, 0, 0)})  # in a container the root is its own group
    assert available_memory() == 2 * GIB


def test_cgroups_version_1_are_read(system):
    own = "9:cpu,cpuacct:/x\n4:memory:/x/y\n0::/\n"
    system(free=8 * GIB, own=own, memory__x__y=(2**63 - 4096, GIB, 0), memory__x=(3 * GIB, 2 * GIB, GIB))
    assert available_memory() == 2 * GIB


def test_nothing_is_refused_if_memory_is_unknown(system, monkeypatch):
    monkeypatch.delattr(os, "sysconf", raising=False)
    assert available_memory() is None
    check_memory(10**18, "for nothing")
    system(own="broken\n::\n")
    assert available_memory() is None


@pytest.fixture
def scene():
    made = pr.Scene()
    made.add(pr.Model(pr.Points(sphere_points(2000), sphere_points(2000))))
    return made


def test_pictures_that_do_not_fit_are_refused_at_once(scene, system):
    camera = pr.Camera.frame(scene.bounds, size=(4096, 4096))
    system(free=400 * 2**20)
    for settings in (pr.Settings(noise=0.1), pr.Settings("ao", denoise=True)):
        with pytest.raises(ValueError, match=r"for a picture of 4096x4096, 400 MiB are available"):
            pr.render(scene, camera, settings)
    with pytest.raises(ValueError, match=r"1\.2 GiB of memory are needed for a picture"):
        pr.render_layers(scene, camera)
    system(free=100 * 2**20)
    with pytest.raises(ValueError, match="256 MiB of memory are needed"):
        pr.render(scene, camera)
    with pytest.raises(ValueError, match="to write a.png"):
        write_image("a.png", np.broadcast_to(np.float32(0), (4096, 4096, 3)))


@pytest.mark.parametrize("output", ["a.png", "a.npz", "a.exr", "film"])
@pytest.mark.parametrize("file", ["scan.ply", "scene.toml"])
def test_the_command_line_refuses_before_it_begins(tmp_path, monkeypatch, capsys, system, file, output):
    """The command refuses before it reads the scan or writes anything."""
    if output == "a.exr":
        pytest.importorskip("OpenEXR")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scan.ply").write_text("no points")
    (tmp_path / "scene.toml").write_text('[models.a]\nfile = "scan.ply"\n[[instances]]\nmodel = "a"\n')
    system(free=GIB)
    before = sorted(tmp_path.iterdir())
    assert execute(["animate" if output == "film" else "render", file, "-o", output, "--size", "32768x32768"]) == 2
    printed = capsys.readouterr().err
    assert re.fullmatch(
        r"pointray: \d+\.0 GiB of memory are needed for a picture of 32768x32768, 1.0 GiB .*\n", printed
    )
    assert sorted(tmp_path.iterdir()) == before


# Bytes a pixel: the peak of memory in the last lines, less the memory before and the picture itself.
PEAK = """
import sys
import numpy as np
import pointray as pr
from helpers.clouds import sphere_points
from pointray.image import write_image, write_layers

def now(name):
    return 1024 * int(next(line for line in open("/proc/self/status") if line.startswith(name)).split()[1])

scene = pr.Scene()
scene.add(pr.Model(pr.Points(sphere_points(2000), sphere_points(2000))))
def camera(edge):
    return pr.Camera.frame(scene.bounds, size=(edge, edge))
def work(edge):
    {work}
work(256)  # compiles, and imports
open("/proc/self/clear_refs", "w").write("5")
before = now("VmRSS:")
work(2048)
print((now("VmHWM:") - before) / 2048**2)
"""
ALLOWED = 20 + 16 + 8  # bytes a pixel beside the picture, and of the picture; then 32 MiB for bands of any size


@pytest.mark.long
@pytest.mark.skipif(not os.access("/proc/self/clear_refs", os.W_OK), reason="needs Linux's /proc")
@pytest.mark.parametrize(
    ("work", "most"),
    [
        ('write_image(sys.argv[1] + "/a.png", pr.render(scene, camera(edge), pr.Settings("normal")))', ALLOWED),
        ('write_image(sys.argv[1] + "/a.jpg", pr.render(scene, camera(edge), pr.Settings("normal")))', ALLOWED),
        ('write_image(sys.argv[1] + "/a.exr", pr.render(scene, camera(edge), pr.Settings("normal")))', ALLOWED),
        ('pr.render(scene, camera(edge), pr.Settings("normal", spp=2, noise=0.5))', ALLOWED),
        ('write_layers(sys.argv[1] + "/a.npz", pr.render_layers(scene, camera(edge)))', 2.5 * 80),
        ('write_layers(sys.argv[1] + "/a.exr", pr.render_layers(scene, camera(edge)))', 2.5 * 64),
    ],
)
def test_a_large_picture_takes_little_beside_itself(tmp_path, work, most):
    if ".exr" in work:
        pytest.importorskip("OpenEXR")
    code = PEAK.replace("{work}", work)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < most


# ------------------------------------------------------------------------------------- bands change nothing


@pytest.mark.parametrize("alpha", [1.0, 0.5])
@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_a_picture_of_several_bands_is_one(tmp_path, monkeypatch, name, alpha, rng):
    image = rng.random((70, 50, 4), dtype=np.float32)
    image[..., 3] = 1
    image[-1, -1] *= alpha  # this is in the last band only
    write_image(tmp_path / name, image)
    whole = (tmp_path / name).read_bytes()
    assert 70 * 50 < BAND
    monkeypatch.setattr("pointray.image.write.BAND", 7 * 50 + 3)
    write_image(tmp_path / name, image.astype(np.float64))
    assert (tmp_path / name).read_bytes() == whole


@pytest.mark.parametrize("size", [(65, 97), (3, 1), (1, 65), (40, 64)])
@pytest.mark.parametrize("projection", ["perspective", "orthographic", "panorama"])
def test_layers_of_several_bands_are_those_of_all_rays(scene, monkeypatch, size, projection):
    camera = pr.Camera.frame(scene.bounds, size=size, projection=projection)
    monkeypatch.setattr("pointray.rendering.layers.BAND", 1)
    layers = pr.render_layers(scene, camera)
    hits = scene.intersect(*camera.rays())
    # Bands of a picture one pixel wide end within tiles. There a ray may be traced singly, with other rounding.
    rounding = {"rtol": 1e-6, "atol": 1e-7} if 1 in size else {"rtol": 0, "atol": 0}
    for name in ("normal", "position", "instance", "point"):
        np.testing.assert_allclose(layers[name], getattr(hits, name), **rounding)
    np.testing.assert_array_equal(layers["albedo"], hits.color)
    assert (np.isfinite(layers["depth"]) == (hits.instance >= 0)).all()


def test_sums_of_many_samples_stay_exact(scene):
    """4,096 samples, in one pass or several, err by 1e-6. Sums rounded at each sample would err by far more."""
    color = 0.1
    scene.add(pr.Plane((0, 0, 2), (0, 0, 1), color))
    camera = pr.Camera.look_at((0, 0, 9), (0, 0, 0), size=(8, 8))
    settings = {"integrator": "color", "spp": 4096}
    whole = pr.render(scene, camera, pr.Settings(**settings))
    pieces = pr.render(scene, camera, pr.Settings(**settings, time_limit=1e4))
    np.testing.assert_array_equal(whole, pieces)
    np.testing.assert_allclose(whole[..., :3], np.float32(color), rtol=1e-6)
    rounded = np.cumsum(np.full(4096, color, np.float32), dtype=np.float32)[-1] / 4096
    assert abs(rounded / color - 1) > 1e-5


def test_a_legend_is_drawn_into_its_box_only():
    attribute = pr.Attribute("height", range=(0.0, 10.0))
    light = np.full((120, 160, 4), np.float32(0.5))
    light[0, 0] = np.nan
    drawn = draw_legend(light, attribute)
    changed = (drawn != light).any(axis=2)
    assert changed.any() and not changed[:, :40].all()
    np.testing.assert_array_equal(drawn[:, :40], light[:, :40])


@pytest.fixture
def little(monkeypatch):
    """A machine with so little memory left that 100,000 points make no model, but more than 65,535 could be read."""
    free = 25_000_000
    monkeypatch.setattr(memory, "available_memory", lambda: free)
    return free


@pytest.mark.parametrize("with_normals", [True, False])
def test_a_model_that_does_not_fit_is_refused_at_once(little, monkeypatch, with_normals):
    rows = sphere_points(100_000)
    monkeypatch.setattr("pointray.cloud.preparation.place", lambda *args, **more: pytest.fail("work was begun"))
    with pytest.raises(
        ValueError, match=r"33 MiB of memory are needed to make a model of 100,000 points.*--max-points"
    ):
        pr.Model(pr.Points(rows, rows if with_normals else None))


def test_small_models_are_not_checked(little, monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda: 0)
    assert len(pr.Model(sphere_points(2000)).points) == 2000


def test_a_command_reports_a_lack_of_memory_in_one_line(little, monkeypatch, tmp_path, capsys):
    rows = sphere_points(100_000)
    pr.write(tmp_path / "a.ply", pr.Points(rows, rows))
    assert execute(["render", str(tmp_path / "a.ply"), "-o", str(tmp_path / "a.png")]) == 2
    printed = [line for line in capsys.readouterr().err.splitlines() if line]
    assert "to make a model of 100,000 points" in printed[-1] and "--every" in printed[-1]
    assert not (tmp_path / "a.png").exists()


MODEL_PEAK = """
import ctypes, sys
import numpy as np
import pointray as pr
torus = pr.procedural("torus", 500_000)
away = np.random.default_rng(1).normal(scale=0.3 * 0.0056, size=(500_000, 3)) if sys.argv[1] == "noisy" else 0.0
points = pr.Points(torus.positions + away, torus.normals if sys.argv[1] == "with" else None)
pr.Model(points.select(np.arange(0, 500_000, 100)))
getattr(ctypes.CDLL(None), "malloc_trim", bool)(0)  # what was freed before is not used again unnoticed
open("/proc/self/clear_refs", "w").write("5")
def size(name):
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith(name)) * 1024
before = size("VmRSS")
pr.Model(points)
print(size("VmHWM") - before)
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="how much memory a process took")
@pytest.mark.parametrize("kind", ["with", "without", "noisy"])
def test_models_take_about_the_estimated_memory(kind):
    """The estimate is that of noisy points; noise is known only after the work has started."""
    from pointray.cloud.preparation import PEAK

    done = subprocess.run([sys.executable, "-c", MODEL_PEAK, kind], capture_output=True, text=True, check=True)
    a_point = int(done.stdout) / 500_000
    print(f"{a_point:.0f} bytes a point")
    assert (0.7 if kind == "noisy" else 0.3) * PEAK < a_point < 1.2 * PEAK  # 387, and 170
