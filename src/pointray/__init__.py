"""pointray: ray tracing of point clouds, interactively, on an ordinary PC.

>>> import pointray as pr
>>> model = pr.Model(pr.read("scan.ply"))
>>> scene = pr.Scene()
>>> scene.add(model)
>>> pr.write_image("scan.png", pr.render(scene, pr.frame(scene)))
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

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
    "Survey": "cloud.georeference",
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

__all__ = sorted([*_HOME, "__version__"])

if TYPE_CHECKING:
    from .auto_view.first_view import frame as frame
    from .auto_view.studio import studio as studio
    from .baking.baked import Baked as Baked, StaleLightWarning as StaleLightWarning, bake as bake
    from .baking.settings import BakeSettings as BakeSettings
    from .cloud.cleaning import clean as clean, find_flaws as find_flaws
    from .cloud.denoising.smooth import smooth as smooth
    from .cloud.georeference import Survey as Survey
    from .cloud.normals.comparison import check_normals as check_normals
    from .cloud.normals.estimate import estimate_normals as estimate_normals
    from .cloud.outliers import find_strays as find_strays, merge_layers as merge_layers
    from .cloud.points import Points as Points
    from .image import draw_legend as draw_legend, write_image as write_image, write_layers as write_layers
    from .io.files import read as read, write as write
    from .io.known_formats import formats as formats
    from .io.trajectory import eyes_along as eyes_along
    from .model.model import Model as Model
    from .procedural_models import procedural as procedural, procedural_distance as procedural_distance
    from .rendering.camera import Camera as Camera
    from .rendering.camera_path import fly as fly, turntable as turntable
    from .rendering.layers import render_layers as render_layers
    from .rendering.picture import render as render
    from .rendering.sequence import animate as animate
    from .rendering.settings import Settings as Settings
    from .scene.instances import Plane as Plane
    from .scene.rays import Hits as Hits
    from .scene.scene import Scene as Scene
    from .scene.transforms import transform as transform
    from .scenefile import SceneFile as SceneFile, load_scene as load_scene
    from .shade.attributes import Attribute as Attribute
    from .shade.environment import EnvironmentLight as EnvironmentLight
    from .shade.lights import (
        DiskLight as DiskLight,
        PointLight as PointLight,
        RectLight as RectLight,
        SphereLight as SphereLight,
        SunLight as SunLight,
    )
    from .shade.materials.diffuse import Diffuse as Diffuse, Emissive as Emissive
    from .shade.materials.phong import Phong as Phong
    from .shade.materials.principled import Principled as Principled
    from .shade.materials.specular import Dielectric as Dielectric, Mirror as Mirror
    from .surface.splats.subsample import subsample as subsample
    from .viewer import view as view


# The only dependency on a higher layer: rendering and baking get Dask executors from here when a client is given.
register_backend(lambda: importlib.import_module(".cluster.backend", __name__))


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'pointray' has no attribute {name!r}")
    value = getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
