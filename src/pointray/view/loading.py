"""From files to a scene that is shown while it comes: first a coarse version, of some of the points, then all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..data import Points
from ..model import Model
from ..points.files import check_readable, check_regular, read
from ..saved import SAVED
from ..scene import Scene
from ..scenefile import Plan
from ..splats.radii import radii_in

Say = Callable[[str, float | None], None]

COARSE = 60_000  # points of the coarse version: built in some 0.3 s
WORTH = 4 * COARSE  # points from which it is


@dataclass(frozen=True)
class Files:
    """Scans and saved models, together in one scene: a `subject.Loader`.

    Parameters
    ----------
    surface : dict
        surface, samples and radius_scale, as `Model` takes them.
    """

    paths: Sequence[Path]
    surface: dict[str, Any]

    def check(self) -> None:
        """Raise what keeps a file from being opened."""
        for path in self.paths:
            (check_regular if path.suffix.lower() == SAVED else check_readable)(path)

    def __call__(self, show: Callable[[Scene], None], say: Say) -> None:
        clouds: list[Points | Model] = []
        for path in self.paths:
            say(f"reading {path.name}", None)
            clouds.append(Model.load(path) if path.suffix.lower() == SAVED else read(path))
        if any(isinstance(cloud, Points) and len(cloud) > WORTH for cloud in clouds):
            say("building a coarse version", None)
            show(_scene([_coarse(cloud) for cloud in clouds]))
        show(_scene([self._whole(cloud, path, say) for cloud, path in zip(clouds, self.paths, strict=True)]))

    def _whole(self, cloud: Points | Model, path: Path, say: Say) -> Model:
        if isinstance(cloud, Model):
            return cloud
        try:
            return Model(
                cloud, radii_in(cloud), **self.surface, progress=lambda stage, share: say(f"building: {stage}", share)
            )
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error


def _coarse(cloud: Points | Model) -> Model:
    """Of some of the points."""
    if isinstance(cloud, Model) or len(cloud) <= WORTH:
        return cloud if isinstance(cloud, Model) else Model(cloud)
    rows = np.random.default_rng(0).choice(np.flatnonzero(cloud.finite), COARSE)
    return Model(cloud.select(np.unique(rows)))


def _scene(models: Sequence[Model]) -> Scene:
    scene = Scene()
    for model in models:
        scene.add(model)
    return scene


@dataclass(frozen=True)
class Described:
    """The scene of a scene file: a `subject.Loader`."""

    plan: Plan

    def __call__(self, show: Callable[[Scene], None], say: Say) -> None:
        show(self.plan.build(say).scene)
