"""Pictures of meshes' vertices compared with Mitsuba's of the meshes, at sizes that take seconds."""

import os
import sys

import pytest

import mitsuba_child
import mitsuba_pairs
import pointray as pr
from beside_mitsuba import Pair, choose_variant, compare
from conftest import MODELS, shared_model, slow
from mitsuba_pairs import COLOR, MATERIALS
from mitsuba_scenes import Case, body


@pytest.fixture(scope="module", params=["torus", slow("bunny")])
def pair(request):
    for package in ("mitsuba", "trimesh"):
        pytest.importorskip(package)
    if request.param == "bunny":
        shared_model("meshes/stanford_bunny_mesh.ply")
    choose_variant(arrays=False)  # old versions of LLVM end the process on processors with AVX-512
    return Pair(body(request.param, MODELS / "meshes"), size=96, spp=49)


@pytest.mark.parametrize("light", ["sun", slow("constant"), "disk"])
def test_direct_light(pair, light):
    row = compare(pair, Case(light, "diffuse"))
    assert row.met, row
    assert row.model.pixels > 1000 and row.all.pixels > 5000
    assert row.all.apart < 1.2 * row.all.apart_noise + 0.005


@pytest.mark.long
def test_four_bounces_in_a_corner(pair):
    row = compare(pair, Case("rectangle", "diffuse", "corner", 4))
    assert row.met, row


@pytest.mark.long
def test_mirrors(pair):
    row = compare(pair, Case("gradient", "mirror", "floor", 2))
    assert row.met, row


def test_a_wrong_color_is_noticed(pair, monkeypatch):
    wrong = MATERIALS["diffuse"]()._replace(ours=pr.Diffuse([1.03 * c for c in COLOR]))
    monkeypatch.setitem(mitsuba_pairs.MATERIALS, "diffuse", lambda: wrong)
    row = compare(pair, Case("sun", "diffuse"))
    assert not row.model.met and row.model.off == pytest.approx(1 / 1.03 - 1, abs=0.005)


def aborted(*arguments):
    """End the process as Mitsuba does if its LLVM does not know the processor."""
    os.abort()


@pytest.mark.slow
def test_where_mitsuba_ends_its_process_the_rest_goes_on(capfd):
    pytest.importorskip("mitsuba")
    from mitsuba_speed import speed

    speed(2_000, 32, 1, 1, beside=aborted)
    out = capfd.readouterr().out.splitlines()
    assert out[0].startswith("Mitsuba has ended its process (SIGABRT): ") and out[0].endswith("; pointray alone:")
    assert out[1] == "statue: 2,000 points, 32x32"
    assert [line.split(":")[0] for line in out[2:]] == ["path", "lit", "lit"]


def test_how_a_child_ends():
    assert mitsuba_child.in_child(print) is None
    assert mitsuba_child.in_child(os.abort) == "SIGABRT"
    assert mitsuba_child.in_child(sys.exit, 3) == "status 3"


def test_an_llvm_that_ends_its_process_is_not_taken(monkeypatch, capsys):
    pytest.importorskip("mitsuba")
    monkeypatch.setattr(mitsuba_child, "try_llvm", os.abort)
    assert choose_variant() == "scalar_rgb"
    assert capsys.readouterr().out.count("(SIGABRT)") == 1
