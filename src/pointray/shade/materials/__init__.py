"""Materials, one file a kind, with its class and the kernel functions that evaluate and sample it.

Colours are linear RGB or an `Attribute`; None takes the colours of the points. Opaque materials are two-sided. All
materials conserve energy and are reciprocal.

base : base class; diffuse, phong, principled; specular : mirrors and glass

`shade/bsdf.py` calls the functions of each kind. A new kind is a file here, see ARCHITECTURE.md. Begin with diffuse.
"""

from __future__ import annotations

import pkgutil
from importlib import import_module

from .base import Material


def material_kinds() -> dict[str, type[Material]]:
    """Return all subclasses of `Material`, by name in lower case: those of this folder and those of callers."""
    for file in pkgutil.iter_modules(__path__):
        import_module(f"{__name__}.{file.name}")
    return {known.__name__.lower(): known for known in Material.__subclasses__()}
