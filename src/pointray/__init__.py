"""pointray: ray tracing of point clouds, interactively, on an ordinary PC.

>>> import pointray as pr
>>> model = pr.Model(pr.read("scan.ply"))
>>> scene = pr.Scene()
>>> instance = scene.add(model)
>>> pr.write_image("scan.png", pr.render(scene, pr.frame(scene)))
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from .base.deprecation import warn_renamed
from .base.executor import register_backend
from .base.version import __version__ as __version__

# Modules of the public names, imported on first use: `import pointray` is fast.
_HOME = {
    "Attribute": "shade.attributes",
    "BakeSettings": "baking.settings",
    "Baked": "baking.baked",
    "Camera": "rendering.camera",
    "Dielectric": "shade.materials.specular",
    "Diffuse": "shade.materials.diffuse",
    "DiskLight": "shade.lights",
    "EnvironmentLight": "shade.environment",
    "Emissive": "shade.materials.diffuse",
    "Hits": "scene.rays",
    "Mirror": "shade.materials.specular",
    "Model": "model.model",
    "Phong": "shade.materials.phong",
    "Plane": "scene.instances",
    "PointLight": "shade.lights",
    "RectLight": "shade.lights",
    "SphereLight": "shade.lights",
    "Points": "cloud.points",
    "Georeference": "cloud.georeference",
    "Principled": "shade.materials.principled",
    "Scene": "scene.scene",
    "SceneFile": "scenefile",
    "Settings": "rendering.settings",
    "StaleLightWarning": "baking.baked",
    "SunLight": "shade.lights",
    "animate": "rendering.sequence",
    "bake": "baking.baked",
    "check_normals": "cloud.normals.comparison",
    "clean": "cloud.cleaning",
    "draw_legend": "image",
    "estimate_normals": "cloud.normals.estimate",
    "eyes_along": "io.trajectory",
    "find_flaws": "cloud.cleaning",
    "find_strays": "cloud.outliers",
    "fly": "rendering.camera_path",
    "frame": "auto_view.first_view",
    "load_scene": "scenefile",
    "merge_layers": "cloud.outliers",
    "Prepared": "model.preparation",
    "prepare": "model.preparation",
    "procedural": "procedural_models",
    "procedural_distance": "procedural_models",
    "formats": "io.known_formats",  # not `io.formats`, the folder
    "read": "io.files",
    "render": "rendering.picture",
    "render_layers": "rendering.layers",
    "smooth": "cloud.denoising.smooth",
    "studio": "auto_view.studio",
    "subsample": "surface.splats.subsample",
    "transform": "scene.transforms",
    "turntable": "rendering.camera_path",
    "view": "viewer",
    "write": "io.files",
    "write_image": "image",
    "write_layers": "image",
}

_RENAMED = {"Survey": "Georeference"}  # deprecated aliases

__all__ = sorted([*_HOME, "__version__"])

if TYPE_CHECKING:
    from .auto_view.first_view import frame as frame
    from .auto_view.studio import studio as studio
    from .baking.baked import Baked as Baked
    from .baking.baked import StaleLightWarning as StaleLightWarning
    from .baking.baked import bake as bake
    from .baking.settings import BakeSettings as BakeSettings
    from .cloud.cleaning import clean as clean
    from .cloud.cleaning import find_flaws as find_flaws
    from .cloud.denoising.smooth import smooth as smooth
    from .cloud.georeference import Georeference as Georeference
    from .cloud.normals.comparison import check_normals as check_normals
    from .cloud.normals.estimate import estimate_normals as estimate_normals
    from .cloud.outliers import find_strays as find_strays
    from .cloud.outliers import merge_layers as merge_layers
    from .cloud.points import Points as Points
    from .image import draw_legend as draw_legend
    from .image import write_image as write_image
    from .image import write_layers as write_layers
    from .io.files import read as read
    from .io.files import write as write
    from .io.known_formats import formats as formats
    from .io.trajectory import eyes_along as eyes_along
    from .model.model import Model as Model
    from .model.preparation import Prepared as Prepared
    from .model.preparation import prepare as prepare
    from .procedural_models import procedural as procedural
    from .procedural_models import procedural_distance as procedural_distance
    from .rendering.camera import Camera as Camera
    from .rendering.camera_path import fly as fly
    from .rendering.camera_path import turntable as turntable
    from .rendering.layers import render_layers as render_layers
    from .rendering.picture import render as render
    from .rendering.sequence import animate as animate
    from .rendering.settings import Settings as Settings
    from .scene.instances import Plane as Plane
    from .scene.rays import Hits as Hits
    from .scene.scene import Scene as Scene
    from .scene.transforms import transform as transform
    from .scenefile import SceneFile as SceneFile
    from .scenefile import load_scene as load_scene
    from .shade.attributes import Attribute as Attribute
    from .shade.environment import EnvironmentLight as EnvironmentLight
    from .shade.lights import DiskLight as DiskLight
    from .shade.lights import PointLight as PointLight
    from .shade.lights import RectLight as RectLight
    from .shade.lights import SphereLight as SphereLight
    from .shade.lights import SunLight as SunLight
    from .shade.materials.diffuse import Diffuse as Diffuse
    from .shade.materials.diffuse import Emissive as Emissive
    from .shade.materials.phong import Phong as Phong
    from .shade.materials.principled import Principled as Principled
    from .shade.materials.specular import Dielectric as Dielectric
    from .shade.materials.specular import Mirror as Mirror
    from .surface.splats.subsample import subsample as subsample
    from .viewer import view as view


# The only dependency on a higher layer: rendering and baking get Dask executors from here when a client is given.
register_backend(lambda: importlib.import_module(".cluster.backend", __name__))


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        warn_renamed(f"pointray.{name}", f"pointray.{_RENAMED[name]}")
        name = _RENAMED[name]
    if name not in _HOME:
        raise AttributeError(f"module 'pointray' has no attribute {name!r}")
    value = getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
