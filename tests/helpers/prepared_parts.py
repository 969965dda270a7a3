"""Models in parts, prepared in small parts."""

from pathlib import Path

import pointray as pr
from pointray.io.files import request_of
from pointray.io.selection import Selection
from pointray.model.out_of_core.prepare import prepare
from pointray.surface.splats.scattered.spheres import ALL_SURFACE
from pointray.surface.tree.settings import check_settings

SIZE = 1 << 14


def prepared(file, folder, size=SIZE, smooth="auto"):
    """The model in parts of a file, made part by part."""
    reading = request_of(), Selection(1, None, None, None, None)
    settings = check_settings("apss", 4, 1, "auto"), smooth, ALL_SURFACE
    prepare([Path(file)], reading, folder, settings, size)
    return pr.Model.load(folder)
