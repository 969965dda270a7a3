"""A scene of two balls between two planes, lights, and settings for a quick bake."""

from functools import cache

import numpy as np

import pointray as pr

QUICK = pr.BakeSettings(links=4, patches=600, noise=1.0)
SKY = pr.EnvironmentLight(1.0, ground=0.3)
SUN = pr.SunLight((-1, 1, -2), 2.0)
COLORS = np.random.default_rng(3).integers(0, 255, (2000, 3), np.uint8)


def ball(**changes):
    """Return a model of a sphere with optional changes."""
    points = pr.procedural("sphere", 2000)
    positions = points.positions * changes.pop("size", 1.0)
    colors = changes.pop("colors", COLORS)
    return pr.Model(pr.Points(positions, changes.pop("normals", points.normals), colors), **changes)


@cache
def plain_ball():
    return ball()


def room(model=None, lights=(SKY, SUN), **changes):
    """Return a scene of two balls between two planes with optional changes."""
    model = plain_ball() if model is None else model
    scene = pr.Scene()
    scene.add(model, material=pr.Diffuse(changes.get("albedo")))
    scene.add(pr.Plane(changes.get("floor", (0, 0, -1)), (0, 0, 1), shadow_catcher=changes.get("catcher", False)))
    scene.add(model, changes.get("place", pr.transform(translate=(2.5, 0, 0), scale=0.8)))
    scene.add(pr.Plane((0, 2, 0), (0, -1, 0), color=(0.8, 0.2, 0.1)))
    scene.clips = changes.get("clips", [((0, 0, 3), (0, 0, 1))])
    scene.lights = lights
    return scene
