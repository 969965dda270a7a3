"""Loads files into a scene that is shown meanwhile: a coarse version, then all points, then levels of detail."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from ..auto_view.first_view import Scan, ViewChoice
from ..auto_view.studio import CLAY, with_direct_light
from ..base.warning_log import collect_warnings
from ..cloud.normals.validation import check_normals_choice, refit_normals, validate_normals
from ..cloud.outliers import without_strays
from ..cloud.points import Points, spread_rows
from ..io.files import read, request_of
from ..io.previews import preview_resolution
from ..io.remote.remote_file import Location, RemoteFile, local_copy
from ..model.model import SURFACE, Model
from ..model.model_cache import Entry, built
from ..model.model_file import SAVED
from ..rendering.settings import Settings
from ..rendering.warmup import NORMALS, expect, is_warm, wait_until_warm
from ..scene.scene import Scene
from ..scenefile import Plan
from ..shade.materials.diffuse import Diffuse
from ..surface.splats.radii import radii_in
from .shared_scene import SharedScene
from .sketch import Sketch
from .thread_priority import LEVELS, run_niced

COARSE = 60_000  # points of the coarse version, built in about 0.3 s
LARGE_FROM = 4 * COARSE  # points above which a coarse version is built

Group = list[Location] | Points | Model  # what one model is made of


@dataclass(frozen=True)
class FileLoader:
    """Loads files for the viewer: scans, which form one cloud, and saved models, all in one scene.

    Called with a `SharedScene`, which it updates: first with a coarse version of large scans, then with all points. Of
    remote COPC files, the points of the coarse version are fetched first.

    Parameters
    ----------
    paths : sequence of Path or RemoteFile
    surface : dict
        surface, samples, radius_scale and smooth, as `Model` takes them.
    choice : ViewChoice
        How to view the scans.
    set_up_scene : callable
        Adds lights, ground and background to a scene with its models; returns the up direction.
    leveled : bool
        Whether large scans get levels of detail.
    normals : {"auto", "file", "fit"}
        Whether to use the file's normals or to fit them.
    light : callable, optional
        Called with a scene and `SharedScene.report`, returns its baked light. The scene is shown only with this light.
    reading : dict
        Arguments of `read` for the scans.
    entry : Entry, optional
        Cache entry of the scans' model, from which it is loaded, or in which it is stored at the end.
    drop_strays : bool
        Whether to remove strays from the scans.
    memory : int, optional
        Memory budget in bytes of the open parts of a model, see `Model.load`.
    clouds : sequence of Points or Model
        Shown beside the files.
    """

    paths: Sequence[Location]
    surface: dict[str, Any]
    set_up_scene: Callable[[Scene], tuple[float, float, float]]
    leveled: bool = True
    normals: str = "auto"
    choice: ViewChoice = ViewChoice()
    light: Callable[[Scene, Callable[[str, float | None], None]], Any] | None = None
    reading: Mapping[str, Any] = field(default_factory=dict)
    entry: Entry | None = None
    drop_strays: bool = False
    memory: int | None = None
    clouds: Sequence[Points | Model] = ()

    @property
    def _groups(self) -> list[Group]:
        """What each model is made of: the paths of all scans together, of a saved model, or points in memory."""
        scans = [path for path in self.paths if path.suffix.lower() != SAVED]
        return [*([scans] if scans else []), *([path] for path in self.paths if path not in scans), *self.clouds]

    def __call__(self, shared: SharedScene) -> None:
        notes: list[str] = []
        is_shown = self._preview(shared)
        clouds = [self._read(group, shared) for group in self._groups]
        found = bool(self.entry) and isinstance(clouds[0], Model)
        samples = [self._sample(cloud, k) for k, cloud in enumerate(clouds)]
        self._prepare(clouds, samples, shared)
        if not is_shown and self.light is None and any(_is_large(cloud) for cloud in clouds):
            shared.report("building a coarse version", None)
            # Small scans are built here and not again below.
            clouds = [c if _is_large(c) else self._build_model(c, k, shared, notes) for k, c in enumerate(clouds)]
            pairs = enumerate(zip(clouds, samples, strict=True))
            coarse = [c if isinstance(c, Model) else self._coarse(sample, k) for k, (c, sample) in pairs]
            self._show(coarse, shared, coarse=True)
        models = [self._build_model(cloud, k, shared, notes) for k, cloud in enumerate(clouds)]
        without_levels = [model for model in models if self.leveled and _lacks_levels(model)]
        if without_levels and self.light is None:
            self._show(models, shared)
        for model in without_levels:
            run_niced(
                LEVELS, partial(model.make_levels, lambda stage, share: shared.report(f"building: {stage}", share))
            )
        self._show(models, shared)  # again: the range of an attribute's colours includes the levels
        if self.entry is not None and (not found or models[0] in without_levels):
            run_niced(LEVELS, partial(self.entry.store, models[0], notes))

    def _show(self, models: Sequence[Model], shared: SharedScene, coarse: bool = False) -> None:
        """Show a scene of models once the kernels that draw it are compiled.

        shared : the scene of all browsers; coarse : whether a finer version follows
        """
        scene = self._scene(models, shared)
        if self.light is not None:
            scene.baked = self.light(scene, shared.report)
        first = self._first(shared)
        if not is_warm(first):
            shared.report("", None)
            wait_until_warm(first)
        shared.show(scene, coarse=coarse)

    def _first(self, shared: SharedScene) -> Settings:
        """Return settings of the first images: with direct light, unless the scene comes with baked light.

        Nothing is shown before the kernel for these settings is compiled.
        """
        return shared.settings if self.light is not None else with_direct_light(shared.settings)

    def _prepare(self, clouds: Sequence[Points | Model], samples: Sequence[Points], shared: SharedScene) -> None:
        """Show samples of the clouds as dots if the kernel that renders is not compiled yet.

        If normals must be fitted, also announce the kernels for this, for the estimate of the remaining time.

        clouds : the points or model of each group of files; samples : at most COARSE (60,000) points of each
        """
        if any(sample.normals is None for sample in samples):
            expect(NORMALS)
        if not is_warm(self._first(shared)):
            sketch = Sketch(samples, [len(_points(cloud)) for cloud in clouds])
            shared.show_sketch(sketch, Scan(sketch.points, self.choice).up)

    def _preview(self, shared: SharedScene) -> bool:
        """Show a coarse version of remote COPC files before they are downloaded; return whether that was done.

        Only the coarse levels of their octrees are fetched. It is not done if their model is in the cache, and for
        files beside other models.
        """
        groups = self._groups
        if self.light is not None or len(groups) > 1 or (self.entry is not None and self.entry.path.exists()):
            return False
        files = groups[0]
        if not isinstance(files, list) or not all(isinstance(file, RemoteFile) for file in files):
            return False
        shared.report("reading a coarse version", None)
        chosen = {name: self.reading[name] for name in ("bounds", "resolution", "strict") if name in self.reading}
        resolution = preview_resolution(files, request_of(**chosen), 2 * COARSE)
        if resolution is None:
            return False
        try:
            with collect_warnings():  # they follow when all points are read
                points = read(files, **{**self.reading, "resolution": resolution})  # type: ignore[arg-type]
        except ValueError:  # no selected points, for example
            return False
        sample = self._sample(points, 0)
        self._prepare([points], [sample], shared)
        self._show([self._coarse(sample, 0)], shared, coarse=True)
        return True

    def _read(self, files: Group, shared: SharedScene) -> Points | Model:
        if not isinstance(files, list):
            return files
        stage = f"reading {files[0].name if len(files) == 1 else f'{len(files):,} files'}"
        shared.report(stage, None)
        if files[0].suffix.lower() == SAVED:
            with local_copy(files[0], shared.report) as path:
                return Model.load(path, memory=self.memory)
        known = None if self.entry is None else self.entry.load()
        if known is not None:
            known.levels = known.levels if self.leveled else ()
            return known

        def report(name: str, share: float) -> None:
            shared.report(name if name.startswith("downloading") else stage, share)

        points = read(files, progress=report, **self.reading)  # type: ignore[arg-type]  # RemoteFiles too
        for file in files:
            if isinstance(file, RemoteFile):
                file.release()
        if self.drop_strays:
            points = without_strays(points, files[0].name, progress=shared.report)
        with _with_file_name(files):
            check_normals_choice(points, self.normals)
        return points

    def _sample(self, cloud: Points | Model, number: int) -> Points:
        """Return at most COARSE (60,000) points of a scan or model, for a coarse version and for dots shown before it.

        A scan's points have no normals if these are unwanted or deviate too much from the surface of this sample.

        number : index of the group of files that it comes from, for error messages
        """
        points = _points(cloud)
        if isinstance(cloud, Model) and cloud.parts:  # reading all points would take long
            return points.select(spread_rows(len(points), COARSE))
        if len(points) > COARSE:
            rows = np.flatnonzero(points.finite)
            rows = np.random.default_rng(0).choice(rows, min(COARSE, len(rows)), replace=False, shuffle=False)
            points = points.select(np.sort(rows))
        if isinstance(cloud, Model):
            return points
        with _with_file_name(self._groups[number]), collect_warnings():  # warnings follow when all points are processed
            points, wrong = validate_normals(points, self.normals)
        return points.with_normals(None) if wrong else points

    def _coarse(self, sample: Points, number: int) -> Model:
        with _with_file_name(self._groups[number]), collect_warnings():
            return Model(sample, **self.surface)

    def _build_model(self, cloud: Points | Model, number: int, shared: SharedScene, notes: list[str]) -> Model:
        if isinstance(cloud, Model):
            return cloud

        def report(stage: str, share: float) -> None:
            shared.report(f"building: {stage}", share)

        def build() -> Model:
            points, wrong = validate_normals(cloud, self.normals)
            points = refit_normals(points, report) if wrong else points
            return Model(points, radii_in(points), **self.surface, progress=report)

        with _with_file_name(self._groups[number]):
            model, new_notes = built(build)
        notes += new_notes
        return model

    def _scene(self, models: Sequence[Model], shared: SharedScene) -> Scene:
        scene = Scene()
        for model in models:
            scene.add(model, material=None if model.points.colors is not None else Diffuse(CLAY))
        shared.up = self.set_up_scene(scene)
        return scene


def _points(cloud: Points | Model) -> Points:
    return cloud.points if isinstance(cloud, Model) else cloud


def _is_large(cloud: Points | Model) -> bool:
    return isinstance(cloud, Points) and len(cloud) > LARGE_FROM


def _lacks_levels(model: Model) -> bool:
    """Return whether a model should get levels of detail: if it is large and its surface is the default one."""
    return not (model.parts or model.levels) and model.surface == SURFACE and len(model.points) > LARGE_FROM


@contextmanager
def _with_file_name(files: Group) -> Iterator[None]:
    """Prepend the name of the file, or the number of files, to the message of a ValueError raised in this context."""
    try:
        yield
    except ValueError as error:
        if not isinstance(files, list):
            raise
        raise ValueError(f"{files[0]}: {error}" if len(files) == 1 else f"{len(files):,} files: {error}") from error


@dataclass(frozen=True)
class SceneFileLoader:
    """Loads a scene file (TOML) for the viewer. plan : the parsed file

    Called with a `SharedScene`, which it updates with the scene, its camera and its exposure.
    """

    plan: Plan

    def __call__(self, shared: SharedScene) -> None:
        made = self.plan.build(shared.report)
        shared.exposure, shared.curve = float(made.exposure), made.curve
        shared.show(made.scene, made.camera)
