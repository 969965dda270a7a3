"""Pictures whose rays travel to those who hold the models: the same to the last bit as with all models at hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pointray as pr
from clusters import ball, camera_of, scene_of
from pointray.parts.split import split
from pointray.rendering.picture import kernel_for
from pointray.rendering.plan import plan
from pointray.rendering.waves.recall import recalled_for
from pointray.rendering.waves.route import route
from pointray.rendering.waves.spread import NOTHING
from pointray.rendering.waves.travel import View, held_world
from pointray.rendering.waves.wave import Pictured, Question, Waves, answer_question, passes_of, pieces_of
from pointray.scene.shares import Shares, boxes_of


def by_waves(scene: pr.Scene, camera: pr.Camera, settings: pr.Settings, holders: int) -> tuple[Any, list[int]]:
    """A picture of models that so many hold, all in this process; and how many rays each was asked."""
    now = scene.snapshot().seen_by(camera.record())
    world, job = plan(now, camera, settings, held=NOTHING)
    names = [str(k) for k in range(holders)]
    shares = Shares(now, names)
    view = View(camera, settings.most if settings.levels else None)
    worlds = [held_world(now, view, shares.of(name)) for name in names]
    boxes = boxes_of(now, shares.rows)
    film = np.zeros((camera.size[1], camera.size[0], 8), np.float32)
    image = np.empty((camera.size[1], camera.size[0], 4), np.float32)
    kernel = recalled_for(kernel_for(settings))
    picture = Pictured(kernel, world, camera.record(), job, film, image, None)
    asked = [0] * holders
    for piece in pieces_of(camera.size, (0, settings.spp)):
        for samples in passes_of((0, settings.spp)):
            waves = Waves(picture, piece, samples)
            while (question := waves.ask()) is not None:
                meets = route(question.rays, boxes, shares.owners, holders, None)
                for k in reversed(range(holders)):
                    some = np.flatnonzero(meets[:, k])
                    part = Question(question.rays[some], int((some < question.closest).sum()))
                    waves.take(some, answer_question(worlds[k], part))
                    asked[k] += len(some)
    return image, asked


@pytest.fixture(scope="module")
def parted(tmp_path_factory: pytest.TempPathFactory) -> pr.Model:
    rng = np.random.default_rng(2)
    points = pr.procedural("statue", 60_000)
    colors = rng.integers(0, 256, points.positions.shape).astype(np.uint8)
    attributes = {"height": points.positions[:, 2], "class": rng.integers(0, 5, len(points)).astype(np.uint8)}
    model = pr.Model(pr.Points(points.positions, points.normals, colors, attributes))
    folder = tmp_path_factory.mktemp("parts") / "a.pointray"
    split(model, folder, 16_384)
    return pr.Model.load(folder)


SETTINGS = [
    pr.Settings(),
    pr.Settings(spp=3, sky_rays=2),
    pr.Settings("ao", spp=2),
    pr.Settings("path", spp=5),
    pr.Settings("path", max_depth=8),
    pr.Settings("color"),
    pr.Settings("normal"),
    pr.Settings("depth"),
]


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda settings: f"{settings.integrator}-{settings.spp}")
def test_a_picture_by_waves_is_the_same(parted: pr.Model, settings: pr.Settings) -> None:
    scene = scene_of(ball())
    scene.add(parted, pr.transform(translate=(0.6, -1.2, 0), scale=0.8))
    scene.add(parted, pr.transform(translate=(-1, -1, 0), scale=0.5, rotate=70), pr.Phong(pr.Attribute("height")))
    scene.add(pr.Plane((0, 2, 0), (0, -1, 0)), material=pr.Mirror())
    scene.add(ball(), pr.transform(translate=(-1.4, -0.5, 0.3), scale=0.4), pr.Dielectric())
    camera = camera_of()
    image, asked = by_waves(scene, camera, settings, 3)
    np.testing.assert_array_equal(image, pr.render(scene, camera, settings))
    assert min(asked) > 1000
