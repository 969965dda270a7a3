"""Degenerate clouds give a model or a ValueError, in time nearly proportional to the number of points.

Processor times of two sizes are compared, which other programs hardly affect. Sixteen times the points take some
sixteen times as long; a search among all pairs would take 256 times.
"""

import time
import warnings

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points, uneven_points
from helpers.marks import long

FEW, MANY, MOST = 4_000, 64_000, 60.0
LEAST = 0.02  # seconds: less is too little to measure. All pairs of MANY points take more than 60 times as long


def sphere(n):
    return sphere_points(n, 1).astype(np.float64)


def in_one_place(n):
    return np.tile([1.0, 2.0, 3.0], (n, 1))


def in_few_places(n):
    return sphere(100)[np.arange(n) % 100]


def on_a_line(n):
    return np.outer(np.random.default_rng(1).random(n), [1.0, 2.0, 3.0])


def in_a_plane(n):
    return np.column_stack([np.random.default_rng(1).random((n, 2)), np.zeros(n)])


def in_two_clusters(n):
    """Spheres of radius 1, 10,000 from each other."""
    return sphere(n) + np.where(np.arange(n) % 2, 1e4, 0.0)[:, None]


def huge(n):
    return 0.99e12 * sphere(n)


def tiny(n):
    return 1e-12 * sphere(n)


def far_away(n):
    return sphere(n) + 1e12


def with_gaps(n):
    points = sphere(n)
    points[::3] = np.nan
    return points


def outcome(positions, normals):
    """A model or the ValueError, and processor seconds. Warnings are expected."""
    points = pr.Points(positions, normals=sphere(len(positions)) if normals else None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        begun = time.process_time()
        try:
            made = pr.Model(points)
        except ValueError as error:
            made = error
        return made, time.process_time() - begun


WITHOUT_A_MODEL = {in_one_place: "distinct positions|same position", tiny: "radii range"}
CLOUDS = [in_few_places, on_a_line, in_a_plane, in_two_clusters, uneven_points, huge, far_away, with_gaps]


@pytest.mark.parametrize("normals", [False, True])
@pytest.mark.parametrize("cloud", WITHOUT_A_MODEL)
def test_some_degenerate_clouds_are_refused(cloud, normals):
    made, _ = outcome(cloud(3000), normals)
    assert isinstance(made, ValueError)
    assert any(words in str(made) for words in WITHOUT_A_MODEL[cloud].split("|"))


@pytest.mark.parametrize("normals", [False, True])
@pytest.mark.parametrize("cloud", CLOUDS)
def test_other_degenerate_clouds_become_models(cloud, normals):
    """Every splat has a finite position and a radius smaller than the cloud."""
    positions = cloud(2000)
    model, _ = outcome(positions, normals)
    splats, rows = model.splats
    extent = np.ptp(positions[np.isfinite(positions).all(axis=1)], axis=0).max()
    assert len(rows) > 1000
    assert np.isfinite(splats.positions).all()
    assert np.linalg.norm(splats.normals, axis=1) == pytest.approx(1.0, abs=1e-5)
    assert ((model.radii[rows] > 0) & (model.radii[rows] < extent)).all()
    assert len(np.unique(rows)) == len(rows)


@pytest.mark.parametrize("normals", [False, True])
@pytest.mark.parametrize("cloud", [in_one_place, in_few_places, *(long(cloud) for cloud in (*CLOUDS[1:], tiny))])
def test_time_is_nearly_proportional_to_the_points(cloud, normals):
    outcome(cloud(3000), normals)  # compiles missing kernels
    few = min(outcome(cloud(FEW), normals)[1] for _ in range(2))
    assert outcome(cloud(MANY), normals)[1] < MOST * max(few, LEAST)
