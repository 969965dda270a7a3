"""Clusters and scenes for the tests of rendering on Dask."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import dask
import distributed
import numpy as np
from distributed import Client, LocalCluster

import pointray as pr
from helpers.clouds import sphere_points
from pointray.cluster.client import UNPROFILED


@contextmanager
def cluster_of(workers: int, processes: bool, threads: int = 1) -> Iterator[Any]:
    """A client of workers on this machine."""
    with (
        dask.config.set({"scheduler": None, **UNPROFILED}),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=threads,
            processes=processes,
            dashboard_address="127.0.0.1:0",
            memory_limit=0,
            silence_logs=50,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        try:
            yield client
        finally:
            _forget_clients()


def _forget_clients() -> None:
    """Tasks of workers in this process make clients, which stay the default for other tests after their workers."""
    distributed.client._global_clients.clear()


def ball(n: int = 3000) -> pr.Model:
    """A sphere with an attribute."""
    rows = sphere_points(n)
    return pr.Model(pr.Points(rows, rows, attributes={"height": rows[:, 2]}))


def scene_of(model: pr.Model) -> pr.Scene:
    """Two balls over a plane that catches shadows, a sun, a lamp with the camera and a sky."""
    scene = pr.Scene()
    scene.add(model, material=pr.Diffuse(pr.Attribute("height")))
    scene.add(model, pr.transform(translate=(1.5, 0.5, 0.2), scale=0.7), pr.Phong((0.8, 0.4, 0.2)))
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1), shadow_catcher=True))
    scene.lights = [pr.SunLight((1, 1, -2)), pr.PointLight((1, 1, 0), 5, camera=True), pr.EnvironmentLight(0.4)]
    return scene


def camera_of(width: int = 200, height: int = 120, turn: float = 0.0) -> pr.Camera:
    """A camera before the balls."""
    eye = (5 * np.sin(turn), -5 * np.cos(turn), 1.5)
    return pr.Camera.look_at(eye, (0.5, 0, 0), fov=40, size=(width, height))


def assert_alike(image: Any, wanted: Any) -> None:
    """A picture is the same to the last bit."""
    assert image.shape == wanted.shape
    assert np.array_equal(image, wanted), f"{(image != wanted).any(axis=2).sum()} pixels differ"
