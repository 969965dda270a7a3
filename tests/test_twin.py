"""Rays agree with the brute-force twin: the same hits and misses, t within 2% of the local radius."""

import numpy as np
import pytest

import pointray as pr
from conftest import shared_model, slow
from naive import walk

SURFACES = ["paper", "imls", "apss"]
CLOUDS = ["bunny", "dragon", "lattice", "statue"]


def cloud(name):
    """The points, and a direction to view them from."""
    if name in ("bunny", "dragon"):
        return pr.read(shared_model(f"points/stanford_{name}.ply")), (0.45, 0.35, 1.0), (0, 1, 0)
    # Rays graze the lattice's many rims; their share falls with the radius.
    count = 500_000 if name == "lattice" else 100_000
    return pr.procedural(name, count), (0.45, -1.0, 0.35), (0, 0, 1)


def compare(name, surface, size):
    points, side, up = cloud(name)
    model = pr.Model(points, surface=surface)
    origins, directions = (
        a.reshape(-1, 3) for a in pr.Camera.frame(model.bounds, side, size=(size, size), up=up).rays()
    )
    scene = pr.Scene()
    scene.add(model)
    t = scene.intersect(origins, directions).t
    twin = walk(model, origins, directions)
    sure = ~twin.doubtful
    assert np.isfinite(twin.t).mean() > 0.1
    assert (~sure).mean() <= 0.005 + 2 / len(sure), f"{(~sure).sum()} of {len(sure)} rays are left out"
    same = np.isfinite(t) == np.isfinite(twin.t)
    assert same[sure].all(), (
        f"{(~same[sure]).sum()} rays hit in one and miss in the other: {np.flatnonzero(sure & ~same)}"
    )
    both = sure & np.isfinite(t)
    gap = np.abs(t[both] - twin.t[both]) / twin.radius[both]
    assert gap.max() <= 0.02, f"{(gap > 0.02).sum()} of {both.sum()} hits are off, by up to {gap.max():.3f} radii"


@pytest.mark.parametrize(
    ("name", "surface"),
    [
        *(("bunny", "imls"), ("bunny", "apss"), ("statue", "apss")),
        *(slow("bunny", "paper"), slow("statue", "paper"), slow("statue", "imls")),
    ],
)
def test_rays_agree_with_the_twin(name, surface):
    compare(name, surface, 64)


@pytest.mark.long
@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("name", CLOUDS)
def test_many_rays_agree_with_the_twin(name, surface):
    compare(name, surface, 96)
