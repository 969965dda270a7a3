"""A scene file: first checked completely, then built into a scene."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..baking.baked import Baked, bake
from ..image import write_image
from ..image.tone import check_tone
from ..rendering.camera import Camera
from ..rendering.settings import Settings
from ..scene.scene import Scene
from .instances import check_clip_plane, check_instance, check_plane, count_matrices, load_matrices
from .light import check_bake, load_light
from .lines import Key
from .models import check_contents, check_model, load_model
from .shading import check_lights, check_material, make_light
from .source import Source
from .words import Word, check_table, words_of

BOX = [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]  # bounds for checking a camera before there are models

LOOK_AT = words_of(Camera.look_at)
FRAME = {**words_of(Camera.frame, "bounds"), **{name: LOOK_AT[name] for name in ("aperture", "focus")}}
ROOT = {
    **words_of(write_image, "path", "image"),
    "background": Word(("str", "ArrayLike", "None"), False),
    **dict.fromkeys(("camera", "settings", "bake", "models", "materials"), Word(("dict",), False)),
    **dict.fromkeys(("instances", "planes", "lights", "clips"), Word(("list",), False)),
}

Report = Callable[[str, float], None]


class SceneFile(NamedTuple):
    """The contents of a scene file, for `render` and `write_image`.

    Attributes
    ----------
    scene : Scene
    camera : Camera
    settings : Settings
    exposure : float
        In stops; an argument of `write_image`.
    curve : str
        Name of the tone curve; an argument of `write_image`.

    Examples
    --------
    >>> with open("ball.toml", "w") as file:
    ...     print('models.ball = {procedural = "sphere", points = 1000}', file=file)
    ...     print('instances = [{model = "ball"}]', file=file)
    >>> loaded = pr.load_scene("ball.toml")
    >>> loaded.settings.integrator, loaded.exposure, loaded.curve
    ('phong', 0.0, 'srgb')
    """

    scene: Scene
    camera: Camera
    settings: Settings
    exposure: float
    curve: str


class Plan:
    """A scene file, completely checked, from which `build` makes the scene. The files that it names have not been read.

    Attributes
    ----------
    camera : dict
        Keyword arguments of `Camera.look_at`, or of `Camera.frame` for a camera that shows the whole scene.
    settings : Settings
    background : array_like, "environment" or None
    exposure : float
        In stops.
    curve : str
        Name of the tone curve.
    bake : BakePlan
        Where the baked light comes from, for the integrator "baked".

    Raises
    ------
    OSError
        If the file, or one that it refers to, cannot be opened.
    ValueError
        If the file is invalid.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._source = source = Source(path)
        root = check_table(source, (), ROOT)
        self._models = {name: check_model(source, ("models", name)) for name in root.get("models", ())}
        self._materials = {name: check_material(source, ("materials", name)) for name in root.get("materials", ())}
        self._placements = [
            check_instance(source, key, self._models, self._materials) for key in _rows(root, "instances")
        ]
        self._placements += [check_plane(source, key, self._materials) for key in _rows(root, "planes")]
        self._lights = check_lights(source, _rows(root, "lights"))
        self._clips = [check_clip_plane(source, key) for key in _rows(root, "clips")]
        self.settings = self._check_settings()
        self.bake = check_bake(source, self.settings.seed)
        self.camera = self._check_camera()
        self.background: Any = root.get("background")
        self.exposure: float = root.get("exposure", 0.0)
        self.curve: str = root.get("curve", "srgb")
        with source.errors_at((), root):
            self._check_root()

    @property
    def files(self) -> list[Path]:
        """The scene file and all files that it names: scans, models, matrices, environment maps, baked light.

        Baked light is included only if images show it and its file exists.
        """
        named = [recipe.file for recipe in self._models.values()]
        named += [placement.matrices for placement in self._placements]
        named += [light.values.get("image") for light in self._lights]
        named += [self.bake.found] if self.is_baked else []
        return [self._source.file, *(path for path in named if isinstance(path, Path))]

    @property
    def is_baked(self) -> bool:
        """Whether images show baked light: the integrator is "baked"."""
        return self.settings.integrator == "baked"

    @property
    def model_instances(self) -> int:
        """Number of instances of models in the scene, without planes."""
        return sum(count_matrices(placement) for placement in self._placements if isinstance(placement.shape, str))

    def error(self, name: str, message: str) -> ValueError:
        """Return a ValueError whose message begins with file, line and name of a top-level key, present or missing."""
        return self._source.error((name,), message)

    def _check_root(self) -> None:
        check_tone(self.exposure, self.curve)
        Scene().background = self.background

    def _check_settings(self) -> Settings:
        key = ("settings",)
        values = check_table(self._source, key, words_of(Settings)) if "settings" in self._source.data else {}
        with self._source.errors_at(key, values):
            return Settings(**values)

    def _check_camera(self) -> dict[str, Any]:
        key, table = ("camera",), self._source.data.get("camera", {})
        words = LOOK_AT if "eye" in table or "target" in table else FRAME
        values = check_table(self._source, key, words) if table else {}
        if "eye" not in values and not any(isinstance(placement.shape, str) for placement in self._placements):
            raise self._source.error(
                key, "eye and target are missing, and there are no instances for an automatic camera"
            )
        with self._source.errors_at(key, values):
            camera_of(values, BOX)
        return values

    def change(self, camera: dict[str, Any], settings: dict[str, Any], root: dict[str, Any]) -> None:
        """Replace values of the file by those of command-line options; raise ValueError if a new one is invalid.

        Each dict has only the values to replace, by name.

        camera : arguments of `Camera.look_at` or `Camera.frame`; settings : fields of `Settings`
        root : "background" and "exposure"
        """
        self.settings = replace(self.settings, **settings)
        self.camera = {**self.camera, **camera}
        if "eye" in camera or "target" in camera:
            self.camera.pop("direction", None)
        camera_of(self.camera, BOX)
        self.background = root.get("background", self.background)
        self.exposure = root.get("exposure", self.exposure)
        self._check_root()

    def build(self, progress: Report | None = None, lit: bool = True) -> SceneFile:
        """Read the files that the scene file names, and build the scene: instances in the file's order, then planes.

        progress : called with the name of a stage and its completed fraction
        lit : whether to add baked light if images show it; False leaves that to the caller
        """
        source, report = self._source, progress or (lambda stage, share: None)
        scene = Scene()
        scene.background = self.background
        scene.clips = np.array(self._clips).reshape(-1, 2, 3)
        for light in self._lights:
            scene.add_light(make_light(source, light))
        placements = [(placement, load_matrices(source, placement)) for placement in self._placements]
        used = dict.fromkeys(placement.shape for placement in self._placements if isinstance(placement.shape, str))
        for name in used:
            check_contents(source, self._models[name])
        models = {name: load_model(source, self._models[name], report) for name in used}
        for placement, matrices in placements:
            shape = models[placement.shape] if isinstance(placement.shape, str) else placement.shape
            material = None if placement.material is None else self._materials[placement.material]
            for matrix in matrices:
                scene.add(shape, matrix, material)
        if lit and self.is_baked:
            scene.baked = self._light(scene, report)
        camera = camera_of(self.camera, scene.bounds if models else BOX)
        return SceneFile(scene, camera, self.settings, self.exposure, self.curve)

    def _light(self, scene: Scene, report: Report) -> Baked:
        """Return the baked light of the scene: read from a file, or baked if none is named or it does not exist."""
        plan, file = self.bake, self.bake.found
        if file is None:
            report("baking light", 0.0)
            with self._source.errors_at(()):
                return bake(scene, plan.settings, report)
        report("reading light", 0.0)
        with nullcontext() if plan.key is None else self._source.errors_at(plan.key):
            return load_light(file, scene)


def camera_of(values: Mapping[str, Any], bounds: ArrayLike) -> Camera:
    """Make the camera of a scene file.

    values : arguments of `Camera.look_at` if they include eye and target, otherwise of `Camera.frame`
    bounds : (2, 3), minimum and maximum of the scene, which `Camera.frame` shows completely
    """
    if "eye" in values or "target" in values:
        for name in ("eye", "target"):
            if name not in values:
                raise ValueError(f"{name} is missing: set both eye and target, or neither for an automatic camera")
        return Camera.look_at(**values)
    lens = {name: values[name] for name in ("aperture", "focus") if name in values}
    framed = Camera.frame(bounds, **{name: value for name, value in values.items() if name not in lens})
    return replace(framed, **lens)


def _rows(root: dict[str, Any], name: str) -> list[Key]:
    return [(name, k) for k in range(len(root.get(name, ())))]
