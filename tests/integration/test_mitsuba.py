"""Pictures of vertices of meshes compared with Mitsuba's pictures of the meshes, at small sizes."""

import os
import sys
from functools import cache

import numpy as np
import pytest

import pointray as pr
from bench.light import mitsuba_child, mitsuba_pairs
from bench.light.beside_mitsuba import Pair, choose_variant, compare
from bench.light.mitsuba_pairs import COLOR, MATERIALS
from bench.light.mitsuba_scenes import DIAGONAL, Body, Case, body
from helpers.marks import long, long_scan, scan
from helpers.places import MODELS, shared_model


def ring():
    """A torus of few triangles: the benchmark's files are much finer than small pictures need."""
    import trimesh

    mesh = trimesh.creation.torus(1.0, 0.4, 128, 64)
    vertices = mesh.vertices * (DIAGONAL / np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    normals = np.asarray(mesh.vertex_normals, np.float32)
    return Body("ring", np.asarray(vertices, np.float32), normals, np.asarray(mesh.faces, np.uint32))


SMALL = "ring", 48, 16
LARGE = [("torus", 96, 49), ("bunny", 96, 49)]


@pytest.fixture(scope="module", params=[SMALL, long(LARGE[0]), long_scan(LARGE[1])], ids=str)
def pair(request):
    """A mesh with the size and samples of its pictures."""
    for package in ("mitsuba", "trimesh"):
        pytest.importorskip(package)
    name, size, spp = request.param
    if name == "bunny":
        shared_model("meshes/stanford_bunny_mesh.ply")
    choose_variant(arrays=False)  # old versions of LLVM end the process on processors with AVX-512
    pair = Pair(ring() if name == "ring" else body(name, MODELS / "meshes"), size, spp)
    pair.theirs = cache(pair.theirs)  # tests that change only our side use the same reference pictures
    return pair


@pytest.mark.parametrize(
    ("pair", "light"),
    [
        (SMALL, "sun"),
        (SMALL, "disk"),
        *(
            mark(mesh, light)
            for mark, mesh in zip((long, long_scan), LARGE, strict=True)
            for light in ("sun", "constant", "disk")
        ),
    ],
    ids=str,
    indirect=["pair"],
)
def test_direct_light_equals_that_of_mitsuba(pair, light):
    row = compare(pair, Case(light, "diffuse"))
    assert row.met, row
    assert row.model.pixels > 0.11 * pair.camera.size[0] ** 2 and row.all.pixels > 0.54 * pair.camera.size[0] ** 2
    assert row.all.apart < 1.2 * row.all.apart_noise + 0.005


@pytest.mark.long
@pytest.mark.parametrize("pair", [LARGE[0], scan(LARGE[1])], indirect=True, ids=str)
def test_four_bounces_in_a_corner_equal_those_of_mitsuba(pair):
    row = compare(pair, Case("rectangle", "diffuse", "corner", 4))
    assert row.met, row


@pytest.mark.long
@pytest.mark.parametrize("pair", [LARGE[0], scan(LARGE[1])], indirect=True, ids=str)
def test_mirrors_equal_those_of_mitsuba(pair):
    row = compare(pair, Case("gradient", "mirror", "floor", 2))
    assert row.met, row


def test_a_wrong_color_is_detected(pair, monkeypatch):
    wrong = MATERIALS["diffuse"]()._replace(ours=pr.Diffuse([1.03 * c for c in COLOR]))
    monkeypatch.setitem(mitsuba_pairs.MATERIALS, "diffuse", lambda: wrong)
    row = compare(pair, Case("sun", "diffuse"))
    assert not row.model.met and row.model.off == pytest.approx(1 / 1.03 - 1, abs=0.005)


def aborted(*arguments):
    """End the process as Mitsuba does if its LLVM does not know the processor."""
    os.abort()


@pytest.mark.long
def test_an_abort_of_mitsuba_does_not_stop_the_benchmark(capfd):
    pytest.importorskip("mitsuba")
    from bench.light.mitsuba_speed import speed

    speed(2_000, 32, 1, 1, beside=aborted)
    out = capfd.readouterr().out.splitlines()
    assert out[0].startswith("Mitsuba has ended its process (SIGABRT): ") and out[0].endswith("; pointray alone:")
    assert out[1] == "statue: 2,000 points, 32x32"
    assert [line.split(":")[0] for line in out[2:]] == ["path", "lit", "lit"]


def test_the_end_of_a_child_process_is_reported():
    assert mitsuba_child.in_child(print) is None
    assert mitsuba_child.in_child(os.abort) == "SIGABRT"
    assert mitsuba_child.in_child(sys.exit, 3) == "status 3"


def test_an_llvm_that_aborts_is_not_used(monkeypatch, capsys):
    pytest.importorskip("mitsuba")
    monkeypatch.setattr(mitsuba_child, "try_llvm", os.abort)
    assert choose_variant() == "scalar_rgb"
    assert capsys.readouterr().out.count("(SIGABRT)") == 1
