"""From files to a scene that is shown while it comes: a coarse version of some of the points, all, levels of detail."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..data import Points
from ..model import Model
from ..points.files import read
from ..points.trust import judged, replaced
from ..saved import SAVED
from ..scene import Scene
from ..scenefile import Plan
from ..shade.materials import Diffuse
from ..splats.radii import radii_in
from ..staging.first_view import Scan, ViewChoice
from ..staging.studio import ALBEDO
from ..warmup import NORMALS, expect, is_warm, wait_until_warm
from .sketch import Sketch
from .subject import Subject

COARSE = 60_000  # points of the coarse version: built in some 0.3 s
WORTH = 4 * COARSE  # points from which it is


@dataclass(frozen=True)
class Files:
    """Scans and saved models, together in one scene: a `subject.Loader`.

    Parameters
    ----------
    surface : dict
        surface, samples and radius_scale, as `Model` takes them.
    choice : ViewChoice
        How the scans are seen.
    furnish : callable
        Puts lights and the like into a scene that has its models; returns which way is up in it.
    leveled : bool
        Whether large scans get levels of detail.
    normals : {"auto", "file", "fit"}
        Whose normals scans have.
    """

    paths: Sequence[Path]
    surface: dict[str, Any]
    furnish: Callable[[Scene], tuple[float, float, float]]
    leveled: bool = True
    normals: str = "auto"
    choice: ViewChoice = ViewChoice()

    def __call__(self, subject: Subject) -> None:
        clouds: list[Points | Model] = []
        wrong: list[bool] = []  # whether there are normals, to be replaced
        for path in self.paths:
            cloud, replace = self._read(path, subject)
            clouds.append(cloud)
            wrong.append(replace)
        self._prepare(clouds, wrong, subject)
        if any(_is_large(cloud) for cloud in clouds):
            subject.say("building a coarse version", None)
            # Small ones are models from here on, and not built again.
            clouds = [c if _is_large(c) else self._whole(c, k, wrong[k], subject) for k, c in enumerate(clouds)]
            self._show([self._coarse(c, replace) for c, replace in zip(clouds, wrong, strict=True)], subject)
        models = [self._whole(cloud, k, wrong[k], subject) for k, cloud in enumerate(clouds)]
        self._show(models, subject)
        large = [model for cloud, model in zip(clouds, models, strict=True) if _is_large(cloud)]
        if self.leveled and large:
            for model in large:
                model.make_levels(lambda stage, share: subject.say(f"building: {stage}", share))
            self._show(models, subject)  # anew: what colours the points by an attribute counts the levels too

    def _show(self, models: Sequence[Model], subject: Subject) -> None:
        """Put models into the place of what was shown, as soon as their pictures can be drawn."""
        if not is_warm(subject.settings):
            subject.say("", None)
            wait_until_warm(subject.settings)
        subject.show(self._scene(models, subject))

    def _prepare(self, clouds: Sequence[Points | Model], wrong: Sequence[bool], subject: Subject) -> None:
        """Say which kernels will be needed; where pictures cannot be drawn yet a sketch is seen."""
        known = [cloud.points if isinstance(cloud, Model) else cloud for cloud in clouds]
        known = [cloud.with_normals(None) if bad else cloud for cloud, bad in zip(known, wrong, strict=True)]
        if any(cloud.normals is None for cloud in known):
            expect(NORMALS)
        if not is_warm(subject.settings):
            sketch = Sketch(known)
            subject.outline(sketch, Scan(sketch.points, self.choice).up)

    def _read(self, path: Path, subject: Subject) -> tuple[Points | Model, bool]:
        """What is in a file, and whether its normals are to be replaced."""
        stage = f"reading {path.name}"
        subject.say(stage, None)
        if path.suffix.lower() == SAVED:
            return Model.load(path), False
        points = read(path, partial(subject.say, stage))
        try:
            return judged(points, self.normals, name=path.name if len(self.paths) > 1 else "")
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error

    def _coarse(self, cloud: Points | Model, wrong: bool) -> Model:
        """Of some of the points."""
        if isinstance(cloud, Model):
            return cloud
        rows = np.random.default_rng(0).choice(np.flatnonzero(cloud.finite), COARSE)
        some = cloud.select(np.unique(rows))
        with warnings.catch_warnings():  # what there is to say is said of all points
            warnings.simplefilter("ignore")
            return Model(some.with_normals(None) if wrong else some, **self.surface)

    def _whole(self, cloud: Points | Model, number: int, wrong: bool, subject: Subject) -> Model:
        if isinstance(cloud, Model):
            return cloud

        def say(stage: str, share: float) -> None:
            subject.say(f"building: {stage}", share)

        try:
            points = replaced(cloud, partial(say, "normals")) if wrong else cloud
            return Model(points, radii_in(points), **self.surface, progress=say)
        except ValueError as error:
            raise ValueError(f"{self.paths[number]}: {error}") from error

    def _scene(self, models: Sequence[Model], subject: Subject) -> Scene:
        scene = Scene()
        for model in models:
            scene.add(model, material=None if model.points.colors is not None else Diffuse(ALBEDO))
        subject.up = self.furnish(scene)
        return scene


def _is_large(cloud: Points | Model) -> bool:
    return isinstance(cloud, Points) and len(cloud) > WORTH


@dataclass(frozen=True)
class Described:
    """The scene of a scene file: a `subject.Loader`."""

    plan: Plan

    def __call__(self, subject: Subject) -> None:
        made = self.plan.build(subject.say)
        subject.exposure, subject.curve = float(made.exposure), made.curve
        subject.show(made.scene, made.camera)
