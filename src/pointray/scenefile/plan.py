"""A scene file, checked from its first key to its last; and from there to the scene."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..image import write_image
from ..image.tone import check_tone
from ..rendering.camera import Camera
from ..rendering.settings import Settings
from ..scene.scene import Scene
from .lines import Key
from .looks import check_lights, check_material, make_light
from .models import check_model, load_model
from .places import check_cut, check_instance, check_plane, matrices
from .source import Source
from .words import Word, check_table, words_of

BOX = [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]  # a camera is tried on it before there are models

AIMED = words_of(Camera.look_at)
FRAMED = {**words_of(Camera.frame, "bounds"), **{name: AIMED[name] for name in ("aperture", "focus")}}
ROOT = {
    **words_of(write_image, "path", "image"),
    "background": Word(("str", "ArrayLike", "None"), False),
    **dict.fromkeys(("camera", "settings", "models", "materials"), Word(("dict",), False)),
    **dict.fromkeys(("instances", "planes", "lights", "clips"), Word(("list",), False)),
}

Say = Callable[[str, float], None]


class SceneFile(NamedTuple):
    """What a scene file describes, ready for `render` and `write_image`.

    Attributes
    ----------
    scene : Scene
    camera : Camera
    settings : Settings
    exposure : float
        Stops, and
    curve : str
        as `write_image` takes them.
    """

    scene: Scene
    camera: Camera
    settings: Settings
    exposure: float
    curve: str


class Plan:
    """A scene file without any mistake that can be seen before the files that it names are read.

    Attributes
    ----------
    camera : dict
        What `Camera.look_at` or `Camera.frame` is told.
    settings : Settings
    background : array_like, "environment" or None
    exposure : float
    curve : str

    Raises
    ------
    OSError
        If the file, or one that it names, cannot be opened.
    ValueError
        If anything in it is wrong.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._source = source = Source(path)
        root = check_table(source, (), ROOT)
        self._models = {name: check_model(source, ("models", name)) for name in root.get("models", ())}
        self._materials = {name: check_material(source, ("materials", name)) for name in root.get("materials", ())}
        self._places = [check_instance(source, key, self._models, self._materials) for key in _rows(root, "instances")]
        self._places += [check_plane(source, key, self._materials) for key in _rows(root, "planes")]
        self._lamps = check_lights(source, _rows(root, "lights"))
        self._clips = [check_cut(source, key) for key in _rows(root, "clips")]
        self.settings = self._check_settings()
        self.camera = self._check_camera()
        self.background: Any = root.get("background")
        self.exposure: float = root.get("exposure", 0.0)
        self.curve: str = root.get("curve", "srgb")
        with source.telling((), root):
            self._check_look()

    @property
    def files(self) -> list[Path]:
        """The scene file, and those that it names."""
        named = [recipe.file for recipe in self._models.values()] + [place.many for place in self._places]
        named += [lamp.values.get("image") for lamp in self._lamps]
        return [self._source.file, *(path for path in named if isinstance(path, Path))]

    def error(self, name: str, message: str) -> ValueError:
        """What is wrong with a value that the file has, or should have, at its top."""
        return self._source.error((name,), message)

    def _check_look(self) -> None:
        check_tone(self.exposure, self.curve)
        Scene().background = self.background

    def _check_settings(self) -> Settings:
        key = ("settings",)
        values = check_table(self._source, key, words_of(Settings)) if "settings" in self._source.data else {}
        with self._source.telling(key, values):
            return Settings(**values)

    def _check_camera(self) -> dict[str, Any]:
        key, table = ("camera",), self._source.data.get("camera", {})
        words = AIMED if "eye" in table or "target" in table else FRAMED
        values = check_table(self._source, key, words) if table else {}
        if "eye" not in values and not any(isinstance(place.shape, str) for place in self._places):
            raise self._source.error(key, "eye and target are missing, and there are no instances to be framed")
        with self._source.telling(key, values):
            camera_of(values, BOX)
        return values

    def change(self, camera: dict[str, Any], settings: dict[str, Any], look: dict[str, Any]) -> None:
        """Other values than the file's, where there are any; look: background, exposure. ValueError if one is wrong."""
        self.settings = replace(self.settings, **settings)
        self.camera = {**self.camera, **camera}
        if "eye" in camera or "target" in camera:
            self.camera.pop("direction", None)
        camera_of(self.camera, BOX)
        self.background = look.get("background", self.background)
        self.exposure = look.get("exposure", self.exposure)
        self._check_look()

    def build(self, progress: Say | None = None) -> SceneFile:
        """Read the files and make the scene: instances in the order of the file, then planes."""
        source, say = self._source, progress or (lambda stage, share: None)
        scene = Scene()
        scene.background = self.background
        scene.clips = np.array(self._clips).reshape(-1, 2, 3)
        for lamp in self._lamps:
            scene.add_light(make_light(source, lamp))
        places = [(place, matrices(source, place)) for place in self._places]
        used = dict.fromkeys(place.shape for place in self._places if isinstance(place.shape, str))
        models = {name: load_model(source, self._models[name], say) for name in used}
        for place, transforms in places:
            shape = models[place.shape] if isinstance(place.shape, str) else place.shape
            material = None if place.material is None else self._materials[place.material]
            for matrix in transforms:
                scene.add(shape, matrix, material)
        camera = camera_of(self.camera, scene.bounds if models else BOX)
        return SceneFile(scene, camera, self.settings, self.exposure, self.curve)


def camera_of(told: Mapping[str, Any], bounds: ArrayLike) -> Camera:
    """The camera that the words of a file describe, for a scene with these bounds."""
    if "eye" in told or "target" in told:
        for name in ("eye", "target"):
            if name not in told:
                raise ValueError(f"a camera has eye and target, or neither and is framed: {name} is missing")
        return Camera.look_at(**told)
    lens = {name: told[name] for name in ("aperture", "focus") if name in told}
    framed = Camera.frame(bounds, **{name: value for name, value in told.items() if name not in lens})
    return replace(framed, **lens)


def _rows(root: dict[str, Any], name: str) -> list[Key]:
    return [(name, k) for k in range(len(root.get(name, ())))]
