"""Whether the library of kernels is there."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import pointray
from pointray.base.dependencies import key_of
from pointray.engine.jit import library

PACKAGE = Path(pointray.__file__).parent


def is_there() -> bool:
    """Return whether there is a library built from the current sources."""
    try:
        kernels = json.loads((library.FOLDER / library.MANIFEST).read_text())["kernels"]
    except FileNotFoundError:
        return False
    return kernels["pointray.surface.tree.wide.enclose"]["key"] == key_of([PACKAGE / "surface" / "tree" / "wide.py"])


needs_library = pytest.mark.skipif(not is_there(), reason="no compiled kernels of these sources (make kernels)")
