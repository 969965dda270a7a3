"""Materials: how a surface scatters light; one file a kind, with its class and with what kernels evaluate and sample.

Colours are linear RGB or an `Attribute`; None takes the points' own. Opaque materials shade both sides. None of them
reflects more light than it receives, and all are reciprocal.

base : what all share; diffuse, phong, principled; specular : mirrors and glass

`shade/bsdf.py` calls the functions of each kind. A new kind is a file here, see ARCHITECTURE.md. Begin with diffuse.
"""

from __future__ import annotations

import pkgutil
from importlib import import_module

from .base import Material


def material_kinds() -> dict[str, type[Material]]:
    """All classes of materials, by their names in lower case: those of the files here, and those of callers."""
    for file in pkgutil.iter_modules(__path__):
        import_module(f"{__name__}.{file.name}")
    return {known.__name__.lower(): known for known in Material.__subclasses__()}
