"""pointray: ray tracing of point clouds, interactively, on an ordinary PC.

>>> import pointray as pr
>>> model = pr.Model(pr.read("scan.ply"))
>>> scene = pr.Scene()
>>> instance = scene.add(model)
>>> pr.write_image("scan.png", pr.render(scene, pr.frame(scene)))
"""

from __future__ import annotations

import importlib
from typing import Any

import lazy_loader

from .base.deprecation import warn_renamed
from .base.executor import register_backend
from .base.registered import register

# `__init__.pyi` lists the public names, which are imported on first use: `import pointray` is fast.
_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

_ROOMS = ("compat",)  # modules for users, imported on first use
_RENAMED = {"Survey": "Georeference"}  # deprecated aliases

# The only dependencies on higher layers: Dask executors for rendering and baking, when a client is given; conversions
# of objects of other libraries for `cloud/`; the scene that the command line makes of a scan; and ray queries for
# `Model.to_mesh`.
register_backend(lambda: importlib.import_module(".cluster.backend", __name__))
register("exchange", lambda: importlib.import_module(".io.exchange.convert", __name__))
register("default_scene", lambda: importlib.import_module(".auto_view.default_scene", __name__))
register("meshing", lambda: importlib.import_module(".scene.meshing", __name__))


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        warn_renamed(f"pointray.{name}", f"pointray.{_RENAMED[name]}")
        return _load(_RENAMED[name])
    if name in __all__:
        return _load(name)
    if name in _ROOMS:
        return importlib.import_module(f".{name}", __name__)
    import difflib

    near = difflib.get_close_matches(name, __all__, 1)
    advice = f": did you mean {near[0]!r}?" if near and not name.startswith("_") else ""
    raise AttributeError(f"module 'pointray' has no attribute {name!r}{advice}", name=name)
